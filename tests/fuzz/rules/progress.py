"""What long runs of the rules have done, kept in a file: a run that ends goes on from it."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Final

from magcal_service.base.disk import write_whole

_COLUMNS: Final = ("worlds", "steps", "messages", "starts", "checkpoints", "contained", "escapes")


@dataclass(slots=True)
class Progress:
    """How far a run has come.

    Parameters
    ----------
    line: the link.
    seed: of the run.
    batches: finished.
    processor_s: taken [s].
    done: what was done, by method.
    escapes: each broken promise, with the steps to it.
    """

    line: str
    seed: int
    batches: int = 0
    processor_s: float = 0.0
    done: dict[str, Counter[str]] = field(default_factory=dict)
    escapes: list[str] = field(default_factory=list)

    @property
    def steps(self) -> int:
        """Of all methods."""
        return sum(one["steps"] for one in self.done.values())

    def add(self, method: str, total: Counter[str], processor_s: float, escape: str) -> None:
        """A batch is done."""
        self.batches += 1
        self.processor_s += processor_s
        one = self.done.setdefault(method, Counter())
        one.update(total)
        one["escapes"] += bool(escape)
        if escape:
            self.escapes.append(escape)

    def told(self, steps: int) -> str:
        """A line: how far, how fast, how long still [of the processor]."""
        rate = self.steps / max(self.processor_s, 1e-9)
        left_min = max(0, steps - self.steps) / max(rate, 1e-9) / 60.0
        return (
            f"{self.steps} of {steps} steps over {self.line}, {len(self.escapes)} escapes; "
            f"{rate:.0f} steps a second of processor, {left_min:.0f} min of it left"
        )

    def save(self, path: Path) -> None:
        """Write it as a whole, over what is there."""
        told = {one.name: getattr(self, one.name) for one in fields(self)}
        write_whole(path, json.dumps(told, indent=1).encode())

    @classmethod
    def load(cls, path: Path) -> Progress:
        """Read what ``save`` wrote."""
        read = json.loads(path.read_text())
        return cls(**{**read, "done": {name: Counter(one) for name, one in read["done"].items()}})


def table(runs: Iterable[Progress]) -> str:
    """What was done: a row for each method over all links, one for each link over all methods, and their sum."""
    methods, lines, every = dict[str, Counter[str]](), dict[str, Counter[str]](), Counter[str]()
    for run in runs:
        for name, one in run.done.items():
            for sums in (methods.setdefault(f"`{name}`", Counter()), lines.setdefault(run.line, Counter()), every):
                sums.update(one)
    rows = [f"| | {' | '.join(_COLUMNS)} |", f"|---|{'---:|' * len(_COLUMNS)}"]
    for name, one in [*methods.items(), *((f"over {line}", one) for line, one in lines.items()), ("all", every)]:
        rows.append(f"| {name} | {' | '.join(str(one[column]) for column in _COLUMNS)} |")
    return "\n".join(rows) + "\n"
