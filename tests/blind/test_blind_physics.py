"""The surroundings and the craft of the concealed cases against closed forms and known values."""

from __future__ import annotations

import math
from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest

from magcal_service.earth import geomagnetic
from tests.blind.attitude import Motion, RateProfile
from tests.blind.field import ring_current_field, times_ns
from tests.blind.orbit import EQUATOR_KM, Orbit, draw_orbit, solve_kepler
from tests.blind.power import battery_current, loop_field_nt_a
from tests.blind.streams import Streams
from tests.blind.sun import EARTH_RADIUS_KM, sun_direction, sunlit
from tests.blind.thermal import STEFAN_BOLTZMANN, STEP_S, Craft, heat_balance
from tests.blind.torquer import Firing, dipole_field_nt
from tests.blind.vectors import Floats, dot, frame_with_z_along, unit
from tests.blind.world import World, draw_world


@pytest.fixture(scope="module")
def world() -> World:
    """Some craft."""
    return draw_world(Streams(5, "physics"))


def test_kepler_equation_holds() -> None:
    """The eccentric anomaly satisfies Kepler's equation to rounding."""
    mean = np.linspace(-10.0, 10.0, 101)
    anomaly = solve_kepler(mean, 0.03)
    assert np.abs(anomaly - 0.03 * np.sin(anomaly) - mean).max() < 1e-13


def test_sun_synchronous_node_follows_the_sun() -> None:
    """At 700 km and 98.19 deg the node turns by 0.9856 deg a day, which makes such orbits Sun-synchronous."""
    orbit = Orbit(EQUATOR_KM + 700.0, 0.0, math.radians(98.19), 0.0, 0.0, 0.0)
    assert math.degrees(orbit.drifts_rad_s[0] * 86400.0) == pytest.approx(0.9856, abs=0.003)


def test_orbit_keeps_its_altitudes() -> None:
    """Every orbit stays between 400 and 800 km above the equator's radius."""
    for seed in range(20):
        orbit = draw_orbit(Streams(seed, "orbits").rng("orbit"))
        radius = np.linalg.norm(orbit.position_km(np.arange(0.0, 6000.0, 20.0)), axis=1)
        assert radius.min() - EQUATOR_KM > 399.9
        assert radius.max() - EQUATOR_KM < 800.1


def test_speed_obeys_vis_viva() -> None:
    """v^2 = mu (2 / r - 1 / a) to the size of the oblateness, one part in a thousand."""
    orbit = Orbit(6950.0, 0.02, 1.2, 0.3, 0.4, 0.5)
    times = np.arange(0.0, 6000.0, 100.0)
    radius = np.linalg.norm(orbit.position_km(times), axis=1)
    speed = np.linalg.norm(orbit.velocity_km_s(times), axis=1)
    assert speed == pytest.approx(np.sqrt(398600.4418 * (2.0 / radius - 1.0 / 6950.0)), rel=1.5e-3)


def test_sun_at_solstice_and_equinox() -> None:
    """Declination 23.44 deg at the solstice of 2024-06-20 20:51 UTC and 0 at the equinox of 2024-03-20 03:06 UTC."""
    for moment, declination in ((datetime(2024, 6, 20, 20, 51), 23.436), (datetime(2024, 3, 20, 3, 6), 0.0)):
        direction = sun_direction(np.array([moment.replace(tzinfo=UTC).timestamp()]))[0]
        assert math.degrees(math.asin(direction[2])) == pytest.approx(declination, abs=0.02)


def test_eclipse_share_of_a_circular_orbit_in_the_suns_plane() -> None:
    """With the Sun in the orbit's plane the shadow takes asin(R / r) / pi of a circular orbit."""
    angle = np.linspace(0.0, 2.0 * np.pi, 20001)
    for altitude in (400.0, 800.0):
        radius = EARTH_RADIUS_KM + altitude
        place = radius * np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=-1)
        lit = sunlit(place, np.broadcast_to([1.0, 0.0, 0.0], place.shape))
        assert (lit[0], lit[10000]) == (1.0, 0.0)  # towards the Sun, and behind the Earth
        assert 1.0 - lit.mean() == pytest.approx(math.asin(EARTH_RADIUS_KM / radius) / math.pi, abs=1e-3)


def test_penumbra_lasts_some_seconds() -> None:
    """Between full light and full shadow the Sun's disc fades over 8 to 10 seconds of a low orbit."""
    times = np.arange(0.0, 5668.0, 0.05)
    angle = 2.0 * np.pi * times / 5668.0
    place = 6871.0 * np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=-1)
    lit = sunlit(place, np.broadcast_to([1.0, 0.0, 0.0], place.shape))
    fading = 0.05 * np.count_nonzero((lit > 0.0) & (lit < 1.0)) / 2.0
    assert 8.0 < fading < 10.0
    assert np.abs(np.diff(lit)).max() < 0.02


