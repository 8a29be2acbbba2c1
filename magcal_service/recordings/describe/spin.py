"""A steady spin that the measured field shows: offered, not concluded, for only its owner knows if it is meant."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from magcal_service.base.errors import Fault, InputRefusedError
from magcal_service.recordings.describe.draft import Draft, Question, answered
from magcal_service.recordings.describe.times_found import Times

FloatArray = npt.NDArray[np.float64]

_LEAST_RPM: Final = 0.1  # ten times what a craft that looks at the Earth turns at: that is no spin
_LEAST_TURNS: Final = 3.0  # in one stretch of rows; choice: fewer may be a manoeuvre
_PLANE: Final = 0.05
"""Of the changes' mean square, what may lie along the axis; choice: a circle of 1 rpm at 1 Hz in 300 nT has 0.01."""
_ROUND: Final = 0.3  # the lesser over the greater mean square across the axis: scale errors of 30 % are within 0.5
_STEADY: Final = 0.9  # mean length of the changes' turns, each a unit vector; noise alone has 0.5
_SAME: Final = 0.05  # share by which the first and the second half may differ in rate
_FAR_RAD: Final = 0.5  # turn between rows at which nothing is gained by rows that are further apart
_FAST_RAD: Final = np.pi / 2.0  # turn between rows from which a faster one that looks the same is worth a word
_NEAR_DEG: Final = 10.0  # an axis this near to one of the sensor's is called by its letter
_OTHER_DEG: Final = 20.0  # an answered axis further off is another one, and the rate about it was not measured
_PARTS: Final = 8  # of a stretch, whose axes and rates show how well the whole has them
_FIELD_RPM: Final = 0.02  # what the field itself turns along an orbit, at most
_COARSEST: Final = 0.05  # of the rate, one unit of its last digit; choice: half of it is a quarter of what is noticed
_LETTERS: Final = ("x", "y", "z")


@dataclass(frozen=True, slots=True)
class SteadySpin:
    """What the field shows.

    Parameters
    ----------
    axis: unit vector (3,) in the sensor's axes.
    rate_rpm: about +axis.
    turns: in the longest stretch that was looked at.
    step_rad: turn from row to row.
    axis_sigma_deg, rate_sigma_rpm: 1 sigma, by how parts of the stretch differ.  The field's own turning (up to
        0.02 rpm along an orbit) and the sensor's scale errors (some degrees at 0.1) come on top.
    """

    axis: FloatArray
    rate_rpm: float
    turns: float
    step_rad: float
    axis_sigma_deg: float
    rate_sigma_rpm: float

    @property
    def letter(self) -> str:
        """The axis of the sensor that is near; empty where none is."""
        nearest = int(np.argmax(np.abs(self.axis)))
        return _LETTERS[nearest] if _off_deg(self.axis, np.eye(3)[nearest]) <= _NEAR_DEG else ""

    @property
    def vector_text(self) -> str:
        """The axis as a vector that can be answered."""
        return ",".join(f"{part:.4f}" for part in self.axis)

    @property
    def named(self) -> SteadySpin:
        """The same about that axis of the sensor which is near, or else with a positive rate."""
        nearest = int(np.argmax(np.abs(self.axis)))
        sign = np.sign(self.axis[nearest]) if self.letter else np.sign(self.rate_rpm)
        return replace(self, axis=self.axis * sign, rate_rpm=float(self.rate_rpm * sign))


def find_spin(draft: Draft, field_nt: FloatArray | None, times: Times | None) -> None:
    """Offer a steady spin, or put down the one that was answered."""
    given, rate = draft.answers.get("spin.axis"), draft.answers.get("spin.rate_rpm")
    seen = None if field_nt is None or times is None else steady_spin(field_nt, times.seconds, draft.log.block)
    if given is None:
        if rate is not None:
            raise InputRefusedError([Fault("--answer spin.rate_rpm", rate, "spin.axis is to be answered as well")])
        if seen is not None:
            draft.ask(_question(seen.named))
        return
    axis = _axis(given)
    draft.put("spin", "axis", given if given in _LETTERS else [float(part) for part in axis])
    value = None if rate is None else _rate(rate)
    if seen is not None and value is None and _off_deg(seen.axis, axis) <= _OTHER_DEG:
        value = _to_its_digits(seen.rate_rpm * float(np.sign(seen.axis @ axis)), seen.rate_sigma_rpm)
        why = f"so the measured field turns, 1 sigma {seen.rate_sigma_rpm:.1g} beside its own turning along an orbit"
        draft.conclude("spin.rate_rpm", f"{value:g}", why)
    if value is not None:
        draft.put("spin", "rate_rpm", value)
    draft.conclude("spin.axis", given, answered("spin.axis"))


def _to_its_digits(rate_rpm: float, sigma_rpm: float) -> float:
    """A rate [rpm] to the last digit that is sure, so that what it may be off is not taken for a change of the spin.

    A slow one keeps three digits: the windows of the spin need it to a few percent.
    """
    unit = 10.0 ** math.ceil(math.log10(2.0 * (_FIELD_RPM + 3.0 * sigma_rpm)))
    if unit > _COARSEST * abs(rate_rpm):
        return float(f"{rate_rpm:.3g}")
    return float(f"{round(rate_rpm / unit) * unit:.9g}")


