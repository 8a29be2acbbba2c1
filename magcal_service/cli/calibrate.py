"""``magcal calibrate``: the nine errors of a whole recording."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from magcal_service.base.errors import ConfigError, Fault
from magcal_service.cli.common import (
    CRAFT_HELP,
    DONE,
    NOT_TRUSTED,
    RECORDING_HELP,
    SOURCE_HELP,
    Parser,
    add_executor,
    beside_json,
    executor_of,
    methods_text,
    print_asked,
    refuse_executor,
    refuse_unwritable,
    source_lines,
    verdict_text,
    write_json,
)
from magcal_service.cli.craft_choice import CONFIG_HELP, craft_from, say_undriven

if TYPE_CHECKING:
    from magcal_service.offline.calibrate import Calibration

PRIOR_HELP = (
    "an earlier result of this sensor: the filter goes on from its nine errors, without a start of its own; effects of "
    "other physics are not taken from it"
)
START_HELP = "first seconds that a filter starts from; a log that is no longer is taken as one batch (default: 120)"


def add_calibrate(parser: Parser) -> None:
    """The arguments of ``magcal calibrate``."""
    parser.add_argument(
        "recordings", type=Path, nargs="+", metavar="RECORDING.toml|FILE.mcap", help=f"{RECORDING_HELP}; or several"
    )
    parser.add_argument("--craft", metavar="NAME", help=CRAFT_HELP)
    parser.add_argument("--source", metavar="NAME", help=SOURCE_HELP)
    parser.add_argument("--method", metavar="NAME", help="one of those below (default: ukf, the daemon's own)")
    parser.more = methods_text
    parser.add_argument("--config", type=Path, metavar="FILE", help=CONFIG_HELP)
    parser.add_argument("--prior", type=Path, metavar="RESULT.json", help=PRIOR_HELP)
    parser.add_argument("--start-s", type=float, metavar="S", help=START_HELP)
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the result here; - is standard output")
    parser.add_argument("--out", type=Path, metavar="DIR", help="several recordings: folder for a result of each")
    add_executor(parser)
    parser.examples = (
        "magcal calibrate output/paper/RECORDING.toml --method spin --json result.json",
        "magcal calibrate flights/*.toml --out results",
    )
    parser.set_defaults(command=_calibrate)


def _calibrate(options: argparse.Namespace) -> int:
    return _calibrate_one(options) if options.out is None else _calibrate_each(options)


def _calibrate_each(options: argparse.Namespace) -> int:
    from magcal_service.config.settings import DEFAULT_METHOD
    from magcal_service.estimators import find_method
    from magcal_service.offline.calibrate_each import calibrate_each

    if options.json is not None:
        accepted = "a recording's result is in its own folder of --out; leave --json out"
        raise ConfigError([Fault("--json", str(options.json), accepted)])
    given = {"--config": options.config, "--prior": options.prior, "--start-s": options.start_s}
    accepted = "it goes with one recording, without --out; leave it out"
    if faults := [Fault(name, str(value), accepted) for name, value in given.items() if value is not None]:
        raise ConfigError(faults)
    method = find_method(options.method or DEFAULT_METHOD)
    executor = executor_of(options)
    return print_asked(
        calibrate_each(options.recordings, method.name, options.craft, options.out, executor, options.source)
    )


def _calibrate_one(options: argparse.Namespace) -> int:
    from dataclasses import replace

    from magcal_service.config.settings import DEFAULT_METHOD
    from magcal_service.estimators import find_method
    from magcal_service.offline.calibrate import calibrate
    from magcal_service.recordings.reader import read_recording

    accepted = "several recordings need a folder for their results: --out DIR"
    if len(options.recordings) != 1:
        raise ConfigError([Fault("number of recordings", len(options.recordings), accepted)])
    refuse_executor(options, accepted)
    refuse_unwritable(options.json, *options.recordings, options.prior, options.config)
    path = options.recordings[0]
    configured, to_read = craft_from(path, options.config, options.craft, "a calibration")
    method = options.method and find_method(options.method).name
    recording = read_recording(path, to_read, source=options.source)
    if configured is not None and method:
        configured = replace(configured, filter=replace(configured.filter, method=method))
    craft = configured or recording.craft
    physics = None if craft is None else craft.physics
    say_undriven(physics, recording)
    result = calibrate(recording, method or DEFAULT_METHOD, configured, start_s=options.start_s, prior=options.prior)
    found = (f"found: {one}" for one in result.findings)
    with beside_json(options.json):
        print("\n".join([*source_lines(recording), *recording.report.lines(), *found]))
        print(_table(result, path, "physics.toml" if physics is None else physics.name))
    write_json(options.json, result.as_json())
    return DONE if result.trusted else NOT_TRUSTED


def _table(result: Calibration, path: Path, physics: str = "physics.toml") -> str:
    import numpy as np

    from magcal_service.model import BIAS, STATE_NAMES

    sigma = np.sqrt(np.diagonal(result.covariance))
    counted = result.counters
    lines = [
        f"rows: {result.rows}",
        f"method {result.method}: {counted.get('accepted', 0)} samples accepted, {counted.get('rejected', 0)} of them "
        f"stopped by the filter's gate, {result.ticks} ticks",
    ]
    if result.verdict == "not_started":
        lines.append("  no estimate: the start was never sure")
    for i, (name, value, error) in enumerate(zip(STATE_NAMES, result.x, sigma, strict=True)):
        if result.verdict == "not_started":
            break
        number = f"{value:12.1f} +- {3 * error:9.1f} nT" if i < BIAS.stop else f"{value:12.5f} +- {3 * error:9.5f}"
        lines.append(f"  {name:<4}{number}   (3 sigma)")
    lines += _temperature_lines(result)
    lines += [f"scale: {result.scale_doubt}"] if result.scale_doubt else []
    lines += [f"{physics}: {doubt}" for doubt in result.physics_doubts]
    residuals = result.residuals
    held_out = "no sound fit" if residuals.held_out is None else f"{residuals.held_out:.1f} nT"
    after = "" if result.verdict == "not_started" else f", {residuals.after:.1f} nT after"
    lines.append(
        f"residual rms: {residuals.before:.1f} nT before{after}; noise {residuals.noise}; held out: {held_out}"
    )
    lines.append(verdict_text(result.verdict, result.reasons, result.remedy, result.model_doubt, path))
    return "\n".join(lines)


def _temperature_lines(result: Calibration) -> list[str]:
    from magcal_service.physics.held import held_in_words

    if result.verdict == "not_started":
        return []
    lines = [f"  at {held_in_words(result.held_at)}"] if result.held_at else []
    return [*lines, *([f"  constants over {result.over}"] if result.over is not None else [])]
