"""Rows over time of bounded size, and what of them somebody has not seen yet."""

from __future__ import annotations

from collections import deque
from itertools import islice
from typing import Any, Final

Row = tuple[float | None, ...]
"""One instant: its time [s] first; None where a column has no value."""

MOST_RECENT: Final = 900
"""Rows that are kept of the newest: a quarter of an hour at 1 Hz."""

MOST_WHOLE: Final = 1600
"""Rows that are kept of the whole session: about one for each pixel of a wide plot."""


class Recent:
    """The newest rows."""

    def __init__(self, most: int = MOST_RECENT) -> None:
        self.rows: deque[Row] = deque(maxlen=most)
        self.count = 0

    def add(self, row: Row) -> None:
        """Append a row; the oldest one goes where there are too many."""
        self.rows.append(row)
        self.count += 1

    @property
    def mark(self) -> tuple[int, int]:
        """What a reader keeps to ask later for what has come since."""
        return 0, self.count

    def since(self, mark: tuple[int, int] | None) -> tuple[bool, list[Row]]:
        """Whether the reader has to begin anew, and the rows that he lacks."""
        missing = self.count if mark is None else self.count - mark[1]
        if mark is None or missing >= len(self.rows):
            return True, list(self.rows)
        return False, list(islice(self.rows, len(self.rows) - missing, None))


class Whole:
    """Every n-th row since the beginning; n doubles whenever there are too many."""

    def __init__(self, most: int = MOST_WHOLE) -> None:
        self.rows: list[Row] = []
        self.every = 1
        self._most, self._count, self._thinned = most, 0, 0

    def add(self, row: Row) -> None:
        """Append a row where it is its turn."""
        if self._count % self.every == 0:
            self.rows.append(row)
            if len(self.rows) > self._most:
                self.rows, self.every, self._thinned = self.rows[::2], 2 * self.every, self._thinned + 1
        self._count += 1

    @property
    def mark(self) -> tuple[int, int]:
        """What a reader keeps to ask later for what has come since."""
        return self._thinned, len(self.rows)

    def since(self, mark: tuple[int, int] | None) -> tuple[bool, list[Row]]:
        """Whether the reader has to begin anew, and the rows that he lacks."""
        if mark is None or mark[0] != self._thinned:
            return True, list(self.rows)
        return False, self.rows[mark[1] :]


class Lacking:
    """What one reader lacks of the newest rows and of all of them."""

    def __init__(self) -> None:
        self._recent: tuple[int, int] | None = None
        self._whole: tuple[int, int] | None = None

    def update(self, recent: Recent, whole: Whole) -> dict[str, Any]:
        """What has come since the last call as plain data: ``recent`` and ``whole``, each ``anew`` and ``rows``."""
        update: dict[str, Any] = {}
        for name, series, mark in (("recent", recent, self._recent), ("whole", whole, self._whole)):
            anew, rows = series.since(mark)
            update[name] = {"anew": anew, "rows": rows}
        self._recent, self._whole = recent.mark, whole.mark
        return update
