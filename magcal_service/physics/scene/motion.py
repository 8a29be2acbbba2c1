"""How things change in a recording with gaps: slopes within its stretches, and the turn from attitudes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from magcal_service.model import Array

_FEWEST_FOR_SLOPE = 2  # samples of a stretch: of two, both have the difference between them
FEWEST_FOR_MEANS = 4  # samples of a stretch in which means before and after an instant are compared


def pauses(time_s: Array, longest_s: float) -> NDArray[np.intp]:
    """Rows (k,) that begin a new stretch after a step longer than ``longest_s`` [s], with row 0, for times (n,) [s]."""
    return np.concatenate([[0], np.flatnonzero(np.diff(time_s) > longest_s) + 1]).astype(np.intp)


def slope(values: Array, time_s: Array, pauses: NDArray[np.intp]) -> Array:
    """Time derivative of values (n, ...), central, one-sided at the ends of each stretch, 0 in one too short.

    Parameters
    ----------
    time_s: (n,) [s].
    pauses: rows (k,) at which stretches begin, row 0 among them.
    """
    result = np.zeros_like(values, dtype=np.float64)
    ends = np.append(pauses[1:], len(time_s))
    for first, end in zip(pauses.tolist(), ends.tolist(), strict=True):
        if end - first >= _FEWEST_FOR_SLOPE:
            result[first:end] = np.gradient(values[first:end], time_s[first:end], axis=0)
    return result


def smooth_slope(values: Array, width_s: float, time_s: Array, pauses: NDArray[np.intp], period_s: float) -> Array:
    """Slope (n,) of values (n,) between their means over the stretches of a width before and after each."""
    half = max(round(0.5 * width_s / period_s), 1)
    sums = np.concatenate([[0.0], np.cumsum(values)])
    times = np.concatenate([[0.0], np.cumsum(time_s)])
    row, result = np.arange(len(time_s)), np.zeros(len(time_s))
    ends = np.append(pauses[1:], len(time_s))
    for first, end in zip(pauses.tolist(), ends.tolist(), strict=True):
        if end - first < FEWEST_FOR_MEANS:
            continue
        middle = np.clip(row[first:end], first + 1, end - 1)
        low, high = np.maximum(middle - half, first), np.minimum(middle + half, end)
        rise = (sums[high] - sums[middle]) / (high - middle) - (sums[middle] - sums[low]) / (middle - low)
        taken = (times[high] - times[middle]) / (high - middle) - (times[middle] - times[low]) / (middle - low)
        result[first:end] = rise / taken
    return result


def rate_of(body_from_eci: Array, time_s: Array, pauses: NDArray[np.intp]) -> Array:
    """(n, 3) body rate [rad/s] of attitudes (n, 3, 3): the turn from each sample to the next, as rotation vectors."""
    change = np.einsum("nij,nkj->nik", body_from_eci[1:], body_from_eci[:-1])
    cosine = np.clip((np.trace(change, axis1=1, axis2=2) - 1.0) / 2.0, -1.0, 1.0)
    angle = np.arccos(cosine)
    axis = np.stack(
        [change[:, 1, 2] - change[:, 2, 1], change[:, 2, 0] - change[:, 0, 2], change[:, 0, 1] - change[:, 1, 0]],
        axis=1,
    )
    sine = np.maximum(2.0 * np.sin(angle), 1e-12)
    steps = np.diff(time_s)
    rate = axis / sine[:, None] * (angle / steps)[:, None]
    usable = np.ones(len(steps), dtype=bool)
    usable[pauses[1:] - 1] = False
    middle = 0.5 * (time_s[1:] + time_s[:-1])
    if not usable.any():
        return np.zeros((len(time_s), 3))
    return np.stack([np.interp(time_s, middle[usable], column[usable]) for column in rate.T], axis=1)
