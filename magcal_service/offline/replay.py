"""A recording through the whole service, the way a live link's samples go."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

import numpy as np

from magcal_service.config.settings import (
    Config,
    CraftConfig,
    FilterConfig,
    SensorConfig,
    SpinConfig,
    StateConfig,
    TickConfig,
)
from magcal_service.daemon.checkpoints.store import MISFITS, Checkpoints
from magcal_service.daemon.estimate_csv import EstimateCsv
from magcal_service.daemon.pipeline import Pipeline
from magcal_service.daemon.service import Service
from magcal_service.links.recording import RecordingLink
from magcal_service.recordings.recording import Recording
from magcal_service.wire.messages import Command, Estimate, Message

CRAFT: Final = "craft"


def craft_of(recording: Recording, method: str | None = None) -> CraftConfig:
    """The craft's configuration as the recording states it.

    That of a session is the one it was recorded under; of another log what its descriptor says: noise, spin, and pauses
    fit for its period.  ``method`` is the estimator where given, else the recorded one or ``ukf``.
    """
    if recording.craft is not None:
        method = method or recording.craft.filter.method
        return replace(recording.craft, filter=replace(recording.craft.filter, method=method))
    descriptor = recording.descriptor
    spin = None
    if descriptor.spin is not None and descriptor.spin.rate_rpm:
        spin = SpinConfig(axis=descriptor.spin.axis, rate_rpm=descriptor.spin.rate_rpm)
    steps_s = np.diff(np.unique(recording.time_ns)) * 1e-9
    period_s = float(np.median(steps_s)) if steps_s.size else 1.0
    ticks = TickConfig(gap_s=min(max(TickConfig().gap_s, 5.0 * period_s), TickConfig().step_confirm_s))
    return CraftConfig(
        CRAFT,
        sensor=SensorConfig(noise_nt=descriptor.magnetometer.noise_nt),
        spin=spin,
        filter=FilterConfig(method=method or FilterConfig().method),
        ticks=ticks,
    )


@dataclass(frozen=True, slots=True)
class Replay:
    """A recording after it has gone through the service.

    Parameters
    ----------
    pipeline: the craft's, as the recording left it.
    estimates: how many were published.
    remark: what kept the replay from beginning as the session did, empty where nothing did.
    """

    pipeline: Pipeline
    estimates: int
    remark: str = ""


def replay(
    recording: Recording,
    craft: CraftConfig,
    speed: float = 0.0,
    csv: EstimateCsv | None = None,
    sink: Callable[[Message], None] | None = None,
    *,
    as_recorded: bool = False,
) -> Replay:
    """Send a recording through the service, the same way a live link's samples go.

    Parameters
    ----------
    speed: times real time; 0 as fast as it goes.
    csv: where each tick's estimate is written.
    sink: is called with every message that the service publishes.
    as_recorded: begin with the state that a session began with, where it is replayed under its own configuration.
    """
    estimates = Counter[str]()

    def count(message: Message) -> None:
        estimates["all"] += isinstance(message, Estimate)
        if sink is not None:
            sink(message)

    address = f"recording:-?speed={speed:g}&craft={craft.name}"
    with RecordingLink(address, recording=recording, sink=count) as link, TemporaryDirectory() as folder:
        # Checkpoints that a command makes within the session are there for one that goes back to them.
        checkpoints = Checkpoints(StateConfig(Path(folder)), (craft,)) if _commanded(recording) else None
        service = Service(Config(link.address, (craft,)), link, csv, checkpoints=checkpoints)
        remark = _begin_as_recorded(service, recording, craft) if as_recorded else ""
        service.run(threading.Event())
    if service.csv_error is not None:
        raise service.csv_error
    return Replay(service.pipelines[craft.name], estimates["all"], remark)


def _commanded(recording: Recording) -> bool:
    return any(isinstance(message, Command) for message in recording.stream or ())


def _begin_as_recorded(service: Service, recording: Recording, craft: CraftConfig) -> str:
    """Take over the session's first state; why that could not be, empty where it could or there is none."""
    if recording.state is None:
        return ""
    if craft != recording.craft:
        return "the session began with a state of its own, which does not go with another configuration"
    try:
        service.pipelines[craft.name].restore_state(recording.state)
    except MISFITS as error:
        service.pipelines[craft.name] = Pipeline(craft)
        return f"the state that the session began with does not fit this version: {error}"
    return ""
