"""Sample in to calibrated vector out, beside a bare zenoh echo: ``python -m tests.benchmarks.bench_latency``.

Two processes besides this one: a bare echo (a subscriber whose callback puts the payload back), and the daemon,
``magcal run``.  Both listen on 127.0.0.1; round trips to them take turns, so that both meet the same load.  Samples
come at 10 Hz of sample time, references at 1 Hz, so that one sample in ten closes a tick.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import queue
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import zenoh
from zenoh import handlers

from magcal_service.links import Link, Role, open_link
from magcal_service.wire.codec import encode
from magcal_service.wire.messages import CalibratedVector, Frame, MagnetometerSample, Message, ReferenceSample
from tests.benchmarks.results import write

ROOT = Path(__file__).resolve().parents[2]
RATE_HZ = 10
WARM_UP = 200
WAIT_S = 10.0
SPIN_RAD_S, ORBIT_RAD_S = 7.5 * 2.0 * np.pi / 60.0, 2.0 * np.pi / 5800.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--round-trips", type=int, default=3000, metavar="N", help="of each kind (default 3000)")
    parser.add_argument("--pause-ms", type=float, default=2.0, metavar="T", help="between round trips (default 2)")
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--echo", type=int, metavar="PORT", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.echo:
        serve_echo(options.echo)
    else:
        write(options.json, measure(options.round_trips, options.pause_ms / 1e3))


def measure(round_trips: int, pause_s: float) -> dict[str, float]:
    """Start both processes, take the round trips, print the table; the same as figures [ms]."""
    with contextlib.ExitStack() as stack:
        echo = stack.enter_context(echo_client())
        node = stack.enter_context(daemon_client())
        times_s: dict[str, list[float]] = {"bare zenoh echo": [], "sample to vector": []}
        for number in range(WARM_UP, WARM_UP + round_trips):
            times_s["bare zenoh echo"].append(echo.round_trip(number))
            time.sleep(pause_s)
            times_s["sample to vector"].append(vector_round_trip(node, number))
            time.sleep(pause_s)
    return report(times_s)


def report(times_s: dict[str, list[float]]) -> dict[str, float]:
    """One row for each kind of round trip, and their ratio."""
    print(f"{'round trip [ms]':18}{'p50':>9}{'p99':>9}{'max':>9}{'n':>8}")
    rows = {name: np.percentile(1e3 * np.array(values), (50, 99, 100)) for name, values in times_s.items()}
    for name, row in rows.items():
        print(f"{name:18}" + "".join(f"{value:9.3f}" for value in row) + f"{len(times_s[name]):8d}")
    bare, vector = rows.values()
    print(f"{'ratio':18}" + "".join(f"{value:9.2f}" for value in vector / bare))
    kinds = {"echo": bare, "vector": vector}
    return {f"{kind}_ms_{at}": float(row[i]) for kind, row in kinds.items() for i, at in enumerate(("p50", "p99"))}


# The bare echo


def bare_config(mode: str, port: int) -> zenoh.Config:
    config = zenoh.Config()
    endpoints = json.dumps([f"tcp/127.0.0.1:{port}"])
    config.insert_json5("mode", json.dumps(mode))
    config.insert_json5("listen/endpoints", endpoints if mode == "peer" else "[]")
    config.insert_json5("connect/endpoints", "[]" if mode == "peer" else endpoints)
    config.insert_json5("scouting/multicast/enabled", "false")
    return config


def serve_echo(port: int) -> None:
    """Put back what arrives, until standard input ends."""
    with zenoh.open(bare_config("peer", port)) as session:
        publisher = session.declare_publisher("echo/back", express=True)
        callback = handlers.Callback(lambda sample: publisher.put(sample.payload), indirect=False)
        subscriber = session.declare_subscriber("echo/there", callback)
        sys.stdin.read()
        subscriber.undeclare()


class EchoClient:
    """The measuring end of the bare echo."""

    def __init__(self, session: zenoh.Session) -> None:
        self._back: queue.SimpleQueue[zenoh.Sample] = queue.SimpleQueue()
        self._subscriber = session.declare_subscriber("echo/back", handlers.Callback(self._back.put, indirect=False))
        self._publisher = session.declare_publisher("echo/there", express=True)

    def round_trip(self, number: int, wait_s: float = WAIT_S) -> float:
        """Time from put to the echo's arrival [s]; the payload is that of a sample."""
        payload = encode(sample(number))
        begun_s = time.perf_counter()
        self._publisher.put(payload)
        self._back.get(timeout=wait_s)
        return time.perf_counter() - begun_s


