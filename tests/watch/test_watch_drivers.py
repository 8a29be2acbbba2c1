"""Drivers at a sample's time: interpolation, staleness, light and its memory, each limit from both sides."""

from __future__ import annotations

import math

import numpy as np
import pytest

from magcal_service.earth import geomagnetic
from magcal_service.physics.apply.live_drivers import stale_after_s
from magcal_service.physics.scene.sunlight import sun_eci
from magcal_service.watch.drivers import Driver, DriverTrack, value_of
from magcal_service.wire.messages import Clock, Frame, PositionSample, TelemetrySample

START_NS = 1_750_000_000 * 10**9


def ns(seconds: float) -> int:
    return START_NS + round(seconds * 1e9)


def telemetry(seconds: float, *values: float, channel: str = "temperature", unit: str = "degC") -> TelemetrySample:
    return TelemetrySample(
        craft="c",
        source="t",
        sequence=0,
        time_ns=ns(seconds),
        clock=Clock.UTC,
        channel=channel,
        unit=unit,
        values=values,
    )


def track(*samples: TelemetrySample) -> DriverTrack:
    target = DriverTrack()
    for sample in samples:
        target.telemetry(sample)
    return target


def at(target: DriverTrack, seconds: float, channel: str = "temperature") -> tuple[float, ...] | None:
    return target.at(ns(seconds)).get(channel)


def test_between_two_values_it_is_linear_and_at_a_value_exact() -> None:
    target = track(telemetry(0.0, 10.0), telemetry(4.0, 30.0), telemetry(8.0, 20.0))
    found = [at(target, seconds) for seconds in (0.0, 1.0, 3.0, 4.0, 6.0, 8.0)]
    assert found == [(10.0,), (15.0,), (25.0,), (30.0,), (25.0,), (20.0,)]


def test_each_value_of_a_channel_is_interpolated_and_in_its_base_unit() -> None:
    target = track(
        telemetry(0.0, 0.0, 1000.0, 5.0, channel="coil", unit="mA"),
        telemetry(2.0, 500.0, 0.0, 5.0, channel="coil", unit="mA"),
    )
    assert at(target, 1.0, "coil") == pytest.approx((0.25, 0.5, 0.005))


@pytest.mark.parametrize(
    ("unit", "quantity", "pace_s"),
    [("degC", "temperature", 1.0), ("A", "current", 1.0), ("A", "current", 40.0), ("degC", "temperature", 400.0)],
)
def test_the_newest_value_is_held_while_it_is_not_stale(unit: str, quantity: str, pace_s: float) -> None:
    limit_s = stale_after_s(pace_s, quantity)
    for late_s, expected in ((0.001, (7.0,)), (limit_s - 0.001, (7.0,)), (limit_s + 0.001, None)):
        target = track(telemetry(0.0, 5.0, unit=unit), telemetry(pace_s, 7.0, unit=unit))
        assert at(target, pace_s + late_s) == expected


@pytest.mark.parametrize(("unit", "quantity"), [("degC", "temperature"), ("A", "current")])
def test_a_single_value_has_a_pace_of_a_minute(unit: str, quantity: str) -> None:
    limit_s = stale_after_s(60.0, quantity)
    assert at(track(telemetry(0.0, 5.0, unit=unit)), limit_s - 0.001) == (5.0,)
    assert at(track(telemetry(0.0, 5.0, unit=unit)), limit_s + 0.001) is None


@pytest.mark.parametrize(("unit", "quantity"), [("degC", "temperature"), ("A", "current")])
def test_the_first_value_holds_for_a_short_time_before_it(unit: str, quantity: str) -> None:
    limit_s = stale_after_s(0.0, quantity)
    target = track(telemetry(0.0, 5.0, unit=unit), telemetry(1.0, 9.0, unit=unit))
    assert at(target, 0.001 - limit_s) == (5.0,)
    assert at(target, -limit_s - 0.001) is None


