"""What a ``physics.toml`` adds on a scene as a whole, without an estimator between."""

from __future__ import annotations

import numpy as np

from magcal_service.model import Array
from magcal_service.physics.apply.forward import at_origin, bind, followed, less
from magcal_service.physics.apply.model_file import PhysicsModel
from magcal_service.physics.catalogue import effect_named
from magcal_service.physics.scene.scene import Scene


def effects_on(scene: Scene, model: PhysicsModel) -> tuple[Array, Array]:
    """What a model's effects and curves add on a scene.

    Parameters
    ----------
    scene: with ``calibrated_nt`` and ``clean_field_nt`` by the model's nine errors, as ``recordings.scene_of.cleaned``
        makes them.
    model: from ``physics.toml``.

    Returns (d, m): body field (n, 3) and growth of the reference's magnitude (n,) [nT], as in ``physics.interface``.
    Raises DriverMissingError, MisfitError.
    """
    body, magnitude = np.zeros((len(scene), 3)), np.zeros(len(scene))
    placed = at_origin(scene, model)
    for term in model.terms:
        field, growth = bind(term, placed).disturbance()
        if effect_named(term.effect).bends:
            field, growth = bind(term, less(placed, field, model.x)).disturbance()
        body += field
        magnitude += growth
    for curve in model.empirical:
        field, growth = curve.disturbance(followed(curve, placed), placed.clean_field_nt)
        body += field
        magnitude += growth
    return body, magnitude
