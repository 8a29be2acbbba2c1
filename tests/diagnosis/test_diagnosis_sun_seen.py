"""Where telemetry shows the Sun: found by a shadow that is elsewhere, and left alone where it may be something else."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from magcal_service.diagnosis.problem import Problem
from magcal_service.diagnosis.screen import hypotheses_of
from magcal_service.diagnosis.sun_seen import SunSeen, sun_seen
from magcal_service.earth import geomagnetic
from magcal_service.model import Array
from magcal_service.physics.apply.forward import bind
from magcal_service.physics.apply.model_file import ModelTerm
from magcal_service.physics.catalogue import effect_named
from magcal_service.physics.scene.scene import SUN_AHEAD, Scene, Telemetry
from tests.physics.scenes import ORIGIN_NS, orbit_eci_km

TIME_S = 10.0 * np.arange(1700)
AHEAD_DEG = 120.0
EARTH_KM, OBLIQUITY = 6378.137, np.radians(23.44)
ORBIT_S = 2.0 * np.pi / 1.1068e-3


def light(ahead_deg: float) -> Array:
    """(n,) 1 in light and 0 in the shadow of a round Earth, with the Sun so far ahead of the equinox, where it is."""
    angle = np.radians(ahead_deg)
    sun = np.array([np.cos(angle), np.sin(angle) * np.cos(OBLIQUITY), np.sin(angle) * np.sin(OBLIQUITY)])
    place = orbit_eci_km(TIME_S)
    along = place @ sun
    across = np.linalg.norm(place - along[:, None] * sun, axis=1)
    return np.asarray(1.0 - ((along < 0.0) & (across < EARTH_KM)))


def lagging(drive: Array, tau_s: float) -> Array:
    """What follows a drive (n,), step by step."""
    found = np.empty(len(drive))
    value = drive.mean()
    for row, now in enumerate(drive):
        value += (now - value) * 10.0 / tau_s
        found[row] = value
    return found


def scene(**channels: Array) -> Scene:
    """A craft that turns, with channels (n,) of these names; those named ``temperature`` are one."""
    rng = np.random.default_rng(5)
    turn = np.stack([np.sin(TIME_S / 31.0), np.cos(TIME_S / 31.0), np.sin(TIME_S / 77.0)], axis=1)
    field = 40_000.0 * turn / np.linalg.norm(turn, axis=1)[:, None]
    time_ns = ORIGIN_NS + np.rint(TIME_S * 1e9).astype(np.int64)
    telemetry = {}
    for name, values in channels.items():
        quantity = "temperature" if name == "temperature" else "current"
        telemetry[name] = Telemetry(name, quantity, (values + rng.normal(0.0, 0.02, len(values)))[:, None])
    return Scene(
        time_s=TIME_S,
        origin_ns=ORIGIN_NS,
        utc=True,
        field_nt=field,
        calibrated_nt=field,
        clean_field_nt=field,
        magnitude_nt=np.linalg.norm(field, axis=1),
        position_ecef_km=geomagnetic.ecef_from_eci(time_ns, orbit_eci_km(TIME_S)),
        channels=telemetry,
    )


def noise(of: Scene) -> Array:
    """(n,) residual [nT] of the magnetometer alone."""
    return np.random.default_rng(11).normal(0.0, 20.0, len(of))


def following(of: Scene, ahead_deg: float) -> Array:
    """(n,) residual [nT] of a field along x by what is not recorded: heat beside a current, a current beside heat."""
    lit = light(ahead_deg)
    return np.asarray(50.0 * of.unit[:, 0] * (lagging(lit, 600.0) if "current" in of.channels else lit) + noise(of))


def seen_by(of: Scene, ahead_deg: float = AHEAD_DEG) -> SunSeen | None:
    """The Sun that a scene shows whose residual follows the light of one so far ahead."""
    return sun_seen(of, following(of, ahead_deg))


@pytest.mark.parametrize("name", ["current", "temperature"])
def test_a_channel_in_another_suns_light_tells_where_it_is(name: str) -> None:
    course = light(AHEAD_DEG) if name == "current" else 20.0 * lagging(light(AHEAD_DEG), 900.0)
    seen = seen_by(scene(**{name: course}))
    assert seen is not None
    assert seen.channel == name
    assert seen.ahead_deg == pytest.approx(AHEAD_DEG, abs=2.0)
    assert re.match(rf"12\d deg ahead of where the stated time has it, by the .* in channel {name}", str(seen))


def test_a_current_is_believed_before_a_temperature() -> None:
    """What lags could be late for other reasons."""
    both = scene(temperature=20.0 * lagging(light(75.0), 900.0), current=light(AHEAD_DEG))
    seen = seen_by(both)
    assert seen is not None
    assert seen.channel == "current"


ELSEWHERE = {
    "light at its date": {"current": light(0.0)},
    "heat at its date": {"temperature": 20.0 * lagging(light(0.0), 900.0)},
    "heat that comes a long way": {"temperature": 20.0 * np.roll(lagging(light(0.0), 900.0), 60)},
    "one angle to the Sun": {"current": np.maximum(np.cos(2.0 * np.pi * TIME_S / ORBIT_S + 1.0), 0.0)},
    "a wave an orbit": {"temperature": 9.0 * np.sin(2.0 * np.pi * TIME_S / ORBIT_S)},
    "a trend": {"temperature": 0.001 * TIME_S},
    "noise": {"current": 0.0 * TIME_S},
    "one that bears the date out": {"temperature": 20.0 * lagging(light(0.0), 900.0), "current": light(AHEAD_DEG)},
    "a duty of minutes": {"current": np.asarray(np.sin(TIME_S / 60.0) > 0.3, dtype=np.float64)},
}


@pytest.mark.parametrize("case", ELSEWHERE)
def test_what_may_be_something_else_moves_no_sun(case: str) -> None:
    assert seen_by(scene(**ELSEWHERE[case])) is None


def test_the_residual_keeps_the_sun_where_light_explains_it_at_the_date() -> None:
    """A payload that is on for two thirds of each orbit looks like the light of another Sun."""
    payload = scene(current=light(AHEAD_DEG))
    assert seen_by(payload, 0.0) is None
    assert seen_by(payload, AHEAD_DEG) is not None


OTHERWISE: dict[str, Callable[[Scene], Array]] = {
    "noise alone": noise,
    "a step": lambda of: noise(of) + 50.0 * of.unit[:, 1] * (TIME_S > 7000.0),
    "a drift": lambda of: noise(of) + 0.01 * of.unit[:, 2] * TIME_S,
    "the channel itself": lambda of: noise(of) + 40.0 * of.unit[:, 0] * of.channels["current"].values[:, 0],
}


@pytest.mark.parametrize("residual", OTHERWISE)
def test_a_residual_that_follows_no_light_moves_no_sun(residual: str) -> None:
    """It goes a little better with one Sun than with another by chance, and a recorded driver needs no Sun."""
    payload = scene(current=light(AHEAD_DEG))
    assert sun_seen(payload, OTHERWISE[residual](payload)) is None


def test_a_disturbance_by_the_suns_direction_shows_the_sun_too() -> None:
    """Of its field nothing follows light alone: the Sun's direction turns in the body."""
    angle = TIME_S / 31.0
    turn = np.stack([np.cos(angle), np.sin(angle), -np.sin(angle), np.cos(angle)], axis=1).reshape(-1, 2, 2)
    body = np.tile(np.eye(3), (len(TIME_S), 1, 1))
    body[:, :2, :2] = turn
    of = replace(scene(current=light(AHEAD_DEG)), body_from_eci=body)
    moved = replace(of, sun_ahead_deg=AHEAD_DEG)
    assert moved.sun_body is not None
    residual = noise(of) + 50.0 * (moved.sun_body[:, 0] * of.unit[:, 1] * light(AHEAD_DEG))
    assert sun_seen(of, residual) is not None
    assert sun_seen(replace(of, body_from_eci=None), residual) is None


