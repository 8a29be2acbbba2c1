"""What numbers can be a magnetic field near the Earth, and in which unit."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from magcal_service.base.units import FIELD_NT, FieldUnit

FloatArray = npt.NDArray[np.float64]

EARTH_NT: Final = (18e3, 75e3)
"""The field from the highest orbit at the equator to the ground at the poles, with a tenth to spare."""

_DISTURBED_NT: Final = (1.5e3, 3e5)
"""What an uncalibrated sensor in an airframe, a craft or a coil can read."""

_TURNED_NT: Final = (11e3, 120e3)
"""The radius of a turned sensor's sphere: the Earth's field, and a scale that may be a good third off."""

_FEWEST: Final = 12  # vectors that a sphere is fitted to
_SPREAD: Final = 0.35
"""Of the radius: a cloud thinner than that in a direction has no centre in it."""

_ROUGHEST: Final = 0.25  # of the radius: beyond that a cloud is no shell
_LEAST_CHANGE: Final = 0.1  # of F^2 along the rows: below that there is nothing to follow
_EXPLAINED: Final = 0.8  # of its changes: then the sensor follows the model, and its scale is known
_NEAR: Final = 1.3  # between the fitted scale and that of a unit: a sensor's own error


@dataclass(frozen=True, slots=True)
class Size:
    """How long vectors are.

    Parameters
    ----------
    usual: their usual length.
    radius: that of a sphere through them; None where they show none.
    roughness: standard deviation of their distance from its centre, of the radius; 1 where there is none.
    """

    usual: float
    radius: float | None
    roughness: float = 1.0

    @property
    def best(self) -> float:
        """The radius where it is known, else the usual length."""
        return self.usual if self.radius is None else self.radius

    @property
    def shown(self) -> str:
        """What ``best`` is, in words."""
        return "their usual size" if self.radius is None else "the radius of the sphere through them"

    def of(self, label: str) -> str:
        """What ``best`` is of columns, in words."""
        return f"the usual size of {label}" if self.radius is None else f"the radius of the sphere through {label}"


def in_earth_field(length: float, unit: str) -> bool:
    """Whether a length in a unit is one that the Earth's field can have."""
    return EARTH_NT[0] <= length * FIELD_NT[FieldUnit(unit)] <= EARTH_NT[1]


def size_of(vectors: FloatArray, *, still: bool = False) -> Size | None:
    """The size of vectors (n, 3); None where too few are finite, or they never change and are not allowed to."""
    good = vectors[np.isfinite(vectors).all(axis=1)]
    if len(good) < 2 or (not still and float(np.ptp(good, axis=0).max()) == 0.0):
        return None
    lengths = np.sqrt((good**2).sum(axis=1))
    return Size(float(np.quantile(lengths, 0.8)), *_sphere(good))


def _sphere(vectors: FloatArray) -> tuple[float | None, float]:
    """Radius and roughness of the sphere through a cloud; None and 1 where the cloud is no shell."""
    if len(vectors) < _FEWEST:
        return None, 1.0
    scale = float(np.abs(vectors).max())
    if scale == 0.0:
        return None, 1.0
    unit = vectors / scale
    terms = np.column_stack([2.0 * unit, np.ones(len(unit))])
    solution, *_ = np.linalg.lstsq(terms, (unit**2).sum(axis=1), rcond=None)
    squared = float(solution[3] + solution[:3] @ solution[:3])
    if squared <= 0.0:
        return None, 1.0
    radius = float(np.sqrt(squared))
    from_centre = unit - solution[:3]
    least = float(np.sqrt(max(np.linalg.eigvalsh(np.cov(from_centre.T))[0], 0.0)))
    roughness = float((np.sqrt((from_centre**2).sum(axis=1)) - radius).std()) / radius
    if least < _SPREAD * radius or roughness > _ROUGHEST:
        return None, 1.0
    return radius * scale, roughness


def scale_by_model(vectors: FloatArray, model_nt: FloatArray) -> float | None:
    """Nanotesla in one unit of the vectors, where a model's changes show it; None where they do not.

    A bias b and one scale s leave |s m - b|^2 = F^2, so F^2 = s^2 |m|^2 - 2 s b m + b^2 is linear in the rest: a fit
    over the rows (n, 3) and (n,) with what it explains of the model's changes.
    """
    return _fit_to_model(vectors, model_nt)[0]


def differs_from_model(vectors: FloatArray, model_nt: FloatArray) -> bool:
    """Whether a model's magnitudes (n,) change along the rows, and those of the vectors (n, 3) do not with them."""
    scale, told = _fit_to_model(vectors, model_nt)
    return told and scale is None


