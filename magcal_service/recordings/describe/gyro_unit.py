"""The unit of a gyro, by how the measured field turns."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]

SURE: Final = 0.5  # share of the field's changes that a turn explains where the gyro's unit is told by them
_CLOSE: Final = (0.7, 1.4)  # of a unit's size: gyro and field are sampled at other moments, and the field has scales
_LEAST_ROWS: Final = 50  # with a neighbour; choice: fewer leave the turn to noise
_DEG: Final = np.pi / 180.0  # radians per degree
_UNITS: Final = {"rad/s": 1.0, "deg/s": _DEG, "mrad/s": 1e-3, "rpm": np.pi / 30.0}


@dataclass(frozen=True, slots=True)
class Turning:
    """How the field turns with a gyro.

    Parameters
    ----------
    rad_s: what one unit of the gyro is [rad/s]; negative where it counts the other way.
    unit: the unit that this is; empty where it is none.
    """

    rad_s: float
    unit: str

    @property
    def as_counts(self) -> str:
        """One count in words."""
        return f"one of them is {self.rad_s / _DEG:.3g} deg/s"


def by_turning(
    rates: FloatArray, field: FloatArray, seconds: FloatArray, neighbours: npt.NDArray[np.bool_]
) -> Turning | None:
    """The size of a gyro's unit: dB/dt = -w x (B - b), with the bias b as a free vector.

    None where the field does not turn with it.
    """
    step = np.diff(seconds)
    middle = 0.5 * (field[1:] + field[:-1])
    rate = 0.5 * (rates[1:] + rates[:-1])
    good = neighbours & (step > 0) & np.isfinite(middle).all(axis=1) & np.isfinite(rate).all(axis=1)
    if good.sum() < _LEAST_ROWS:
        return None
    step, middle, rate, change = step[good], middle[good], rate[good], np.diff(field, axis=0)[good]
    turned = -np.cross(rate, middle) * step[:, None]
    zero = np.zeros(len(step))
    x, y, z = rate.T * step
    of_bias = np.stack([np.column_stack([zero, z, -y]), np.column_stack([-z, zero, x]), np.column_stack([y, -x, zero])])
    terms = np.concatenate([np.column_stack([turned[:, i], -of_bias[i]]) for i in range(3)])
    wanted = change.T.reshape(-1)
    solution, *_ = np.linalg.lstsq(terms, wanted, rcond=None)
    explained = 1.0 - float(((wanted - terms @ solution) ** 2).sum() / max(float((wanted**2).sum()), 1e-30))
    if explained <= SURE:
        return None
    size = float(solution[0])
    low, high = _CLOSE
    return Turning(size, next((unit for unit, one in _UNITS.items() if low * one < size < high * one), ""))
