"""What is due again and again, by the monotonic clock."""

from __future__ import annotations

import time


class Timer:
    """Something that is due every ``period_s`` [s] of the monotonic clock."""

    def __init__(self, period_s: float) -> None:
        self._period_s = period_s
        self._next_s = time.monotonic() + period_s

    def due(self) -> bool:
        """Whether it is due; missed periods are skipped."""
        now_s = time.monotonic()
        if now_s < self._next_s:
            return False
        self._next_s = now_s + self._period_s
        return True
