"""The Sun, its shadow and answers to it, against closed forms and a second implementation."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import Final

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import minimize_scalar

from magcal_service.earth.geomagnetic import geodetic_from_ecef
from magcal_service.model import Array
from magcal_service.physics.scene.sunlight import carried, first_order, hold_over_nan, sun_eci, sunlit
from sim_sensor.sunlight import lit_fraction, sun_direction_eci
from tests.blind import sun as blind
from tests.regimes import orbit as regimes


def test_against_the_simulators_sun() -> None:
    """Two low-precision theories of the Sun, Meeus's and the Almanac's, agree to 0.02 deg over twenty years."""
    utc_s = np.linspace(1_262_304_000.0, 1_893_456_000.0, 4001)
    other = sun_direction_eci(np.rint(utc_s * 1e9).astype(np.int64))
    apart = np.degrees(np.linalg.norm(sun_eci(utc_s) - other, axis=1))
    assert float(apart.max()) < 0.02


def test_sun_is_at_the_node_at_the_equinox() -> None:
    """On 2025-03-20T09:01 UTC the Sun crosses the equator northwards, along +x of date."""
    equinox = sun_eci(np.array([1_742_461_260.0]))[0]
    assert np.degrees(np.arccos(equinox[0])) < 0.03


LIGHT: Final[dict[str, Callable[[Array, float], Array]]] = {
    "sim_sensor": lambda place, utc_s: lit_fraction(np.full(len(place), round(utc_s) * 10**9), place),
    "blind": lambda place, utc_s: blind.sunlit(place, blind.sun_direction(np.full(len(place), utc_s))),
    "regimes": lambda place, utc_s: regimes.sunlight(place, regimes.sun_direction(utc_s)),
}
"""Share of light (n,) at places (n, 3) [km] at a time, as each of the simulators has it."""


@pytest.mark.parametrize("simulator", LIGHT)
def test_shadow_edges_against_the_simulators(simulator: str) -> None:
    """In every season, on low orbits of any plane, each edge is where the simulator has it, to a second and a half.

    Left out are orbits with the Sun 60 deg or more off their plane, which graze the shadow.
    """
    rng, time_s, edges = np.random.default_rng(12), np.arange(0.0, 5800.0, 0.5), 0
    for month in range(24):
        utc_s = 1_735_689_600.0 + month * 15.2 * 86400.0
        sun = sun_eci(np.array([utc_s]))
        first, second = np.linalg.qr(rng.normal(size=(3, 2)))[0].T
        if np.hypot(first @ sun[0], second @ sun[0]) < 0.5:
            continue
        angle = 2.0 * np.pi * time_s / 5800.0
        place = rng.uniform(6800.0, 7150.0) * (np.outer(np.cos(angle), first) + np.outer(np.sin(angle), second))
        ours, other = (
            np.flatnonzero(np.diff(light > 0.5)) for light in (sunlit(place, sun), LIGHT[simulator](place, utc_s))
        )
        assert len(ours) == len(other) == 2
        assert float(0.5 * np.abs(ours - other).max()) <= 1.5
        edges += len(ours)
    assert edges > 20


def test_shadow_of_a_craft_behind_the_earth() -> None:
    """Straight behind the Earth it is dark, before it and beside it light, and half at the limb."""
    sun = np.tile([1.0, 0.0, 0.0], (4, 1))
    place = np.array([[-7000.0, 0.0, 0.0], [7000.0, 0.0, 0.0], [-3000.0, 9000.0, 0.0], [-3000.0, 6378.137, 0.0]])
    assert sunlit(place, sun) == pytest.approx([0.0, 1.0, 1.0, 0.5], abs=1e-9)


def test_shadow_is_flat_at_the_poles() -> None:
    """Over a pole the limb is 21 km lower than at the equator."""
    sun = np.tile([1.0, 0.0, 0.0], (2, 1))
    limb = 6378.137 * (1.0 - 1.0 / 298.257)
    place = np.array([[-3000.0, 0.0, limb], [-3000.0, limb, 0.0]])
    assert sunlit(place, sun) == pytest.approx([0.5, 0.0], abs=1e-4)


@pytest.mark.parametrize("radius_km", [6800.0, 42164.0])
@pytest.mark.parametrize("month", [0, 3, 6])
def test_half_of_the_sun_is_seen_where_its_ray_touches_the_ellipsoid(radius_km: float, month: int) -> None:
    """Edges found by bisection on inclined orbits: the ray to the Sun's middle comes down to a height of 0 km.

    The height is the geodetic one of places along the ray, the least of them by scipy, to 20 m.
    """
    utc_s = 1_735_689_600.0 + month * 30.44 * 86400.0
    sun = sun_eci(np.array([utc_s]))
    rng = np.random.default_rng(month)
    found = 0
    for _ in range(12):
        first, second = np.linalg.qr(rng.normal(size=(3, 2)))[0].T

        def place(angle: float, first: Array = first, second: Array = second) -> Array:
            return np.asarray(radius_km * (np.cos(angle) * first + np.sin(angle) * second))

        def dark(angle: float) -> bool:
            return bool(sunlit(place(angle)[None], sun)[0] < 0.5)

        midnight = float(np.arctan2(-second @ sun[0], -first @ sun[0]))
        if not dark(midnight):
            continue
        for side in (-1.0, 1.0):
            inside, outside = midnight, midnight + side * 0.5 * np.pi
            for _ in range(50):
                middle = 0.5 * (inside + outside)
                inside, outside = (middle, outside) if dark(middle) else (inside, middle)
            edge = place(inside)

            def height_km(way_km: float, edge: Array = edge) -> float:
                return float(geodetic_from_ecef((edge + way_km * sun[0])[None])[2][0])

            least = minimize_scalar(height_km, bounds=(0.0, 2.0 * radius_km), method="bounded", options={"xatol": 1e-3})
            assert float(least.fun) == pytest.approx(0.0, abs=0.02)
            found += 1
    assert found >= 2


def uneven(seed: int, count: int) -> Array:
    """Rising times (n,) with steps from 0.2 to 30 s."""
    return np.cumsum(np.random.default_rng(seed).uniform(0.2, 30.0, count))


def test_first_order_answers_a_step_with_an_exponential() -> None:
    """After a step from 0 to 1 the answer is 1 - exp(-t / tau), whatever the samples' spacing."""
    time_s = uneven(1, 400)
    found = first_order(time_s, np.ones(400), 300.0, 0.0)
    assert found == pytest.approx(-np.expm1(-(time_s - time_s[0]) / 300.0), abs=1e-12)


