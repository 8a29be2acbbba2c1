"""``magcal export``: the nine numbers for flight software."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Final

from magcal_service.cli.common import DONE, NOT_TRUSTED, Parser, refuse_unwritable, write_text

_LSB_NT: Final = (0.01, 1e4)
"""Of one count: a fluxgate's digitiser, and a compass for the pocket."""


def add_export(parser: Parser) -> None:
    """The arguments of ``magcal export``."""
    parser.add_argument(
        "result", type=Path, metavar="RESULT.json|physics.toml", help="of calibrate --json, or diagnose"
    )
    parser.add_argument("--format", required=True, metavar="NAME", help="one of those below")
    parser.add_argument("--out", type=Path, metavar="FILE", help="write it here (default: to stdout)")
    parser.add_argument("--index", type=int, default=0, metavar="N", help="which compass of the autopilot (default: 0)")
    parser.add_argument("--lsb-nt", type=float, metavar="NT", help="nT of one count of the sensor, for betaflight")
    parser.more = forms_text
    parser.examples = ("magcal export result.json --format c-header --out magcal.h",)
    parser.set_defaults(command=_export)


def forms_text() -> str:
    """Every format in a line, for the help."""
    from magcal_service.offline.exports import FORMS

    lines = [f"  {form.name:<12}  {form.says}" for form in FORMS.values()]
    return "\nformats:\n" + "\n".join(lines) + "\n"


def _export(options: argparse.Namespace) -> int:
    from magcal_service.base.errors import ConfigError, Fault
    from magcal_service.base.typed_toml import nearest
    from magcal_service.offline.exports import FORMS, Wanted
    from magcal_service.offline.exports.form import left_out
    from magcal_service.offline.given import read_given

    form = FORMS.get(options.format)
    if form is None:
        raise ConfigError([Fault("--format", options.format, nearest(options.format, FORMS))])
    if options.lsb_nt is not None and not _LSB_NT[0] <= options.lsb_nt <= _LSB_NT[1]:
        accepted = f"nT of one count, {_LSB_NT[0]:g} to {_LSB_NT[1]:g}, is accepted"
        raise ConfigError([Fault("--lsb-nt", options.lsb_nt, accepted)])
    refuse_unwritable(options.out, options.result)
    given = read_given(options.result)
    made = form.make(given, Wanted(options.index, options.lsb_nt))
    write_text(options.out, made.text)
    for line in filter(None, (made.remark, *left_out(given), *given.doubts())):
        print(line, file=sys.stderr)
    return NOT_TRUSTED if made.lossy or not given.trusted else DONE
