"""Whether results still come."""

from __future__ import annotations

import math
from collections import deque
from typing import Final

STALE_S: Final = 5.0
"""Silence after which results are called stale [s], or three times the longest of the newest gaps if that is longer."""

_GAPS: Final = 16  # choice: the newest, between which the usual one is found


class Pulse:
    """When results of one kind came, by the reader's own clock."""

    def __init__(self) -> None:
        self._newest_s = -math.inf
        self._gaps = deque[float](maxlen=_GAPS)

    def beat(self, now_s: float) -> None:
        """Note that a result has come at ``now_s`` [s]."""
        if self._newest_s > -math.inf:
            self._gaps.append(now_s - self._newest_s)
        self._newest_s = now_s

    def age_s(self, now_s: float) -> float:
        """How long ago the newest one came [s]; infinite before the first."""
        return now_s - self._newest_s

    def is_stale(self, now_s: float) -> bool:
        """Whether results have stopped, or never came."""
        return self.age_s(now_s) > max(STALE_S, 3.0 * max(self._gaps, default=0.0))

    def shown(self, now_s: float) -> dict[str, float | bool | None]:
        """As plain data: ``age_s`` [s], None before the first, and ``is_stale``."""
        age_s = self.age_s(now_s)
        return {"age_s": round(age_s, 1) if math.isfinite(age_s) else None, "is_stale": self.is_stale(now_s)}
