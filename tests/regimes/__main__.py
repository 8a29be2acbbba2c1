"""``python -m tests.regimes --seed S --n N --out DIR [--clean]``: write cases and their answers."""

from __future__ import annotations

import argparse
from pathlib import Path

from tests.regimes.case import draw_case
from tests.regimes.write import write_answers, write_case


def main() -> None:
    """Write ``DIR/case-000`` and so on, and ``DIR/answers.json``."""
    parser = argparse.ArgumentParser(prog="python -m tests.regimes", description=__doc__)
    parser.add_argument("--seed", type=int, required=True, help="of all cases; case k of a seed is always the same")
    parser.add_argument("--n", type=int, default=64, help="number of cases (default: 64, four of each regime)")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR")
    parser.add_argument("--clean", action="store_true", help="nothing is wrong in any of them")
    options = parser.parse_args()
    answers = {}
    for index in range(options.n):
        case = draw_case(options.seed, index, clean=options.clean)
        name = f"case-{index:03d}"
        write_case(case, options.out / name)
        answers[name] = case.answer
    write_answers(answers, options.out)


if __name__ == "__main__":
    main()
