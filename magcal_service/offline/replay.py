"""A recording through the whole service, the way a live link's samples go."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import numpy as np

from magcal_service.base.progress import Work, counted
from magcal_service.config.daemon_settings import StateConfig
from magcal_service.config.magnetometers import label_of
from magcal_service.config.settings import (
    Config,
    CraftConfig,
    FilterConfig,
    MagnetometerConfig,
    SensorConfig,
    SpinConfig,
    TickConfig,
)
from magcal_service.daemon.checkpoints.store import MISFITS, Checkpoints
from magcal_service.daemon.estimate_csv import EstimateCsv
from magcal_service.daemon.pipeline import Pipeline
from magcal_service.daemon.service import Service
from magcal_service.links.recording import RecordingLink
from magcal_service.model import Array
from magcal_service.offline.compensated import EffectAccount
from magcal_service.offline.given import Given
from magcal_service.offline.nine_errors import NineErrors
from magcal_service.offline.prior import go_on
from magcal_service.offline.published import ObservedPipeline, Published
from magcal_service.recordings.inspect.inspection import Inspection, inspect
from magcal_service.recordings.reader import read_recording
from magcal_service.recordings.recording import Recording
from magcal_service.trust.doubted import doubted_reasons, doubted_verdict
from magcal_service.trust.reasons import REMEDIES, Reason
from magcal_service.wire.messages import Command, Estimate, Message, Verdict

CRAFT: Final = "craft"


def craft_of(recording: Recording, method: str | None = None) -> CraftConfig:
    """The craft's configuration as the recording states it.

    That of a session is the one it was recorded under; of another log what its descriptor says: noise, range, spin, and
    pauses fit for its period.  ``method`` is the estimator where given, else the recorded one or ``ukf``.
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
    own = descriptor.magnetometer
    listed = (own, *descriptor.beside) if descriptor.beside else ()
    return CraftConfig(
        CRAFT,
        sensor=SensorConfig() if listed else SensorConfig(noise_nt=own.noise_nt, range_nt=own.range_nt),
        spin=spin,
        filter=FilterConfig(method=method or FilterConfig().method),
        ticks=ticks,
        max_sources=max(CraftConfig(CRAFT).max_sources, len(listed)),
        magnetometers=tuple(
            MagnetometerConfig(one.source, noise_nt=one.noise_nt, range_nt=one.range_nt) for one in listed
        ),
    )


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Replay(NineErrors):
    """A recording after it has gone through the service.

    Parameters
    ----------
    pipeline: the craft's, of the magnetometer that the recording's rows are of, as the recording left it.
    inspection: what was found on the recording, and the rows that were left out for it.
    estimates: how many were published of that magnetometer.
    x, covariance: the last estimate (9,) and its covariance (9, 9) [nT, -].
    remark: what kept the replay from beginning as the session did, empty where nothing did.
    """

    pipeline: Pipeline
    inspection: Inspection
    estimates: int
    x: Array
    covariance: Array
    remark: str = ""

    @property
    def verdict(self) -> Verdict:
        """How far the last estimate is to be trusted; not, while something has to be answered about the recording."""
        return doubted_verdict(self.pipeline.trust.verdict, bool(self.inspection.open))

    @property
    def reasons(self) -> tuple[Reason, ...]:
        """Why it is not trusted, where it is not; a doubtful recording is the first reason, and no physics is named."""
        return tuple(map(Reason, doubted_reasons(self.pipeline.trust.reasons, bool(self.inspection.open))))

    @property
    def model_doubt(self) -> str:
        """What the model seems to leave out, in words; empty while the recording itself is in doubt."""
        return "" if self.inspection.open else self.pipeline.model_doubt

    @property
    def protection(self) -> str:
        """The last estimate's protection level, what sets it and its limit, or why there is none, in words."""
        trust, limit_nt = self.pipeline.trust, self.pipeline.config.trust.protection_nt
        said = trust.protection.removeprefix(", ")
        return said if trust.protection_nt is None else f"{said}; trusted up to {limit_nt:g} nT"

    @property
    def remedy(self) -> str:
        """What to do about the first reason, empty where there is none."""
        return REMEDIES[Reason.RECORDING_DOUBTFUL] if self.inspection.open else self.pipeline.trust.remedy

    @property
    def published(self) -> Published | None:
        """What the craft has published, where it compensates by ``physics.toml``."""
        return self.pipeline.published if isinstance(self.pipeline, ObservedPipeline) else None

    @property
    def compensated(self) -> tuple[EffectAccount, ...]:
        """What was done with each effect of ``physics.toml``; empty where none is compensated."""
        if not isinstance(self.pipeline, ObservedPipeline) or self.pipeline.compensation is None:
            return ()
        channels = self.inspection.recording.driving
        return self.pipeline.tally.accounts(self.pipeline.compensation.model, channels, self.pipeline.stopped)

    @property
    def counters(self) -> dict[str, int]:
        """What became of the samples, by kind."""
        return dict(self.pipeline.ticks.counters + self.pipeline.counters)

    def to_dict(self) -> dict[str, Any]:
        """The last estimate and the counters as plain data."""
        return {
            "verdict": str(self.verdict),
            "reasons": [str(reason) for reason in self.reasons],
            "protection_nt": self.pipeline.trust.protection_nt,
            "protection_by": self.pipeline.trust.protection_by,
            "estimates": self.estimates,
            "bias_nt": self.bias_nt.tolist(),
            "D": self.D.tolist(),
            "sigma": {"bias_nt": self.sigma_bias_nt.tolist(), "D": self.sigma_D.tolist()},
            "counters": self.counters,
            "physics": [one.to_dict() for one in self.compensated],
            "remark": self.remark,
            "findings": [one.to_dict() for one in self.inspection.findings],
        }

    def __repr__(self) -> str:
        reasons = f" ({', '.join(self.reasons)})" if self.reasons else ""
        return f"Replay: {self.verdict}{reasons}, {self.estimates} estimates\n{self._table()}"


