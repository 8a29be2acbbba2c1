"""Processes that are killed or stopped: the daemon, the node, the router, a viewer."""

from __future__ import annotations

import contextlib
import json
import random
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from magcal_service.config.reader import load_config
from magcal_service.daemon.pipeline import Pipeline
from magcal_service.wire.messages import Estimate, Message
from tests.daemon.service_processes import free_port, stream, wait_for, write_config
from tests.faults.bench import Daemons, Feeder, Witness, estimates_by_time, stopped
from tests.faults.faults import Fault, Outcome

ROOT = Path(__file__).resolve().parents[2]
RATE_HZ = 300.0  # messages a second: a sample and a reference for each second of flight
SECOND_NS = 1_000_000_000


def with_state(config: Path, folder: Path, period_s: float = 10.0) -> Path:
    """The configuration with checkpoints, by default every 10 s of the wall clock, the shortest period there is."""
    config.write_text(f"{config.read_text()}[state]\ndirectory = {json.dumps(str(folder))}\nperiod_s = {period_s}\n")
    return config


def uninterrupted(config: Path, messages: tuple[Message, ...]) -> dict[int, Estimate]:
    """What a daemon that nothing happens to says of each tick: a replay equals the live run bit for bit."""
    pipeline = Pipeline(load_config(config).crafts[0])
    published = [answer for message in messages for answer in pipeline.handle(message)]
    return {message.time_ns: message for message in published if isinstance(message, Estimate)}


