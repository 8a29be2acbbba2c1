"""The phase of a turn from that of each sample: carried over gaps and half turns, and smoothed between knots."""

from __future__ import annotations

from typing import Final

import numpy as np

from magcal_service.model import Array
from magcal_service.physics.scene.scene import Scene
from magcal_service.residuals import rms

_KNOT_TURNS: Final = (12.0, 6.0, 3.0, 1.5)
"""Turns between knots of the smoothed phase; choice: fewer let noise in, and are only taken where the rate changes."""

_FOLLOWS: Final = 0.5
"""Of the misfit with fewer knots, to which twice as many bring it where the rate changes between them."""

_SURE_ACROSS: Final = 0.2
"""Part of the field across the axis, of its mean size, at which a sample moves the tracked turn half as much as usual:
near the axis a degree of error in the reference, as of coefficients 15 years old, turns the direction round it."""


def phases(scene: Scene, turn: Array, strength: Array, rate: float) -> tuple[Array, Array]:
    """Raw and smoothed phases (n,): local straight lines carried from stretch to stretch, then a spline through knots.

    Each stretch is unwrapped by itself, relative to its mean rate; over a gap the phase is carried on at the rate
    of the two sides, which is right while it drifts by less than half a turn.
    """
    raw = np.empty(len(scene))
    sure = strength**2 / (strength**2 + (_SURE_ACROSS * float(np.mean(scene.magnitude_nt))) ** 2)
    ends = np.append(scene.pauses[1:], len(scene))
    last: tuple[float, float, float] | None = None
    for first, end in zip(scene.pauses.tolist(), ends.tolist(), strict=True):
        time_s = scene.time_s[first:end] - scene.time_s[first]
        local = _tracked(turn[first:end], time_s, rate, sure[first:end])
        if last is not None:
            expected = last[0] + last[1] * (scene.time_s[first] - last[2])
            local += 2.0 * np.pi * np.round((expected - local[0]) / (2.0 * np.pi))
        raw[first:end] = local
        if end - first >= 10:
            slope, level = np.polyfit(time_s, local, 1)
            last = (float(level + slope * time_s[-1]), float(slope), float(scene.time_s[end - 1]))
        else:
            last = (float(local[-1]), rate if last is None else last[1], float(scene.time_s[end - 1]))
    return raw, smoothed(scene, raw, strength, rate)


def _tracked(turn: Array, time_s: Array, rate: float, sure: Array) -> Array:
    """Unwrapped phase of one stretch: a running estimate of phase and rate, each sample within half a turn of it.

    ``sure`` (n,), 0 to 1, is how far a sample counts: what is near the axis must not carry the estimate off by a turn.
    """
    angles = np.angle(turn).tolist()
    times, weights = time_s.tolist(), sure.tolist()
    phase, speed, usual_s = angles[0], rate, float(np.median(np.diff(time_s))) if len(time_s) > 1 else 1.0
    found = [phase]
    for index in range(1, len(times)):
        step = times[index] - times[index - 1]
        expected = phase + speed * step
        miss = (angles[index] - expected + np.pi) % (2.0 * np.pi) - np.pi
        phase = expected + 0.25 * weights[index] * miss
        # a direction's error grows by 1/s, its rate by 1/s^2; two stamps much closer than usual tell no rate
        speed += 0.02 * weights[index] ** 2 * miss / max(step, usual_s)
        found.append(expected + miss)
    return np.array(found)


def smoothed(scene: Scene, raw: Array, strength: Array, rate: float) -> Array:
    """Least-squares line through knots some turns apart, in each stretch: slow changes of rate are kept."""
    weight = strength / np.maximum(strength.max(), 1e-9)
    trials = [_with_knots(scene, raw, weight, turns * 2.0 * np.pi / max(abs(rate), 1e-6)) for turns in _KNOT_TURNS]
    misfits = [rms((raw - trial) * weight) for trial in trials]
    found = 0
    for number, misfit in enumerate(misfits):
        if misfit < _FOLLOWS * misfits[found]:
            found = number
    return trials[found]


def _with_knots(scene: Scene, raw: Array, weight: Array, width_s: float) -> Array:
    """The line through knots so far apart [s], in each stretch, for weights (n,)."""
    smooth = np.empty_like(raw)
    ends = np.append(scene.pauses[1:], len(scene))
    for first, end in zip(scene.pauses.tolist(), ends.tolist(), strict=True):
        time_s, values, heft = scene.time_s[first:end], raw[first:end], weight[first:end]
        if end - first < 4:
            smooth[first:end] = values
            continue
        count = int(np.clip((time_s[-1] - time_s[0]) / width_s, 1, 60)) + 1
        count = min(count, (end - first) // 2)
        slope, level = np.polyfit(time_s - time_s[0], values, 1)
        line = level + slope * (time_s - time_s[0])
        smooth[first:end] = line + _through_knots(time_s, values - line, heft, max(count, 2))
    return smooth


def _through_knots(time_s: Array, values: Array, weight: Array, count: int) -> Array:
    """Weighted least-squares piecewise-linear curve with ``count`` even knots, at the samples (n,)."""
    position = (time_s - time_s[0]) / max(time_s[-1] - time_s[0], 1e-9) * (count - 1)
    left = np.minimum(position.astype(np.intp), count - 2)
    share = position - left
    near, far, squares = 1.0 - share, share, weight**2

    def summed(at_left: Array, at_right: Array) -> Array:
        """(count,) sums over the samples on either side of each knot."""
        return np.asarray(np.bincount(left, at_left, count) + np.bincount(left + 1, at_right, count), np.float64)

    beside = np.bincount(left, squares * near * far, count)[: count - 1]
    normal = np.diag(summed(squares * near**2, squares * far**2) + 1e-6) + np.diag(beside, 1) + np.diag(beside, -1)
    knots = np.linalg.solve(normal, summed(squares * near * values, squares * far * values))
    result: Array = near * knots[left] + far * knots[left + 1]
    return result
