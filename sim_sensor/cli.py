"""``sim-sensor``: run a scenario on a link, write it as a recording, or list what is shipped."""

from __future__ import annotations

import argparse
import contextlib
import math
import signal
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Protocol, runtime_checkable

from magcal_service.base.errors import ConfigError, FileFault, MagcalError
from magcal_service.base.progress import Work, duration, is_wanted, showing
from magcal_service.base.version import __version__
from magcal_service.cli.common import Parser, described
from magcal_service.cli.completion import Names, add_completion
from magcal_service.cli.output import standard_output
from magcal_service.links import Role, open_link
from magcal_service.links.base import Link
from magcal_service.links.presence import Presence
from magcal_service.links.silence import why_silent
from magcal_service.physics.apply.advice import doubts_of
from magcal_service.physics.apply.model_file import PhysicsModel, read_model
from magcal_service.wire.fields import NAME
from magcal_service.wire.messages import Estimate, Message
from sim_sensor.beside import is_own
from sim_sensor.demo.flow import WindowedLink
from sim_sensor.node import NodeReport, run_node
from sim_sensor.physics import doubled
from sim_sensor.recorder import record_simulation
from sim_sensor.scenario import Scenario
from sim_sensor.scenario_reader import load_scenario, shipped_scenarios
from sim_sensor.simulation import Simulation

DEFAULT_LINK = "zenoh:tcp/127.0.0.1:7447"
_WINDOW = 200  # samples on the way when faster than real time: below the smallest buffer of any link
_PATIENCE_S = 2.0  # without an answer this long, the daemon is gone or never was
_SETTLE_S = 0.5  # after the last sample, for the last answers
_PROGRESS_S = 0.2  # between two progress lines: five a second look steady and cost nothing


class UnansweredError(MagcalError):
    """Everything was sent, and nobody has answered."""

    exit_code = 3


@runtime_checkable
class Attended(Protocol):
    """A link that knows the peers at its other ends."""

    def alive(self) -> frozenset[Presence]:
        """Who is there."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Parse, call, print; returns the exit code: 0 done, 2 refused, 3 done and never answered, 130 interrupted."""
    options = _parser().parse_args(arguments)
    command: Callable[[argparse.Namespace], object] = options.command
    try:
        with standard_output(endless=False), showing(options.quiet):
            command(options)
    except MagcalError as error:
        print(error, file=sys.stderr)
        return error.exit_code
    except KeyboardInterrupt:
        print("interrupted: what was asked for is not done", file=sys.stderr)
        return 130
    return 0


