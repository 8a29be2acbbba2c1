"""The ``magcal`` command: parse, call, print.

Exit codes: 0 done; 2 the input or the configuration was refused, with one line per fault on stderr; 3 done, but the
result must not be trusted, with the reasons in the output.
"""

from __future__ import annotations

import argparse
import os
import signal
import sys
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from magcal_service import __version__
from magcal_service.errors import ConfigError, Fault, MagcalError
from magcal_service.record_cli import add_commands
from magcal_service.status_cli import add_status

if TYPE_CHECKING:
    from magcal_service.calibrate import Calibration, Replay
    from magcal_service.config import CraftConfig
    from magcal_service.recordings.recording import Recording

DONE, REFUSED, NOT_TRUSTED = 0, 2, 3
_WHOSE = "which craft of a session that holds several"

# Matrices of nine rows gain nothing from threads, and waiting for them costs a quarter of a replay's time.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; returns its exit code."""
    options = _parser().parse_args(arguments)
    try:
        code: int = options.command(options)
        sys.stdout.flush()
    except MagcalError as error:
        print(error, file=sys.stderr)
        return error.exit_code
    except KeyboardInterrupt:
        return 130
    except BrokenPipeError:  # whoever read the output has seen enough, such as head
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return DONE
    return code


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="magcal", description="Real-time magnetometer calibration without attitude.")
    parser.add_argument("--version", action="version", version=f"magcal {__version__}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    run = commands.add_parser("run", help="the daemon: samples in, calibrated vectors and estimates out")
    run.add_argument("--config", type=Path, required=True, metavar="FILE", help="TOML configuration")
    run.set_defaults(command=_run)

    replay = commands.add_parser("replay", help="send a recording through the daemon's own path")
    replay.add_argument("recording", type=Path, metavar="RECORDING.toml|FILE.mcap")
    replay.add_argument("--config", type=Path, metavar="FILE", help="configuration of exactly one craft, or of --craft")
    replay.add_argument("--craft", metavar="NAME", help=_WHOSE)
    replay.add_argument("--speed", type=_speed, default=0.0, help="times real time; 0 (default) as fast as it goes")
    replay.add_argument("--out", type=Path, metavar="FILE.csv", help="one row per tick")
    replay.set_defaults(command=_replay)

    calibrate = commands.add_parser("calibrate", help="estimate the nine errors of a whole recording")
    calibrate.add_argument("recording", type=Path, metavar="RECORDING.toml|FILE.mcap")
    calibrate.add_argument("--craft", metavar="NAME", help=_WHOSE)
    calibrate.add_argument("--method", default="ukf", help="estimator (default: ukf, the daemon's own)")
    calibrate.add_argument("--json", type=Path, metavar="FILE", help="write the result here")
    calibrate.set_defaults(command=_calibrate)

    diagnose = commands.add_parser("diagnose", help="name the physics that a simulation left out, and show the gain")
    diagnose.add_argument("recording", type=Path, metavar="RECORDING.toml|FILE.mcap")
    diagnose.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder for its three files")
    diagnose.add_argument("--simulation", metavar="SCENARIO.toml", help="compare with this scenario's nine errors")
    diagnose.add_argument("--craft", metavar="NAME", help=_WHOSE)
    diagnose.set_defaults(command=_diagnose)

    study = commands.add_parser("study", help="Monte-Carlo studies of the estimators")
    study.add_argument("name", metavar="NAME", help="table2, convergence, noise, window, step, spin-rates, blind")
    study.add_argument("--runs", type=int, metavar="N", help="Monte-Carlo runs (default: the study's own)")
    study.add_argument("--seed", type=int, default=1, metavar="S", help="of the whole study (default: 1)")
    study.add_argument("--json", type=Path, metavar="FILE", help="write tables, figures and curves here")
    study.add_argument("--out", type=Path, metavar="DIR", help="write NAME.md, NAME.json and NAME.png here")
    study.add_argument("--methods", default="", metavar="A,B", help="estimators to compare (default: the study's own)")
    study.add_argument("--duration-s", type=int, metavar="S", help="length of a flight (default: the study's own)")
    study.add_argument("--workers", type=int, metavar="N", help="processes (default: one per core)")
    study.set_defaults(command=_study)

    add_status(commands.add_parser("status", help="ask a running daemon; exit code 3 where it is not healthy"))
    add_commands(commands.add_parser("record", help="recorded sessions: info, check, export, recover, join, describe"))
    return parser


def _speed(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0.0 <= value <= 1e6:
        raise argparse.ArgumentTypeError(f"{text!r} is refused; 0 (as fast as it goes) to 1e6 is accepted")
    return value


def _run(options: argparse.Namespace) -> int:
    from magcal_service import log
    from magcal_service.config_reader import load_config
    from magcal_service.private_files import check_unaltered
    from magcal_service.service import run_daemon

    config = load_config(options.config)
    check_unaltered(options.config)
    for craft in config.crafts:
        _check_method(options.config, craft.filter.method)
    stop = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stop.set())
    log.to_stderr()
    run_daemon(config, stop)
    return DONE


def _check_method(config: Path, name: str) -> None:
    """Refuse an unknown method by the file and field that name it, before anything is opened."""
    from magcal_service.estimators import find_method

    try:
        find_method(name)
    except ConfigError as error:
        fault = error.faults[0]
        raise ConfigError([Fault(f"{config.name}: craft.filter.method", fault.value, fault.accepted)]) from None


def _replay(options: argparse.Namespace) -> int:
    from contextlib import ExitStack

    from magcal_service.calibrate import craft_of, refuse_hopeless, replay, residuals_of
    from magcal_service.output import EstimateCsv
    from magcal_service.recordings.reader import read_recording

    configured = _craft_from(options.config, options.craft)
    recording = read_recording(options.recording, options.craft)
    refuse_hopeless(recording)
    craft = configured or craft_of(recording)
    with ExitStack() as stack:
        csv = stack.enter_context(EstimateCsv(options.out)) if options.out is not None else None
        result = replay(recording, craft, options.speed, csv, as_recorded=True)
    state = result.pipeline.estimator.estimate()
    residuals = residuals_of(recording, state.x, craft)
    print(_counts(recording, result))
    print(
        f"residual rms: {residuals.before:.1f} nT before, {residuals.after:.1f} nT after "
        f"(noise floor {residuals.noise_floor:.1f} nT)"
    )
    trust, model = result.pipeline.trust, result.pipeline.model_doubt
    print(_verdict(trust.verdict, trust.reasons, trust.remedy, model))
    return DONE if trust.verdict == "trusted" else NOT_TRUSTED


def _craft_from(config: Path | None, name: str | None) -> CraftConfig | None:
    from magcal_service.config_reader import load_config

    if config is None:
        return None
    crafts = load_config(config).crafts
    if len(crafts) > 1 and name is not None:
        crafts = tuple(craft for craft in crafts if craft.name == name)
    if len(crafts) != 1:
        accepted = "a replay takes exactly one [[craft]], or the one that --craft names"
        raise ConfigError([Fault(f"{config.name}: craft", len(crafts), accepted)])
    _check_method(config, crafts[0].filter.method)
    return crafts[0]


def _counts(recording: Recording, result: Replay) -> str:
    counters = result.pipeline.ticks.counters + result.pipeline.counters
    kinds = ", ".join(f"{name} {count}" for name, count in sorted(counters.items()) if count)
    lines = [*recording.report.lines(), *filter(None, [result.remark])]
    return "\n".join([*lines, f"{result.estimates} estimates; {kinds}"])


def _verdict(verdict: str, reasons: Sequence[str], remedy: str, model: str) -> str:
    text = f"verdict: {verdict}"
    if reasons:
        text += f" ({', '.join(reasons)})"
    return "\n".join(filter(None, (text, model, remedy and f"remedy: {remedy}")))


def _calibrate(options: argparse.Namespace) -> int:
    from magcal_service.calibrate import calibrate_recording
    from magcal_service.estimators import find_method
    from magcal_service.output import unwritable
    from magcal_service.recordings.reader import read_recording

    find_method(options.method)
    recording = read_recording(options.recording, options.craft)
    result = calibrate_recording(recording, options.method)
    print("\n".join(recording.report.lines()))
    print(_table(result))
    if options.json is not None:
        try:
            options.json.write_text(result.as_json(), encoding="utf-8")
        except OSError as exc:
            raise unwritable(options.json, exc) from None
    return DONE if result.trusted else NOT_TRUSTED


def _diagnose(options: argparse.Namespace) -> int:
    from magcal_service.diagnosis.command import Request, run
    from magcal_service.diagnosis.progress import progress

    with progress() as tell:
        outcome = run(Request(options.recording, options.out, options.simulation, options.craft), tell)
    print("\n".join(outcome.lines))
    return DONE if outcome.diagnosis.trusted else NOT_TRUSTED


def _study(options: argparse.Namespace) -> int:
    from magcal_service.studies import run_study, save
    from magcal_service.studies.executor import executor_for
    from magcal_service.studies.study import Request

    methods = tuple(name for name in options.methods.split(",") if name)
    executor = executor_for(options.workers)
    report = run_study(options.name, Request(options.runs, options.seed, executor, methods, options.duration_s))
    print(report.markdown(), end="")
    save(report, options.json, options.out)
    return DONE


def _table(result: Calibration) -> str:
    import numpy as np

    from magcal_service.model import BIAS, STATE_NAMES

    sigma = np.sqrt(np.diagonal(result.covariance))
    lines = [f"method {result.method}: {result.samples} samples, {result.ticks} ticks"]
    if result.verdict == "not_started":
        lines.append("  no estimate: the start was never sure")
    for i, (name, value, error) in enumerate(zip(STATE_NAMES, result.x, sigma, strict=True)):
        if result.verdict == "not_started":
            break
        number = f"{value:12.1f} +- {3 * error:9.1f} nT" if i < BIAS.stop else f"{value:12.5f} +- {3 * error:9.5f}"
        lines.append(f"  {name:<4}{number}   (3 sigma)")
    residuals = result.residuals
    held_out = "no sound fit" if residuals.held_out is None else f"{residuals.held_out:.1f} nT"
    lines.append(
        f"residual rms: {residuals.before:.1f} nT before, {residuals.after:.1f} nT after; "
        f"noise floor {residuals.noise_floor:.1f} nT; held out: {held_out}"
    )
    lines.append(_verdict(result.verdict, result.reasons, result.remedy, result.model_doubt))
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