def _fit_to_model(vectors: FloatArray, model_nt: FloatArray) -> tuple[float | None, bool]:
    """The scale, None where the vectors do not follow; and whether the model changes enough to tell."""
    good = np.isfinite(vectors).all(axis=1) & np.isfinite(model_nt)
    if good.sum() < 4 * _FEWEST:
        return None, False
    m, f2 = vectors[good] / float(np.abs(vectors[good]).max()), model_nt[good] ** 2
    f2 = f2 / float(f2.max())
    if float(f2.std()) < _LEAST_CHANGE:
        return None, False
    terms = np.column_stack([(m**2).sum(axis=1), m, np.ones(len(m))])
    solution, *_ = np.linalg.lstsq(terms, f2, rcond=None)
    explained = 1.0 - float(((f2 - terms @ solution) ** 2).sum()) / float(((f2 - f2.mean()) ** 2).sum())
    if explained < _EXPLAINED or solution[0] <= 0.0:
        return None, True
    scale = float(np.sqrt(solution[0])) * float(model_nt[good].max()) / float(np.abs(vectors[good]).max())
    return scale, True


@dataclass(frozen=True, slots=True)
class UnitFound:
    """A unit of vectors or magnitudes: empty where open, whether it is sure, and the evidence.

    Parameters
    ----------
    possible: units that the numbers allow, the likeliest first.
    factor: what a number is multiplied by to be in the unit.
    """

    unit: str
    sure: bool
    why: str
    possible: tuple[str, ...]
    factor: float = 1.0

    @property
    def unit_nt(self) -> float:
        """Nanotesla per 1 of a number; only where there is a unit."""
        return self.factor * FIELD_NT[FieldUnit(self.unit)]


def find_unit(size: Size | None, said: str, *, whole: bool, expected_nt: float | None = None) -> UnitFound:
    """The unit by what the names say and what the numbers can be.

    Parameters
    ----------
    said: the unit that the names say, empty where none.
    whole: whether all are whole numbers: raw counts of a sensor look like that.
    expected_nt: the field [nT] that a model or a reference has there, where known.
    """
    if size is None:
        return UnitFound("", False, "the numbers never change", ())
    units = [unit.value for unit in FieldUnit]
    band = EARTH_NT if expected_nt is None else (0.6 * expected_nt, 1.6 * expected_nt)
    tight = tuple(u for u in units if band[0] <= size.best * FIELD_NT[FieldUnit(u)] <= band[1])
    loose = tuple(u for u in units if _DISTURBED_NT[0] <= size.usual * FIELD_NT[FieldUnit(u)] <= _DISTURBED_NT[1])
    if not said and size.radius is not None:  # a sphere has no bias in it: it is the field or raw counts
        loose = tuple(u for u in units if _TURNED_NT[0] <= size.radius * FIELD_NT[FieldUnit(u)] <= _TURNED_NT[1])
    possible = tight + tuple(u for u in loose if u not in tight)
    shown = size.shown
    if said:
        return _said_unit(size, said, shown, possible)
    if len(tight) != 1:
        return UnitFound("", False, f"no name says the unit, and {shown} is {size.best:.4g}", possible)
    if whole and expected_nt is None:
        why = f"no name says it, and whole numbers may be raw counts ({shown} is {size.best:.4g})"
        return UnitFound("", False, why, possible)
    amount = size.best * FIELD_NT[FieldUnit(tight[0])] / 1e3
    why = f"no name says it; of all units only {tight[0]} gives a field near the Earth's ({shown} is {amount:.3g} uT"
    why += f", where {expected_nt / 1e3:.3g} uT are expected)" if expected_nt is not None else ")"
    return UnitFound(tight[0], True, why, possible)


def _said_unit(size: Size, said: str, shown: str, possible: tuple[str, ...]) -> UnitFound:
    """The unit that the names say, where the numbers can be that."""
    if said not in list(FieldUnit):
        return UnitFound("", False, f"the names say {said}, which is no unit of a field", ())
    amount = size.best * FIELD_NT[FieldUnit(said)] / 1e3
    if said in possible:
        return UnitFound(said, True, f"the names say {said}, and {shown} is {amount:.3g} uT", possible)
    why = f"the names say {said}, but {shown} would be {amount:.3g} uT, where 18 to 75 uT are usual near the Earth"
    return UnitFound("", False, why, possible)


def unit_by_model(said: str, scale_nt: float | None) -> UnitFound | None:
    """The unit where a sensor follows the field model and its scale is one unit's; None where it tells nothing."""
    if scale_nt is None:
        return None
    near = [u.value for u in FieldUnit if 1.0 / _NEAR < scale_nt / FIELD_NT[u] < _NEAR]
    if not near:
        return None
    if said in {"", near[0]}:
        names = "the names say so, and" if said else "no name says it, but"
        ratio = scale_nt / FIELD_NT[FieldUnit(near[0])]
        why = f"{names} the length follows IGRF along the way and its scale is {ratio:.2f} times that of {near[0]}"
        return UnitFound(near[0], True, why, (near[0],))
    why = f"the names say {said}, but the length follows IGRF along the way with the scale of {near[0]}"
    return UnitFound("", False, why, (near[0], said) if said in list(FieldUnit) else (near[0],))
