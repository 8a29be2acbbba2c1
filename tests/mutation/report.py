"""Mutation scores as tables."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any, Final

from tests.mutation.mutants import BY_TIME, Mutant, Outcome
from tests.mutation.rooms import ROOMS

_EXPLAINED: Final = Path(__file__).parent / "explained.toml"
_PAGE: Final = """# Mutation testing

Single changes of the core (an operator, a bound, a number, a call left out), drawn by seed, and whether the tests *of
the same room* notice. The changes are made by [cosmic-ray](https://cosmic-ray.readthedocs.io)'s operators in a copy of
the checkout; `tests/mutation/rooms.py` says which code and which tests belong together. `python -m tests.mutation
--sample N --seed {seed} --log FILE` tries, with `--results FILE --out docs` it writes this page; at most {sample} of a
room were tried here; `diagnosis` was drawn by the seeds 18 and 19. `make mutate` tries a small sample.
Samples are small: a score of 8 in 10 may be 5 in 10 or 9.5 in 10.

Not drawn is what decides nothing (annotations, imports, `__all__`, the words of a refusal, arguments of `@dataclass`,
the markers `*` and `/` of a signature), and what leaves no Python: any test would notice. A mutant that needs three
times the processor time of the unchanged code and a minute more, or waits for 20 minutes in one test, comes to no end:
it is noticed "by time". A loaded machine makes no such mutants, since the time is the processor's. A room whose tests
fail without a mutant is refused.

{table}

## Survivors

{survivors}
"""


@cache
def _explained() -> tuple[dict[str, str], ...]:
    return tuple(tomllib.loads(_EXPLAINED.read_text(encoding="utf-8")).get("mutant", ()))


def explanation(mutant: Mutant) -> str:
    """Why a mutant may live, empty where nobody has said so."""
    for entry in _explained():
        if (entry["file"], entry["before"], entry["after"]) == (mutant.file, mutant.before, mutant.after):
            return entry["why"]
    return ""


def summary(outcomes: Sequence[Outcome]) -> str:
    """A table: a row for each room."""
    rows = [
        "| room | mutants | noticed | by time | survivors explained | not explained | score |",
        "|---|---|---|---|---|---|---|",
    ]
    names = [room.name for room in ROOMS if any(outcome.room == room.name for outcome in outcomes)]
    rows += [_row(name, [outcome for outcome in outcomes if outcome.room == name]) for name in names]
    return "\n".join([*rows, _row("all", outcomes)])


def _row(name: str, outcomes: Sequence[Outcome]) -> str:
    killed = sum(bool(outcome.killed_by) for outcome in outcomes)
    explained = sum(bool(not outcome.killed_by and explanation(outcome.mutant)) for outcome in outcomes)
    left = len(outcomes) - killed - explained
    by_time = sum(outcome.killed_by == BY_TIME for outcome in outcomes)
    score = 100 * killed / len(outcomes)
    return f"| {name} | {len(outcomes)} | {killed} | {by_time} | {explained} | {left} | {score:.0f} % |"


def _survivors(outcomes: Sequence[Outcome]) -> str:
    lines = [
        f"- {outcome.room}: {outcome.mutant.text}: {explanation(outcome.mutant) or '**not explained**'}"
        for outcome in outcomes
        if not outcome.killed_by
    ]
    return "\n".join(lines) or "None."


def recorded(log: Path) -> list[Outcome]:
    """The outcomes that ``--log`` has written, one JSON object a line."""
    found = []
    for line in log.read_text(encoding="utf-8").splitlines():
        content = json.loads(line)
        room, killed_by = content.pop("room"), content.pop("killed_by")
        found.append(Outcome(room, Mutant(**content), killed_by))
    return found


def write(outcomes: Sequence[Outcome], seed: int, docs: Path) -> None:
    """``mutation.md`` and ``results/mutation.json``."""
    counts = [sum(outcome.room == room.name for outcome in outcomes) for room in ROOMS]
    page = _PAGE.format(sample=max(counts), seed=seed, table=summary(outcomes), survivors=_survivors(outcomes))
    (docs / "mutation.md").write_text(page, encoding="utf-8")
    content: dict[str, Any] = {"seed": seed, "outcomes": [outcome.as_dict() for outcome in outcomes]}
    (docs / "results/mutation.json").write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
