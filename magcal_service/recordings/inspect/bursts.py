"""Rows that come in bursts: no rate can stand for their times."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np

from magcal_service.recordings.inspect.finding import Code, Seen
from magcal_service.recordings.inspect.log import Log
from magcal_service.recordings.table import FloatArray, IntArray

_SHORTEST: Final = 4
"""Rows of the shortest burst looked for: of three, a spin about a third of a turn a row has as many phases."""

_LONGEST: Final = 128
"""Rows of the longest burst looked for: buffers of serial links and file writers are up to there."""

_FEWEST_BURSTS: Final = 20
"""Bursts from which it is said: a median of 20 is known to a sixth, and none of 128 is twice another by chance."""

_LOOKED_AT: Final = 20_000
"""Rows from the first that are looked at: 150 bursts of the longest, in a tenth of a second."""

_LONGER: Final = 2.0
"""Times the longest step elsewhere in a burst, what the step between bursts has to be: a pause of two rows or more."""

_UNEVEN: Final = 1.5
"""Rows by which stamps' counts may differ from their mean: rounding gives one, jitter of the clock a little more."""

_MOST_UNEVEN: Final = 0.02
"""Of the stamps, how many may have more or fewer; choice: single late rows are no bursts."""


def bursts(log: Log) -> Iterator[Seen]:
    """Rows whose times are counted by ``rate_hz``, and whose vectors jump regularly."""
    if log.recording.descriptor.time.rate_hz is None:
        return
    length, longer = burst(log)
    if length:
        says = f"rows seem to come in bursts of {length}: the vector moves {longer:.1f} times as far between as within"
        remedy = (
            "no rate_hz makes their times: log a time with each row, and name its column under [time]; "
            "where the reference is constant the nine errors need no times, and accept under [inspect] says so"
        )
        yield Seen(Code.BURSTS, False, log.rows, says, remedy)


def burst(log: Log) -> tuple[int, float]:
    """How many rows a burst has, and how much farther the vector moves between two; (0, 1.0) where there are none."""
    rows = log.rows[:_LOOKED_AT]
    follows = np.diff(rows) == 1
    steps = np.full(int(rows[-1]) + 1, np.nan)
    moved = np.linalg.norm(np.diff(log.field_as_written[:_LOOKED_AT], axis=0), axis=1)
    steps[rows[1:][follows]] = moved[follows]
    for length in range(_SHORTEST, min(_LONGEST, len(steps) // _FEWEST_BURSTS) + 1):
        phases = steps[: len(steps) // length * length].reshape(-1, length)
        known = np.count_nonzero(np.isfinite(phases), axis=0)
        if known.min() < _FEWEST_BURSTS - 1:
            continue
        middle = np.sort(phases, axis=0)[known // 2, np.arange(length)]  # NaN are sorted to the end
        first = int(np.argmax(middle))
        second = float(np.max(np.delete(middle, first)))
        if float(np.median(middle)) > 0.0 and middle[first] > _LONGER * second:
            return length, float(middle[first] / np.median(middle))
    return 0, 1.0


def is_even(stamps: IntArray | FloatArray) -> bool:
    """Whether shared stamps (n,) have as many rows each as rows at one rate give; the first and the last may be cut."""
    counts = np.unique(stamps, return_counts=True)[1][1:-1]
    if not len(counts):
        return True
    return bool(np.mean(np.abs(counts - counts.mean()) > _UNEVEN) <= _MOST_UNEVEN)
