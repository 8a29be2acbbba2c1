"""``python -m tests.blind --seed S --n N --out DIR``: write cases of every kind and their answers."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Final

from tests.blind.answers import common_form, write_answers
from tests.blind.catalogue import DRIVEN, EFFECTS, OUTSIDE
from tests.blind.draw import draw_case
from tests.blind.recording import write_case

CLEAN: Final = 0.2
"""Of all cases, those with nothing wrong: a fifth, so that 300 cases have 60 chances of a false alarm."""

IN_NO_CATALOGUE: Final = 0.12
"""With something that is in no catalogue; choice: enough of each kind to know a share within a tenth or so."""

IN_PAIRS: Final = 0.12
"""With two effects; the same choice."""

HIDDEN: Final = 0.16
"""With the driver left out of the recording; choice: more than of the others, since craft seldom record all."""


def plan(count: int) -> list[tuple[str, bool]]:
    """Kind of each case, and whether the channel that drives it is recorded; every effect in turn, and the shares."""
    clean, outside, pairs, hidden = (
        max(1, round(share * count)) for share in (CLEAN, IN_NO_CATALOGUE, IN_PAIRS, HIDDEN)
    )
    effects, driven, strange = sorted(EFFECTS), sorted(DRIVEN), sorted(OUTSIDE)
    kinds = [("none", True)] * clean
    kinds += [(f"outside:{strange[i % len(strange)]}", True) for i in range(outside)]
    kinds += [("pair", True)] * pairs
    kinds += [(driven[i % len(driven)], False) for i in range(hidden)]
    kinds += [(effects[i % len(effects)], True) for i in range(max(1, count - clean - outside - pairs - hidden))]
    return kinds[:count]


def write_cases(seed: int, count: int, folder: Path) -> None:
    """Write ``case-000`` and so on with ``answers.json`` into a folder, which is made; same arguments, same bytes."""
    answers = {}
    for index, (kind, recorded) in enumerate(plan(count)):
        case = draw_case(seed * 100_000 + index, kind, driver_recorded=recorded)
        name = f"case-{index:03d}"
        write_case(case, folder / name)
        answers[name] = common_form(case.answer, driver_concealed=not recorded)
    write_answers(answers, folder)


def main() -> None:
    """Write ``DIR/case-000`` and so on, and ``DIR/answers.json``."""
    parser = argparse.ArgumentParser(prog="python -m tests.blind", description=__doc__)
    parser.add_argument("--seed", type=int, required=True, help="of all cases")
    parser.add_argument("--n", type=int, default=300, help="number of cases (default: 300)")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR")
    options = parser.parse_args()
    write_cases(options.seed, options.n, options.out)


if __name__ == "__main__":
    main()
