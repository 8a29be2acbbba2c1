"""Nutation from its line in the misfit of the axis: size, rate and sigmas by hand, and where it begins to count."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from magcal_service.model import Array
from magcal_service.physics.catalogue import effect_named
from magcal_service.physics.effects.nutation import _distance, _peak, _spectrum
from magcal_service.physics.interface import Finding
from magcal_service.physics.scene.scene import Scene
from magcal_service.physics.scene.view import View

COUNT, PERIOD_S, SPIN_HZ, ACROSS_NT = 1200, 2.0, 0.041, 20e3
TIME_S = PERIOD_S * np.arange(float(COUNT))


def flown(
    size: float,
    line_hz: float,
    *,
    noise_nt: float = 30.0,
    stated_nt: float = 30.0,
    count: int = COUNT,
    reference: bool = True,
    grown: float = 0.0,
    nearer: tuple[float, float] = (0.0, 0.0),
    still: tuple[float, float] = (0.0, 0.0),
) -> Finding | None:
    """What is found where the axis moves by a line of so much of the field across it, and more in the second half.

    ``nearer`` and ``still`` are two further lines, size and frequency [Hz].

    The spin is about z; the field across it turns in space to and fro meanwhile, as on an orbit.
    """
    time_s = PERIOD_S * np.arange(float(count))
    turn = 2.0 * math.pi * SPIN_HZ * time_s + 1.5 * np.sin(time_s / 800.0)
    field = np.stack([ACROSS_NT * np.cos(turn), ACROSS_NT * np.sin(turn), np.full(count, 15e3)], axis=1)
    course = np.where(np.arange(count) < count // 2, size, size + grown)
    moved = ACROSS_NT * course * np.cos(turn + 2.0 * math.pi * line_hz * time_s)
    for further, further_hz in (nearer, still):
        moved += ACROSS_NT * further * np.cos(turn + 2.0 * math.pi * further_hz * time_s)
    misfit = moved + np.random.default_rng(7).normal(0.0, noise_nt, count)
    eci = np.tile([0.0, 0.0, 15e3], (count, 1)) + np.outer(np.sin(time_s / 900.0), [9e3, 4e3, 0.0])
    scene = Scene(time_s, 0, False, field, field, field, np.linalg.norm(field, axis=1), eci if reference else None)
    z = np.array([0.0, 0.0, 1.0])
    return told_of(scene, z, misfit, stated_nt)


def told_of(scene: Scene, axis: Array, misfit: Array | None, noise_nt: float, hz: float = SPIN_HZ) -> Finding | None:
    """What is found of a turn about z, with a misfit along an axis in space or, without one, alone."""
    turn: Any = SimpleNamespace(
        axis_body=np.array([0.0, 0.0, 1.0]), rate_rad_s=2.0 * math.pi * hz, turn=None, axis_eci=axis
    )
    turn.turn, turn.axial_misfit_nt = turn, misfit
    which = {"alone": turn} if misfit is None else {"spin": turn}
    find = effect_named("nutation").find
    assert find is not None
    return find(View(scene, np.zeros(len(scene)), noise_nt, **which))


@pytest.mark.parametrize("has_reference", [True, False])
@pytest.mark.parametrize("angle_deg", [0.4, 9.0, 25.0])
def test_the_cone_of_a_body_without_torque_is_told_at_any_angle(angle_deg: float, has_reference: bool) -> None:
    """Three turns about z, x and z by hand; without a reference vector the coning was a rate that was none, trusted.

    The field along the momentum changes as on an orbit, from one side to the other.
    """
    count, angle = 5400, math.radians(angle_deg)
    time_s = PERIOD_S * np.arange(float(count))
    precession, spin = 2.0 * math.pi * 0.0621 * time_s, 2.0 * math.pi * -0.0153 * time_s
    orbit = 2.0 * math.pi * time_s / 5600.0
    space = np.stack([18e3 * np.cos(orbit), 9e3 + 4e3 * np.sin(orbit), 21e3 * np.sin(orbit)], axis=1)
    x = space[:, 0] * np.cos(precession) + space[:, 1] * np.sin(precession)
    y = space[:, 1] * np.cos(precession) - space[:, 0] * np.sin(precession)
    y, z = y * math.cos(angle) + space[:, 2] * math.sin(angle), space[:, 2] * math.cos(angle) - y * math.sin(angle)
    body = np.stack([x * np.cos(spin) + y * np.sin(spin), y * np.cos(spin) - x * np.sin(spin), z], axis=1)
    body += np.random.default_rng(11).normal(0.0, 50.0, body.shape)
    scene = Scene(time_s, 0, False, body, body, body, np.linalg.norm(space, axis=1), space if has_reference else None)
    axis = np.array([0.0, 0.0, 1.0])
    misfit = body[:, 2] - space[:, 2] if has_reference else None
    told = numbers(told_of(scene, axis, misfit, 50.0, 0.0621 - 0.0153))
    assert abs(told["angle_deg"][0] - angle_deg) < 3.0 * told["angle_deg"][1]
    assert told["angle_deg"][1] < 0.02
    assert told["frequency_hz"][0] == pytest.approx(0.0153, abs=1e-6)


def numbers(found: Finding | None) -> dict[str, tuple[float, float]]:
    assert found is not None
    return {name: (float(value.value), float(value.sigma)) for name, value in found.parameters.items()}


@pytest.mark.parametrize("line_hz", [0.0123, -0.0201])
@pytest.mark.parametrize("size", [0.01, 0.2])
def test_size_and_rate_come_from_the_line(size: float, line_hz: float) -> None:
    """Size is the angle's tangent; the sign of the line does not matter."""
    found = flown(size, line_hz)
    told = numbers(found)
    assert told["angle_deg"][0] == pytest.approx(math.degrees(math.atan(size)), rel=0.015)
    assert told["frequency_hz"][0] == pytest.approx(abs(line_hz), abs=2e-6 / size)
    assert told["rate_rad_s"][0] == pytest.approx(2.0 * math.pi * told["frequency_hz"][0])
    assert told["rate_rad_s"][1] == pytest.approx(2.0 * math.pi * told["frequency_hz"][1])
    assert found is not None
    assert found.share == pytest.approx(1.0, abs=0.02)