def as_played(inspection: Inspection, craft: CraftConfig) -> Recording:
    """The recording whose messages a replay under this configuration sends through the service."""
    recording = inspection.to_replay
    if recording.stream is None and craft.magnetometers:  # rows that say of no source are of the craft's own
        return replace(recording, source=recording.source or craft.magnetometers[0].source)
    return recording


def replay(
    recording: Recording | Path | str,
    config: CraftConfig | None = None,
    speed: float = 0.0,
    csv: EstimateCsv | None = None,
    sink: Callable[[Message], None] | None = None,
    *,
    as_recorded: bool = False,
    inspection: Inspection | None = None,
    prior: Given | None = None,
) -> Replay:
    """Send a recording through the service, the same way a live link's samples go, but for rows that are none.

    Parameters
    ----------
    recording: a recording, or the descriptor or session to read one from.
    config: the craft's configuration; None: as the recording states it.
    speed: times real time; 0 as fast as it goes.
    csv: where each tick's estimate is written.
    sink: is called with every message that the service publishes.
    inspection: what was found on the recording, where that is known already.
    prior: nine errors that the estimator goes on from, where ``offline.prior`` lets them pass.
    as_recorded: begin with the state that a session began with, where it is replayed under its own configuration.
    """
    recording = recording if isinstance(recording, Recording) else read_recording(recording)
    inspection = inspect(recording) if inspection is None else inspection
    craft = craft_of(inspection.to_replay) if config is None else config
    recording = as_played(inspection, craft)
    estimates = Counter[str]()
    first_ns, last_ns = (int(end) for end in (recording.time_ns.min(), recording.time_ns.max()))
    work = Work("replaying", (last_ns - first_ns) * 1e-9, "s")

    def count(message: Message) -> None:
        if isinstance(message, Estimate):
            estimates[label_of(message)] += 1
            work.done = (message.time_ns - first_ns) * 1e-9
        if sink is not None:
            sink(message)

    address = f"recording:-?speed={speed:g}&craft={craft.name}"
    with RecordingLink(address, recording=recording, sink=count) as link, TemporaryDirectory() as folder:
        # Checkpoints that a command makes within the session are there for one that goes back to them.
        checkpoints = Checkpoints(StateConfig(Path(folder)), (craft,)) if _commanded(recording) else None
        service = Service(Config(link.address, (craft,)), link, csv, checkpoints=checkpoints, build=_pipeline)
        remark = _begin_as_recorded(service, recording, craft) if as_recorded else ""
        if prior is not None:
            go_on(service.magnetometers[craft.name].heard(recording.source).estimator, prior, craft)
        with counted(work):
            service.run(threading.Event())
    if service.rows.error is not None:
        raise service.rows.error
    pipeline = service.magnetometers[craft.name].heard(recording.source)
    state = pipeline.estimator.estimate()
    return Replay(pipeline, inspection, estimates[pipeline.label], state.x, state.covariance, remark)


def _pipeline(craft: CraftConfig) -> Pipeline:
    """The craft's; it keeps what it does where no formula over the recording tells it."""
    return Pipeline(craft) if craft.physics is None else ObservedPipeline(craft)


def _commanded(recording: Recording) -> bool:
    return any(isinstance(message, Command) for message in recording.stream or ())


def _begin_as_recorded(service: Service, recording: Recording, craft: CraftConfig) -> str:
    """Take over the session's first state; why that could not be, empty where it could or there is none."""
    if recording.state is None:
        return ""
    if craft != recording.craft:
        return "the session began with a state of its own, which does not go with another configuration"
    magnetometers, remark = service.magnetometers[craft.name], ""
    for source, state in {"": recording.state, **recording.beside}.items():
        pipeline = (
            magnetometers.heard(source) if source in ("", *magnetometers.sources) else magnetometers.appear(source)
        )
        if pipeline is None:
            continue
        try:
            pipeline.restore_state(state)
        except MISFITS as error:
            service.pipelines[pipeline.label] = _pipeline(pipeline.config)
            remark = f"the state that the session began with does not fit this version: {error}"
        pipeline.take_events()
    return remark
