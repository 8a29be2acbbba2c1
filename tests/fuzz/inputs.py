"""Where readers of files find their input, and sound messages to begin with."""

from __future__ import annotations

import atexit
import shutil
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

from magcal_service.config.settings import CraftConfig
from magcal_service.daemon.pipeline import Pipeline
from magcal_service.wire.framing import FrameEncoder
from magcal_service.wire.messages import Command, Message
from sim_sensor.scenario_reader import load_scenario
from sim_sensor.simulation import Simulation

ROOT = Path(__file__).resolve().parents[2]


@cache
def folder() -> Path:
    """Where readers of files find their input; in memory where the machine has such a place."""
    shared = Path("/dev/shm")
    path = Path(tempfile.mkdtemp(prefix="magcal-fuzz-", dir=shared if shared.is_dir() else None))
    atexit.register(shutil.rmtree, path, ignore_errors=True)
    return path


def file_of(name: str, data: bytes) -> Path:
    """A file with this content."""
    path = folder() / name
    path.write_bytes(data)
    return path


@cache
def flight(seconds: int, scenario: str = "hot-electronics") -> tuple[Message, ...]:
    """What the craft ``a`` sends in so many seconds."""
    return tuple(replace(one, craft="a") for one in Simulation(load_scenario(scenario), 1, float(seconds)).messages())


def one_of_each() -> tuple[Message, ...]:
    """A message of every kind: what a pipeline is given and what it answers."""
    pipeline = Pipeline(CraftConfig("a"))
    command = Command(craft="a", source="b", sequence=1, time_ns=2, name="freeze", arguments={"x": 1.5, "y": "z"})
    sent: list[Message] = [*flight(30), command]
    given = [one for message in sent for one in (message, *pipeline.handle(message))]
    given.append(pipeline.status(1.0, pipeline.ticks.counters))
    return tuple({type(message): message for message in given}.values())


def frames(messages: Sequence[Message]) -> bytes:
    """Messages as a serial line carries them."""
    encoder = FrameEncoder()
    return b"".join(map(encoder.encode, messages))