def test_sigmas_are_those_of_the_noise_and_of_what_the_halves_differ_by() -> None:
    """White noise moves the size by s sqrt(2 / power); halves of 1 and 1.8 per cent differ by forty times that."""
    told = numbers(flown(0.02, 0.0123))
    white = math.degrees(30.0 * math.sqrt(2.0 / (COUNT * ACROSS_NT**2)))
    assert 0.99 * white < told["angle_deg"][1] < 4.0 * white
    assert told["frequency_hz"][1] == pytest.approx(math.radians(told["angle_deg"][1]) / 0.02 / TIME_S[-1], rel=0.02)
    grown = numbers(flown(0.01, 0.0123, grown=0.008))
    assert grown["angle_deg"][0] == pytest.approx(math.degrees(math.atan(0.014)), rel=0.02)
    assert math.radians(grown["angle_deg"][1]) == pytest.approx(0.004, rel=0.05)


@pytest.mark.parametrize(("grown", "found"), [(0.009, True), (0.03, False)])
def test_a_line_that_one_half_hardly_has_is_no_nutation(grown: float, found: bool) -> None:
    """A steady coning is in both: half of what they differ by is its sigma, of which it needs three."""
    assert (flown(0.01, 0.0123, grown=grown) is not None) is found


@pytest.mark.parametrize(("of_noise", "found"), [(0.09, False), (0.11, True)])
def test_a_motion_counts_from_a_tenth_of_the_noise_on(of_noise: float, found: bool) -> None:
    """In the field's rms, over 12 000 s: a shorter line of that size is none by its evidence."""
    size = of_noise * 300.0 * math.sqrt(2.0) / ACROSS_NT
    assert (flown(size, 0.0123, noise_nt=1.0, stated_nt=300.0, count=6000) is not None) is found
    assert flown(size, 0.0123, noise_nt=1.0, stated_nt=300.0) is None


def test_a_line_beside_those_of_what_is_fixed_is_no_nutation() -> None:
    """Beside zero its image is beside twice the spin; beside the spin the image at three times the spin is told."""
    assert flown(0.001, 0.001) is None
    beside = numbers(flown(0.002, SPIN_HZ - 0.001))
    assert beside["frequency_hz"][0] == pytest.approx(3.0 * SPIN_HZ - 0.001, abs=5e-4)


