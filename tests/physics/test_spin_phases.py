"""Phases of a steady turn over pauses, and a nutation's numbers with their sigmas."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from magcal_service.model import Array
from magcal_service.physics.catalogue import effect_named
from magcal_service.physics.scene import spin_phase, steady_spin
from magcal_service.physics.scene.scene import Scene
from magcal_service.physics.scene.steady_spin import SpinSolution
from magcal_service.physics.scene.view import View

AXIS_BODY, AXIS_ECI = np.array([0.36, 0.48, 0.8]), np.array([-0.6, 0.64, 0.48])


def timed(time_s: Array, w: Array | None = None, reference: Array | None = None) -> Scene:
    field = np.ones((len(time_s), 3)) if w is None else w
    return Scene(time_s, 0, True, field, field, field, np.linalg.norm(field, axis=1), reference)


def phases(time_s: Array, phase: Array, rate: float) -> tuple[Array, Array]:
    raw, smooth = spin_phase.phases(timed(time_s), np.exp(1j * phase), np.ones(len(time_s)), rate)
    assert raw is not None
    assert smooth is not None
    return raw, smooth


def test_over_pauses_a_phase_goes_on_at_the_rate_before_them() -> None:
    """Three stretches, the second of five samples alone: no turn is lost, and none is made up."""
    time_s = np.concatenate([np.arange(100.0), 400.0 + np.arange(5.0), 900.0 + np.arange(100.0)])
    phase = 0.4 + 0.7 * time_s
    raw, smooth = phases(time_s, phase, 0.7)
    assert raw == pytest.approx(phase, abs=1e-6)
    assert smooth == pytest.approx(phase, abs=1e-4)


def test_a_stretch_carries_on_at_its_own_rate_rather_than_the_mean_one() -> None:
    """Turning at 0.703 instead of the 0.7 that was told: after a pause of 700 s that is a third of a turn."""
    time_s = np.concatenate([np.arange(200.0), 900.0 + np.arange(50.0)])
    phase = 0.703 * time_s
    raw, _ = phases(time_s, phase, 0.7)
    assert raw == pytest.approx(phase, abs=1e-6)
    assert math.pi / 2.0 < (0.703 - 0.7) * 700.0


def test_a_smoothed_phase_keeps_a_slow_change_of_rate_and_loses_the_noise() -> None:
    time_s = np.arange(3000.0)
    phase = 0.7 * time_s + 1e-6 * time_s**2
    noise = np.random.default_rng(1).normal(0.0, 0.05, 3000)
    smooth = spin_phase.smoothed(timed(time_s), phase + noise, np.ones(3000), 0.7)
    assert float(np.abs(smooth - phase).max()) < 0.03
    assert float(np.std(smooth - phase)) < 0.012


def test_a_smoothed_phase_listens_to_strong_samples_and_leaves_three_as_they_are() -> None:
    time_s = np.concatenate([np.arange(500.0), 1000.0 + np.arange(3.0)])
    phase = 0.7 * time_s
    spoiled = phase + np.where(np.arange(503) % 2, 0.5, 0.0)
    strength = np.where(np.arange(503) % 2, 1e-3, 1.0)
    smooth = spin_phase.smoothed(timed(time_s), spoiled, strength, 0.7)
    assert smooth[:500] == pytest.approx(phase[:500], abs=0.01)
    assert smooth[500:].tolist() == spoiled[500:].tolist()


def coned(angle_rad: float, cone_hz: float, noise_nt: float) -> View:
    """A craft whose axis cones, small, about the one that is fixed in the body, seen for 1000 samples every 2 s."""
    rng = np.random.default_rng(2)
    time_s = 2.0 * np.arange(1000.0)
    rate = 0.31
    reference = 30e3 * np.stack([np.sin(time_s / 90.0), np.cos(time_s / 210.0), 0.3 * np.ones(1000)], axis=1)
    attitude = steady_spin.attitude_of(AXIS_BODY, AXIS_ECI, rate * time_s)
    w = np.einsum("nij,nj->ni", attitude, reference)
    b1, b2 = steady_spin.across(AXIS_BODY)
    angle = 2.0 * math.pi * cone_hz * time_s
    momentum = np.cos(angle)[:, None] * b1 + np.sin(angle)[:, None] * b2
    tilt = np.cross(np.cross(AXIS_BODY, momentum), w)  # the turn of the body that brings its axis on the cone
    w = w - angle_rad * tilt + rng.normal(0.0, noise_nt, (1000, 3))
    misfit = w @ AXIS_BODY - reference @ AXIS_ECI
    across = np.linalg.norm(np.cross(reference, AXIS_ECI), axis=1)
    spin = SpinSolution(AXIS_BODY, AXIS_ECI, rate * time_s, rate * time_s, rate, attitude, misfit, across, 4e4)
    return View(timed(time_s, w, reference), np.zeros(1000), max(noise_nt, 1.0), spin)


def found(view: View) -> dict[str, tuple[float, float]] | None:
    find = effect_named("nutation").find
    assert find is not None
    finding = find(view)
    return None if finding is None else {n: (float(v.value), float(v.sigma)) for n, v in finding.parameters.items()}


@pytest.mark.parametrize("cone_hz", [0.0113, 0.0291])
def test_a_cone_is_measured_with_its_angle_and_rate(cone_hz: float) -> None:
    """Within three of the sigmas that are said, which are a few per cent."""
    values = found(coned(math.radians(0.5), cone_hz, 30.0))
    assert values is not None
    angle, sigma = values["angle_deg"]
    assert 0.002 < sigma < 0.1
    assert angle == pytest.approx(0.5, abs=3.0 * sigma + 0.01)
    assert values["frequency_hz"][0] == pytest.approx(cone_hz, abs=2e-5)
    assert values["rate_rad_s"][0] == pytest.approx(2.0 * math.pi * values["frequency_hz"][0])
    assert values["rate_rad_s"][1] == pytest.approx(2.0 * math.pi * values["frequency_hz"][1])


def test_a_cone_that_the_noise_hides_is_no_finding() -> None:
    assert found(coned(0.0, 0.0113, 30.0)) is None
    assert found(coned(math.radians(0.002), 0.0113, 300.0)) is None


def test_a_smoothed_phase_follows_a_slow_spin_that_dies_away() -> None:
    """Ten turns per knot were a radian and more beside it: an attitude of the wrong side of the craft."""
    time_s = np.arange(3000.0)
    phase = 0.09 * time_s * (1.0 - 0.2 * time_s / 3000.0)
    noise = np.random.default_rng(2).normal(0.0, 0.01, 3000)
    smooth = spin_phase.smoothed(timed(time_s), phase + noise, np.ones(3000), 0.07)
    assert float(np.abs(smooth - phase).max()) < 0.15


def test_two_stamps_much_closer_than_usual_tell_no_rate() -> None:
    """Samples of jittering packets, six stamped a microsecond after the ones before: the rate was 98617 rpm."""
    time_s = 2.0 * np.arange(2000.0)
    phase = 0.14 * time_s + np.random.default_rng(3).normal(0.0, 0.05, 2000)
    close = np.arange(200, 2000, 300)
    time_s[close] = time_s[close - 1] + 1e-6
    _, smooth = phases(time_s, phase, 0.14)
    assert np.polyfit(time_s, smooth, 1)[0] == pytest.approx(0.14, rel=1e-3)


@pytest.mark.parametrize(("swing_rad", "is_attitude"), [(0.0, True), (0.1, True), (0.25, False), (0.3, False)])
def test_the_spin_of_a_craft_that_swings_far_beside_it_is_no_attitude(swing_rad: float, is_attitude: bool) -> None:
    """What follows from one that was 50 degrees off on average was named; the spin itself is still one."""
    rng, time_s = np.random.default_rng(4), np.arange(3000.0)
    course = np.stack([np.cos(1.2e-3 * time_s), 0.7 * np.sin(1.2e-3 * time_s), 0.8 * np.sin(2.4e-3 * time_s)], axis=1)
    field = 3e4 * course / np.linalg.norm(course, axis=1)[:, None]
    axis = np.array([0.48, 0.36, 0.8])
    turn = Rotation.from_rotvec(np.outer(0.09 * time_s * (1.0 - 0.2 * time_s / 3000.0), axis))
    swing = swing_rad * np.stack([np.sin(0.011 * time_s), np.cos(0.017 * time_s), np.sin(0.007 * time_s)], axis=1)
    body = (turn * Rotation.from_rotvec(swing)).inv().apply(field) + rng.normal(0.0, 30.0, field.shape)
    spin = steady_spin.solve_spin(timed(time_s, body, field), None, None)
    assert spin is not None
    assert spin.is_attitude is is_attitude
    off = np.sqrt(np.mean(np.sum((np.einsum("nij,nj->ni", spin.body_from_eci, field) - body) ** 2, axis=1))) / 3e4
    assert bool(off < 0.2) is is_attitude


@pytest.mark.parametrize(("rate", "span_s", "lost"), [(0.09, 3000, 0.4), (0.01, 6000, 0.6), (0.03, 1500, 0.4)])
def test_a_spin_of_a_few_turns_that_dies_away_is_followed(rate: float, span_s: int, lost: float) -> None:
    """With six turns in all, 12 and 6 turns a knot are the same two knots, and no step to 3 was made."""
    time_s = np.arange(float(span_s))
    phase = rate * time_s * (1.0 - 0.5 * lost * time_s / span_s)
    smooth = spin_phase.smoothed(timed(time_s), phase, np.ones(span_s), phase[-1] / span_s)
    assert float(np.abs(smooth - phase).max()) < 0.3
