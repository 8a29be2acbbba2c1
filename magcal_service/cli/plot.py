"""``magcal plot``: a figure for a paper."""

from __future__ import annotations

import argparse
from pathlib import Path

from magcal_service.cli.common import CRAFT_HELP, DONE, SOURCE_HELP, Parser, refuse_unwritable


def add_plot(parser: Parser) -> None:
    """The arguments of ``magcal plot``."""
    parser.add_argument(
        "input", type=Path, metavar="RECORDING.toml|FILE.mcap|RESULT.json", help="what the figure is of"
    )
    parser.add_argument("--out", type=Path, required=True, metavar="FILE", help="figure to write: .svg, .pdf or .png")
    names = "of a recording: before-after (default), errors, track or spectrum"
    parser.add_argument("--figure", metavar="NAME", help=names)
    given = "of a recording: show this result on it, in place of a replay; physics.toml with its effects subtracted"
    parser.add_argument("--with", dest="given", type=Path, metavar="RESULT.json|physics.toml", help=given)
    parser.add_argument("--craft", metavar="NAME", help=CRAFT_HELP)
    parser.add_argument("--source", metavar="NAME", help=SOURCE_HELP)
    parser.examples = ("magcal plot output/paper/RECORDING.toml --figure errors --out errors.svg",)
    parser.set_defaults(command=_plot)


def _plot(options: argparse.Namespace) -> int:
    from magcal_service.plots.paper import refuse_suffix, save
    from magcal_service.plots.plot import sheet_of

    refuse_suffix(options.out)
    refuse_unwritable(options.out, options.input, options.given)
    sheet = sheet_of(options.input, options.figure, options.given, options.craft, options.source)
    save(sheet, options.out)
    print("\n".join([*sheet.doubts, f"written: {options.out}"]))
    return DONE
