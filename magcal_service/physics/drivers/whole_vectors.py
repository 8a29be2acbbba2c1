"""What only whole vectors show beside a recorded attitude: samples of another time than the attitude's, or answers that
come late.

A vector that is late points elsewhere as soon as the craft turns, whatever the field's size does.  A clock that is off
by s gives w(t + s) = w + s w' + s^2 w'' / 2.  What answers late does so as well, to first order; a low-pass, for which
tau w' = A H - w, by -tau w' and nothing else.  So where the craft turns little in that time, nothing tells the two.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Final

import numpy as np

from magcal_service.model import Array
from magcal_service.physics.columns import Columns
from magcal_service.physics.interface import START, Block, Hypothesis, Nonlinear
from magcal_service.physics.scene.memory import AT_START_S
from magcal_service.physics.scene.scene import Scene
from magcal_service.physics.scene.sunlight import carried, first_order

_MOST_TURN: Final = 0.5
"""Turn of the field in the body in between [rad], at the most: a search takes less where the craft turns so far."""

LARGEST_NT: Final = 30_000.0
"""What so much of the largest field is [nT]: vectors of another attitude are off by that, whatever their size is."""

_LEAST_LATE_S: Final = 1e-3  # less turns the field by less than a thousandth on any craft

_AT_START: Final = 0.4
"""Turn [rad] over which the first samples of a stretch tell how it begins; choice: of a turn that changes as quickly, a
parabola over half of it left four times as much."""

_FEWEST_AT_START, _MOST_AT_START = 5, 15  # samples; choice: one more than a cubic has, and what tells noise apart


def another_time(scene: Scene, effect: str, variant: str, name: str, sign: float, longest_s: float) -> Hypothesis:
    """Samples of another time than the attitude that is recorded with them.

    While it is not known by how much, it is expanded; then vectors so much later take the place of those without it.

    Parameters
    ----------
    name: of its amplitude [s], which is positive.
    sign: 1 of samples ahead of the attitude, -1 of those behind.
    longest_s: amplitude at most [s]; a search takes less where the craft turns by half a radian in less.
    """
    slope = scene.field_slope
    rate = float(np.sqrt(np.mean(slope**2) / max(float(np.mean(scene.calibrated_nt**2)), 1e-300)))
    most = min(longest_s, _MOST_TURN / max(rate, 1e-9))
    found_s = sign * _moved_s(scene)
    column: Array = sign * slope
    if _LEAST_LATE_S < found_s <= most:
        column = (_of_another_time(scene, sign * found_s) - scene.calibrated_nt) / found_s
    return Hypothesis(
        effect,
        "none",
        partial(_alone, column),
        (Block(name, "s", (), most=longest_s if scene.is_given else most, least=0.0),),
        variant,
        needs_vectors=True,
        moves_s=partial(_moved, sign),
    )


def answers_late(scene: Scene, effect: str, variant: str, name: str, longest_s: float) -> Iterator[Hypothesis]:
    """A first-order low-pass of the whole vector, and the same from any other start than the turn before tells.

    While it is not known how late, to first order; then the whole of what so long a time constant does is one unit of
    the amplitude for each of its seconds.

    Parameters
    ----------
    name: of its amplitude, the time constant [s].
    longest_s: the longest there is [s].
    """
    found_s = max(-_moved_s(scene), 0.0)
    begins = scene.memory is None and abs(float(scene.time_s[0])) < AT_START_S

    def late(theta: Array) -> Array:
        """(n, 3) per second of a time constant, by the whole of one."""
        tau_s = float(theta[0])
        if tau_s <= _LEAST_LATE_S:
            return -_slope(scene)
        return np.asarray((_low_passed(scene, tau_s) - scene.calibrated_nt) / tau_s)

    def begun(theta: Array) -> Columns:
        fading = np.exp(-(scene.time_s - scene.time_s[0]) / max(float(theta[0]), scene.period_s))
        other = fading[:, None] * np.eye(3)[:, None, :] if begins else np.zeros((3, len(scene), 3))
        return Columns(body=np.concatenate([late(theta)[None], other]))

    block = Block(name, "s", (), most=longest_s, least=0.0)
    plain = Hypothesis(
        effect,
        "none",
        lambda theta: Columns(body=late(theta)[None]),
        (block,),
        variant,
        (Nonlinear("expanded_at_s", "s", np.array([found_s]), "held"),),
        needs_vectors=True,
        moves_s=partial(_moved, -1.0),
    )
    yield plain
    yield replace(
        plain,
        columns=begun,
        blocks=(block, Block(f"{START}nt", "nT", (3,))),
        variant=f"{variant}, from its start",
        refines=plain.label,
    )


def _moved_s(scene: Scene) -> float:
    return 0.0 if scene.moved_s is None else float(np.mean(scene.moved_s))


def _of_another_time(scene: Scene, ahead_s: float) -> Array:
    """(n, 3) the vectors so much later in each stretch [nT], by cubics between samples and on the circle beyond."""
    slope, found = _slope(scene), np.empty_like(scene.calibrated_nt)
    ends = [*scene.pauses[1:].tolist(), len(scene)]
    for first, end in zip(scene.pauses.tolist(), ends, strict=True):
        time_s, value, rise = scene.time_s[first:end], scene.calibrated_nt[first:end], slope[first:end]
        if end - first < 2:
            found[first:end] = value + ahead_s * rise
            continue
        at = np.clip(np.searchsorted(time_s, time_s + ahead_s) - 1, 0, end - first - 2)
        step = (time_s[at + 1] - time_s[at])[:, None]
        share = np.clip((time_s + ahead_s - time_s[at])[:, None] / step, 0.0, 1.0)
        left = (1.0 - share) ** 2 * ((1.0 + 2.0 * share) * value[at] + share * step * rise[at])
        right = share**2 * ((3.0 - 2.0 * share) * value[at + 1] - (1.0 - share) * step * rise[at + 1])
        found[first:end] = left + right
        for edge, side in ((0, slice(None)), (-1, slice(None, None, -1))):
            beyond_s = time_s + ahead_s - time_s[edge]
            outside = beyond_s < 0.0 if edge == 0 else beyond_s > 0.0
            going_on = _Circle.of(time_s[side] - time_s[edge], value[side]).after(beyond_s[outside])
            found[first:end][outside] = value[edge] + going_on
    return found


def _low_passed(scene: Scene, tau_s: float) -> Array:
    """(n, 3) what a low-pass reads of the vectors [nT], in each stretch as if its turn had always been so.

    Between samples a drive lies beside the chord by s (T - s) / 2 of its bend; of that, a step adds
    (T tau (1 + k) - 2 tau^2 (1 - k)) / 2, k being what it keeps.
    """
    slope = _slope(scene)
    bend, parts = scene.slope(slope), []
    ends = [*scene.pauses[1:].tolist(), len(scene)]
    for first, end in zip(scene.pauses.tolist(), ends, strict=True):
        time_s, drive = scene.time_s[first:end], scene.calibrated_nt[first:end]
        start = drive[0] + _Circle.of(time_s - time_s[0], drive).late(tau_s)
        answer, step = first_order(time_s, drive, tau_s, start), np.diff(time_s)
        kept = np.exp(-step / tau_s)
        beside = 0.5 * step * tau_s * (1.0 + kept) - tau_s**2 * (1.0 - kept)
        if len(step):
            pushed = -beside[:, None] * 0.5 * (bend[first : end - 1] + bend[first + 1 : end])
            answer[1:] += carried(kept, pushed, np.zeros(3))
        parts.append(answer)
    return np.concatenate(parts)


@dataclass(frozen=True, slots=True, eq=False)
class _Circle:
    """How vectors go on from one of them: slope (3,) [nT/s], bend across it (3,) [nT/s^2], and square of the rate."""

    slope: Array
    bend: Array
    rate2: float

    @classmethod
    def of(cls, elapsed_s: Array, vectors: Array) -> _Circle:
        """By a cubic through the first of vectors (n, 3), at times (n,) from the first of them on, or back from it."""
        chord = np.linalg.norm(np.diff(vectors[:_MOST_AT_START], axis=0), axis=1)
        turn = float(np.median(chord)) / float(np.linalg.norm(vectors[0])) if len(chord) else 0.0
        count = min(int(np.clip(_AT_START / max(turn, 1e-9), _FEWEST_AT_START, _MOST_AT_START)), len(vectors))
        if count < _FEWEST_AT_START:
            return cls(np.zeros(3), np.zeros(3), 0.0)
        unit_s = float(elapsed_s[count - 1])
        design = np.vander(elapsed_s[:count] / unit_s, 4, increasing=True)
        fitted = np.linalg.lstsq(design, vectors[:count], rcond=None)[0]
        slope, bend = fitted[1] / unit_s, 2.0 * fitted[2] / unit_s**2
        slope2 = max(float(slope @ slope), 1e-300)
        across = bend - slope * float(bend @ slope) / slope2
        return cls(slope, across, float(across @ across) / slope2)

    def after(self, time_s: Array) -> Array:
        """(n, 3) by how much they have changed after times (n,) [nT]."""
        rate = max(math.sqrt(self.rate2), 1e-12)
        angle = (rate * time_s)[:, None]
        return np.asarray(self.slope * np.sin(angle) / rate + self.bend * (1.0 - np.cos(angle)) / rate**2)

    def late(self, tau_s: float) -> Array:
        """(3,) what a low-pass is behind by that has always gone round so [nT].

        Of r cos wt + s sin wt it has (r - w tau s) / (1 + w^2 tau^2).
        """
        found: Array = (tau_s**2 * self.bend - tau_s * self.slope) / (1.0 + tau_s**2 * self.rate2)
        return found


def _slope(scene: Scene) -> Array:
    """dw/dt (n, 3) of the vectors [nT/s]: by differences, of what is left in space where the attitude is known there,
    else short by 1 - sinc(turn from sample to sample)."""
    vectors, rate = scene.calibrated_nt, scene.rate_body
    if rate is None or scene.body_from_eci is None:
        return scene.slope(vectors)
    in_space = np.einsum("nji,nj->ni", scene.body_from_eci, vectors)
    turned: Array = np.einsum("nij,nj->ni", scene.body_from_eci, scene.slope(in_space))
    return turned - np.cross(rate, vectors)


def _alone(field_nt: Array, _theta: Array) -> Columns:
    return Columns(body=field_nt[None])


def _moved(sign: float, amplitudes: Array) -> float:
    return sign * float(amplitudes[0])
