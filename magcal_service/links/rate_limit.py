"""How many messages a source may send: a bucket that fills at a rate and is emptied by messages."""

from __future__ import annotations

from typing import Final

MOST_BUCKETS: Final = 4096
"""Sources with a bucket of their own; where more are named, all are forgotten and begin anew with full buckets."""


class RateLimit:
    """A bucket for each source.

    Parameters
    ----------
    rate_hz: messages a second in the long run [1/s]; no limit where 0.
    burst: messages at once, after a pause.
    """

    def __init__(self, rate_hz: float, burst: float) -> None:
        self._rate_hz, self._burst = rate_hz, burst
        self._buckets: dict[str, tuple[float, float]] = {}  # source -> (messages left, when it was so [s])

    def allows(self, source: str, now_s: float) -> bool:
        """Whether one more message of this source may pass now, a monotonic time [s]; it counts if so."""
        if not self._rate_hz:
            return True
        left, then_s = self._buckets.get(source, (self._burst, now_s))
        left = min(self._burst, left + (now_s - then_s) * self._rate_hz)
        allowed = left >= 1.0
        if source not in self._buckets and len(self._buckets) >= MOST_BUCKETS:
            self._buckets.clear()
        self._buckets[source] = (left - 1.0 if allowed else left, now_s)
        return allowed

    def wait_s(self, source: str, now_s: float) -> float:
        """How long after ``now_s`` the next message of this source may pass [s]; 0 where one may now."""
        if not self._rate_hz:
            return 0.0
        left, then_s = self._buckets.get(source, (self._burst, now_s))
        return max(0.0, (1.0 - left) / self._rate_hz - (now_s - then_s))
