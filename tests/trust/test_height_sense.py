"""Positions that fall otherwise than an orbit at their height does are said; those of any orbit and slow ones not."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from magcal_service.earth.free_fall import MU_KM3_S2
from magcal_service.earth.geomagnetic import EARTH_KM
from magcal_service.trust.height_sense import HeightSense

EPOCH_S = 1.75e9
EARTH_RAD_S = 7.292115e-5


def orbit(perigee_km: float, eccentricity: float, seconds: int, mean_rad: float = 0.0) -> np.ndarray:
    """Places (n, 3) [km] once a second, by Kepler's equation; ``mean_rad`` is the first mean anomaly."""
    axis = perigee_km / (1.0 - eccentricity)
    mean = mean_rad + math.sqrt(MU_KM3_S2 / axis**3) * np.arange(seconds)
    anomaly = mean + eccentricity * np.sin(mean)
    for _ in range(60):
        anomaly -= (anomaly - eccentricity * np.sin(anomaly) - mean) / (1.0 - eccentricity * np.cos(anomaly))
    x = axis * (np.cos(anomaly) - eccentricity)
    y = axis * math.sqrt(1.0 - eccentricity**2) * np.sin(anomaly)
    return np.stack([x, 0.5 * y, math.sqrt(0.75) * y], axis=1)


def higher(places: np.ndarray, km: float | np.ndarray) -> np.ndarray:
    return np.asarray(places * (1.0 + km / np.linalg.norm(places, axis=1))[:, None])


def in_miles(places: np.ndarray) -> np.ndarray:
    return higher(places, 0.609344 * (np.linalg.norm(places, axis=1) - EARTH_KM))


def told(places: np.ndarray, every_s: int = 1, sense: HeightSense | None = None, since_s: float = 0.0) -> list[str]:
    """What is said after each position."""
    sense, said = HeightSense() if sense is None else sense, []
    for second in range(0, len(places), every_s):
        time_s = EPOCH_S + since_s + second
        if sense.wants(time_s):
            x, y, z = places[second].tolist()
            sense.push(time_s, (x, y, z))
        said.append(sense.said)
    return said


ORBITS = {
    "circle": orbit(6878.0, 0.0, 6000),
    "low": orbit(6560.0, 0.001, 6000),
    "e = 0.3": orbit(6700.0, 0.3, 8000),
    "transfer": orbit(6560.0, 0.73, 40_000, -0.3),
    "Molniya": orbit(6900.0, 0.74, 40_000, -0.3),
}


@pytest.mark.parametrize("every_s", [1, 7, 10, 60, 290])
@pytest.mark.parametrize("name", list(ORBITS))
def test_an_orbit_falls_as_it_should(name: str, every_s: int) -> None:
    assert set(told(ORBITS[name], every_s)) == {""}


@pytest.mark.parametrize("name", list(ORBITS))
def test_rounded_and_noisy_positions_and_those_a_little_off_are_left_alone(name: str) -> None:
    places = ORBITS[name]
    noise_km = np.random.default_rng(4).normal(size=places.shape)
    for spoiled in (np.round(places), places + noise_km, higher(places, 30.0)):
        assert set(told(spoiled, 5)) == {""}


@pytest.mark.parametrize("every_s", [1, 7, 10])
@pytest.mark.parametrize("name", list(ORBITS))
def test_heights_in_miles_are_said_wherever_on_the_orbit_it_moves_fast(name: str, every_s: int) -> None:
    assert told(in_miles(ORBITS[name]), every_s)[-1].startswith("positions fall")


def test_it_is_said_before_a_craft_can_be_trusted_and_by_how_much_the_fall_is_off() -> None:
    said = told(higher(ORBITS["circle"], 300.0), 10)
    first = next(row for row, words in enumerate(said) if words)
    assert 10 * first <= 390
    assert said[first] == "positions fall 1.14 times as fast as an orbit at their height does"
    assert "fall 0.936 times" in told(higher(ORBITS["circle"], -150.0), 10)[-1]


def test_what_moves_slowly_says_nothing() -> None:
    """A place on the ground turns with the Earth, an aircraft by 300 m/s more; so do synchronous orbits."""
    angle = np.arange(6000.0)
    for rate_rad_s, radius_km in ((EARTH_RAD_S, 6371.0), (EARTH_RAD_S + 4.7e-5, 6382.0), (EARTH_RAD_S, 42_164.0)):
        turned = rate_rad_s * angle
        places = radius_km * np.stack([np.cos(turned), np.sin(turned), np.zeros(6000)], axis=1)
        assert set(told(places)) == {""}


def test_it_is_over_once_the_height_is_right() -> None:
    sense, places = HeightSense(), ORBITS["circle"]
    assert told(in_miles(places)[:1000], sense=sense)[-1]
    after = told(places[1000:], sense=sense, since_s=1000.0)
    assert after[0]
    assert not after[400]
    assert set(after[400:]) == {""}


def test_false_positions_clock_steps_and_pauses_do_not_make_a_wrong_height() -> None:
    places = ORBITS["circle"].copy()
    places[400] *= 1.5
    places[2000] = 0.0, 0.0, 7000.0
    sense = HeightSense()
    assert set(told(places[:3000], sense=sense)) == {""}
    assert set(told(places[3500:], sense=sense, since_s=9000.0)) == {""}
    assert set(told(places[:3000], sense=sense, since_s=-100_000.0)) == {""}


def test_a_memory_that_is_restored_goes_on() -> None:
    whole, first, second = HeightSense(), HeightSense(), HeightSense()
    wrong = in_miles(ORBITS["circle"])
    told(wrong[:900], sense=whole)
    told(wrong[:300], sense=first)
    second.restore_state(first.export_state())
    told(wrong[300:900], sense=second, since_s=300.0)
    assert whole.said
    assert second.export_state() == whole.export_state()


RADIUS_KM = st.sampled_from([6300.0, 6378.2, 6878.0, 42_164.0, 60_000.0])
STEP_S = st.sampled_from([1e-9, 1.0, 14.9, 15.0, 120.0, 400.0, 401.0, 1e9, -1.0, -401.0, -9e9])
ANGLE = st.floats(0.0, math.tau)


@given(st.lists(st.tuples(STEP_S, RADIUS_KM, ANGLE, ANGLE), max_size=60), st.floats(-9.2e9, 9.2e9))
def test_positions_and_times_at_any_edge_are_taken(steps: list[tuple[float, float, float, float]], at_s: float) -> None:
    """Places on which the model has a field, at times within the wire's; what is kept can be restored."""
    sense = HeightSense()
    for step_s, radius, across, up in steps:
        at_s += step_s
        place = (
            radius * math.cos(across) * math.cos(up),
            radius * math.sin(across) * math.cos(up),
            radius * math.sin(up),
        )
        if sense.wants(at_s):
            sense.push(at_s, place)
    again = HeightSense()
    again.restore_state(sense.export_state())
    assert again.export_state() == sense.export_state()
    assert all(math.isfinite(fall) for fall in sense._falls)
