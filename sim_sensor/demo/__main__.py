"""The whole loop in one command: a simulated craft feeds the daemon over a real link while its errors converge.

    python -m sim_sensor.demo --link zenoh

Two processes: this one is the sensor node, and the daemon (``magcal run``) is a second one.  They meet on the link
alone: samples go out, calibrated vectors and estimates come back.  Truth stays here, for the table and the plot.
"""

from __future__ import annotations

import argparse
import contextlib
import math
import signal
import socket
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import quote

from magcal_service.base.errors import ExtraMissingError, MagcalError
from magcal_service.cli.common import port_number
from magcal_service.links import Link, Role, open_link
from magcal_service.wire.messages import Estimate, Message
from sim_sensor.beside import is_own
from sim_sensor.demo.config import daemon_config, zenoh_settings
from sim_sensor.demo.daemon_process import DaemonProcess
from sim_sensor.demo.flow import WindowedLink
from sim_sensor.demo.next_steps import AND_THEN, next_steps, shown
from sim_sensor.demo.page import FlightSource, live_page
from sim_sensor.demo.pty_pair import PtyPair
from sim_sensor.demo.report import DemoError, Outcome, Plan, Session, Wire, objections, write_results
from sim_sensor.node import Simulation, run_node
from sim_sensor.scenario_reader import load_scenario
from sim_sensor.view.summary import summarise

if TYPE_CHECKING:
    from rich.console import Console

__all__ = ["main", "run_demo"]

WINDOW = 200  # samples on the way: below the smallest buffer on any link, above what a busy machine needs
PATIENCE_S = 5.0  # without any answer for this long, the samples on the way are given up
READY_S = 30.0  # a slow machine imports and opens the link within this
QUIET_S = 1.0  # after the last sample was answered, this long without a result means that no more is coming
STOP_S = 10.0  # a daemon that was asked to end writes its last tick and file well within this
NOT_TRUSTED = 3  # exit code of every command whose result must not be trusted
INTERRUPTED = 130  # the shell's code for Ctrl-C


def run_demo(plan: Plan, console: Console) -> int:
    """Run one demo: 0 where all nine errors end inside 3 sigma and trusted, else 3; 130 after Ctrl-C.

    Raises DemoError or DaemonDiedError where the loop did not work, and ConfigError for a refused scenario.
    """
    simulation = Simulation(load_scenario(plan.scenario), plan.seed, plan.duration_s)
    plan.out.mkdir(parents=True, exist_ok=True)
    what = f"scenario {plan.scenario}, seed {simulation.seed}, {simulation.duration_s:.0f} s"
    console.print(f"{what}; starting the daemon on a {plan.wire.value} link", markup=False, highlight=False)
    with contextlib.ExitStack() as stack:
        page = stack.enter_context(_page(plan, f"{what}, over {plan.wire.value}", console))
        session, stop = Session(simulation, page.take), threading.Event()
        with _stop_on_signals(stop):
            outcome = _exchange(plan, session, stop, console)
        page.note = "The flight is over."
        code = _report(plan, session, outcome, console)
        if plan.stay and not outcome.interrupted:
            console.print("the page stays until Ctrl-C", style="bold")
            with _stop_on_signals(stop):
                stop.wait()
    return code


@contextlib.contextmanager
def _page(plan: Plan, what: str, console: Console) -> Iterator[FlightSource]:
    """The live page, with its address on the console; nobody sees what it is fed where none is wanted."""
    source = FlightSource(what)
    if plan.port is None:
        yield source
        return
    with live_page(source, plan.port) as address:
        console.print("live page, for a browser on this machine: ", address, sep="", style="bold", soft_wrap=True)
        yield source


