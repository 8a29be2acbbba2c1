"""``magcal replay``: a recording through the daemon's own path."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from magcal_service.cli.common import (
    CRAFT_HELP,
    DONE,
    NOT_TRUSTED,
    RECORDING_HELP,
    REPLAY_SPEED,
    SOURCE_HELP,
    Parser,
    refuse_unwritable,
    source_lines,
    verdict_text,
)
from magcal_service.cli.craft_choice import CONFIG_HELP, craft_from, say_undriven

if TYPE_CHECKING:
    from magcal_service.offline.replay import Replay
    from magcal_service.recordings.recording import Recording


def add_replay(parser: Parser) -> None:
    """The arguments of ``magcal replay``."""
    parser.add_argument("recording", type=Path, metavar="RECORDING.toml|FILE.mcap", help=RECORDING_HELP)
    parser.add_argument("--config", type=Path, metavar="FILE", help=CONFIG_HELP)
    parser.add_argument("--craft", metavar="NAME", help=CRAFT_HELP)
    parser.add_argument("--source", metavar="NAME", help=SOURCE_HELP)
    parser.add_argument(
        "--speed", type=REPLAY_SPEED, default=0.0, help="times real time; 0 (default) as fast as it goes"
    )
    parser.add_argument("--out", type=Path, metavar="FILE.csv", help="one row per tick")
    parser.examples = ("magcal replay output/paper/RECORDING.toml --out rows.csv",)
    parser.set_defaults(command=_replay)


def _replay(options: argparse.Namespace) -> int:
    from contextlib import ExitStack

    from magcal_service.daemon.estimate_csv import EstimateCsv
    from magcal_service.offline.calibrate import residuals_of
    from magcal_service.offline.compensated import compensation_lines
    from magcal_service.offline.replay import craft_of, replay
    from magcal_service.recordings.inspect.inspection import inspect
    from magcal_service.recordings.reader import read_recording
    from magcal_service.recordings.usable import refuse_hopeless

    refuse_unwritable(options.out, options.recording, options.config)
    configured, to_read = craft_from(options.recording, options.config, options.craft, "a replay")
    recording = read_recording(options.recording, to_read, source=options.source)
    inspection = inspect(recording)
    refuse_hopeless(inspection.usable, inspection.lines())
    craft = configured or craft_of(inspection.to_replay)
    say_undriven(craft.physics, recording)
    with ExitStack() as stack:
        csv = stack.enter_context(EstimateCsv(options.out)) if options.out is not None else None
        result = replay(recording, craft, options.speed, csv, as_recorded=True, inspection=inspection)
    residuals = residuals_of(inspection.usable, result, result.pipeline.config)
    print(_counts(recording, result))
    after = "" if result.verdict == "not_started" else f", {residuals.after:.1f} nT after"
    print(f"residual rms: {residuals.before:.1f} nT before{after} (noise {residuals.noise})")
    if result.pipeline.compensation is not None:
        name = "physics.toml" if craft.physics is None else craft.physics.name
        print(*compensation_lines(result.compensated, result.pipeline.compensation.model, name), sep="\n")
    if residuals.published is not None:
        print(f"vectors as they were published since the start: {residuals.published:.1f} nT")
    print(verdict_text(result.verdict, result.reasons, result.remedy, result.model_doubt, options.recording))
    if result.protection:
        print(result.protection)
    return DONE if result.verdict == "trusted" else NOT_TRUSTED


def _counts(recording: Recording, result: Replay) -> str:
    counters = result.pipeline.ticks.counters + result.pipeline.counters
    kinds = ", ".join(f"{name} {count}" for name, count in sorted(counters.items()) if count)
    found = result.inspection
    lines = [
        *source_lines(recording),
        *recording.report.lines(),
        *found.lines(),
        f"rows: {found.account}",
        *filter(None, [result.remark]),
    ]
    return "\n".join([*lines, f"{result.estimates} estimates; {kinds}"])
