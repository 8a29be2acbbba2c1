"""When a diagnosis will have ended, by how long its steps have taken so far and what usually follows them.

How many searches there are is not known before, so this is what is usual, in units of the searches that have ended.
``python -m tests.benchmarks.bench_progress`` measures the table, and how far off what is told was.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final, NamedTuple

from magcal_service.diagnosis.stages import LEFT, RIVALS, SEARCHING, SIMULATING


class Usual(NamedTuple):
    """From the beginning of a step, in units: until the end of everything, and of the step itself; means over
    diagnoses."""

    left: float
    own: float


Place = tuple[int, int, str]
"""The most effects that were looked for so far, how many searches have compared rivals, and the step that begins."""

MOST_ROUNDS: Final = 2
"""Searches that have compared rivals, from which on nothing new is told by one more; choice: few have more."""

WRITING_S: Final = 1.3
"""Drawing the report, whatever the recording is [s of the processor of the figures' machine]."""

FIRST, SECOND, THIRD = SEARCHING

USUAL: Final[Mapping[Place, Usual]] = {
    (1, 0, FIRST): Usual(28.71, 8.18),  # of 30
    (1, 0, RIVALS): Usual(0.53, 0.04),  # of 7
    (1, 1, LEFT): Usual(0.49, 0.17),  # of 7
    (2, 0, SECOND): Usual(3.44, 0.87),  # of 23
    (2, 0, RIVALS): Usual(0.64, 0.20),  # of 16
    (2, 1, LEFT): Usual(0.44, 0.23),  # of 16
    (3, 0, THIRD): Usual(6.41, 1.16),  # of 7
    (3, 0, RIVALS): Usual(4.81, 0.85),  # of 7
    (3, 1, FIRST): Usual(9.91, 1.67),  # of 2
    (3, 1, SECOND): Usual(7.17, 1.55),  # of 2
    (3, 1, THIRD): Usual(5.41, 1.12),  # of 5
    (3, 1, RIVALS): Usual(4.39, 3.03),  # of 2
    (3, 1, LEFT): Usual(3.45, 0.24),  # of 7
}
"""Beside each row of how many diagnoses of 34 simulated recordings (``python -m tests.benchmarks.bench_progress`` on
``python -m tests.blind --seed 7701 --n 24`` and ``python -m tests.regimes --seed 7702 --n 32``: the first ones, and
some that were picked for being short, for several effects or for none of the catalogue).  What follows `LEFT` goes on
from what was told there."""

_LONGER: Final = 0.5
"""Of what a step has taken, what it will take besides once it has taken longer than usual; a choice."""


@dataclass(slots=True)
class Course:
    """The forecast of one diagnosis; ``usual`` as ``USUAL``."""

    usual: Mapping[Place, Usual] = field(default_factory=lambda: USUAL)
    _step: str = ""
    _began_s: float = 0.0
    _told_s: float | None = None
    _rounds: int = 0
    _reached: int = 0
    _simulated_s: float | None = None
    _searched_s: list[float] = field(default_factory=list)

    def begin(self, step: str, now_s: float) -> None:
        """A step begins, and the one before has ended."""
        took_s, self._told_s = now_s - self._began_s, self.left_s(now_s)
        if self._step == SIMULATING:
            self._simulated_s = took_s
        elif self._step in SEARCHING:
            self._searched_s.append(took_s)
        elif self._step == RIVALS:
            self._rounds = min(self._rounds + 1, MOST_ROUNDS)
        self._step, self._began_s = step, now_s
        if step in SEARCHING:
            self._reached = max(self._reached, SEARCHING.index(step) + 1)

    @property
    def place(self) -> Place:
        """Where it is in the table."""
        return self._reached, self._rounds, self._step

    @property
    def unit_s(self) -> float | None:
        """The mean search so far [s]; before the first has ended, what the nine errors alone have taken."""
        if self._searched_s:
            return sum(self._searched_s) / len(self._searched_s)
        return self._simulated_s

    def left_s(self, now_s: float) -> float | None:
        """What is usually left [s]; of a step that is not in the table what was told before it; None without either."""
        unit_s, usual = self.unit_s, self.usual.get(self.place)
        within_s = now_s - self._began_s
        if unit_s is None or usual is None:
            return None if self._told_s is None else max(self._told_s - within_s, _LONGER * within_s)
        own_s = unit_s * usual.own
        step_s = own_s - within_s if within_s < own_s else _LONGER * within_s
        return WRITING_S + unit_s * max(usual.left - usual.own, 0.0) + step_s