def _euler_step(state: Floats, inertia: Floats, step: float) -> Floats:
    """One Runge-Kutta step of rate (3) and attitude rows (9): I dw/dt = -w x I w, dA/dt = -[w x] A."""

    def slope(y: Floats) -> Floats:
        rate, attitude = y[:3], y[3:].reshape(3, 3)
        turning = -np.cross(rate, inertia @ rate)
        return np.concatenate([np.linalg.solve(inertia, turning), -np.cross(rate, attitude, axisb=0, axisc=0).ravel()])

    a = slope(state)
    b = slope(state + 0.5 * step * a)
    c = slope(state + 0.5 * step * b)
    return np.asarray(state + step / 6.0 * (a + 2.0 * b + 2.0 * c + slope(state + step * c)))


@pytest.fixture(scope="module")
def coning() -> tuple[Motion, Floats]:
    """A disc-like body that cones by 8 deg about a momentum, its axis askew in the body, and its inertia tensor."""
    axis = unit(np.array([0.3, -0.5, 0.8]))
    rate = RateProfile(0.4, 0.4)
    motion = Motion(axis, unit(np.array([1.0, 2.0, -0.5])), rate, 0.7, math.radians(8.0), 1.6)
    frame = frame_with_z_along(axis)
    return motion, np.asarray(frame.T @ np.diag([1.0, 1.0, 1.6]) @ frame)


def test_coning_solves_eulers_equations(coning: tuple[Motion, Floats]) -> None:
    """Attitude and rate in closed form equal Euler's equations integrated in steps of 10 ms over a minute."""
    motion, inertia = coning
    times = np.array([0.0, 60.0])
    first, last = motion.body_from_eci(times)
    state = np.concatenate([motion.body_rate(times)[0], first.ravel()])
    for _ in range(6000):
        state = _euler_step(state, inertia, 0.01)
    assert state[:3] == pytest.approx(motion.body_rate(times)[1], abs=1e-8)
    assert state[3:].reshape(3, 3) == pytest.approx(last, abs=1e-7)


def test_coning_keeps_energy_and_momentum(coning: tuple[Motion, Floats]) -> None:
    """Without torque the energy and the momentum in space stand still, the momentum where it was said to be."""
    motion, inertia = coning
    times = np.linspace(0.0, 20000.0, 500)
    rate = motion.body_rate(times)
    momentum = rate @ inertia
    in_space = np.einsum("nji,nj->ni", motion.body_from_eci(times), momentum)
    assert np.ptp(dot(rate, momentum)) < 1e-12
    assert np.ptp(in_space, axis=0).max() < 1e-10
    assert unit(in_space[0]) == pytest.approx(motion.momentum_eci, abs=1e-10)


def test_spin_without_cone_is_the_limit_of_one(world: World) -> None:
    """A cone of 1e-9 rad gives the attitude of the pure spin."""
    times = np.linspace(0.0, 500.0, 50)
    pure = replace(world.motion, phase_rad=0.4)
    assert replace(pure, cone_rad=1e-9).body_from_eci(times) == pytest.approx(pure.body_from_eci(times), abs=1e-8)


def test_rate_is_the_slope_of_the_angle() -> None:
    """Despin by a constant and by an eddy-current torque: the angle's derivative is the rate."""
    profile = RateProfile(1.0, 0.2, 3000.0, 1e-5)
    times = np.linspace(0.0, 9000.0, 50)
    slope = (profile.angle(times + 0.5) - profile.angle(times - 0.5)) / 1.0
    assert slope == pytest.approx(profile.rate(times), abs=1e-8)


def _craft(**changed: float) -> Craft:
    plain = Craft(np.full(6, 0.03), 0.7, 0.8, 2000.0, 60.0, 0.1, 8.0, 0.0)
    return replace(plain, **changed)  # type: ignore[arg-type]


def test_heat_balance_reaches_its_steady_state() -> None:
    """In constant sunlight the structure settles where it radiates what it takes in, (Q / e s A)^(1/4)."""
    craft = _craft()
    settled = heat_balance(craft, np.full(6000, 40.0), 5.0, 250.0)[-1]
    expected = (53.0 / (0.8 * STEFAN_BOLTZMANN * 0.18)) ** 0.25
    assert settled == pytest.approx([expected, expected], abs=1e-6)


def test_warm_sensor_sits_above_the_structure_by_power_over_conductance() -> None:
    """With its own 0.3 W behind 0.1 W/K the magnetometer settles 3 K above the structure."""
    settled = heat_balance(_craft(sensor_power_w=0.3), np.full(6000, 40.0), 5.0, 250.0)[-1]
    assert settled[1] - settled[0] == pytest.approx(3.0, abs=1e-6)


