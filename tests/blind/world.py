"""The craft and its surroundings before anything disturbs them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import cached_property

import numpy as np

from tests.blind.attitude import Motion, RateProfile, draw_motion
from tests.blind.field import FieldTrack, main_field_track
from tests.blind.orbit import Orbit, draw_orbit
from tests.blind.streams import Streams
from tests.blind.sun import sun_direction, sunlit
from tests.blind.vectors import Floats, log_uniform, random_direction, turn

MARGIN_S = 240.0  # the sensor's clock may be off by so much
FIRST_DAY = datetime(2020, 1, 1, tzinfo=UTC).timestamp()
LAST_DAY = datetime(2029, 12, 15, tzinfo=UTC).timestamp()


@dataclass(frozen=True, eq=False)
class World:
    """Orbit, motion, and a magnetometer with its nine errors and white noise.

    Parameters
    ----------
    streams: where every cause gets its random numbers.
    start_unix_s: UTC of the first sample, a whole second.
    time_s: (n,) tags of the samples since the first.
    orbit, motion: where the craft is and how it turns.
    bias_nt: (3,) b.
    scale: (3, 3) symmetric D.
    noise_nt: 1 sigma of the white noise per axis, in the corrected frame.
    """

    streams: Streams
    start_unix_s: float
    time_s: Floats
    orbit: Orbit
    motion: Motion
    bias_nt: Floats
    scale: Floats
    noise_nt: float

    @property
    def period_s(self) -> float:
        """Time between samples [s]."""
        return float(self.time_s[1] - self.time_s[0])

    @property
    def duration_s(self) -> float:
        """Tag of the last sample [s]."""
        return float(self.time_s[-1])

    @property
    def span_s(self) -> tuple[float, float]:
        """First and last time at which the field can be asked for."""
        return -MARGIN_S, self.duration_s + MARGIN_S

    def field_eci(self, times_s: Floats) -> Floats:
        """The main field (n, 3) [nT] ECI where the craft is."""
        return self.main_field(times_s)

    @cached_property
    def main_field(self) -> FieldTrack:
        """The main field along the orbit."""
        return main_field_track(self.orbit.position_km, self.start_unix_s, self.span_s)

    def field_body(self, times_s: Floats) -> Floats:
        """The main field (n, 3) [nT] in the body."""
        return turn(self.motion.body_from_eci(times_s), self.field_eci(times_s))

    def sun_eci(self, times_s: Floats) -> Floats:
        """Directions (n, 3) to the Sun, ECI."""
        return sun_direction(self.start_unix_s + times_s)

    def sun_body(self, times_s: Floats) -> Floats:
        """Directions (n, 3) to the Sun in the body."""
        return turn(self.motion.body_from_eci(times_s), self.sun_eci(times_s))

    def sunlit(self, times_s: Floats) -> Floats:
        """Visible share (n,) of the Sun's disc."""
        return sunlit(self.orbit.position_km(times_s), self.sun_eci(times_s))

    def with_motion(self, motion: Motion) -> World:
        """The same world with another motion of the craft."""
        return replace(self, motion=motion)

    def with_rate(self, rate: RateProfile) -> World:
        """The same world with another spin rate over time."""
        return self.with_motion(replace(self.motion, rate=rate))


def draw_world(streams: Streams) -> World:
    """A craft on some orbit, on some date, turning somehow, with a magnetometer that has errors."""
    rng = streams.rng("sampling")
    sample_hz = float(rng.choice([1.0, 2.0, 4.0, 0.2], p=[0.78, 0.08, 0.02, 0.12]))
    longest = min(18000.0, 36000.0 / sample_hz)
    count = round(rng.uniform(9000.0, longest) * sample_hz)
    rng = streams.rng("date")
    start = float(np.floor(rng.uniform(FIRST_DAY, LAST_DAY)))
    bias, scale = draw_sensor_errors(streams.rng("errors"))
    return World(
        streams=streams,
        start_unix_s=start,
        time_s=np.arange(count) / sample_hz,
        orbit=draw_orbit(streams.rng("orbit")),
        motion=draw_motion(streams.rng("motion"), sample_hz),
        bias_nt=bias,
        scale=scale,
        noise_nt=log_uniform(streams.rng("noise level"), 50.0, 300.0),
    )


def draw_sensor_errors(rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Bias (3,) of up to 30 uT and symmetric D (3, 3) of up to 0.2 on its diagonal, 0.1 beside it."""
    bias = rng.uniform(500.0, 30000.0) * random_direction(rng)
    size = rng.uniform(0.1, 1.0)
    scale = np.diag(rng.uniform(-0.2, 0.2, 3) * size)
    for row, column in ((0, 1), (0, 2), (1, 2)):
        scale[row, column] = scale[column, row] = rng.uniform(-0.1, 0.1) * size
    return bias, scale
