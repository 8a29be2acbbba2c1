"""The forms of an effect on the clean scene, and what they add there."""

from __future__ import annotations

import numpy as np

from magcal_service.model import Array
from magcal_service.physics.catalogue import effect_named
from magcal_service.physics.interface import Hypothesis
from magcal_service.physics.scene.scene import Scene
from tests.physics.scenes import scene

TIME_S, SPAN_S = scene().time_s, float(scene().time_s[-1])
FIELD, UNIT = scene().clean_field_nt, scene().unit


def forms(name: str, of: Scene | None = None) -> dict[tuple[str, str], Hypothesis]:
    """The forms of an effect by driver and variant."""
    return {(form.driver, form.variant): form for form in effect_named(name).hypotheses(of or scene())}


def added(form: Hypothesis, amplitudes: object, *theta: float) -> Array:
    """The body field (n, 3) of amplitudes, given in the shape of the results."""
    return form.columns(np.array(theta)).field(np.asarray(amplitudes, dtype=float).reshape(-1))
