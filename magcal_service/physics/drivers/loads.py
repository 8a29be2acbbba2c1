"""Whether recorded currents change at an instant: then a load may have been switched, whoever recorded it by itself."""

from __future__ import annotations

from typing import Final

import numpy as np

from magcal_service.model import Array
from magcal_service.physics.scene.scene import Scene

_OVER_S: Final = 60.0
"""Time before and after an instant that a record is averaged over [s]: longer than housekeeping is held for."""

_BESIDE_S: Final = 10.0  # left out on either side: a record may be late by so much

_ELSEWHERE: Final = 400  # other instants that a change is held against; choice: the hundredth of them is the fourth
_SELDOM: Final = 0.99  # of those, how many have to change by less


def jumps_along(scene: Scene, at_s: Array) -> bool:
    """Whether any recorded current changes at one of the instants ``at_s`` (k,) as it seldom does.

    Of a record that is switched often that is no wonder, and not seen.
    """
    times = scene.time_s[np.unique(np.linspace(0, len(scene) - 1, _ELSEWHERE).astype(np.intp))]
    records = [c.values[:, k] for c in scene.of_quantity("current") for k in range(c.values.shape[1])]
    for record in records:
        usual, here = _change(scene.time_s, record, times), _change(scene.time_s, record, at_s)
        if np.isfinite(usual).any() and bool((here > np.nanquantile(usual, _SELDOM)).any()):
            return True
    return False


def _change(time_s: Array, record: Array, at_s: Array) -> Array:
    """(k,) sizes of a record's (n,) change at instants, between means on either side; NaN beside the ends."""
    sums = np.concatenate([[0.0], np.cumsum(record)])
    reach = np.array([-_BESIDE_S - _OVER_S, -_BESIDE_S, _BESIDE_S, _BESIDE_S + _OVER_S])
    first, last, begin, end = np.searchsorted(time_s, at_s[None] + reach[:, None])
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(
            np.abs((sums[end] - sums[begin]) / (end - begin) - (sums[last] - sums[first]) / (last - first))
        )
