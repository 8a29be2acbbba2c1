"""``magcal apply``: the calibrated vectors of a recording."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from magcal_service.cli.common import (
    CRAFT_HELP,
    DONE,
    NOT_TRUSTED,
    RECORDING_HELP,
    SOURCE_HELP,
    Parser,
    refuse_unwritable,
    source_lines,
)

if TYPE_CHECKING:
    from magcal_service.offline.apply import Applied
    from magcal_service.offline.given import Given
    from magcal_service.recordings.inspect.inspection import Inspection


def add_apply(parser: Parser) -> None:
    """The arguments of ``magcal apply``."""
    parser.add_argument("recording", type=Path, metavar="RECORDING.toml|FILE.mcap", help=RECORDING_HELP)
    given = "what calibrate --json or diagnose --out has written"
    parser.add_argument(
        "--with", dest="given", type=Path, required=True, metavar="RESULT.json|physics.toml", help=given
    )
    parser.add_argument("--out", type=Path, required=True, metavar="FILE", help="ending in .csv, .parquet or .mcap")
    parser.add_argument("--craft", metavar="NAME", help=CRAFT_HELP)
    parser.add_argument("--source", metavar="NAME", help=SOURCE_HELP)
    parser.examples = ("magcal apply output/paper/RECORDING.toml --with result.json --out vectors.csv",)
    parser.set_defaults(command=_apply)


def _apply(options: argparse.Namespace) -> int:
    from magcal_service.base.errors import Fault, InputRefusedError
    from magcal_service.base.progress import Work, counted
    from magcal_service.offline.apply import apply
    from magcal_service.offline.given import read_given
    from magcal_service.offline.vector_file import refuse_suffix, write_vectors
    from magcal_service.physics.apply.lacking import undriven_lines
    from magcal_service.recordings.inspect.inspection import inspect
    from magcal_service.recordings.reader import read_recording
    from magcal_service.recordings.usable import refuse_hopeless

    refuse_suffix(options.out)
    refuse_unwritable(options.out, options.recording, options.given)
    given = read_given(options.given)
    recording = read_recording(options.recording, options.craft, source=options.source)
    given.refuse_other_craft(recording)
    if given.source and recording.source and given.source != recording.source:
        accepted = f"a result of magnetometer {recording.source} is accepted; --source chooses another of the recording"
        raise InputRefusedError([Fault(f"{options.given}: source", given.source, accepted)])
    inspection = inspect(recording)
    refuse_hopeless(inspection.usable, inspection.lines())
    for line in [] if given.model is None else undriven_lines(given.name, given.model, recording.driving):
        print(line, file=sys.stderr)
    about = {"recording": recording.name, "result": given.name, "result_sha256": given.sha256}
    with counted(Work("applying")):
        applied = apply(given, inspection)
        write_vectors(options.out, applied.vectors, about)
    print("\n".join([*source_lines(recording), *recording.report.lines(), *inspection.lines()]))
    print(f"rows: {inspection.account}")
    print("\n".join(_said(given, inspection, applied, options.out)))
    return DONE if applied.trusted and not inspection.open and not applied.remark else NOT_TRUSTED


def _said(given: Given, inspection: Inspection, applied: Applied, out: Path) -> list[str]:
    from magcal_service.offline.apply import residual_rms
    from magcal_service.offline.compensated import account_lines

    vectors = applied.vectors
    lines = [
        f"{out}: {len(vectors)} vectors, {applied.trusted} of them trusted; w = (I + D) B - b by {given.name}, "
        f"sha256 {given.sha256[:12]}"
    ]
    if given.model is not None and not applied.stopped:
        lines += [f"{given.name}: {one}" for one in account_lines(applied.accounts, given.model)]
    before, after = residual_rms(given, inspection, applied)
    lines.append(f"residual rms: {before:.1f} nT before, {after:.1f} nT after")
    if not given.whole:
        lines.append(
            f"covariance: of the nine sigmas in {given.name} without their correlations: too wide along some axes"
        )
    if applied.partly:
        lines.append(f"{applied.partly} vectors are doubtful: not every effect was subtracted from them")
    if applied.strayed:
        lines.append(f"{applied.strayed} vectors are doubtful: they are not as long as the reference")
    if inspection.open:
        codes = ", ".join(str(one.code) for one in inspection.open)
        lines.append(f"to be answered about the recording first: {codes}; magcal inspect has what and how")
    return [*lines, *filter(None, [applied.remark]), *given.doubts()]