def test_heat_that_passes_between_the_two_is_not_lost() -> None:
    """Where nothing radiates, what the magnetometer's 0.5 W put in is in the two heat capacities."""
    craft = _craft(emissivity=1e-15, power_w=0.0, sensor_power_w=0.5)
    course = heat_balance(craft, np.zeros(201), 0.0, 280.0) - 280.0
    stored = course @ [craft.capacity_j_k, craft.sensor_capacity_j_k]
    assert stored == pytest.approx(0.5 * STEP_S * np.arange(201), abs=1e-6)


def test_sensor_follows_with_its_time_constant() -> None:
    """Behind a structure that barely moves, the magnetometer's gap closes by e in C2 / G."""
    craft = _craft(capacity_j_k=1e9)
    course = heat_balance(craft, np.zeros(61), 0.0, 280.0)
    warm = heat_balance(replace(craft, sensor_power_w=1.0), np.zeros(61), 0.0, 280.0)
    gap = 10.0 - (warm[:, 1] - course[:, 1])
    assert gap[round(craft.sensor_tau_s / STEP_S)] == pytest.approx(10.0 / math.e, rel=1e-3)


def test_loop_of_many_corners_has_the_field_of_a_ring() -> None:
    """A 200-cornered loop of 2 cm radius gives mu0 R^2 / 2 (R^2 + z^2)^(3/2) on its axis, 10 cm away."""
    angle = 2.0 * np.pi * np.arange(200) / 200
    corners = np.stack([0.02 * np.cos(angle), 0.02 * np.sin(angle), np.full(200, -0.1)], axis=-1)
    ring = 2e2 * math.pi * 0.02**2 / (0.02**2 + 0.1**2) ** 1.5
    assert loop_field_nt_a(corners) == pytest.approx([0.0, 0.0, ring], rel=1e-3, abs=1e-9)


def test_small_loop_far_away_is_a_dipole() -> None:
    """A loop of 1 cm2 half a metre away has the field of its magnetic moment."""
    corners = np.array([[1, 1, 0], [-1, 1, 0], [-1, -1, 0], [1, -1, 0]]) * 0.005 + np.array([0.3, 0.2, 0.35])
    assert loop_field_nt_a(corners) == pytest.approx(dipole_field_nt(np.array([0.3, 0.2, 0.35]))[:, 2] * 1e-4, rel=2e-3)


def test_full_battery_takes_no_more() -> None:
    """A battery at 100 % takes no current, and gives what the loads need in the dark."""
    time_s = np.arange(10.0)
    craft = replace(draw_world(Streams(1, "battery")), time_s=time_s)
    array = np.where(time_s < 5, 2.0, 0.0)
    current = battery_current(craft, array, np.full(10, 0.5), 2.0, 1.0)
    assert current == pytest.approx(np.where(time_s < 5, 0.0, -0.5), abs=1e-2)


def test_torquer_knows_its_last_command() -> None:
    """Between switching instants the command holds, and the sign of the last one is remembered after it."""
    firing = Firing(np.array([-1.0, 2.0, 3.0]), np.array([[0.0, 0, 0], [0.1, -0.1, 0], [0.0, 0, 0]]))
    command, before, since = firing.at(np.array([1.0, 2.5, 3.5]))
    assert command[:, 0].tolist() == [0.0, 0.1, 0.0]
    assert before[2].tolist() == [0.1, -0.1, 0.0]
    assert since.tolist() == [2.0, 0.5, 0.5]
    assert firing.remembered(np.array([1.0, 2.5, 3.5])).tolist() == [[0, 0, 0], [1, -1, 0], [1, -1, 0]]


def test_field_track_against_igrf(world: World) -> None:
    """Between its knots the field along the orbit is IGRF-14's to 0.1 nT."""
    times = world.streams.rng("anywhere").uniform(*world.span_s, 300)
    exact = geomagnetic.igrf_eci_nt(times_ns(world.start_unix_s, times), world.orbit.position_km(times))
    assert np.abs(world.field_eci(times) - exact).max() < 0.1


def test_ring_current_on_the_ground() -> None:
    """Along the axis the equator's ground has Dst, the pole's less, and far away the outer part alone is left."""
    axis = np.array([[0.0, 0.0, 1.0]])
    field = ring_current_field(np.array([-100.0]), axis, np.array([[6371.2, 0.0, 0.0]]))
    assert field[0] == pytest.approx([0.0, 0.0, -100.0], abs=1e-9)
    pole = ring_current_field(np.array([-100.0]), axis, np.array([[0.0, 0.0, 6371.2]]))
    assert pole[0] == pytest.approx([0.0, 0.0, -100.0 * (1.0 - 2.0 * 0.27) / 1.27], abs=1e-9)
    far = ring_current_field(np.array([-100.0]), axis, np.array([[60000.0, 0.0, 0.0]]))
    assert far[0, 2] == pytest.approx(-100.0 / 1.27, rel=1e-2)