def _exchange(plan: Plan, session: Session, stop: threading.Event, console: Console) -> Outcome:
    """Start the daemon, send everything, wait for the last estimate, stop the daemon."""
    from sim_sensor.view.terminal import LiveTable

    scenario = session.simulation.truth
    with contextlib.ExitStack() as stack:
        service_address, node_address = stack.enter_context(_cable(plan))
        config = plan.out / "magcal.toml"
        config.write_text(daemon_config(scenario, service_address, plan.out / "ticks.csv"))
        daemon = stack.enter_context(DaemonProcess(config, plan.out / "daemon.log", plan.daemon))
        link = stack.enter_context(open_link(node_address, Role.NODE, crafts=[scenario.craft]))
        _await_daemon(link, daemon, session, stop)
        table = stack.enter_context(LiveTable(session.simulation.duration_s, console, leave=False))

        def take(message: Message) -> None:
            session.take(message)
            if isinstance(message, Estimate) and is_own(message):
                table.update(session.time_s, message, session.truth, _counts(flow))

        flow = WindowedLink(link, WINDOW, take, PATIENCE_S, daemon.check, session.watcher)
        table.update(0.0, None, session.truth)
        begin_s = time.monotonic()
        run_node(session.simulation, flow, plan.speed, stop)
        interrupted = stop.is_set()
        flow.wait_for_room()
        _receive_rest(flow, session)
        wall_s = time.monotonic() - begin_s
        code = _stop(daemon, flow)
        used = session.estimate.samples_used if session.estimate is not None else 0
        return Outcome({**_counts(flow), "used": used}, code, wall_s, interrupted)


def _counts(flow: WindowedLink) -> dict[str, int]:
    counters = flow.counters
    return {"sent": counters["samples"], "answered": counters["answered"], "unanswered": counters["unanswered"]}


def _await_daemon(link: Link, daemon: DaemonProcess, session: Session, stop: threading.Event) -> None:
    """Return once the daemon's first status has come: a sample sent before could be lost."""
    deadline_s = time.monotonic() + READY_S
    while not session.statuses and not stop.is_set():
        for message in link.receive(0.1):
            session.take(message)
        daemon.check()
        if time.monotonic() > deadline_s:
            where = f"on {link.address} within {READY_S:.0f} s"
            raise DemoError(f"no status of the daemon came {where}; its last lines:\n{daemon.last_lines()}")


def _receive_rest(flow: WindowedLink, session: Session) -> None:
    """Receive until no result has come for ``QUIET_S``."""
    begin_s = time.monotonic()
    while time.monotonic() - max(session.last_result_s, begin_s) < QUIET_S:
        flow.receive(0.05)


def _stop(daemon: DaemonProcess, flow: WindowedLink) -> int:
    """Ask the daemon to end, take what it still has to say, and return its exit code."""
    daemon.ask_to_stop()
    deadline_s = time.monotonic() + STOP_S
    while daemon.running and time.monotonic() < deadline_s:
        flow.receive(0.05)
    code = daemon.stop(timeout_s=0.1)
    flow.receive(0.05)
    return code


def _report(plan: Plan, session: Session, outcome: Outcome, console: Console) -> int:
    """Print what came out, leave it in files, and return the exit code."""

    def say(text: str, style: str = "") -> None:
        console.print(text, style=style, markup=False, highlight=False, soft_wrap=True)

    if session.history.last is None and outcome.interrupted:
        say("interrupted before any estimate came: no estimate, no results", "yellow")
        return INTERRUPTED
    if session.history.last is None:
        raise DemoError(f"no estimate came back; {outcome.text()}; see {plan.out / 'daemon.log'}")
    summary = summarise(session.history)
    text = "\n\n".join([summary.text(), *filter(None, [session.gain_text()]), outcome.text()])
    say(f"\n{text}")
    files = write_results(plan, session, text, recording=not outcome.interrupted)
    say(f"results in {shown(plan.out)}: {', '.join(path.name for path in files.values())}\n")
    if outcome.daemon_code != 0:
        raise DemoError(f"the daemon ended with exit code {outcome.daemon_code}; see {plan.out / 'daemon.log'}")
    if outcome.interrupted:
        say("interrupted: these are the numbers of the shorter run", "yellow")
        return INTERRUPTED
    found = objections(summary)
    if found:
        say("not as it should be at the end: " + "; ".join(found), "bold red")
    else:
        say("all nine errors are inside 3 sigma, and trusted", "bold green")
    say("\nWhat next?  Each line works as it stands:")
    for what, command in next_steps(plan, files["recording"]).items():
        say(f"# {what}", "dim")
        say(command)
    say(AND_THEN)
    return NOT_TRUSTED if found else 0


