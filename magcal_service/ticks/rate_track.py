"""The angular rate at the time of a magnetometer sample, from a telemetry channel of three rates.

The rate is interpolated linearly between the two samples around the time asked for, when they are at most
``max_gap_ns`` apart; nothing is extrapolated.
"""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass
from typing import Final

from magcal_service.base.snapshot import Stateful
from magcal_service.base.units import CHANNEL_UNITS
from magcal_service.wire.messages import Clock, TelemetrySample, Vector

_MOST: Final = 8192
"""Rates kept at most; the oldest go first."""


@dataclass(init=False, repr=False, eq=False)
class RateTrackMemory:
    """What of ``RateTrack`` outlives a restart, saved and restored whole."""

    _channel: str
    _clock: Clock | None
    _times: list[int]
    _rates: list[Vector]


class RateTrack(Stateful, RateTrackMemory):
    """Rates of one craft, by time.

    Parameters
    ----------
    max_gap_ns: two samples further apart are not interpolated between [ns].
    """

    def __init__(self, max_gap_ns: int) -> None:
        self._max_gap_ns = max_gap_ns
        self._channel = ""
        self._clock = None
        self._times = []
        self._rates = []

    def add(self, sample: TelemetrySample) -> bool:
        """Take a sample if it is the craft's rate: the first channel of three angular rates; whether it was taken."""
        unit = CHANNEL_UNITS.get(sample.unit)
        if unit is None or unit.quantity != "angular rate" or len(sample.values) != 3:
            return False
        if self._channel not in ("", sample.channel):
            return False
        if sample.clock is not self._clock or (self._times and sample.time_ns < self._times[0]):
            self._times, self._rates = [], []
        self._channel, self._clock = sample.channel, sample.clock
        at = bisect_left(self._times, sample.time_ns)
        if at < len(self._times) and self._times[at] == sample.time_ns:
            return False
        x, y, z = unit.to_base(sample.values).tolist()
        self._times.insert(at, sample.time_ns)
        self._rates.insert(at, (x, y, z))
        if len(self._times) > _MOST:
            del self._times[0], self._rates[0]
        return True

    def at(self, time_ns: int, clock: Clock) -> Vector | None:
        """The rate [rad/s] at a time, or None."""
        if clock is not self._clock:
            return None
        times, at = self._times, bisect_left(self._times, time_ns)
        if at == len(times):
            return None
        if times[at] == time_ns:
            return self._rates[at]
        if at == 0 or times[at] - times[at - 1] > self._max_gap_ns:
            return None
        share = (time_ns - times[at - 1]) / (times[at] - times[at - 1])
        x, y, z = (a + share * (b - a) for a, b in zip(self._rates[at - 1], self._rates[at], strict=True))
        return (x, y, z)
