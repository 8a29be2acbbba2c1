"""The angular rate at a sample's time: interpolated, never extrapolated, from the one channel that is a rate."""

import math

import pytest

from magcal_service.ticks.rate_track import RateTrack
from magcal_service.wire.messages import Clock, TelemetrySample

SECOND = 1_000_000_000


def rate(time_s: float, values: tuple[float, ...], unit: str = "rad/s", channel: str = "gyro") -> TelemetrySample:
    return TelemetrySample(
        craft="x",
        source="imu",
        sequence=0,
        time_ns=round(time_s * SECOND),
        clock=Clock.UTC,
        channel=channel,
        unit=unit,
        values=values,
    )


def track(*samples: TelemetrySample) -> RateTrack:
    result = RateTrack(10 * SECOND)
    for sample in samples:
        result.add(sample)
    return result


def test_a_rate_between_two_samples_lies_on_their_line() -> None:
    found = track(rate(0.0, (0.0, 1.0, 2.0)), rate(4.0, (4.0, 1.0, -2.0))).at(SECOND, Clock.UTC)
    assert found == pytest.approx((1.0, 1.0, 1.0))


def test_degrees_become_radians() -> None:
    assert track(rate(0.0, (180.0, 0.0, 90.0), "deg/s")).at(0, Clock.UTC) == pytest.approx((math.pi, 0.0, math.pi / 2))


@pytest.mark.parametrize("time_s", [-1.0, 5.0])
def test_nothing_is_extrapolated(time_s: float) -> None:
    both = track(rate(0.0, (1.0, 1.0, 1.0)), rate(4.0, (1.0, 1.0, 1.0)))
    assert both.at(round(time_s * SECOND), Clock.UTC) is None


def test_nothing_is_interpolated_over_a_long_gap() -> None:
    apart = track(rate(0.0, (1.0, 1.0, 1.0)), rate(11.0, (1.0, 1.0, 1.0)))
    assert apart.at(5 * SECOND, Clock.UTC) is None


def test_another_clock_has_no_rate() -> None:
    assert track(rate(0.0, (1.0, 1.0, 1.0))).at(0, Clock.ELAPSED) is None


@pytest.mark.parametrize(
    "other",
    [rate(0.0, (20.0,), "degC", "temperature"), rate(0.0, (1.0, 2.0, 3.0), "A m2", "torquer"), rate(0.0, (1.0,))],
)
def test_what_is_no_rate_is_not_taken(other: TelemetrySample) -> None:
    assert not RateTrack(SECOND).add(other)


def test_a_second_gyro_is_not_mixed_with_the_first() -> None:
    one = track(rate(0.0, (1.0, 1.0, 1.0)))
    assert not one.add(rate(1.0, (9.0, 9.0, 9.0), channel="spare"))


def test_a_clock_set_back_starts_the_track_anew() -> None:
    again = track(rate(100.0, (1.0, 1.0, 1.0)), rate(0.0, (2.0, 2.0, 2.0)))
    assert again.at(0, Clock.UTC) == (2.0, 2.0, 2.0)
    assert again.at(100 * SECOND, Clock.UTC) is None
