"""The unit of a gyro, by how the measured field turns: where a log is described, and as a check of a descriptor."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from magcal_service.base.units import CHANNEL_UNITS
from magcal_service.recordings.inspect.finding import Code, Seen
from magcal_service.recordings.inspect.log import Log
from magcal_service.recordings.recording import Channel

FloatArray = npt.NDArray[np.float64]

SURE: Final = 0.5  # share of the field's changes that a turn explains where the gyro's unit is told by them
_CLOSE: Final = (0.7, 1.4)  # of a unit's size: gyro and field are sampled at other moments, and the field has scales
_LEAST_ROWS: Final = 50  # with a neighbour; choice: fewer leave the turn to noise
_DEG: Final = np.pi / 180.0  # radians per degree
_MOST: Final = 20_000  # rows: more only take time
_LONGEST_TURN: Final = 0.35
"""Radians between rows: beyond, a difference is no derivative."""

_LEAST_RAD_S: Final = 5e-3
"""Five times what the field itself turns at along a low orbit: below that it is not the craft that turns it."""
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


def gyro_unit(log: Log) -> Iterator[Seen]:
    """A gyro whose numbers turn as the field does in another unit than the described one."""
    if len(log) < _LEAST_ROWS:
        return
    first = slice(0, _MOST)
    field, seconds = log.field_nt[first], log.time_s[first]
    step = np.diff(seconds)
    neighbours = (step > 0.0) & (step < 3.0 * log.step_s)
    turn = np.linalg.norm(np.diff(field, axis=0), axis=1) / np.linalg.norm(field[1:], axis=1)
    if not neighbours.any() or float(np.median(turn[neighbours])) > _LONGEST_TURN:
        return
    for gyro in log.recording.channels.values():
        if not is_gyro(gyro):
            continue
        rates = gyro.values[log.rows[first]]
        turning = by_turning(rates, field, seconds, neighbours)
        told = CHANNEL_UNITS[gyro.spec.unit].factor
        if turning is None or not turning.unit or _CLOSE[0] < turning.rad_s / told < _CLOSE[1]:
            continue
        if float(np.nanmedian(np.linalg.norm(rates, axis=1))) * turning.rad_s < _LEAST_RAD_S:
            continue
        name, unit = gyro.spec.name, turning.unit
        says = f"the field turns with the channel {name} as it would in {unit}, not in {gyro.spec.unit}: "
        says += turning.as_counts
        yield Seen(Code.GYRO_UNIT, False, log.rows, says, f'check channels.{name}: if it is so, write unit = "{unit}"')


def is_gyro(channel: Channel) -> bool:
    """Whether a channel can be the craft's rate."""
    return channel.spec.quantity == "angular rate" and len(channel.spec.columns) == 3