def test_a_line_near_those_of_what_is_fixed_counts_where_nothing_nearer_is_higher() -> None:
    """Of a cone at 1.6 mHz what stands beyond 2 mHz was taken for a nutation of half the angle."""
    told = numbers(flown(0.05, 0.0016))
    assert told["frequency_hz"][0] == pytest.approx(0.0016, abs=1e-5)
    assert told["angle_deg"][0] == pytest.approx(math.degrees(math.atan(0.05)), rel=0.02)
    assert flown(0.05, 0.0016, nearer=(0.06, 0.0009)) is None


@pytest.mark.parametrize(("line_hz", "found"), [(0.0009, False), (0.0012, False), (0.0015, True)])
def test_what_the_orbit_may_make_at_seven_times_its_frequency_is_no_nutation(line_hz: float, found: bool) -> None:
    """An axis that precesses by the field, with a dipole along it, was said to nutate by 0.7 degrees, trusted."""
    assert (flown(0.02, line_hz, count=6000) is not None) is found


@pytest.mark.parametrize(("size", "found"), [(0.003, True), (0.002, False)])
def test_a_side_line_is_lower_than_two_thirds_of_its_own(size: float, found: bool) -> None:
    """Beside one of 0.4 per cent that something nearer to the still lines keeps from being a nutation."""
    told = flown(size, 0.0021, count=6000, nearer=(0.004, 0.0015), still=(0.01, 0.0005))
    assert (told is not None) is found


@pytest.mark.parametrize("line_hz", [0.003, SPIN_HZ - 0.003])
def test_a_line_three_thousandths_away_is(line_hz: float) -> None:
    assert numbers(flown(0.002, line_hz))["frequency_hz"][0] == pytest.approx(line_hz, abs=1e-4)


def test_noise_few_samples_and_no_reference_find_nothing() -> None:
    assert flown(0.0, 0.0123) is None
    assert flown(0.05, 0.0123, count=199) is None
    assert flown(0.05, 0.0123, count=200) is not None
    assert flown(0.05, 0.0123, reference=False) is None


# Lines


def test_a_spectrum_is_the_sum_over_samples_with_gaps_where_they_are() -> None:
    time_s = np.array([10.0, 12.0, 14.0, 22.0])
    signal = np.array([1.0 + 2.0j, -3.0, 0.5j, 4.0])
    frequency, line = _spectrum(time_s, signal, 2.0)
    assert len(frequency) == 14
    expected: Array = np.exp(2j * math.pi * np.outer(frequency, time_s - 10.0)) @ signal
    assert line == pytest.approx(expected)


@pytest.mark.parametrize("offset", [-0.7, -0.04, 0.0, 0.33, 0.8])
def test_a_peak_between_the_lines_has_its_frequency_and_height(offset: float) -> None:
    width_hz = 0.5 / TIME_S[-1]
    tone = 5.0 * np.exp(-2j * math.pi * (0.02 + offset * width_hz) * (TIME_S - TIME_S[0]))
    peak = _peak(TIME_S, tone, 0.02, width_hz)
    assert peak is not None
    found_hz, height = peak
    assert found_hz == pytest.approx(0.02 + offset * width_hz, abs=2e-3 * width_hz)
    assert height == pytest.approx(5.0 * COUNT, rel=1e-4)


def test_distance_is_from_a_line_of_either_sign_and_from_where_it_is_folded_to() -> None:
    frequency = np.array([0.10, 0.13, -0.11, -0.24, 0.20, 0.0])
    assert _distance(frequency, 0.11, 2.0) == pytest.approx([0.01, 0.02, 0.0, 0.13, 0.09, 0.11])
    assert _distance(frequency, 0.30, 2.0) == pytest.approx([0.10, 0.07, 0.09, 0.04, 0.0, 0.20])
    assert _distance(frequency, 0.0, 2.0) == pytest.approx([0.10, 0.13, 0.11, 0.24, 0.20, 0.0])


def test_the_flank_of_another_line_has_no_peak() -> None:
    """A parabola through it had one at 5e303 Hz, a nutation by 44 degrees."""
    beside_hz = 0.0123
    signal = np.exp(-2j * math.pi * beside_hz * TIME_S)
    width_hz = 0.5 / (COUNT * PERIOD_S)
    assert _peak(TIME_S, signal, beside_hz + 1.2 * width_hz, width_hz) is None
    assert _peak(TIME_S, signal, beside_hz + 0.5 * width_hz, width_hz) is not None
