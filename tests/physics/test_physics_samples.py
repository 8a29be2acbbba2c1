"""Effects that show in the samples themselves or in the noise: lattices, stops, frozen axes, memory."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from magcal_service.model import Array
from magcal_service.physics.catalogue import effect_named
from magcal_service.physics.effects.coloured_noise import (
    Whitener,
    _independent,
    autoregression,
    body_correlation,
    covariance,
    is_noise,
    long_memory,
)
from magcal_service.physics.effects.hysteresis import play
from magcal_service.physics.effects.quantisation import sigma_of, step_of
from magcal_service.physics.effects.torquer import remembered
from magcal_service.physics.interface import Finding
from magcal_service.physics.scene.view import View, runs
from magcal_service.samples.stops import stops
from tests.physics.scenes import NOISE_NT, scene, spoiled, view

NOISY = scene(NOISE_NT)


def find(name: str, seen: View) -> Finding | None:
    """What an effect finds."""
    effect = effect_named(name)
    assert effect.find is not None
    return effect.find(seen)


def stirred(seed: int, count: int = 4000) -> Array:
    """White noise (n,), unit sigma."""
    return np.random.default_rng(seed).normal(size=count)


@pytest.mark.parametrize("step", [0.5, 12.0, 73.3])
def test_step_of_a_lattice(step: float) -> None:
    """The step of rounded values is found to a thousandth, with an offset and missing levels."""
    values = np.round(30.0 * stirred(1)) * step + 0.31
    assert step_of(values) == pytest.approx(step, rel=1e-3)


@pytest.mark.parametrize("digits", [1, 3])
def test_a_step_is_known_to_the_last_digit_over_the_number_of_steps(digits: int) -> None:
    """Both ends are off by up to half a digit: two in three errors are within about 1 sigma, none beyond 2.5."""
    rng, off = np.random.default_rng(9421), []
    for step in rng.uniform(20.0, 200.0, 60):
        values = np.round(np.round(rng.uniform(-4e4, 4e4, 2000) / step) * step, digits)
        found = step_of(values)
        if found:
            off.append(abs(found - step) / sigma_of(values, found))
    assert len(off) > 40
    assert 0.4 < np.mean(np.array(off) < 1.0) < 0.8
    assert max(off) < 2.5


@pytest.mark.parametrize("between", [0.1, 0.5, 0.93])
def test_a_range_that_ends_between_two_steps_hides_no_lattice(between: float) -> None:
    """At the largest value, at the least, and at both; all three axes of a craft whose x and y are cut."""
    values, end = 150.0 * np.round(10.0 * stirred(9420)), 150.0 * (12.0 + between)
    for cut in (np.minimum(values, end), np.maximum(values, -end), np.clip(values, -end, end)):
        assert step_of(cut) == pytest.approx(150.0, rel=1e-6)
    field = np.round(NOISY.field_nt / 150.0) * 150.0
    field[:, 0] = np.minimum(field[:, 0], 150.0 * (100.0 + between))
    field[:, 1] = np.clip(field[:, 1], -150.0 * (90.0 + between), 150.0 * (80.0 + between))
    found = find("quantisation", view(spoiled(field, NOISY)))
    assert found is not None
    assert found.parameters["lsb_by_axis_nt"].value == pytest.approx([150.0, 150.0, 150.0], rel=1e-6)


def test_no_step_where_there_is_no_lattice() -> None:
    """Values that were not rounded, a constant, and two levels have no step."""
    assert step_of(800.0 * stirred(2)) == 0.0
    assert step_of(np.full(100, 4.2)) == 0.0
    assert step_of(np.array([1.0, 2.0] * 50)) == 0.0


def test_no_step_where_levels_are_not_even() -> None:
    """A few hundred levels at random places are no lattice."""
    levels = np.sort(np.random.default_rng(3).uniform(-1000.0, 1000.0, 300))
    assert step_of(np.random.default_rng(4).choice(levels, 4000)) == 0.0


def test_quantisation_is_found_with_its_step() -> None:
    """Samples rounded to 150 nT at 80 nT of noise: the step, and q / sqrt 12 of noise."""
    found = find("quantisation", view(spoiled(np.round(NOISY.field_nt / 150.0) * 150.0, NOISY)))
    assert found is not None
    assert float(found.parameters["lsb_nt"].value) == pytest.approx(150.0, rel=1e-3)
    assert float(found.parameters["added_noise_nt"].value) == pytest.approx(150.0 / math.sqrt(12.0), rel=1e-3)


def test_a_step_far_below_the_noise_is_no_finding() -> None:
    """Samples written to 1 nT at 80 nT of noise are as good as any."""
    assert find("quantisation", view(spoiled(np.round(NOISY.field_nt), NOISY))) is None


def test_stuck_axis_is_found_with_its_stretch() -> None:
    """One axis frozen over 90 samples: axis, value, times, and those rows spoiled, no others."""
    field = np.array(NOISY.field_nt)
    field[700:790, 1] = field[700, 1]
    found = find("stuck_axis", view(spoiled(field, NOISY)))
    assert found is not None
    assert found.spoiled is not None
    assert np.flatnonzero(found.spoiled).tolist() == list(range(700, 790))
    assert found.parameters["axis"].value.tolist() == [0.0, 1.0, 0.0]
    assert float(found.parameters["value_nt"].value) == field[700, 1]
    assert float(found.parameters["from_s"].value) == NOISY.time_s[700]
    assert float(found.parameters["to_s"].value) == NOISY.time_s[789]


def test_a_short_repetition_is_no_stuck_axis() -> None:
    """Ten equal samples happen, and a craft that stands still repeats all axes."""
    field = np.array(NOISY.field_nt)
    field[700:710, 1] = field[700, 1]
    assert find("stuck_axis", view(spoiled(field, NOISY))) is None
    field = np.array(NOISY.field_nt)
    field[700:800] = field[700]
    assert find("stuck_axis", view(spoiled(field, NOISY))) is None


def test_saturation_is_found_with_its_limits() -> None:
    """An axis that ends at 22 uT on both sides: axis, limits, the share clipped, and where in words."""
    field = np.array(NOISY.field_nt)
    field[:, 2] = np.clip(field[:, 2], -22_000.0, 22_000.0)
    clipped = np.abs(field[:, 2]) == 22_000.0
    found = find("saturation", view(spoiled(field, NOISY)))
    assert found is not None
    assert found.parameters["axis"].value.tolist() == [0.0, 0.0, 1.0]
    assert found.parameters["limit_nt"].value.tolist() == [22_000.0, -22_000.0]
    assert float(found.parameters["share_of_samples"].value) == pytest.approx(clipped.mean())
    says = effect_named("saturation").sentence(found.parameters, "none")
    assert says.startswith("Readings stop at +22000 nT on z and -22000 nT on z, the end of the range: ")


@pytest.mark.parametrize(("side", "stop_nt"), [(1.0, -1000.0), (-1.0, 2000.0), (1.0, 0.0), (1.0, 20000.0)])
def test_a_stop_spoils_what_without_its_noise_is_near_it(side: float, stop_nt: float) -> None:
    """Within three sigma, on its own side, wherever zero lies: as the truth has it but for a few rows in a thousand."""
    field = np.array(NOISY.field_nt)
    field[:, 2] = side * np.minimum(side * field[:, 2], side * stop_nt)
    found = find("saturation", view(spoiled(field, NOISY)))
    assert found is not None
    assert found.spoiled is not None
    near = side * scene().field_nt[:, 2] > side * stop_nt - 3.0 * NOISE_NT
    assert np.count_nonzero(near & (field[:, 2] != stop_nt)) > 6
    assert np.count_nonzero(found.spoiled != (near | (field[:, 2] == stop_nt))) <= 4


def test_what_a_diagnosis_leaves_out_is_what_the_inspection_does() -> None:
    """The effect has no rule of its own."""
    field = np.array(NOISY.field_nt)
    field[:, 2] = np.minimum(field[:, 2], 20_000.0)
    found = find("saturation", view(spoiled(field, NOISY)))
    assert found is not None
    (stop,) = stops(field, NOISY.magnitude_nt)
    assert np.array_equal(found.spoiled, stop.spoiled)


def test_a_lattice_is_no_stop() -> None:
    """Samples on a coarse lattice come again and again at the ends of the range, but no oftener than beside."""
    coarse = np.round(NOISY.field_nt / 10_000.0) * 10_000.0
    assert min(np.count_nonzero(coarse == coarse.max(axis=0), axis=0)) > 20
    assert find("saturation", view(spoiled(coarse, NOISY))) is None


@pytest.mark.parametrize("name", ["quantisation", "stuck_axis", "saturation", "coloured_noise"])
def test_clean_samples_are_no_finding(name: str) -> None:
    """White noise on sound samples is nothing to any of them, in five recordings."""
    for seed in range(5):
        noise = NOISE_NT * np.random.default_rng(20 + seed).normal(size=(len(NOISY), 3))
        assert find(name, view(spoiled(scene().field_nt + noise, NOISY))) is None


def coloured(correlation: float, seed: int) -> View:
    """Noise fixed in the body with a memory of one sample, seen along the field."""
    white = np.random.default_rng(seed).normal(size=(len(scene()), 3))
    noise = np.empty_like(white)
    noise[0] = white[0]
    for row in range(1, len(white)):
        noise[row] = correlation * noise[row - 1] + math.sqrt(1.0 - correlation**2) * white[row]
    residual = NOISE_NT * np.einsum("ni,ni->n", noise, scene().unit)
    return replace(view(scene()), residual_nt=residual)


def test_coloured_noise_is_found_with_its_correlation() -> None:
    """A memory of 0.6 in the body comes back to 0.06, though the turning field hides it from the residual itself."""
    for seed in range(5):
        found = find("coloured_noise", coloured(0.6, seed))
        assert found is not None
        assert float(found.parameters["correlation"].value) == pytest.approx(0.6, abs=0.06)
        assert float(found.parameters["level_nt"].value) == pytest.approx(NOISE_NT, rel=0.1)


def test_white_noise_has_no_correlation_in_the_body() -> None:
    """A residual without memory gives zero to three of its sigmas."""
    for seed in range(5):
        assert abs(body_correlation(coloured(0.0, 30 + seed))) < 3.0 * 2.0 / math.sqrt(len(scene()))


def first_order_noise(correlation: float, seed: int, count: int = 6000) -> Array:
    """x_k = correlation x_(k-1) + white."""
    white, found = stirred(seed, count).tolist(), [0.0]
    for part in white[1:]:
        found.append(correlation * found[-1] + part)
    return np.array(found)


def test_autoregression_finds_the_coefficient() -> None:
    """Of a first-order process the first coefficient is the correlation, the others are nothing, the gain is known."""
    coefficients, nats = autoregression(first_order_noise(0.7, 1))
    assert float(coefficients[0]) == pytest.approx(0.7, abs=0.04)
    assert float(np.abs(coefficients[1:]).max()) < 0.06
    assert nats == pytest.approx(-0.5 * 6000 * math.log(1.0 - 0.49), rel=0.1)


def test_autoregression_gains_nothing_over_white_noise() -> None:
    """Eight coefficients cost more than they bring."""
    assert max(autoregression(stirred(40 + seed))[1] for seed in range(10)) < 0.0


def test_autoregression_does_not_reach_over_pauses() -> None:
    """Rows after a pause are predicted from none before it: signs that flip at pauses leave the coefficient alone."""
    flipped = first_order_noise(0.7, 2) * np.where(np.arange(6000) // 12 % 2, -1.0, 1.0)
    assert float(autoregression(flipped, np.arange(0, 6000, 12))[0][0]) == pytest.approx(0.7, abs=0.05)


def pink(seed: int, count: int = 16384) -> Array:
    """Noise with a power that falls as 1 / f, by its spectrum."""
    spectrum = np.fft.rfft(stirred(seed, count))
    frequency = np.fft.rfftfreq(count)
    frequency[0] = frequency[1]
    return np.asarray(np.fft.irfft(spectrum / np.sqrt(frequency), count))


def whitened(noise: Array, coefficients: Array) -> Array:
    """What a prediction from the past leaves, after the first rows."""
    left = np.array(noise)
    kernel = np.concatenate([[1.0], -coefficients])
    return np.asarray(np.convolve(left, kernel)[len(kernel) : len(left)])


def test_long_memory_whitens_noise_that_falls_as_one_over_f() -> None:
    """Low frequencies hold twenty times more than high ones before, and at most 1.6 times after."""
    noise = pink(3)

    def slope(values: Array) -> float:
        power = np.abs(np.fft.rfft(values)) ** 2
        return float(power[1 : len(power) // 50].mean() / power[len(power) // 2 :].mean())

    left = whitened(noise, long_memory(noise))
    assert slope(noise) > 20.0
    assert 0.6 < slope(left) < 1.6


def test_long_memory_finds_a_short_one_too() -> None:
    """Of a first-order process the first coefficient is the correlation and what is left is the driving noise."""
    noise = first_order_noise(0.6, 4)
    coefficients = long_memory(noise)
    assert float(coefficients[0]) == pytest.approx(0.6, abs=0.05)
    assert float(np.std(whitened(noise, coefficients))) == pytest.approx(1.0, abs=0.04)


def test_play_follows_once_its_slack_is_used_up() -> None:
    """Up to 3, back to 1, down to -3 with a slack of 1: the branches differ by twice the slack."""
    values = np.array([0.0, 1.0, 2.0, 3.0, 2.5, 1.0, 0.0, -3.0])[:, None]
    assert play(values, 1.0)[:, 0].tolist() == [0.0, 0.0, 1.0, 2.0, 2.0, 2.0, 1.0, -2.0]


def test_a_core_remembers_the_sign_of_its_last_command() -> None:
    """Zero before the first command, then the last sign, through pauses."""
    moment = np.array([[0.0], [0.0], [0.2], [0.0], [0.0], [-0.1], [0.001], [0.0], [0.2]])
    assert remembered(scene(), moment, 0.2)[:, 0].tolist() == [0.0, 0.0, 1.0, 1.0, 1.0, -1.0, -1.0, -1.0, 1.0]


def test_runs_are_first_and_last_plus_one() -> None:
    """Stretches of a flag, at the ends too."""
    flag = np.array([True, True, False, True, False, False, True])
    assert runs(flag) == [(0, 2), (3, 4), (6, 7)]
    assert runs(np.zeros(3, dtype=bool)) == []


def hanging_together(body: Array, level_nt: float, stated_nt: float | None) -> bool:
    """What is said of noise (n, 3) fixed in the body, of a level, beside the level that is stated."""
    unit = scene().unit
    residual = level_nt * np.einsum("ni,ni->n", unit, body)
    return is_noise(replace(view(scene()), residual_nt=residual, stated_noise_nt=stated_nt))


def first_order_body(correlation: float, seed: int) -> Array:
    """Noise (n, 3) of unit variance with a memory, in each axis of the body."""
    rng = np.random.default_rng(seed)
    body = np.empty((len(scene()), 3))
    body[0] = rng.normal(size=3)
    for row in range(1, len(body)):
        body[row] = correlation * body[row - 1] + math.sqrt(1.0 - correlation**2) * rng.normal(size=3)
    return body


@pytest.mark.parametrize("stated_nt", [80.0, None])
def test_noise_with_a_short_memory_is_noise(stated_nt: float | None) -> None:
    """A correlation of 0.7 at one sample, on a craft that turns 48 degrees in it."""
    assert hanging_together(first_order_body(0.7, 5), 80.0, stated_nt)


@pytest.mark.parametrize(("level_nt", "expected"), [(80.0, True), (70.0, True), (100.0, False)])
def test_white_noise_with_a_little_memory_is_noise_where_its_level_is_the_stated_one(
    level_nt: float, expected: bool
) -> None:
    """A fifth of it remembers: as much as white noise changes from sample to sample, but nothing on top of it."""
    white = np.random.default_rng(14).normal(size=(len(scene()), 3))
    body = math.sqrt(0.75) * white + 0.5 * first_order_body(0.7, 15)
    assert hanging_together(body, level_nt, 80.0) is expected


@pytest.mark.parametrize("stated_nt", [80.0, None])
def test_a_slow_wander_on_white_noise_is_none(stated_nt: float | None) -> None:
    """A wander over 200 samples of the noise's own size: white noise is still there, so it is something else."""
    white = np.random.default_rng(6).normal(size=(len(scene()), 3))
    assert not hanging_together(white + first_order_body(0.995, 7), 80.0, stated_nt)