@contextlib.contextmanager
def echo_client() -> Iterator[EchoClient]:
    """A client of a new echo process that answers."""
    port = free_port()
    arguments = [sys.executable, "-m", "tests.benchmarks.bench_latency", "--echo", str(port)]
    with (
        process(arguments, stdin=subprocess.PIPE),
        until_open(lambda: zenoh.open(bare_config("client", port))) as session,
    ):
        client = EchoClient(session)
        for number in range(WARM_UP):
            with contextlib.suppress(queue.Empty):
                client.round_trip(number, wait_s=0.2)
        yield client


# The daemon


@contextlib.contextmanager
def daemon_client() -> Iterator[Link]:
    """A node of a new daemon that answers."""
    address = f"zenoh:tcp/127.0.0.1:{free_port()}"
    with tempfile.TemporaryDirectory() as directory:
        config = Path(directory) / "bench.toml"
        config.write_text(f'version = 1\nlink = "{address}"\n[[craft]]\nname = "bench"\n', encoding="utf-8")
        arguments = [sys.executable, "-m", "magcal_service.cli", "run", "--config", str(config)]
        with (
            process(arguments, stderr=subprocess.DEVNULL),
            open_link(address, Role.NODE, crafts=["bench"]) as node,
        ):
            await_link(node)
            for number in range(WARM_UP):
                vector_round_trip(node, number)
            yield node


def await_link(node: Link) -> None:
    deadline_s = time.monotonic() + WAIT_S
    while not node.counters["up"]:
        if time.monotonic() > deadline_s:
            raise TimeoutError("the daemon did not come up")
        node.receive(0.05)


def vector_round_trip(node: Link, number: int) -> float:
    """Time from sending a sample to holding its vector [s]; its reference goes ahead, untimed."""
    if number % RATE_HZ == 0:
        node.send(reference(number))
    message = sample(number)
    begun_s = time.perf_counter()
    node.send(message)
    while True:
        for answer in node.receive(WAIT_S) or unanswered(number):
            if isinstance(answer, CalibratedVector) and answer.sequence == number:
                return time.perf_counter() - begun_s


def unanswered(number: int) -> list[Message]:
    raise TimeoutError(f"sample {number} was not answered within {WAIT_S} s")


def field_nt(number: int) -> tuple[float, float, float]:
    """A field that turns once an orbit [nT]."""
    angle_rad = ORBIT_RAD_S * number / RATE_HZ
    return 22000.0 * float(np.cos(angle_rad)), 9000.0, 40000.0 * float(np.sin(angle_rad))


def reference(number: int) -> ReferenceSample:
    return ReferenceSample(
        craft="bench",
        source="model",
        sequence=number // RATE_HZ,
        time_ns=number * 10**9 // RATE_HZ,
        field_nt=field_nt(number),
        frame=Frame.ECI,
    )


def sample(number: int) -> MagnetometerSample:
    """The field in a body that spins about its z axis, with a bias [nT]."""
    x, y, z = field_nt(number)
    turn = complex(x, y) * np.exp(-1j * SPIN_RAD_S * number / RATE_HZ)
    return MagnetometerSample(
        craft="bench",
        source="mag",
        sequence=number,
        time_ns=number * 10**9 // RATE_HZ,
        field_body_nt=(float(turn.real) + 500.0, float(turn.imag) - 300.0, z + 200.0),
    )


# Processes


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@contextlib.contextmanager
def process(arguments: list[str], **streams: int) -> Iterator[None]:
    """A process that ends with the context."""
    child = subprocess.Popen(arguments, cwd=ROOT, **streams)  # type: ignore[call-overload]
    try:
        yield
    finally:
        child.terminate()
        child.communicate(timeout=WAIT_S)


def until_open(opening: Callable[[], zenoh.Session]) -> zenoh.Session:
    """The session, once the other process listens."""
    deadline_s = time.monotonic() + WAIT_S
    while True:
        try:
            return opening()
        except zenoh.ZError:
            if time.monotonic() > deadline_s:
                raise
            time.sleep(0.05)


if __name__ == "__main__":
    main()
