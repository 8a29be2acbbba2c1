"""A model's terms and curves, told apart once by what is done with them live."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from magcal_service.physics.acting import ActsOn, Direct
from magcal_service.physics.apply.empirical import Empirical, Kind
from magcal_service.physics.apply.model_file import ModelTerm, PhysicsModel
from magcal_service.physics.catalogue import effect_named
from magcal_service.physics.drivers.temperature import SETTLING

WARMTH: Final = "inferred:temperature"
"""Driver of the effects whose temperature at the start is not known elsewhere."""

_BY_ATTITUDE: Final = ("computed:sun_x", "computed:sun_y", "computed:sun_z")


@dataclass(frozen=True, slots=True, eq=False)
class LiveTerms:
    """The terms and curves of one model.

    Parameters
    ----------
    field: those that disturb the sensor.
    direct: of each of those, how it is computed without a scene; None where it needs one.
    groups: for those (by their place) that an inferred temperature drives, the number of their temperature.
    growth: those that act on the reference's magnitude.
    time: those that act on its time.
    curves: curves without a name that disturb the sensor.
    grown: those that act on the reference's magnitude.
    needs_scene: whether a sample takes a scene.
    needs_attitude: whether the craft's attitude may be asked for.
    """

    field: tuple[ModelTerm, ...]
    direct: tuple[Direct | None, ...]
    groups: Mapping[int, int]
    growth: tuple[ModelTerm, ...]
    time: tuple[ModelTerm, ...]
    curves: tuple[Empirical, ...]
    grown: tuple[Empirical, ...]
    needs_scene: bool
    needs_attitude: bool


def live_terms(model: PhysicsModel) -> LiveTerms:
    """A model's terms and curves by what they act on."""
    field = tuple(term for term in model.terms if not _acts_on(term).is_reference)
    direct = tuple(effect_named(term.effect).direct(term) for term in field)
    curves = tuple(curve for curve in model.empirical if curve.kind is not Kind.MAGNITUDE)
    return LiveTerms(
        field=field,
        direct=direct,
        groups=_groups_of(field),
        growth=tuple(term for term in model.terms if _acts_on(term) is ActsOn.REFERENCE),
        time=tuple(term for term in model.terms if _acts_on(term) is ActsOn.REFERENCE_TIME),
        curves=curves,
        grown=tuple(curve for curve in model.empirical if curve.kind is Kind.MAGNITUDE),
        needs_scene=not all(direct) or not all(curve.is_recorded for curve in curves),
        needs_attitude=not all(direct) or any(curve.driver in _BY_ATTITUDE for curve in curves),
    )


def _groups_of(terms: Sequence[ModelTerm]) -> dict[int, int]:
    """For each term (by its place) that an inferred temperature drives, the number of its temperature among others.

    What only settles has none: from another start it is waited for.
    """
    numbers: dict[tuple[float, ...], int] = {}
    found = {}
    for index, term in enumerate(terms):
        if term.driver == WARMTH and SETTLING not in term.variant:
            constants = tuple(float(np.max(term.nonlinear.get(name, 0.0))) for name in ("time_constant_s", "skin_s"))
            found[index] = numbers.setdefault(constants, len(numbers))
    return found


def _acts_on(term: ModelTerm) -> ActsOn:
    return effect_named(term.effect).acts_on