@pytest.mark.parametrize("seed", range(6))
def test_what_does_not_show_that_it_fades_is_none(seed: int) -> None:
    """A twelfth of the square in a wander over 60 samples: by chance its covariance falls within ten at times."""
    rng = np.random.default_rng(160 + seed)
    body = rng.normal(size=(len(scene()), 3)) + 0.3 * first_order_body(0.983, 170 + seed)
    assert not hanging_together(body, 80.0, None)


def test_white_noise_does_not_hang_together() -> None:
    """No memory, whatever is stated."""
    assert not hanging_together(np.random.default_rng(8).normal(size=(len(scene()), 3)), 80.0, 200.0)


@pytest.mark.parametrize("memory", [0.0, 0.5, 0.9])
def test_the_level_of_noise_with_a_memory_is_as_uncertain_as_it_scatters(memory: float) -> None:
    """First-order noise: (1 - rho^2) / (1 + rho^2) of its samples count; 120 draws scatter as they say, within 20 %."""
    draws = [first_order_noise(memory, 500 + seed) for seed in range(120)]
    levels = [float(np.sqrt(np.mean(one**2))) for one in draws]
    said = float(
        np.mean([level / math.sqrt(2.0 * _independent(one)) for level, one in zip(levels, draws, strict=True)])
    )
    assert said == pytest.approx(float(np.std(levels)), rel=0.2)
    share = (1.0 - memory**2) / (1.0 + memory**2)
    assert np.mean([_independent(one) for one in draws]) == pytest.approx(share * len(draws[0]), rel=0.1)


def test_a_driver_that_averages_is_whitened() -> None:
    """The mean of four samples: its memory ends at once, four coefficients leave a correlation of 0.29."""
    white = np.random.default_rng(21).normal(size=20_000)
    mean = np.convolve(white, np.full(4, 0.5), mode="valid")
    left = whitened(mean, long_memory(mean))
    assert max(abs(float(np.corrcoef(left[:-lag], left[lag:])[0, 1])) for lag in range(1, 24)) < 0.16


def test_whitening_in_the_body_takes_the_memory_off() -> None:
    """What a model of the body's noise leaves of its own noise is white, though the craft turns."""
    unit = scene().unit
    noise = np.einsum("ni,ni->n", unit, first_order_body(0.8, 9))
    left = Whitener(long_memory(noise, unit), unit).white(noise[:, None])[:, 0]
    assert covariance(unit, noise, 1) / covariance(unit, noise, 0) == pytest.approx(0.8, abs=0.1)
    assert abs(covariance(unit, left, 1) / covariance(unit, left, 0)) < 0.1
