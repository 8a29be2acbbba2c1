"""Mutation scores as tables."""

from __future__ import annotations

import json
import math
import tomllib
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Final

from tests.mutation.mutants import BY_TIME, Mutant, Outcome
from tests.mutation.rooms import ROOMS

_EXPLAINED: Final = Path(__file__).parent / "explained.toml"
_SIGMAS: Final = 1.96  # of the normal distribution: 95 % lie within
_PAGE: Final = """# Mutation testing

Single changes of the core (an operator, a bound, a number, a call left out), drawn by seed: do the tests *of the same
room* notice? [cosmic-ray](https://cosmic-ray.readthedocs.io)'s operators change a copy of the checkout;
`tests/mutation/rooms.py` says which code and tests belong together.

| command | what it does |
|---|---|
| `make mutate` | tries a small sample |
| `python -m tests.mutation --room ROOM --sample N --seed SEED --log FILE` | tries N mutants of a room |
| `python -m tests.mutation --again FILE --log FILE` | tries unexplained survivors once more, after tests were added |
| `python -m tests.mutation --results FILE --out docs` | writes this page |

The score is what the tests notice now; "at first" is the share before tests were added for survivors, which is what it
says of mutants that were not drawn; the range holds that share of all the room's mutants with 95 % (Wilson 1927).

Not drawn is what decides nothing (annotations, imports, `__all__`, the words of a refusal, arguments of `@dataclass`,
`*` and `/` of a signature). A mutant that needs three times the unchanged code's processor time and a minute more, or
waits for 20 minutes in one test, is noticed "by time". A test has to fail twice. Seed 27 was tried in the order of the
draw until time was up; three mutants of `estimators` lived in the test files nearest to them and count as not noticed
at first, though the rest of the room was not run.

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
        "| room | seeds | mutants | noticed | by time | lived, explained | lived, not | score | at first | range |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    names = [room.name for room in ROOMS if any(outcome.room == room.name for outcome in outcomes)]
    rows += [_row(name, [outcome for outcome in outcomes if outcome.room == name]) for name in names]
    return "\n".join([*rows, _row("all", outcomes)])


def _row(name: str, outcomes: Sequence[Outcome]) -> str:
    count, killed = len(outcomes), sum(bool(outcome.killed_by) for outcome in outcomes)
    explained = sum(bool(not outcome.killed_by and explanation(outcome.mutant)) for outcome in outcomes)
    by_time = sum(outcome.killed_by == BY_TIME for outcome in outcomes)
    at_first = sum(outcome.at_first for outcome in outcomes)
    low, high = _range(at_first, count)
    seeds = ", ".join(str(seed) for seed in sorted({outcome.seed for outcome in outcomes}))
    numbers = f"{seeds} | {count} | {killed} | {by_time} | {explained} | {count - killed - explained}"
    shares = f"{100 * killed / count:.0f} % | {100 * at_first / count:.0f} % | {100 * low:.0f} to {100 * high:.0f} %"
    return f"| {name} | {numbers} | {shares} |"


def _range(noticed: int, count: int) -> tuple[float, float]:
    """The share of all mutants that is believed, 95 % (Wilson 1927)."""
    share = noticed / count
    middle = share + _SIGMAS**2 / (2 * count)
    half = _SIGMAS * math.sqrt(share * (1.0 - share) / count + _SIGMAS**2 / (4 * count**2))
    low, high = ((middle + sign * half) / (1.0 + _SIGMAS**2 / count) for sign in (-1.0, 1.0))
    return low, high


def _survivors(outcomes: Sequence[Outcome]) -> str:
    rows = [
        f"| {outcome.room} | {_place(outcome.mutant)} | {_cell(outcome.mutant.before)} | {_cell(outcome.mutant.after)} "
        f"| {explanation(outcome.mutant) or '**not explained**'} |"
        for outcome in outcomes
        if not outcome.killed_by
    ]
    head = ["| room | where | line | mutant | why it may live |", "|---|---|---|---|---|"]
    return "\n".join([*head, *rows]) if rows else "None."


def _place(mutant: Mutant) -> str:
    return f"{mutant.file.removeprefix('magcal_service/')}:{mutant.line}"


def _cell(code: str) -> str:
    """Code in a cell of a table."""
    escaped = code.replace("|", "\\|")
    return f"`{escaped}`"


def recorded(log: Path) -> list[Outcome]:
    """The outcomes that ``--log`` has written, one JSON object a line; the last of a mutant that was tried again."""
    found: list[Outcome] = []
    for line in log.read_text(encoding="utf-8").splitlines():
        content = json.loads(line)
        own = {name: content.pop(name) for name in ("room", "killed_by", "seed", "at_first")}
        outcome = Outcome(mutant=Mutant(**content), **own)
        index = next((index for index, one in enumerate(found) if _is_again(one, outcome)), None)
        if index is None:
            found.append(outcome)
        else:
            found[index] = replace(found[index], killed_by=outcome.killed_by)
    return found


def _is_again(earlier: Outcome, later: Outcome) -> bool:
    """Whether it is the same mutant; one that lived may have moved since."""
    one, other = earlier.mutant, later.mutant
    same = (one.file, one.operator, one.before, one.after) == (other.file, other.operator, other.before, other.after)
    return same and (one.occurrence == other.occurrence or not earlier.killed_by)


def write(outcomes: Sequence[Outcome], docs: Path) -> None:
    """``mutation.md`` and ``results/mutation.json``."""
    page = _PAGE.format(table=summary(outcomes), survivors=_survivors(outcomes))
    (docs / "mutation.md").write_text(page, encoding="utf-8")
    content = {"outcomes": [outcome.as_dict() for outcome in outcomes]}
    (docs / "results/mutation.json").write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