def _parser() -> Parser:
    parser = Parser(prog="sim-sensor", description="A simulated magnetometer node in orbit.")
    parser.examples = ("sim-sensor list", "sim-sensor record --scenario paper --out output/paper")
    parser.add_argument("--version", action="version", version=f"sim-sensor {__version__}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    run = commands.add_parser("run", help="send a scenario on a link")
    _common(run)
    run.add_argument("--link", default=DEFAULT_LINK, help=f"link address (default {DEFAULT_LINK})")
    run.add_argument("--speed", type=_speed, default=1.0, help="simulated seconds per second, or max (default 1)")
    run.add_argument("--record", type=Path, metavar="DIR", help="write what was sent as a recording, with its truth")
    run.add_argument("--wait", type=_wait, default=5.0, metavar="S", help="wait at most S for the daemon (default 5)")
    run.add_argument("--quiet", action="store_true", help="no line of how far it is, and no summary")
    run.examples = ("sim-sensor run --scenario paper --craft demo --speed 100",)
    run.set_defaults(command=_run)
    record = commands.add_parser("record", help="write a scenario as a recording")
    _common(record)
    record.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder for the recording and its truth")
    record.examples = ("sim-sensor record --scenario paper --out output/paper --duration 3600",)
    record.add_argument("--quiet", action="store_true", help="do not show how far it is, on stderr")
    record.set_defaults(command=_record)
    listing = commands.add_parser("list", help="name and describe the shipped scenarios")
    listing.examples = ("sim-sensor list",)
    listing.set_defaults(command=_list, quiet=True)
    completion = commands.add_parser("completion", help="what completes these commands in a shell")
    add_completion(completion, parser, _names)
    completion.set_defaults(quiet=True)
    described(parser)
    return parser


def _names() -> Names:
    """What completes an argument beside files."""
    return dict.fromkeys([("run", "scenario"), ("record", "scenario")], tuple(shipped_scenarios()))


def _common(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--scenario", required=True, metavar="FILE|NAME", help="a TOML file or a shipped scenario")
    parser.add_argument("--craft", type=_craft, metavar="NAME", help="name of the craft (default: the scenario's)")
    parser.add_argument("--seed", type=_seed, metavar="S", help="seed (default: the scenario's)")
    parser.add_argument("--duration", type=_duration, metavar="S", help="simulated seconds (default: the scenario's)")
    parser.add_argument(
        "--physics", type=Path, metavar="FILE", help="a physics.toml: its nine errors are taken, its effects added"
    )


def _scenario(options: argparse.Namespace) -> Scenario:
    """The scenario asked for, under the craft's name asked for."""
    scenario = load_scenario(options.scenario)
    return replace(scenario, craft=options.craft) if options.craft else scenario


def _craft(text: str) -> str:
    if not NAME.fullmatch(text):
        raise argparse.ArgumentTypeError(f"{text!r} is refused; 1 to 32 of A-Z a-z 0-9 _ - are accepted")
    return text


def _number(text: str, accepted: str, low: float, high: float) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not low <= value <= high:
        raise argparse.ArgumentTypeError(f"{text!r} is refused; {accepted}")
    return value


def _speed(text: str) -> float:
    if text == "max":
        return 0.0
    return _number(text, "max, or simulated seconds per second from 0 (as fast as possible) to 1e6", 0.0, 1e6)


def _wait(text: str) -> float:
    return _number(text, "seconds from 0 to 3600 are accepted", 0.0, 3600.0)


def _duration(text: str) -> float:
    return _number(text, "seconds from 1 to 31622400 (366 days) are accepted", 1.0, 31622400.0)


def _seed(text: str) -> int:
    if not (text.isascii() and text.isdigit() and int(text) < 2**63):
        raise argparse.ArgumentTypeError(f"{text!r} is refused; a whole number from 0 to 2**63 - 1 is accepted")
    return int(text)


def _simulation(options: argparse.Namespace) -> Simulation:
    scenario, model = _scenario(options), _model(options)
    for doubt in doubts_of("" if model is None else model.doubts):
        print(f"warning: {options.physics}: {doubt}", file=sys.stderr)
    for effect, keys in ({} if model is None else doubled(scenario, model)).items():
        print(
            f"warning: {effect} of {options.physics} is added to what {scenario.name} has by itself ({keys}): "
            "both act; for the file's alone, take that out of the scenario",
            file=sys.stderr,
        )
    return Simulation(scenario, options.seed, options.duration, model)


def _model(options: argparse.Namespace) -> PhysicsModel | None:
    return None if options.physics is None else read_model(options.physics)


def _list(options: argparse.Namespace) -> None:
    for name in shipped_scenarios():
        print(f"{name}\n    {' '.join(load_scenario(name).description.split())}\n")


def _record(options: argparse.Namespace) -> None:
    print(_recorded(_simulation(options), options.out, "--out"))


def _recorded(simulation: Simulation, directory: Path, option: str) -> Path:
    try:
        return record_simulation(simulation, directory)
    except OSError as error:
        accepted = "a folder that can be made and written is accepted"
        raise ConfigError([FileFault(f"{option}: {directory}", error, accepted)]) from None


def _run(options: argparse.Namespace) -> None:
    simulation = _simulation(options)
    view = Progress(simulation.duration_s, quiet=options.quiet)
    crafts = [simulation.truth.craft]
    with _stopped_by_signals() as stop, open_link(options.link, Role.NODE, crafts=crafts) as link:
        if not _heard(link, options.wait, stop, view.result) and not options.quiet:
            why = why_silent(link, crafts)
            print(f"no daemon has answered on {options.link}: {why}; sending all the same", file=sys.stderr)
        report = _send(simulation, link, options.speed, stop, view)
        view.summary(report, link)
        silence = "" if stop.is_set() else _silence(report, view, link, crafts)
        if not (silence or stop.is_set() or options.quiet):
            _tell_missing(report, view, options.link)
    if options.record is not None:
        part = Simulation(_scenario(options), options.seed, _length_s(simulation, report, stop), simulation.model)
        _recorded(part, options.record, "--record")
    if silence:
        raise UnansweredError(silence)


def _silence(report: NodeReport, view: Progress, link: Link, crafts: Sequence[str]) -> str:
    """What is to be said where samples were sent and none was answered; empty where one was."""
    sent = report.sent["MagnetometerSample"]
    if not sent or view.received["CalibratedVector"]:
        return ""
    return (
        f"{sent} samples were sent on {link.address} and none was answered: {why_silent(link, crafts)}\n"
        f"next: {_what_next(link.address, link.alone)}, then run this again"
    )


def _tell_missing(report: NodeReport, view: Progress, address: str) -> None:
    """Say on stderr what became of samples that have no answer; nothing where all have one."""
    sent, answered = report.sent["MagnetometerSample"], view.received["CalibratedVector"]
    if answered < sent:
        text = (
            f"{sent - answered} of {sent} samples have no answer: the daemon is behind, refused them, or they were lost"
        )
        print(f"{text}\nnext: {_what_next(address)}", file=sys.stderr)


def _what_next(address: str, alone: str = "") -> str:
    """Where it is said what the daemon makes of the samples; a serial line has no third end to ask at.

    alone: why nobody is at the other end; empty where somebody is, or that cannot be known.
    """
    if alone:
        return "start the daemon (magcal run), or give its address by --link"
    if address.startswith("zenoh:"):
        return f"see what the daemon says by `magcal status --link {address}`"
    return "see what the daemon says in its log and metrics (docs/health.md)"


@contextlib.contextmanager
def _stopped_by_signals() -> Iterator[threading.Event]:
    """An event that SIGINT and SIGTERM set; the handlers that were there before come back."""
    stop = threading.Event()
    numbers = (signal.SIGINT, signal.SIGTERM)
    before = [signal.signal(number, lambda *_: stop.set()) for number in numbers]
    try:
        yield stop
    finally:
        for number, handler in zip(numbers, before, strict=True):
            signal.signal(number, handler)


def _length_s(simulation: Simulation, report: NodeReport, stop: threading.Event) -> float:
    """How much of the run was sent: all of it, or up to the sample at which it was stopped."""
    sampled = 1.0 / simulation.truth.sensor.rate_hz
    return min(simulation.duration_s, report.elapsed_s + sampled) if stop.is_set() else simulation.duration_s


def _heard(link: Link, wait_s: float, stop: threading.Event, on_result: Callable[[Message], None]) -> bool:
    """Wait until the daemon is heard or, where a link lists its peers, among them; at most ``wait_s``."""
    deadline = time.monotonic() + wait_s
    while not stop.is_set() and time.monotonic() < deadline:
        messages = link.receive(min(0.1, wait_s))
        for message in messages:
            on_result(message)
        if messages or (isinstance(link, Attended) and any(one.role is Role.SERVICE for one in link.alive())):
            return True
    return wait_s == 0.0


def _send(simulation: Simulation, link: Link, speed: float, stop: threading.Event, view: Progress) -> NodeReport:
    """The run itself; faster than real time, no more samples are on the way than any link can hold."""
    if speed == 1.0:
        report = run_node(simulation, link, speed, stop, view.result, view.sent)
    else:
        flow = WindowedLink(link, _WINDOW, view.result, patience_s=_PATIENCE_S)
        report = run_node(simulation, flow, speed, stop, on_sent=view.sent)
    deadline = time.monotonic() + _SETTLE_S
    while not stop.is_set() and time.monotonic() < deadline:
        for message in link.receive(0.1):
            view.result(message)
    return report


@dataclass
class Progress:
    """What the terminal shows: one line, rewritten, where stderr is a terminal; a summary at the end."""

    duration_s: float
    quiet: bool = False
    received: Counter[str] = field(default_factory=Counter)
    newest: Estimate | None = None
    _shown: float = 0.0
    _work: Work = field(init=False)

    def __post_init__(self) -> None:
        self._work = Work("sending", self.duration_s, "s")

    def result(self, message: Message) -> None:
        """Take a message from the daemon in."""
        self.received[type(message).__name__] += 1
        if isinstance(message, Estimate) and is_own(message):
            self.newest = message

    def sent(self, report: NodeReport) -> None:
        """Rewrite the line, five times a second at most."""
        if self.quiet or not is_wanted() or time.monotonic() < self._shown + _PROGRESS_S:
            return
        self._shown, self._work.done = time.monotonic(), report.elapsed_s
        left_s = self._work.left_s(self._shown - self._work.began_s)
        end = "" if left_s is None else f", {duration(left_s)} left"
        print(f"\r\x1b[K{self._line(report)}{end}", end="", file=sys.stderr, flush=True)

    def summary(self, report: NodeReport, link: Link) -> None:
        """The last line, kept."""
        if self.quiet:
            return
        start = "\r\x1b[K" if is_wanted() else ""
        dropped = link.counters["dropped"]
        print(f"{start}{self._line(report)}; messages dropped by the link: {dropped}", file=sys.stderr)

    def _line(self, report: NodeReport) -> str:
        share = report.elapsed_s / self.duration_s
        samples, answered = report.sent["MagnetometerSample"], self.received["CalibratedVector"]
        text = f"{report.elapsed_s:9.1f} of {self.duration_s:.0f} s ({share:4.0%}), {report.messages} messages sent"
        text += f", {answered} of {samples} samples answered"
        if self.newest is None:
            return text
        b = ", ".join(f"{value:.0f}" for value in self.newest.bias_nt)
        return f"{text}, b = ({b}) nT {self.newest.verdict.value}"


if __name__ == "__main__":
    sys.exit(main())
