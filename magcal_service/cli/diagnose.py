"""``magcal diagnose``: the physics that a simulation left out."""

from __future__ import annotations

import argparse
from pathlib import Path

from magcal_service.cli.common import CRAFT_HELP, DONE, NOT_TRUSTED


def add_diagnose(parser: argparse.ArgumentParser) -> None:
    """The arguments of ``magcal diagnose``."""
    parser.add_argument("recording", type=Path, metavar="RECORDING.toml|FILE.mcap")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder for its three files")
    parser.add_argument("--simulation", metavar="SCENARIO.toml", help="compare with this scenario's nine errors")
    parser.add_argument("--craft", metavar="NAME", help=CRAFT_HELP)
    parser.set_defaults(command=_diagnose)


def _diagnose(options: argparse.Namespace) -> int:
    from magcal_service.diagnosis.command import Request, run
    from magcal_service.diagnosis.progress import progress

    with progress() as tell:
        outcome = run(Request(options.recording, options.out, options.simulation, options.craft), tell)
    print("\n".join(outcome.lines))
    return DONE if outcome.diagnosis.trusted else NOT_TRUSTED
