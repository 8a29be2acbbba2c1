"""A simulated run as a recording: ``samples.csv`` and ``RECORDING.toml`` as any real log, and ``truth.json`` beside.

One row per magnetometer message, in the order of sending, link faults included.  What has its own rate (reference,
position, telemetry) is interpolated linearly to the row's time stamp, and is absent (NaN) where the samples around
that time are more than two and a half periods apart.  Telemetry keeps its last value for a period, as a log does that
ends between two readouts.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt

from magcal_service.base.errors import ConfigError, Fault
from magcal_service.base.progress import Work, counted
from magcal_service.recordings.channels import Axes
from magcal_service.recordings.recording import Channel as RecordedChannel
from magcal_service.recordings.recording import Position
from magcal_service.recordings.specs import SpinSpec
from magcal_service.recordings.writer import make_channel, write_recording
from magcal_service.wire.messages import (
    Clock,
    Frame,
    MagnetometerSample,
    PositionSample,
    ReferenceSample,
    TelemetrySample,
)
from sim_sensor.beside import OWN_SOURCE
from sim_sensor.scenario import UNITS, Channel, ReferenceForm
from sim_sensor.simulation import Simulation
from sim_sensor.truth import write_truth

Floats = npt.NDArray[np.float64]
Times = npt.NDArray[np.int64]

_WIDEST_PERIODS = 2.5
"""Of a series: wider gaps are left as gaps, so that one lost message is interpolated over and two are not."""
_HELD = (Channel.TORQUER,)  # commands hold until the next one
_BODY = (Channel.SUN, Channel.GYRO, Channel.TORQUER)


@dataclass
class Series:
    """Samples of one source as they were sent: times [ns] and values."""

    times_ns: list[int] = field(default_factory=list)
    values: list[tuple[float, ...]] = field(default_factory=list)

    def add(self, time_ns: int, values: tuple[float, ...]) -> None:
        """Add one sample."""
        self.times_ns.append(time_ns)
        self.values.append(values)

    def at(self, rows_ns: Times, widest_s: float, held: bool = False, kept_s: float = 0.0) -> Floats:
        """Values (n, k) at times (n,) [ns]: linear, or the last one before where ``held``; NaN where too far apart.

        The last of all is kept for ``kept_s``.
        """
        known, first = np.unique(np.array(self.times_ns, dtype=np.int64), return_index=True)
        values = np.array(self.values, dtype=np.float64)[first]
        after = np.clip(np.searchsorted(known, rows_ns, side="left"), 0, len(known) - 1)
        exact = known[after] == rows_ns
        before = np.where(exact, after, np.maximum(after - 1, 0))
        span_ns = known[after] - known[before]
        share = (rows_ns - known[before]) / np.where(span_ns > 0, span_ns, 1)
        steps = 0.0 if held else share[:, None] * (values[after] - values[before])
        result = values[before] + steps
        outside = (rows_ns < known[0]) | (rows_ns > known[-1])
        result[outside | (span_ns > widest_s * 1e9)] = np.nan
        result[(rows_ns > known[-1]) & (rows_ns <= known[-1] + kept_s * 1e9)] = values[-1]
        return np.asarray(result, dtype=np.float64)


def record_simulation(simulation: Simulation, directory: Path) -> Path:
    """Write a whole run into a folder, made where absent; returns the path of ``RECORDING.toml``.

    Raises ConfigError where the scenario sends nothing that a recording could be made of, RecordingError for what the
    writer refuses.
    """
    truth = simulation.truth
    _refuse_unrecordable(simulation)
    samples, reference, position, channels = _collect(simulation)
    rows_ns = np.array(samples.times_ns, dtype=np.int64)
    vectors = truth.reference.form is ReferenceForm.VECTOR
    field_nt = reference.at(rows_ns, _WIDEST_PERIODS / truth.reference.rate_hz)
    noise_nt = float(np.sqrt(np.mean(np.square(truth.sensor.noise_nt))))
    path = write_recording(
        directory,
        time_ns=rows_ns,
        clock=Clock.UTC,
        field_body_nt=np.array(samples.values),
        reference_nt=field_nt if vectors else field_nt[:, 0],
        frame=Frame.ECI if vectors else None,
        position=_position(simulation, position, rows_ns),
        channels=[_channel(simulation, name, series, rows_ns) for name, series in channels.items()],
        spin=SpinSpec(truth.spin.axis_body, round(truth.spin.rate_rad_s * 60.0 / math.tau, 12)),
        noise_nt=noise_nt if noise_nt >= 1e-3 else None,
        craft=truth.craft,
    )
    write_truth(simulation, directory)
    return path


def _refuse_unrecordable(simulation: Simulation) -> None:
    if simulation.truth.reference.form is ReferenceForm.NONE:
        accepted = '"vector" or "magnitude" is accepted: a recording needs a reference'
        raise ConfigError([Fault(f"{simulation.truth.name}: reference.form", "none", accepted)])


def _collect(simulation: Simulation) -> tuple[Series, Series, Series, dict[Channel, Series]]:
    samples, reference, position = Series(), Series(), Series()
    channels = {channel: Series() for channel in simulation.truth.telemetry.channels}
    with counted(Work("simulating", simulation.duration_s, "s")) as work:
        for message in simulation.messages():
            work.done = (message.time_ns - simulation.truth.start_ns) * 1e-9
            if isinstance(message, MagnetometerSample) and message.source == OWN_SOURCE:
                samples.add(message.time_ns, message.field_body_nt)
            elif isinstance(message, ReferenceSample):
                magnitude = (message.magnitude_nt or 0.0,)
                reference.add(message.time_ns, magnitude if message.field_nt is None else message.field_nt)
            elif isinstance(message, PositionSample):
                position.add(message.time_ns, message.position_km)
            elif isinstance(message, TelemetrySample):
                channels[Channel(message.channel)].add(message.time_ns, message.values)
    for name, series in (("magnetometer", samples), ("reference", reference)):
        if not series.times_ns:
            accepted = "a longer duration_s, or milder faults: nothing of it was sent"
            raise ConfigError([Fault(f"{simulation.truth.name}: {name}", "no samples", accepted)])
    return samples, reference, position, {name: series for name, series in channels.items() if series.times_ns}


def _position(simulation: Simulation, series: Series, rows_ns: Times) -> Position | None:
    if not series.times_ns:
        return None
    return Position(series.at(rows_ns, _WIDEST_PERIODS / simulation.truth.position.rate_hz), Frame.ECI)


def _channel(simulation: Simulation, name: Channel, series: Series, rows_ns: Times) -> RecordedChannel:
    period_s = 1.0 / simulation.truth.telemetry.rate_hz
    values = series.at(rows_ns, _WIDEST_PERIODS * period_s, held=name in _HELD, kept_s=period_s)
    return make_channel(name.value, values, UNITS[name], Axes.BODY if name in _BODY else None)
