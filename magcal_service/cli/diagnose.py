"""``magcal diagnose``: the physics that a simulation left out."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from magcal_service.base.errors import ConfigError, Fault, InputRefusedError
from magcal_service.cli.common import (
    CRAFT_HELP,
    DONE,
    NOT_TRUSTED,
    SOURCE_HELP,
    Parser,
    add_executor,
    executor_of,
    print_asked,
    refuse_executor,
)


def add_diagnose(parser: Parser) -> None:
    """The arguments of ``magcal diagnose``."""
    parser.add_argument(
        "recordings",
        type=Path,
        nargs="+",
        metavar="RECORDING.toml|FILE.mcap",
        help="one recording, or several of one craft: their physics is taken to be common",
    )
    out = "folder for its three files (default: diagnosis)"
    parser.add_argument("--out", type=Path, default=Path("diagnosis"), metavar="DIR", help=out)
    parser.add_argument("--simulation", metavar="SCENARIO.toml", help="compare with this scenario's nine errors")
    parser.add_argument("--craft", metavar="NAME", help=CRAFT_HELP)
    parser.add_argument("--source", metavar="NAME", help=f"of one recording: {SOURCE_HELP}")
    alone = "recordings of different craft: each by itself, in a folder of its own under --out"
    parser.add_argument("--separately", action="store_true", help=alone)
    add_executor(parser)
    parser.examples = (
        "magcal diagnose output/paper/RECORDING.toml --out diagnosis",
        "magcal diagnose day1.toml day2.toml --out diagnosis",
    )
    parser.set_defaults(command=_diagnose)


def _diagnose(options: argparse.Namespace) -> int:
    if options.source is not None and (options.separately or len(options.recordings) > 1):
        accepted = (
            "of several recordings each craft's own magnetometer is diagnosed; leave it out, or give one recording"
        )
        raise ConfigError([Fault("--source", options.source, accepted)])
    if options.separately:
        from magcal_service.diagnosis.separately import diagnose_each

        return print_asked(
            diagnose_each(options.recordings, options.simulation, options.craft, options.out, executor_of(options))
        )
    refuse_executor(options, "it is for many recordings at once: add --separately")
    from magcal_service.base.progress import steps
    from magcal_service.diagnosis.command import Request, run
    from magcal_service.diagnosis.forecast import Course
    from magcal_service.diagnosis.stages import STEPS

    if len(options.recordings) > 1:
        return _diagnose_together(options)
    with _kept_if_refused(options.out), steps(STEPS, Course()) as step:
        outcome = run(
            Request(options.recordings[0], options.out, options.simulation, options.craft, options.source), step
        )
    print("\n".join(outcome.lines))
    return DONE if outcome.diagnosis.trusted else NOT_TRUSTED


@contextmanager
def _kept_if_refused(folder: Path) -> Iterator[None]:
    """Say what an earlier run has left in a folder where this one is refused: it is no result of this one."""
    from magcal_service.offline.result_files import kept_line

    try:
        yield
    except InputRefusedError:
        for line in kept_line(folder):
            print(line, file=sys.stderr)
        raise


def _diagnose_together(options: argparse.Namespace) -> int:
    """Recordings of one craft: what physics they have in common."""
    from magcal_service.base.progress import steps
    from magcal_service.diagnosis.forecast import Course
    from magcal_service.diagnosis.joint.command import JointRequest, run_together
    from magcal_service.diagnosis.stages import JOINT_STEPS

    if options.simulation is not None:
        accepted = "one recording is compared with a scenario; leave it out, or add --separately"
        raise ConfigError([Fault("--simulation", options.simulation, accepted)])
    with _kept_if_refused(options.out), steps(JOINT_STEPS, Course()) as step:
        outcome = run_together(JointRequest(tuple(options.recordings), options.out, options.craft), step)
    if outcome.diagnosis.assumed:
        print(f"warning: {outcome.diagnosis.assumed}", file=sys.stderr)
    print("\n".join(outcome.lines))
    return DONE if outcome.diagnosis.trusted else NOT_TRUSTED
