"""Drivers of this moment: the newest values of channels, each held until its next, and a line through two positions.

Error of holding a channel: its rate times its age; a channel that turns with the craft has to be sent with the samples.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from magcal_service.base.units import CHANNEL_UNITS
from magcal_service.earth import geomagnetic
from magcal_service.physics.scene.scene import Telemetry
from magcal_service.wire.messages import Clock, Frame, PositionSample, TelemetrySample, Vector

_MOST_CHANNELS: Final = 64
"""Channels kept: a source that makes up names cannot fill the memory; more than any craft's model needs."""

_STALE_PACES: Final = 3.0
"""Intervals of a channel after which it is stale: two values may be lost. Choice: fewer drop out with single losses."""

_STALE_S: Final = (2.0, 120.0)
"""A channel is not stale before the first and is after the second [s], whatever its interval."""

_SLOW: Final = {"temperature": 30.0}
"""What changes slowly is held so long at least [s]: minutes of time constant make it tenths of a kelvin."""

_POSITION_S: Final = 120.0
"""Time for which a position is carried on along a line [s]; after that the path has bent by 60 km in a low orbit."""


@dataclass(frozen=True, slots=True)
class Held:
    """The newest value of a channel, in its base unit, and the interval [s] to the one before."""

    time_ns: int
    pace_s: float
    quantity: str
    values: tuple[float, ...]

    def is_stale(self, now_ns: int) -> bool:
        """Whether it is no driver any more at a time."""
        return abs(now_ns - self.time_ns) * 1e-9 > stale_after_s(self.pace_s, self.quantity)


@dataclass(frozen=True, slots=True)
class Place:
    """A position, Earth-fixed [km]."""

    time_ns: int
    ecef_km: Vector


def stale_after_s(pace_s: float, quantity: str) -> float:
    """Age [s] beyond which a channel of a quantity that comes every ``pace_s`` is no driver any more."""
    return min(max(_STALE_PACES * pace_s, _SLOW.get(quantity, _STALE_S[0])), _STALE_S[1])


def hold(channels: dict[str, Held], sample: TelemetrySample) -> None:
    """Hold a channel's value in place of the one before, in ``channels``.

    Left out is what has no unit that is known, what is late, and one channel too many.
    """
    unit = CHANNEL_UNITS.get(sample.unit)
    before = channels.get(sample.channel)
    if unit is None or (before is None and len(channels) >= _MOST_CHANNELS):
        return
    if before is not None and sample.time_ns <= before.time_ns:
        if before.time_ns - sample.time_ns < 1e9 * _STALE_S[1]:
            return  # late or doubled; older than that, the clock was set back
        before = None
    pace_s = _STALE_S[1] if before is None else (sample.time_ns - before.time_ns) * 1e-9
    values = tuple(unit.to_base(sample.values).tolist())
    channels[sample.channel] = Held(sample.time_ns, pace_s, unit.quantity, values)


def fresh(channels: Mapping[str, Held], now_ns: int, count: int) -> dict[str, Telemetry]:
    """Channels that are not stale, each with its value ``count`` times."""
    return {
        name: Telemetry(name, held.quantity, np.tile(np.array(held.values), (count, 1)))
        for name, held in channels.items()
        if not held.is_stale(now_ns)
    }


def with_place(places: list[Place], sample: PositionSample) -> list[Place]:
    """The last two places of a track with another one; it begins anew after a gap, and one that is late is left out.

    A position in space is turned with the Earth where its time is UTC, and left out where it is not.
    """
    if places and abs(sample.time_ns - places[-1].time_ns) > 1e9 * _POSITION_S:
        places = []
    if places and sample.time_ns <= places[-1].time_ns:
        return places
    km = np.array([sample.position_km])
    if sample.frame is not Frame.ECEF:
        if sample.clock is not Clock.UTC:
            return places
        km = geomagnetic.ecef_from_eci(np.array([sample.time_ns]), km)
    x, y, z = km[0].tolist()
    return [*places[-1:], Place(sample.time_ns, (x, y, z))]


def positions_km(places: Sequence[Place], times_ns: list[int]) -> NDArray[np.float64] | None:
    """Positions (n, 3), Earth-fixed [km], along the line through the last two places; None where they are too old."""
    if not places or abs(times_ns[-1] - places[-1].time_ns) * 1e-9 > _POSITION_S:
        return None
    last = places[-1]
    place = np.array(last.ecef_km)
    velocity = np.zeros(3)
    if len(places) > 1:
        before = places[0]
        velocity = (place - np.array(before.ecef_km)) / (last.time_ns - before.time_ns)
    return np.stack([place + velocity * (time_ns - last.time_ns) for time_ns in times_ns])
