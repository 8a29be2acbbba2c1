"""``magcal inspect``: defects of a recording, before any physics."""

from __future__ import annotations

import argparse
from pathlib import Path

from magcal_service.cli.common import (
    CRAFT_HELP,
    DONE,
    NOT_TRUSTED,
    RECORDING_HELP,
    SOURCE_HELP,
    Parser,
    beside_json,
    refuse_unwritable,
    source_lines,
    write_json,
)


def add_inspect(parser: Parser) -> None:
    """The arguments of ``magcal inspect``."""
    parser.add_argument("recording", type=Path, metavar="RECORDING.toml|FILE.mcap", help=RECORDING_HELP)
    parser.add_argument("--craft", metavar="NAME", help=CRAFT_HELP)
    parser.add_argument("--source", metavar="NAME", help=SOURCE_HELP)
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the findings here; - is standard output")
    parser.examples = ("magcal inspect output/paper/RECORDING.toml",)
    parser.set_defaults(command=_inspect)


def _inspect(options: argparse.Namespace) -> int:
    import json

    from magcal_service.recordings.inspect.inspection import inspect
    from magcal_service.recordings.reader import read_recording

    refuse_unwritable(options.json, options.recording)
    recording = read_recording(options.recording, options.craft, source=options.source)
    inspection = inspect(recording)
    content = inspection.to_dict()
    with beside_json(options.json):
        print("\n".join([*source_lines(recording), *recording.report.lines(), *inspection.lines()]))
        print(inspection.summary())
    write_json(options.json, json.dumps(content, indent=2, allow_nan=False) + "\n")
    return NOT_TRUSTED if inspection.findings else DONE
