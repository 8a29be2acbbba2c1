"""Samples, references, rates, and what the tick stage answers."""

from __future__ import annotations

from dataclasses import replace

from magcal_service.config.settings import TickConfig
from magcal_service.ticks.assembler import TickAssembler
from magcal_service.wire.messages import Clock, MagnetometerSample, ReferenceSample, TelemetrySample, Vector
from tests.ticks.tick_streams import ns, reference, sample

CONFIG = TickConfig(hold_s=3.0, late_s=30.0, gap_s=60.0, step_confirm_s=600.0)


def at(seconds: float, more_ns: int = 0, clock: Clock = Clock.UTC) -> MagnetometerSample:
    """A sample at a time that is exact to the nanosecond."""
    return replace(sample(seconds, clock), time_ns=ns(seconds) + more_ns)


def referred(seconds: float, more_ns: int = 0, clock: Clock = Clock.UTC) -> ReferenceSample:
    """A reference at a time that is exact to the nanosecond."""
    return replace(reference(seconds, clock), time_ns=ns(seconds) + more_ns)


def answered(target: TickAssembler, message: MagnetometerSample) -> str:
    """The name under which a sample is rejected, empty where it is accepted."""
    return target.add(message) or ""


def rate(seconds: float, values: Vector, clock: Clock = Clock.UTC) -> TelemetrySample:
    return TelemetrySample(
        craft="c",
        source="imu",
        sequence=0,
        time_ns=ns(seconds),
        clock=clock,
        channel="gyro",
        unit="rad/s",
        values=values,
    )
