"""Sessions for the tests of the recorder: a service in this process, fed by the simulator, recorded as it runs."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from unittest.mock import patch

from magcal_service.config.daemon_settings import RecordConfig, StateConfig
from magcal_service.config.settings import Config, CraftConfig, SensorConfig, SpinConfig
from magcal_service.daemon.checkpoints.store import Checkpoints
from magcal_service.daemon.estimate_csv import EstimateCsv
from magcal_service.daemon.service import Service
from magcal_service.links import Role, open_link
from magcal_service.links.base import Link
from magcal_service.recordings import recorder as recorder_module
from magcal_service.recordings.recorder import Recorder
from magcal_service.wire.messages import Command, Message, Status
from sim_sensor.scenario_reader import load_scenario
from sim_sensor.simulation import Simulation

PATIENCE_S = 120.0


def craft(name: str = "paper") -> CraftConfig:
    """A craft whose axis is no round number, so that a lost bit of its configuration shows."""
    axis = (0.1 / 0.9935, -0.98 / 0.9935, 0.13 / 0.9935)
    length = sum(part * part for part in axis) ** 0.5
    x, y, z = (part / length for part in axis)
    return CraftConfig(name, sensor=SensorConfig(noise_nt=300.0), spin=SpinConfig(axis=(x, y, z), rate_rpm=7.5))


@cache
def stream(seconds: int = 200, scenario: str = "paper", name: str = "paper", seed: int = 5) -> tuple[Message, ...]:
    """What a sensor node sends."""
    simulation = Simulation(load_scenario(scenario), seed, float(seconds))
    return tuple(replace(message, craft=name) for message in simulation.messages())


def command(name: str, sequence: int = 0, /, **arguments: str | float) -> Command:
    return Command(craft="paper", source="operator", sequence=sequence, time_ns=0, name=name, arguments=arguments)


def settings(folder: Path, **changes: float) -> RecordConfig:
    """Recording with room for the tests."""
    return replace(RecordConfig(folder, min_free_mb=0.0, flush_s=0.2, retry_s=0.2), **changes)  # type: ignore[arg-type]


@dataclass
class Live:
    """A service that runs in a thread of its own, and the node's end of its link."""

    service: Service
    node: Link
    stop: threading.Event
    thread: threading.Thread

    def send(self, messages: Iterable[Message]) -> None:
        """Send, and return once the service has taken all of it in."""
        count = self.service.link.counters["received"]
        for message in messages:
            self.node.send(message)
            count += 1
            if count % 1000 == 0:  # the link's queue is bounded
                self.wait(count)
        self.wait(count)

    def wait(self, count: int) -> None:
        until(lambda: self.service.link.counters["received"] >= count)

    def status(self) -> Status:
        """A status that the service sends now."""
        self.node.receive(0.0)
        self.service.publish_status()
        (status,) = (message for message in self.node.receive(5.0) if isinstance(message, Status))
        return status

    def close(self) -> None:
        self.stop.set()
        self.thread.join(PATIENCE_S)
        assert not self.thread.is_alive()


def until(done: Callable[[], object]) -> None:
    """Wait for something to become true."""
    deadline = time.monotonic() + PATIENCE_S
    while not done():
        assert time.monotonic() < deadline
        time.sleep(0.005)


def live(
    link: str,
    crafts: Sequence[CraftConfig],
    recorder: Recorder,
    csv: EstimateCsv | None = None,
    state: Path | None = None,
) -> Live:
    """A service on ``loop:LINK``, at work, with its checkpoints in the folder ``state``."""
    names = [one.name for one in crafts]
    end = open_link(f"loop:{link}?queue=100000", Role.SERVICE, crafts=names)
    checkpoints = None if state is None else Checkpoints(StateConfig(state), crafts)
    service = Service(Config(end.address, tuple(crafts)), end, csv, recorder, checkpoints)
    service.restore()
    node = open_link(f"loop:{link}?queue=100000", Role.NODE)
    stop = threading.Event()

    def work() -> None:
        with end:
            service.run(stop)

    thread = threading.Thread(target=work)
    thread.start()
    return Live(service, node, stop, thread)


@contextmanager
def _patient() -> Iterator[None]:
    with (
        patch("os.fdatasync", lambda file: None),
        patch("os.fsync", lambda file: None),
        patch.object(recorder_module, "PATIENCE_S", PATIENCE_S),
    ):
        yield


def record(
    folder: Path,
    messages: Sequence[Message],
    crafts: Sequence[CraftConfig] = (),
    csv: Path | None = None,
    state: Path | None = None,
    **changes: float,
) -> list[Path]:
    """Run a session and record it; its files in order.

    Nothing is synchronised: with a chunk every millisecond a busy disk would take a minute for that.
    """
    crafts = crafts or (craft(),)
    rows = None if csv is None else EstimateCsv(csv)
    with _patient(), Recorder(settings(folder, **changes), crafts) as recorder:
        run = live(folder.name + str(id(recorder)), crafts, recorder, rows, state)
        run.send(messages)
        run.close()
    run.node.close()
    if rows is not None:
        rows.close()
    assert recorder.counters["record.dropped"] == 0
    return sorted(folder.glob("*.mcap"))