def test_a_stale_channel_leaves_the_others_alone() -> None:
    target = track(telemetry(0.0, 5.0), telemetry(9000.0, 1.0, channel="coil", unit="A"))
    assert set(target.at(ns(9000.0))) == {"coil"}
    assert {driver.channel for driver in target.drivers()} == {"temperature", "coil"}


def test_what_lies_before_the_two_around_the_newest_question_is_forgotten() -> None:
    target = track(*(telemetry(float(second), float(second)) for second in range(10)))
    assert at(target, 6.5) == (6.5,)
    series = target._channels["temperature"]
    assert (series.times_ns, series.values) == (
        [ns(5.0), *map(ns, (6.0, 7.0, 8.0, 9.0))],
        [(5.0,), (6.0,), (7.0,), (8.0,), (9.0,)],
    )
    assert at(target, 5.5) == (5.5,)


def test_64_values_of_a_channel_are_kept() -> None:
    target = track(*(telemetry(float(second), float(second)) for second in range(80)))
    series = target._channels["temperature"]
    assert (len(series.values), series.times_ns[0]) == (64, ns(16.0))


def test_values_that_are_not_newer_are_not_taken() -> None:
    target = track(telemetry(0.0, 1.0), telemetry(2.0, 3.0), telemetry(1.0, 99.0), telemetry(2.0, 99.0))
    assert [at(target, seconds) for seconds in (1.0, 2.0)] == [(2.0,), (3.0,)]


@pytest.mark.parametrize(
    "other",
    [
        telemetry(-1.0, 9.0),  # the clock was set back
        telemetry(5.0, 9.0, 8.0),  # another number of values
        telemetry(5.0, 9.0, unit="A"),  # another quantity
    ],
)
def test_a_channel_that_becomes_another_begins_anew(other: TelemetrySample) -> None:
    target = track(telemetry(0.0, 1.0), telemetry(2.0, 3.0), other)
    assert len(target._channels["temperature"].values) == 1
    assert len(at(target, (other.time_ns - START_NS) * 1e-9) or ()) == len(other.values)


@pytest.mark.parametrize(
    ("channel", "unit", "values", "quantity"),
    [
        ("a", "K", (300.0,), "temperature"),
        ("a", "uA", (1.0,), "current"),
        ("a", "A m2", (1.0, 2.0, 3.0), "magnetic moment"),
        ("Fine-Sun", "", (1.0, 0.0, 0.0), "sun"),
        ("fine sun", "1", (1.0, 0.0, 0.0), "sun"),
        ("sun", "1", (1.0, 0.0), None),
        ("star", "1", (1.0, 0.0, 0.0), None),
        ("sun", "W/m2", (1.0, 0.0, 0.0), None),
        ("a", "V", (1.0,), None),
        ("a", "furlong", (1.0,), None),
    ],
)
def test_which_channels_drive(channel: str, unit: str, values: tuple[float, ...], quantity: str | None) -> None:
    found = track(telemetry(0.0, *values, channel=channel, unit=unit)).drivers()
    assert found == [Driver(channel, quantity, column) for column in range(len(values))] if quantity else not found


def test_eight_channels_are_known_and_their_values_go_on_coming() -> None:
    target = track(*(telemetry(0.0, 1.0, channel=f"t{number}") for number in range(10)))
    assert [driver.channel for driver in target.drivers()] == [f"t{number}" for number in range(8)]
    target.telemetry(telemetry(2.0, 3.0, channel="t7"))
    target.telemetry(telemetry(2.0, 3.0, channel="t8"))
    assert at(target, 1.0, "t7") == (2.0,)
    assert at(target, 1.0, "t8") is None


def position(
    seconds: float, place_km: tuple[float, float, float], clock: Clock = Clock.UTC, frame: Frame = Frame.ECI
) -> PositionSample:
    return PositionSample(
        craft="c", source="gps", sequence=0, time_ns=ns(seconds), clock=clock, position_km=place_km, frame=frame
    )


