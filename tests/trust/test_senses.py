"""What |B| cannot show: swapped axes, a spin or gyro that disagrees, a reference that repeats."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from magcal_service.config.settings import SpinConfig
from magcal_service.samples.axes_watch import AxesWatch
from magcal_service.samples.signed_axes import SIGNED_AXES, described
from magcal_service.ticks.held_watch import HeldWatch
from magcal_service.trust.rate_sense import RateSense
from magcal_service.trust.reference_sense import ReferenceSense
from magcal_service.trust.spin_sense import SpinSense

AT = 300


def spinning(rate_rpm: float, seconds: int = 400, noise_nt: float = 100.0) -> np.ndarray:
    """Measured vectors (n, 3) [nT] at 1 Hz of a craft that turns about +z in a field of 38 uT, with a bias."""
    phase = -math.tau * rate_rpm / 60.0 * np.arange(seconds)
    turning = np.stack([26_000.0 * np.cos(phase), 26_000.0 * np.sin(phase), np.full(seconds, 28_000.0)], axis=1)
    noise = np.random.default_rng(1).normal(size=(seconds, 3)) * noise_nt
    return turning + np.array([4000.0, -2000.0, 1000.0]) + noise


def axes_of(fields: np.ndarray) -> AxesWatch:
    watch = AxesWatch()
    for second, (x, y, z) in enumerate(fields.tolist()):
        watch.push(float(second), (x, y, z))
    return watch


@pytest.mark.parametrize("rate_rpm", [0.0, 1.0, 7.5, 65.0])
@pytest.mark.parametrize("change", [1, 8, 17, 47])
def test_axes_swapped_or_flipped_in_flight_are_named_with_the_time(rate_rpm: float, change: int) -> None:
    fields = spinning(rate_rpm)
    fields[AT:] = fields[AT:] @ SIGNED_AXES[change].T
    watch = axes_of(fields)
    assert (watch.changes, watch.since_s) == ([change], float(AT))


@pytest.mark.parametrize(
    "spoil",
    [
        lambda fields: None,
        lambda fields: fields.__setitem__(AT, fields[AT] @ SIGNED_AXES[17].T),
        lambda fields: fields.__setitem__(slice(AT, None), fields[AT:] + np.array([9000.0, -12_000.0, 7000.0])),
        lambda fields: fields.__setitem__(slice(50, None, 9), -fields[50::9]),
    ],
    ids=["sound", "one outlier", "a step of the bias", "one in nine flipped"],
)
def test_what_is_no_change_of_axes_is_not_named_as_one(spoil: Callable[[np.ndarray], None]) -> None:
    fields = spinning(7.5)
    spoil(fields)
    assert axes_of(fields).changes == []


def turned_by_hand(per_burst: int) -> np.ndarray:
    """Measured vectors (n, 3) [nT] of a board turned unevenly: rows of 0.08 s, 0.4 s between bursts."""
    rng, step_s = np.random.default_rng(7), 0.08
    rows = np.arange(900) + 4 * (np.arange(900) // per_burst)
    phases = rng.uniform(0.0, math.tau, (3, 4))
    rates = rng.uniform(1.0, 4.0, (3, 4))
    fields, out = np.array([20_000.0, -15_000.0, 42_000.0]), []
    for at in range(int(rows[-1]) + 1):
        turn = np.sin(rates * at * step_s + phases).sum(axis=1) * step_s
        fields = np.linalg.norm(fields) * (moved := fields - np.cross(turn, fields)) / np.linalg.norm(moved)
        out.append(fields)
    return np.array(out)[rows] + rng.normal(size=(900, 3)) * 300.0


def test_rows_in_bursts_are_no_change_of_axes_and_even_rows_still_show_one() -> None:
    """Stamped evenly as they are, by the rate that all rows have in the mean."""
    assert axes_of(turned_by_hand(per_burst=5)).changes == []
    fields = turned_by_hand(per_burst=10**6)
    fields[AT:] = fields[AT:] @ SIGNED_AXES[17].T
    watch = axes_of(fields)
    assert 17 in watch.changes
    assert watch.since_s == float(AT)


def test_axes_that_change_back_are_as_they_were() -> None:
    fields = spinning(7.5)
    fields[200:AT] = fields[200:AT] @ SIGNED_AXES[17].T
    assert axes_of(fields[:AT]).changes == [17]
    assert axes_of(fields).changes == []


def test_changes_are_said_by_their_axes() -> None:
    swap = next(i for i in range(48) if np.array_equal(SIGNED_AXES[i], [[0, 1, 0], [1, 0, 0], [0, 0, 1]]))
    assert described(swap) == "x and y were swapped"
    assert described(1) == "z was flipped"


@pytest.mark.parametrize(
    ("stated_rpm", "axis", "says"),
    [
        (7.5, (0.0, 0.0, 1.0), ""),
        (-7.5, (0.0, 0.0, 1.0), "other sense"),
        (7.5, (1.0, 0.0, 0.0), "about (-0.00, -0.00, 1.00), which is 90 degrees aside"),
        (6.0, (0.0, 0.0, 1.0), "at 7.5"),
        (1.5, (0.0, 0.0, 1.0), "at 0.83 rpm, or whole turns in 9 s faster; stated are 1.5 rpm"),
        (2.4, (0.0, 0.0, 1.0), "other sense than stated, or by more than half a turn in 6 s"),
        (7.2, (0.0, 0.0, 1.0), ""),
        (30.0, (0.0, 0.0, 1.0), ""),
    ],
    ids=[
        "right",
        "sign",
        "axis",
        "rate",
        "a turn and more in a step",
        "more than half",
        "a little off",
        "half a turn in a step",
    ],
)
def test_a_spin_that_is_not_as_stated_is_said(stated_rpm: float, axis: tuple[float, float, float], says: str) -> None:
    sense = SpinSense(SpinConfig(axis=axis, rate_rpm=stated_rpm))
    for second, (x, y, z) in enumerate(spinning(7.5, seconds=600).tolist()):
        sense.push(float(second), (x, y, z))
    assert says.replace("-0.00", "0.00") in sense.said.replace("-0.00", "0.00")
    assert bool(says) is bool(sense.said)


@pytest.mark.parametrize(("change", "says"), [(0, ""), (1, "z was flipped"), (7, "all three axes were flipped")])
def test_a_gyro_that_turns_otherwise_than_the_vector_is_named(change: int, says: str) -> None:
    """A craft that sways about three axes at once, so that each shows."""
    rng, field, sense = np.random.default_rng(2), np.array([20_000.0, -15_000.0, 28_000.0]), RateSense()
    for second in range(200):
        rate = 0.05 * np.array([math.sin(second / 7.0), math.cos(second / 11.0), math.sin(second / 5.0)])
        measured = SIGNED_AXES[change] @ rate
        sense.push(float(second), field + rng.normal(size=3) * 50.0, measured)
        for part in range(50):
            at = second + (part + 0.5) / 50.0
            turn = 0.05 * np.array([math.sin(at / 7.0), math.cos(at / 11.0), math.sin(at / 5.0)])
            field = field - np.cross(turn, field) / 50.0
    assert says in sense.said
    assert bool(says) is bool(sense.said)


def course(magnitude_nt: Callable[[int], float], seconds: int) -> ReferenceSense:
    sense = ReferenceSense()
    for second in range(seconds):
        sense.push(float(second), magnitude_nt(second))
    return sense


def orbit(second: float) -> float:
    return 40_000.0 + 12_000.0 * math.sin(second / 890.0)


def test_three_glitches_do_not_make_a_constant_reference_vary() -> None:
    sense = course(lambda second: 50_000.0 if second in (100, 500, 900) else 40_000.0, 1200)
    assert (sense.mean_nt, sense.spread_nt) == (40_000.0, 0.0)


def test_a_spread_is_forgotten_after_an_orbit() -> None:
    assert course(orbit, 1000).spread_nt > 1000.0
    assert course(lambda second: orbit(min(second, 1000)), 9000).spread_nt == 0.0


@pytest.mark.parametrize("digits", [6, 0, -1])
def test_a_reference_that_goes_on_is_not_held_however_coarse(digits: int) -> None:
    sense = ReferenceSense()
    for second in range(6000):
        sense.push(float(second), round(orbit(second), digits))
        assert (sense.held_s, sense.step_nt) == (0.0, 0.0)


def test_a_reference_that_stops_or_goes_in_steps_is_held() -> None:
    assert course(lambda second: orbit(min(second, 400)), 460).held_s == 59.0
    assert course(lambda second: orbit(second // 30 * 30), 900).step_nt == pytest.approx(300.0, abs=110.0)


@pytest.mark.parametrize(("times", "held"), [(1, False), (2, True), (3, True)])
def test_held_readings_are_learnt_without_a_stated_noise(times: int, held: bool) -> None:
    watch = HeldWatch()
    for x, y, z in np.repeat(np.round(spinning(7.5)), times, axis=0).tolist():
        watch.push((x, y, z))
    assert watch.is_held is held
    assert watch.factor == pytest.approx(float(times), rel=0.01)


def test_a_coarse_sensor_at_rest_holds_no_readings() -> None:
    watch = HeldWatch()
    for x, y, z in (np.round(spinning(0.0, 1500, 20.0) / 100.0) * 100.0).tolist():
        watch.push((x, y, z))
    assert not watch.is_held