def test_without_utc_or_an_orbit_no_sun_is_seen() -> None:
    known = scene(current=light(AHEAD_DEG))
    assert seen_by(replace(known, utc=False)) is None
    assert seen_by(replace(known, in_orbit=False)) is None


def test_a_model_found_under_another_sun_acts_under_it() -> None:
    """Its terms carry the Sun, so that a scene of the same date has the same columns; recorded drivers carry none."""
    seen = SunSeen("current", AHEAD_DEG)
    plain = scene(temperature=20.0 * lagging(light(AHEAD_DEG), 900.0))
    moved = replace(plain, sun_ahead_deg=seen.ahead_deg)
    every = hypotheses_of([effect_named("current_loop"), effect_named("thermal_bias")], Problem(moved, 10.0))
    assert {h.driver: SUN_AHEAD in h.constants for h in every} == {
        "inferred:array_current": True,
        "inferred:temperature": True,
        "channel:temperature": False,
    }
    lit = next(h for h in every if h.driver == "inferred:array_current")
    size = {"nt_full_sun": np.array([10.0, 0.0, 0.0])}
    term = ModelTerm(lit.effect, lit.driver, lit.variant, size, size, {}, lit.constants)
    field, _ = bind(term, plain).disturbance()
    difference = field[:, 0] - 10.0 * light(AHEAD_DEG)
    assert np.mean(np.abs(difference) > 0.1) < 0.02  # the penumbra, a flattened Earth
    assert np.mean(np.abs(field[:, 0] - 10.0 * light(0.0)) > 5.0) > 0.3