SUN = sun_eci(np.array([ns(0.0)]) * 1e-9)[0]
LIT = tuple((7000.0 * SUN).tolist())
DARK = tuple((-7000.0 * SUN).tolist())


def test_light_is_that_of_the_place_and_warmth_follows_it_with_20_minutes() -> None:
    target = DriverTrack()
    assert target.drivers() == []
    warmth = None
    for seconds, place, lit in ((0.0, LIT, 1.0), (10.0, DARK, 0.0), (610.0, DARK, 0.0), (1210.0, LIT, 1.0)):
        target.position(position(seconds, place))
        step_s = {0.0: 0.0, 10.0: 10.0, 610.0: 600.0, 1210.0: 600.0}[seconds]
        warmth = lit if warmth is None else lit + (warmth - lit) * math.exp(-step_s / 1200.0)
        found = target.at(ns(seconds))
        assert found["light"] == (lit,)
        assert found["warmth"] == pytest.approx((warmth,), rel=1e-12)
    assert target.drivers() == [Driver("light", "light", 0), Driver("warmth", "warmth", 0)]
    assert len(target._light) == 2


@pytest.mark.parametrize(("seconds", "known"), [(119.9, True), (120.1, False), (-119.9, True), (-120.1, False)])
def test_light_is_known_for_two_minutes(seconds: float, known: bool) -> None:
    target = DriverTrack()
    target.position(position(0.0, LIT))
    assert ("light" in target.at(ns(seconds)), "warmth" in target.at(ns(seconds))) == (known, known)


@pytest.mark.parametrize(("seconds", "lit"), [(9.99, 1.0), (10.0, 0.0)])
def test_the_shadow_is_looked_at_every_10_s(seconds: float, lit: float) -> None:
    target = DriverTrack()
    target.position(position(0.0, LIT))
    target.position(position(seconds, DARK))
    assert target.at(ns(seconds))["light"] == (lit,)


def test_a_clock_set_back_begins_the_warmth_anew() -> None:
    target = DriverTrack()
    for seconds, place in ((0.0, LIT), (600.0, DARK), (300.0, LIT)):
        target.position(position(seconds, place))
    assert (target.at(ns(300.0))["warmth"], len(target._light)) == ((1.0,), 1)


def test_a_place_on_another_clock_says_nothing_of_the_sun() -> None:
    target = DriverTrack()
    target.position(position(0.0, LIT, Clock.ELAPSED))
    assert target.drivers() == []


@pytest.mark.parametrize(("eci", "lit"), [(LIT, 1.0), (DARK, 0.0)])
def test_a_place_in_earth_fixed_axes_is_turned_first(eci: tuple[float, float, float], lit: float) -> None:
    fixed = geomagnetic.ecef_from_eci(np.array([ns(0.0)]), np.array([eci]))[0]
    target = DriverTrack()
    target.position(position(0.0, tuple(fixed.tolist()), frame=Frame.ECEF))
    assert target.at(ns(0.0))["light"] == (lit,)


def test_sixteen_drivers_are_given_light_and_warmth_among_them() -> None:
    target = track(*(telemetry(0.0, *range(9), channel=f"coil{number}", unit="A") for number in range(2)))
    assert [(driver.channel, driver.column) for driver in target.drivers()] == [
        *(("coil0", column) for column in range(9)), *(("coil1", column) for column in range(7)),
    ]  # fmt: skip
    target.position(position(0.0, LIT))
    assert len(target.drivers()) == 16
    assert [driver.channel for driver in target.drivers()[13:]] == ["coil1", "light", "warmth"]


def test_a_drivers_number_and_its_name() -> None:
    found = {"coil": (1.0, 2.0)}
    assert value_of(found, Driver("coil", "current", 1)) == 2.0
    assert math.isnan(value_of(found, Driver("coil", "current", 2)))
    assert math.isnan(value_of(found, Driver("other", "current", 0)))
    assert Driver("coil", "current", 1).label == "channel coil"
    assert [Driver(name, name, 0).label for name in ("light", "warmth")] == ["inferred light", "inferred warmth"]
