"""What may drive a disturbance, at the time of a magnetometer sample: telemetry, and light from positions.

A channel is interpolated linearly between its values around the time asked for; its newest value is held for as long as
``live_drivers.stale_after_s`` allows.  The sample's tick closes after the telemetry of its second, so a current that
turns with the craft is taken at the right phase.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from magcal_service.base.snapshot import Stateful
from magcal_service.base.units import CHANNEL_UNITS
from magcal_service.earth import geomagnetic
from magcal_service.physics.acting import LIGHT, WARMTH
from magcal_service.physics.apply.live_drivers import stale_after_s
from magcal_service.physics.scene.sunlight import sun_eci, sunlit
from magcal_service.wire.messages import Clock, Frame, PositionSample, TelemetrySample

DRIVING: Final = ("temperature", "current", "magnetic moment", "sun")
"""Quantities of channels that an effect of the catalogue follows."""

_WARMTH_S: Final = 1200.0  # of electronics in a small craft: 300 to 3600
_LIGHT_S: Final = 10.0  # between two evaluations of the shadow
_MOST_CHANNELS: Final = 8  # kept: more than drive anything in a craft; each costs memory and tests
_MOST_DRIVERS: Final = 16  # tried at once: each has three or six columns in every sum, and each is a test more
_KEPT: Final = 64  # values of a channel: more than come while a tick waits to be closed


@dataclass(frozen=True, slots=True)
class Driver:
    """One number that may drive a disturbance.

    Parameters
    ----------
    channel: name of the telemetry channel; ``light`` and ``warmth`` for those worked out.
    quantity: one of ``DRIVING``, ``LIGHT`` or ``WARMTH``.
    column: which of the channel's values.
    """

    channel: str
    quantity: str
    column: int

    @property
    def label(self) -> str:
        """In words."""
        return f"inferred {self.channel}" if self.quantity in (LIGHT, WARMTH) else f"channel {self.channel}"


@dataclass(frozen=True, slots=True)
class Series:
    """The newest values of one channel, in its base unit, by rising time [ns]."""

    quantity: str
    times_ns: list[int]
    values: list[tuple[float, ...]]


@dataclass(init=False, repr=False, eq=False)
class DriverTrackMemory:
    """What of ``DriverTrack`` outlives a restart, saved and restored whole."""

    _channels: dict[str, Series]
    _light: list[tuple[int, float, float]]


class DriverTrack(Stateful, DriverTrackMemory):
    """Drivers of one craft, by time."""

    def __init__(self) -> None:
        self._channels = {}
        self._light = []  # time [ns], share of sunlight, warmth; the newest two

    def telemetry(self, sample: TelemetrySample) -> None:
        """Take a channel's value, if its quantity drives anything."""
        unit = CHANNEL_UNITS.get(sample.unit)
        quantity = _quantity(sample, "" if unit is None else unit.quantity)
        series = self._channels.get(sample.channel)
        if unit is None or not quantity or (series is None and len(self._channels) >= _MOST_CHANNELS):
            return
        stepped = series is not None and bool(series.times_ns) and sample.time_ns < series.times_ns[0]
        if series is None or stepped or series.quantity != quantity or len(series.values[0]) != len(sample.values):
            series = self._channels[sample.channel] = Series(quantity, [], [])
        if series.times_ns and sample.time_ns <= series.times_ns[-1]:
            return
        series.times_ns.append(sample.time_ns)
        series.values.append(tuple(unit.to_base(sample.values).tolist()))
        del series.times_ns[:-_KEPT], series.values[:-_KEPT]

    def position(self, sample: PositionSample) -> None:
        """Take a position: is the craft in light?"""
        step_s = (sample.time_ns - self._light[-1][0]) * 1e-9 if self._light else 0.0
        if sample.clock is not Clock.UTC or 0.0 < step_s < _LIGHT_S:
            return
        time_ns, place = np.array([sample.time_ns]), np.array([sample.position_km])
        if sample.frame is Frame.ECEF:
            place = geomagnetic.eci_from_ecef(time_ns, place)
        lit = float(sunlit(place, sun_eci(time_ns * 1e-9))[0])
        if step_s <= 0.0:
            self._light = []
        warmth = lit
        if self._light:
            warmth += (self._light[-1][2] - lit) * float(np.exp(-step_s / _WARMTH_S))
        self._light = [*self._light[-1:], (sample.time_ns, lit, warmth)]

    def drivers(self) -> list[Driver]:
        """Those that are known now, in the order in which their channels came first; 16 at most."""
        found = [
            Driver(name, series.quantity, column)
            for name, series in self._channels.items()
            for column in range(len(series.values[0]))
        ]
        light = [Driver(LIGHT, LIGHT, 0), Driver(WARMTH, WARMTH, 0)] if self._light else []
        return [*found[: _MOST_DRIVERS - len(light)], *light]

    def at(self, time_ns: int) -> dict[str, tuple[float, ...]]:
        """Values at a time, by channel; one that is stale then is not in it.  What is older is discarded."""
        found = {name: value for name, series in self._channels.items() if (value := _value(series, time_ns))}
        if self._light and abs(time_ns - self._light[-1][0]) * 1e-9 < 12.0 * _LIGHT_S:
            _, lit, warmth = self._light[-1]
            found[LIGHT], found[WARMTH] = (lit,), (warmth,)
        return found


def _quantity(sample: TelemetrySample, quantity: str) -> str:
    """What a channel can drive by; three numbers of a channel that is called after the Sun are its direction."""
    if quantity == "dimensionless" and len(sample.values) == 3 and "sun" in sample.channel.lower():
        return "sun"
    return quantity if quantity in DRIVING else ""


def _value(series: Series, time_ns: int) -> tuple[float, ...]:
    """Interpolated, or held; empty where the channel is stale."""
    times, values = series.times_ns, series.values
    after = bisect_right(times, time_ns)
    if after == 0:
        return values[0] if (times[0] - time_ns) * 1e-9 <= stale_after_s(0.0, series.quantity) else ()
    if after == len(times):
        pace_s = (times[-1] - times[-2]) * 1e-9 if after > 1 else 60.0
        found = values[-1] if (time_ns - times[-1]) * 1e-9 <= stale_after_s(pace_s, series.quantity) else ()
    else:
        share = (time_ns - times[after - 1]) / (times[after] - times[after - 1])
        found = tuple(a + share * (b - a) for a, b in zip(values[after - 1], values[after], strict=True))
    if after > 2:
        del times[: after - 2], values[: after - 2]
    return found


def value_of(found: Mapping[str, tuple[float, ...]], driver: Driver) -> float:
    """A driver's number among the values of one moment; NaN where it is not there."""
    values = found.get(driver.channel, ())
    return values[driver.column] if driver.column < len(values) else float("nan")