@contextlib.contextmanager
def _cable(plan: Plan) -> Iterator[tuple[str, str]]:
    """The daemon's and the node's address on a link of their own, for as long as the context lasts."""
    if plan.wire is Wire.SERIAL:
        with PtyPair() as pair:
            yield f"serial:{pair.paths[0]}", f"serial:{pair.paths[1]}"
        return
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    settings = plan.out / "zenoh.json5"
    settings.write_text(zenoh_settings())
    address = f"zenoh:tcp/127.0.0.1:{port}?config={quote(str(settings))}"
    yield address, address


@contextlib.contextmanager
def _stop_on_signals(stop: threading.Event) -> Iterator[None]:
    """SIGINT, SIGTERM and SIGHUP set the event; the handlers that were there before come back afterwards."""
    kinds = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    before = [signal.signal(kind, lambda *_: stop.set()) for kind in kinds]
    try:
        yield
    finally:
        for kind, handler in zip(kinds, before, strict=True):
            signal.signal(kind, handler)


def parse_arguments(arguments: Sequence[str] | None) -> Plan:
    """The command line as a plan."""
    parser = argparse.ArgumentParser(prog="python -m sim_sensor.demo", description=(__doc__ or "").split("\n")[0])
    parser.add_argument(
        "--link", type=Wire, choices=list(Wire), default=Wire.ZENOH, help="what joins the two processes"
    )
    parser.add_argument("--scenario", default="paper", help="a shipped scenario's name or a TOML file")
    parser.add_argument("--speed", type=_not_negative, default=300.0, help="sample seconds per second; 0: flat out")
    parser.add_argument("--seed", type=int, help="the scenario's own where absent")
    parser.add_argument("--duration", type=_not_negative, help="sample time [s]; the scenario's own where absent")
    parser.add_argument("--out", type=Path, help="folder for the results; output/<time>-<link> where absent")
    parser.add_argument(
        "--port", type=port_number, default=0, help="of the live page on 127.0.0.1; one that is free where absent"
    )
    parser.add_argument("--no-page", action="store_true", help="no live page")
    parser.add_argument("--stay", action="store_true", help="keep the page at the end, until Ctrl-C")
    given = parser.parse_args(arguments)
    out = given.out or Path("output") / f"{datetime.now(UTC):%Y%m%dT%H%M%SZ}-{given.link.value}"
    if given.no_page and (given.stay or given.port):
        parser.error("--no-page is refused beside --port and --stay: they are about the page")
    port = None if given.no_page else given.port
    return Plan(
        given.link, given.scenario, given.speed, given.seed, out.resolve(), given.duration, port=port, stay=given.stay
    )


def _not_negative(text: str) -> float:
    value = float(text)
    if not 0.0 <= value < math.inf:
        raise argparse.ArgumentTypeError(f"{text} is refused; a number of at least 0 is accepted")
    return value


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point; refusals and failures go to standard error, without a traceback."""
    plan = parse_arguments(arguments)
    try:
        try:
            from rich.console import Console
        except ImportError:
            raise ExtraMissingError("rich", "view", "the demo") from None
        return run_demo(plan, Console())
    except MagcalError as error:
        print(error, file=sys.stderr)
        return error.exit_code


if __name__ == "__main__":
    sys.exit(main())