def apart(estimate: Estimate, other: Estimate) -> float:
    """The largest difference of any of the nine errors, in sigmas of the uninterrupted estimate."""
    diagonal = [row * 9 - row * (row - 1) // 2 for row in range(9)]
    pairs = zip((*estimate.bias_nt, *estimate.D), (*other.bias_nt, *other.D), diagonal, strict=True)
    return max(abs(one - two) / other.covariance[index] ** 0.5 for one, two, index in pairs)


HISTORY = 128  # what a daemon with checkpoints may ask for
SETTLED_S = 700  # of flight, after which the estimate has started


def kill_daemon(folder: Path, quick: bool) -> Outcome:
    """SIGKILL at random instants of a flight that goes on meanwhile, and once when it is over; the next starts at once.

    At 6 samples a second, what is sent from one checkpoint to the next daemon is within the history that it asks for.
    Quickly: no checkpoints, and a history of the whole flight.
    """
    outcome = Outcome(Fault.KILL_DAEMON, "zenoh")
    kills, fast, rate_hz = (2, 0, 300.0) if quick else (8, 2 * SETTLED_S, 12.0)
    messages = stream(seconds=600 if quick else 1500)
    address = f"zenoh:tcp/127.0.0.1:{free_port()}"
    if quick:
        config = write_config(folder, f"{address}?history=1000")
    else:
        config = with_state(write_config(folder, f"{address}?history={HISTORY}"), folder / "state")
    chance = random.Random(6)
    restored = 0
    with Daemons(config) as daemons, Witness(address) as node:
        node.until_heard()
        if fast:
            fly(node, messages[:fast], folder / "state")
        with Feeder(node, messages[fast:], rate_hz) as feeder:
            for kill in range(kills):
                feeder.reach(int((kill + 0.3 + 0.6 * chance.random()) * len(feeder.messages) / kills))
                node.mark()
                daemons.kill()
                daemons.start()
                feeder.fresh_status()
                feeder.until(lambda: node.marked_s is None, "no vector came after a kill")
                restored += node.counters().get("state.restored", 0)
            feeder.settle()
            daemons.kill()
            daemons.start()
            feeder.fresh_status()
            restored += node.counters().get("state.restored", 0)
            feeder.close_books()
        outcome.fed, outcome.accepted = node.sent, node.counters()["accepted"]
        outcome.used(node.counters())
        outcome.recovered_s = max(node.recovered_s, default=None)
        outcome.expect(len(node.recovered_s) == kills, f"{len(node.recovered_s)} recoveries from {kills} kills")
    outcome.balance()
    outcome.notes.append(f"{kills + 1} kills, {restored} restarts went on from a checkpoint")
    outcome.expect(quick or restored == kills + 1, "a restart did not go on from its checkpoint")
    same_as_uninterrupted(outcome, node, uninterrupted(config, messages))
    return outcome


def kill_often(folder: Path, quick: bool) -> Outcome:
    """SIGKILL every 3 to 14 s, drawn anew each time, of a craft at 1 Hz, with the period of 60 s that is the default.

    The estimate has started before.  Quickly: from the beginning of a flight, and faster.
    """
    outcome = Outcome(Fault.KILL_OFTEN, "zenoh")
    kills, least_s, most_s, rate_hz, fast = (3, 2.5, 4.0, 60.0, 0) if quick else (50, 3.0, 14.0, 2.0, 2 * SETTLED_S)
    messages = stream(seconds=600 if quick else SETTLED_S + 600)
    address = f"zenoh:tcp/127.0.0.1:{free_port()}"
    config = with_state(write_config(folder, f"{address}?history={HISTORY}"), folder / "state", 60.0)
    chance = random.Random(8)
    with Daemons(config) as daemons, Witness(address) as node:
        node.until_heard()
        if fast:
            fly(node, messages[:fast], folder / "state")
        with Feeder(node, messages[fast:], rate_hz) as feeder:
            for _ in range(kills):
                due_s = time.monotonic() + chance.uniform(least_s, most_s)
                feeder.until(lambda due_s=due_s: time.monotonic() >= due_s, "time stands still")  # type: ignore[misc]
                node.mark()
                daemons.kill()
                daemons.start()
            feeder.messages = feeder.messages[: feeder.position + 20]  # the kills are over, and so is the flight
            feeder.close_books()
        outcome.fed, outcome.accepted = node.sent, node.counters()["accepted"]
        outcome.used(node.counters())
        outcome.recovered_s = max(node.recovered_s, default=None)
    outcome.balance()
    outcome.notes.append(f"{kills} kills, {least_s:g} to {most_s:g} s apart")
    same_as_uninterrupted(outcome, node, uninterrupted(config, messages))
    return outcome


def fly(node: Witness, messages: Sequence[Message], state: Path) -> None:
    """The first part of a flight, fast, until a checkpoint holds all of it."""
    with Feeder(node, messages, RATE_HZ) as feeder:
        feeder.settle()
        before = newest_number(state)
        feeder.until(lambda: newest_number(state) > before, "no checkpoint")


def newest_number(state: Path) -> int:
    """The number of the newest checkpoint, 0 where there is none."""
    return max((int(path.stem) for path in state.rglob("*.state")), default=0)


def same_as_uninterrupted(outcome: Outcome, node: Witness, reference: dict[int, Estimate]) -> None:
    """Promise that each estimate is half a sigma at most from that of a daemon that nothing happened to."""
    running = {time_ns: one for time_ns, one in estimates_by_time(node).items() if one.verdict != "not_started"}
    differences = [apart(one, reference[time_ns]) for time_ns, one in running.items()]
    worst = max(differences, default=0.0)
    outcome.expect(bool(differences), "no estimate to compare")
    outcome.expect(worst < 0.5, f"an estimate is {worst:.2f} sigma off")
    outcome.notes.append(
        f"{len(differences)} estimates, at most {worst:.3f} sigma from those of an uninterrupted daemon"
    )


def stop_daemon(folder: Path, quick: bool) -> Outcome:
    """SIGSTOP for longer than the link's lease, then SIGCONT."""
    outcome = Outcome(Fault.STOP_DAEMON, "zenoh")
    pause_s = 2.0 if quick else 6.0
    address = f"zenoh:tcp/127.0.0.1:{free_port()}"
    with Daemons(write_config(folder, f"{address}?history=1000")) as daemons, Witness(address) as node:
        node.until_heard()
        with Feeder(node, stream(seconds=600)[: 600 if quick else 1200], RATE_HZ / 3) as feeder:
            feeder.reach(200)
            with stopped(daemons.process.pid):
                time.sleep(pause_s)
                node.mark()
            feeder.close_books()
        outcome.fed, outcome.accepted, outcome.refused = node.sent, node.counters()["accepted"], node.refused
        outcome.used(node.counters())
        outcome.recovered_s = max(node.recovered_s, default=None)
    outcome.balance()
    outcome.notes.append(
        f"stopped for {pause_s:.0f} s; {outcome.fed - len(node.first_s)} vectors did not reach the node"
    )
    return outcome


def stop_node(folder: Path, quick: bool) -> Outcome:
    """A simulated node of its own process, stopped and continued; a witness reads the status."""
    outcome = Outcome(Fault.STOP_NODE, "zenoh")
    seconds, pause_s = (300, 2.0) if quick else (900, 6.0)
    address = f"zenoh:tcp/127.0.0.1:{free_port()}"
    command = [sys.executable, "-m", "sim_sensor.cli", "run", "--scenario", "paper", "--craft", "paper", "--quiet"]
    command += ["--duration", str(seconds), "--speed", "100", "--link", address, "--seed", "3"]
    with Daemons(write_config(folder, f"{address}?history=1000")), Witness(address) as witness:
        witness.until_heard()
        with (
            (folder / "node.log").open("wb") as log,
            subprocess.Popen(command, cwd=ROOT, stdout=log, stderr=log) as node,
        ):
            witness.until_accepted(seconds // 4)
            with stopped(node.pid):
                witness.listen(pause_s)
                before = witness.counters()["accepted"]
                witness.mark()
            witness.until("the node does not go on", lambda: witness.counters()["accepted"] > min(before, seconds - 1))
            witness.until("the node has not ended", lambda: node.poll() is not None)
        witness.until_heard()
        outcome.fed, outcome.accepted, outcome.refused = seconds, witness.counters()["accepted"], witness.refused
        outcome.expect(node.returncode == 0, f"the node ended with {node.returncode}")
        outcome.recovered_s = max(witness.recovered_s, default=None)
    outcome.balance()
    outcome.notes.append(f"stopped for {pause_s:.0f} s")
    return outcome


@contextlib.contextmanager
def router(port: int, log: Path):
    """The shipped router on a port."""
    command = [sys.executable, "-u", str(ROOT / "deploy" / "router.py"), "--listen", f"tcp/127.0.0.1:{port}"]
    with log.open("wb") as output, subprocess.Popen(command, stdout=output, stderr=subprocess.STDOUT) as process:
        try:
            wait_for("router open", log)
            yield process
        finally:
            process.terminate()


def restart_router(folder: Path, quick: bool) -> Outcome:
    """The router between daemon and node ends, and another takes its place after a second."""
    outcome = Outcome(Fault.RESTART_ROUTER, "zenoh, router")
    port = free_port()
    address = f"zenoh:tcp/127.0.0.1:{port}?mode=client"
    config = write_config(folder, f"{address}&history=1000")
    with contextlib.ExitStack() as stack:
        first = stack.enter_context(contextlib.ExitStack())
        first.enter_context(router(port, folder / "router-1.log"))
        stack.enter_context(Daemons(config))
        node = stack.enter_context(Witness(address))
        node.until_heard()
        feeder = stack.enter_context(Feeder(node, stream(seconds=600)[: 400 if quick else 1200], RATE_HZ / 3))
        feeder.reach(150)
        first.close()
        time.sleep(1.0)
        stack.enter_context(router(port, folder / "router-2.log"))
        node.mark()
        feeder.close_books()
        outcome.fed, outcome.accepted, outcome.refused = node.sent, node.counters()["accepted"], node.refused
        outcome.used(node.counters())
        outcome.recovered_s = max(node.recovered_s, default=None)
    outcome.balance()
    return outcome


def slow_consumer(folder: Path, quick: bool) -> Outcome:
    """A viewer that subscribes to everything and then hangs."""
    outcome = Outcome(Fault.SLOW_CONSUMER, "zenoh")
    pause_s = 3.0 if quick else 10.0
    address = f"zenoh:tcp/127.0.0.1:{free_port()}"
    code = (
        "from magcal_service.links import Role, open_link\n"
        f"with open_link({address + '?name=victim&lease_ms=1500'!r}, Role.VIEWER, crafts=['paper']) as link:\n"
        "    print('open', flush=True)\n    while True: link.receive(1.0)"
    )
    with Daemons(write_config(folder, address)), Witness(address) as node:
        node.until_heard()
        with subprocess.Popen([sys.executable, "-c", code], cwd=ROOT, stdout=subprocess.PIPE, text=True) as viewer:
            assert viewer.stdout is not None
            assert viewer.stdout.readline() == "open\n"
            with Feeder(node, stream(seconds=1200), RATE_HZ) as feeder, stopped(viewer.pid):
                time.sleep(pause_s)
                feeder.messages = feeder.messages[: feeder.position + 10]
                feeder.close_books()
            viewer.kill()
        outcome.fed, outcome.accepted, outcome.refused = node.sent, node.counters()["accepted"], node.refused
        slowest_s = max(node.first_s[key] - sent_s for key, sent_s in node.sent_s.items() if key in node.first_s)
    outcome.balance()
    outcome.expect(len(node.first_s) == node.sent, f"{node.sent - len(node.first_s)} vectors did not reach the node")
    outcome.expect(slowest_s < 1.5, "the node waited for the viewer")
    outcome.notes.append(f"hung for {pause_s:.0f} s; the node's longest wait for a vector was {slowest_s:.2f} s")
    return outcome
