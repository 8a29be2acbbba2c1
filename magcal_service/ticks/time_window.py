"""The times that samples may carry: a window whose sums and differences fit 64 bits, whatever comes in what order.

A source time lies within ``EARLIEST_NS`` and ``LATEST_NS``, elapsed time below ``LONGEST_NS`` and a little (it grows by
a second with each step of the clock), so the difference of the two, and of any two of either, is within 2^63 ns.  As
seconds in doubles they are exact to half a microsecond.
"""

from __future__ import annotations

from typing import Final

LATEST_NS: Final = 1 << 62
"""Latest source time [ns]: 146 years after the epoch, in the year 2116."""

EARLIEST_NS: Final = -LATEST_NS
"""Earliest source time [ns]: in the year 1823."""

_YEAR_NS: Final = 31_557_600_000_000_000  # 365.25 days

FURTHEST_NS: Final = 100 * _YEAR_NS
"""Elapsed time up to which a jump ahead is a gap; one beyond is a step of the clock, as backwards [ns]."""

LONGEST_NS: Final = 130 * _YEAR_NS
"""Elapsed time beyond which each sample has to be confirmed as a step of the clock [ns]: 30 years of samples later."""


def is_usable(time_ns: int) -> bool:
    """Whether a source time [ns] lies within the window."""
    return EARLIEST_NS <= time_ns <= LATEST_NS