def test_first_order_answers_a_ramp_late_by_its_time_constant() -> None:
    """A ramp gives t - tau (1 - exp(-t / tau)), exactly."""
    time_s = uneven(2, 300)
    elapsed = time_s - time_s[0]
    found = first_order(time_s, elapsed, 200.0)
    assert found == pytest.approx(elapsed + 200.0 * np.expm1(-elapsed / 200.0), rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("tau_s", [4.0, 90.0, 5000.0])
def test_first_order_against_an_integrator(tau_s: float) -> None:
    """A drive of two columns, linear between uneven samples, is answered as scipy's integrator answers it."""
    time_s = uneven(3, 60)
    drive = np.random.default_rng(4).normal(size=(60, 2))

    def slope(t: float, y: Array) -> Array:
        return (np.array([np.interp(t, time_s, column) for column in drive.T]) - y) / tau_s

    # restarted at each sample, where the drive has a corner
    expected = [np.array([0.5, -1.0])]
    for first, last in pairwise(time_s.tolist()):
        expected.append(solve_ivp(slope, (first, last), expected[-1], rtol=1e-8, atol=1e-10).y[:, -1])
    found = first_order(time_s, drive, tau_s, np.array([0.5, -1.0]))
    assert found == pytest.approx(np.array(expected), abs=1e-6)


def test_first_order_of_one_column_is_that_of_many() -> None:
    """The fast way for (n,) and the general one for (n, k) agree, and start at the drive's own value."""
    time_s = uneven(5, 200)
    drive = np.sin(time_s / 50.0)
    one, many = first_order(time_s, drive, 70.0), first_order(time_s, drive[:, None], 70.0)
    assert one == pytest.approx(many[:, 0], abs=1e-14)
    assert one[0] == drive[0]


@pytest.mark.parametrize("tau_s", [0.1, 1.0, 3.0, 200.0, 1e6])
def test_a_recursion_in_whole_columns_is_that_of_one_step_after_another(tau_s: float) -> None:
    """Uneven steps with two long gaps, three columns; among them steps that keep nothing and steps that keep all."""
    rng = np.random.default_rng(44)
    steps = rng.uniform(0.2, 1.8, 700)
    steps[[100, 500]] = 4000.0
    kept, pushed = np.exp(-steps / tau_s), rng.normal(size=(700, 3))
    kept[300:310], kept[600:620] = 0.0, 1.0
    value, expected = np.array([5.0, -3.0, 1.0]), []
    for share, more in zip(kept, pushed, strict=True):
        expected.append(share * (expected[-1] if expected else value) + more)
    assert carried(kept, pushed, value) == pytest.approx(np.array(expected), rel=1e-12, abs=1e-12)


def test_gaps_of_telemetry_are_bridged() -> None:
    """NaN becomes what lies between its neighbours, ends are held, a column without a number becomes 0."""
    nan = np.nan
    values = np.array([[nan, nan, 1.0], [2.0, nan, nan], [nan, nan, nan], [6.0, nan, 4.0], [nan, nan, 5.0]])
    expected = [[2.0, 0.0, 1.0], [2.0, 0.0, 2.0], [4.0, 0.0, 3.0], [6.0, 0.0, 4.0], [6.0, 0.0, 5.0]]
    assert hold_over_nan(values) == pytest.approx(np.array(expected))