def _question(seen: SteadySpin) -> Question:
    letter = seen.letter
    about = f"about the sensor's {letter}" if letter else "about an axis of its own"
    sigmas = f"1 sigma {seen.rate_sigma_rpm:.1g} rpm and {seen.axis_sigma_deg:.1g} deg"
    asks = f"the field turns steadily, at {seen.rate_rpm:.3g} rpm {about} ({seen.turns:.0f} turns looked at; {sigmas}, "
    asks += "beside up to 0.02 rpm that the field itself turns along an orbit)"
    if abs(seen.step_rad) > _FAST_RAD:
        asks += "; or faster: between two rows it may have gone round more often"
    asks += ". A craft that spins so is calibrated better where [spin] says it. Does it?"
    measured = (seen.vector_text, "as measured; scale errors of the sensor turn it by some degrees")
    off = _off_deg(seen.axis, np.eye(3)[_LETTERS.index(letter)]) if letter else 0.0
    candidates = ((letter, f"{off:.1f} deg from the measured one"), measured) if letter else (measured,)
    return Question("spin.axis", asks, candidates, candidates[0][0], needed=False)


def steady_spin(field_nt: FloatArray, seconds: FloatArray, block: npt.NDArray[np.int64]) -> SteadySpin | None:
    """The spin of rows that belong together by ``block`` (n,); None where there is no steady one.

    The field's changes lie across the axis whatever the sensor's bias, and turn at the rate of the spin.
    """
    runs = [np.flatnonzero(block == number) for number in np.unique(block)]
    usable = [run for run in runs if np.isfinite(field_nt[run]).all() and np.isfinite(seconds[run]).all()]
    if not usable:
        return None
    longest = max(usable, key=len)
    best, apart = None, 1
    while apart * 8 <= len(longest):
        found = _at(field_nt[longest], seconds[longest], apart)
        if found is not None:
            best = found
            if abs(found.step_rad) * apart > _FAR_RAD:
                break
        apart *= 2
    if best is None or abs(best.rate_rpm) < _LEAST_RPM or best.turns < _LEAST_TURNS:
        return None
    return best


def _at(field: FloatArray, seconds: FloatArray, apart: int) -> SteadySpin | None:
    """The spin by rows that are ``apart`` rows from each other."""
    field, seconds = field[::apart], seconds[::apart]
    steps = np.diff(seconds)
    period = float(np.median(steps))
    even = np.abs(steps - period) < 0.2 * period
    pairs = even[1:] & even[:-1]
    if period <= 0.0 or pairs.sum() < 6:
        return None
    change = np.diff(field, axis=0)
    used = change[even]
    squares, axes = np.linalg.eigh(used.T @ used)
    if squares[0] > _PLANE * squares[1:].mean() or squares[1] < _ROUND * squares[2]:
        return None
    axis = axes[:, 0]
    first = axes[:, 1]
    across = change @ first + 1j * (change @ np.cross(axis, first))
    turn = (across[1:] * np.conj(across[:-1]))[pairs]
    turn = turn / np.maximum(np.abs(turn), np.finfo(np.float64).tiny)
    half = len(turn) // 2
    mean = complex(turn.mean())
    early, late = (float(np.angle(part.mean() / mean)) for part in (turn[:half], turn[half:]))
    step = float(np.angle(mean))
    if abs(mean) < _STEADY or abs(early - late) > _SAME * abs(step):
        return None
    rates = _rates(across[even], seconds[1:][even], step / period)
    turns = abs(step) * len(field) / (2.0 * np.pi)
    spread = _off_deg_all([np.linalg.eigh(part.T @ part)[1][:, 0] for part in np.array_split(used, _PARTS)], axis)
    return SteadySpin(
        axis,
        -rates.whole * 30.0 / np.pi,  # the field goes round against the body
        turns,
        step / apart,
        axis_sigma_deg=spread / np.sqrt(_PARTS),
        rate_sigma_rpm=rates.sigma * 30.0 / np.pi,
    )


class _Rates(NamedTuple):
    whole: float
    sigma: float


def _rates(across: npt.NDArray[np.complex128], seconds: FloatArray, about_rad_s: float) -> _Rates:
    """The rate [rad/s] at which a vector turns in its plane (n,), near a known one, and its 1 sigma by parts."""
    seconds = seconds - seconds[0]
    left = np.unwrap(np.angle(across * np.exp(-1j * about_rad_s * seconds)))
    slopes = [
        float(np.polyfit(at - at.mean(), part, 1)[0])
        for at, part in zip(np.array_split(seconds, _PARTS), np.array_split(left, _PARTS), strict=True)
        if len(at) > 2
    ]
    whole = float(np.polyfit(seconds - seconds.mean(), left, 1)[0])
    return _Rates(about_rad_s + whole, float(np.std(slopes)) / np.sqrt(len(slopes)) if len(slopes) > 1 else np.inf)


def _off_deg_all(axes: list[FloatArray], axis: FloatArray) -> float:
    """Rms angle of axes from one [deg]."""
    return float(np.sqrt(np.mean([_off_deg(one, axis) ** 2 for one in axes])))


def _off_deg(one: FloatArray, other: FloatArray) -> float:
    """Angle between two axes, whichever way they point [deg]."""
    return float(np.degrees(np.arccos(np.clip(abs(float(one @ other)), 0.0, 1.0))))


def _axis(given: str) -> FloatArray:
    if given in _LETTERS:
        one: FloatArray = np.eye(3)[_LETTERS.index(given)]
        return one
    try:
        axis = np.array([float(part) for part in given.split(",")])
    except ValueError:
        axis = np.zeros(0)
    length = float(np.sqrt((axis**2).sum()))
    if axis.shape != (3,) or not np.isfinite(length) or length == 0.0:
        raise InputRefusedError([Fault("--answer spin.axis", given, "x, y, z or a vector such as 0,0.1,1 is accepted")])
    return axis / length


def _rate(given: str) -> float:
    try:
        rate = float(given)
    except ValueError:
        rate = float("nan")
    if not np.isfinite(rate):
        raise InputRefusedError([Fault("--answer spin.rate_rpm", given, "a number [rpm] about +axis is accepted")])
    return rate
