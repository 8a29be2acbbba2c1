"""Parts that the catalogue is built of, each alone: turns and phases, tracks and tables, whitening, correlation."""

from __future__ import annotations

import math

import numpy as np
import pytest

from magcal_service.model import Array
from magcal_service.physics.drivers import far
from magcal_service.physics.effects.coloured_noise import Whitener, autoregression, covariance, long_memory
from magcal_service.physics.effects.nutation import _distance, _peak, _spectrum
from magcal_service.physics.effects.quantisation import step_of
from magcal_service.physics.effects.spin_rate import _fitted, _tolerance
from magcal_service.physics.scene import spin_phase, steady_spin
from magcal_service.physics.scene.scene import Scene

AXIS_BODY, AXIS_ECI = np.array([0.36, 0.48, 0.8]), np.array([-0.6, 0.64, 0.48])


def timed(time_s: Array) -> Scene:
    field = np.ones((len(time_s), 3))
    return Scene(time_s, 0, True, field, field, field, field[:, 0])


# A steady turn


@pytest.mark.parametrize("axis", [AXIS_BODY, AXIS_ECI, np.array([0.0, 0.0, 1.0]), np.array([0.0, -1.0, 0.0])])
def test_two_vectors_make_a_right_handed_triad_with_an_axis(axis: Array) -> None:
    first, second = steady_spin.across(axis)
    assert np.stack([first, second, axis]) @ np.stack([first, second, axis]).T == pytest.approx(np.eye(3))
    assert np.cross(first, second) == pytest.approx(axis)


def test_an_attitude_has_the_axis_fixed_and_turns_the_body_right_handed() -> None:
    """A vector fixed in space goes round the axis in the body the other way, by the phase."""
    phase = np.array([0.0, 0.3, 2.0])
    attitude = steady_spin.attitude_of(AXIS_BODY, AXIS_ECI, phase)
    assert attitude @ AXIS_ECI == pytest.approx(np.tile(AXIS_BODY, (3, 1)))
    assert attitude @ np.transpose(attitude, (0, 2, 1)) == pytest.approx(np.tile(np.eye(3), (3, 1, 1)))
    assert np.linalg.det(attitude) == pytest.approx(np.ones(3))
    seen = attitude @ np.array([1.0, 2.0, 3.0])
    for row, angle in enumerate(phase):
        along = AXIS_BODY * (seen[0] @ AXIS_BODY)
        flat = seen[0] - along
        turned = along + flat * math.cos(angle) - np.cross(AXIS_BODY, flat) * math.sin(angle)
        assert seen[row] == pytest.approx(turned)


def test_turns_are_the_phases_of_the_attitude() -> None:
    phase = np.array([0.1, 1.2, -2.5])
    reference = np.array([[20e3, 1e3, 5e3], [0.0, 30e3, 5e3], [9e3, -9e3, 1e3]])
    w = np.einsum("nij,nj->ni", steady_spin.attitude_of(AXIS_BODY, AXIS_ECI, phase), reference)
    turn, strength = steady_spin.turns_of(w, reference, AXIS_BODY, AXIS_ECI)
    assert np.angle(turn) == pytest.approx(phase)
    assert np.abs(turn) == pytest.approx(np.ones(3))
    assert strength == pytest.approx(np.linalg.norm(np.cross(reference, AXIS_ECI), axis=1))


def test_axes_are_those_along_which_both_vectors_agree() -> None:
    phase = 0.7 * np.arange(40.0)
    reference = np.random.default_rng(1).normal(0.0, 30e3, (40, 3))
    w = np.einsum("nij,nj->ni", steady_spin.attitude_of(AXIS_BODY, AXIS_ECI, phase), reference)
    found = steady_spin._axes(w, reference)
    assert found is not None
    sign = np.sign(found[0] @ AXIS_BODY)
    assert sign * found[0] == pytest.approx(AXIS_BODY)
    assert sign * found[1] == pytest.approx(AXIS_ECI)
    flat = reference * np.array([1.0, 1.0, 0.0])
    assert steady_spin._axes(w, flat) is None  # the axis of space alone is free: no pair of unit vectors


@pytest.mark.parametrize(
    ("rate", "nominal", "found"), [(0.3, None, 0.3), (-0.3, None, -0.3), (3.0, None, 3.0 - np.pi), (3.0, 2.9, 3.0)]
)
def test_a_rate_is_that_of_the_step_between_neighbours_or_its_alias(
    rate: float, nominal: float | None, found: float
) -> None:
    time_s = 2.0 * np.arange(60.0)
    assert steady_spin._rate(timed(time_s), np.exp(1j * rate * time_s), nominal) == pytest.approx(found)


def test_a_rate_needs_thirty_even_steps_that_agree() -> None:
    time_s = 2.0 * np.arange(60.0)
    turn = np.exp(0.3j * time_s)
    assert steady_spin._rate(timed(time_s[:31]), turn[:31], None) is not None
    assert steady_spin._rate(timed(time_s[:30]), turn[:30], None) is None
    noise = np.exp(1j * np.random.default_rng(2).uniform(-np.pi, np.pi, 60))
    assert steady_spin._rate(timed(time_s), noise, None) is None


def test_a_phase_is_unwrapped_through_noise_and_a_slow_change_of_rate() -> None:
    time_s = np.arange(400.0)
    phase = 0.2 + 0.9 * time_s + 2e-4 * time_s**2
    noise = np.random.default_rng(3).normal(0.0, 0.3, 400)
    found = spin_phase._tracked(np.exp(1j * (phase + noise)), time_s, 0.9, np.ones(400))
    assert found - found[0] == pytest.approx(phase + noise - (phase[0] + noise[0]), abs=1e-9)


def test_a_curve_through_knots_is_a_broken_line_and_weighs_its_samples() -> None:
    time_s = np.linspace(0.0, 10.0, 101)
    broken = np.interp(time_s, [0.0, 5.0, 10.0], [1.0, 3.0, -2.0])
    weight = np.ones(101)
    assert spin_phase._through_knots(time_s, broken, weight, 3) == pytest.approx(broken, abs=1e-5)
    spoiled = np.array(broken)
    spoiled[40] += 100.0
    weight[40] = 0.0
    assert spin_phase._through_knots(time_s, spoiled, weight, 3)[:40] == pytest.approx(broken[:40], abs=1e-4)
    line = np.polyval(np.polyfit(time_s, broken, 1), time_s)
    assert spin_phase._through_knots(time_s, broken, np.ones(101), 2) == pytest.approx(line, abs=1e-5)


# A rate that is told


@pytest.mark.parametrize(
    ("rpm", "tolerance_rpm"), [(7.5, 0.05), (-7.5, 0.05), (7.512, 0.007512), (100.0, 0.5), (2000.0, 2.0), (0.25, 0.005)]
)
def test_a_stated_rate_is_as_sure_as_its_last_digit(rpm: float, tolerance_rpm: float) -> None:
    """Half a unit of it, and a thousandth at least."""
    assert _tolerance(rpm * math.pi / 30.0) == pytest.approx(tolerance_rpm * math.pi / 30.0)


def test_a_polynomial_is_weighted_and_its_covariance_that_of_its_numbers() -> None:
    share = np.linspace(0.0, 1.0, 50)
    sigma = np.where(share < 0.5, 0.1, 10.0)
    values = 1.0 + 2.0 * share - 3.0 * share**2
    found = _fitted(values, share, sigma, 2)
    assert found.values == pytest.approx([1.0, 2.0, -3.0])
    design = np.vander(share, 3, increasing=True) / sigma[:, None]
    assert found.covariance == pytest.approx(np.linalg.inv(design.T @ design))
    off = _fitted(values + 0.1, share, sigma, 0)
    weight = 1.0 / sigma**2
    mean = float((weight * (values + 0.1)).sum() / weight.sum())
    assert off.left == pytest.approx((values + 0.1 - mean) / sigma)


# Lines of a complex signal


def test_a_transform_has_its_line_where_the_signal_turns_back() -> None:
    """Sum of signal exp(+i w t): what goes round at -f shows at f; the finer look finds it between the bins."""
    time_s = 10.0 + 2.0 * np.arange(500.0)
    elapsed = time_s - 10.0
    signal = 3.0 * np.exp(-2j * np.pi * 0.03127 * elapsed)
    frequency, line = _spectrum(time_s, signal, 2.0)
    best = int(np.argmax(np.abs(line)))
    assert len(frequency) == 1000
    assert float(frequency[best]) == pytest.approx(0.03127, abs=0.5 / 2000.0)
    direct = np.sum(signal * np.exp(2j * np.pi * frequency[best] * elapsed))
    assert complex(line[best]) == pytest.approx(complex(direct))
    found_hz, height = _peak(time_s, signal, float(frequency[best]), 1.0 / 2000.0)
    assert found_hz == pytest.approx(0.03127, abs=1e-6)
    assert height == pytest.approx(1500.0, rel=1e-3)


def test_frequencies_near_a_line_of_either_sign_or_its_fold_are_known() -> None:
    frequency = np.array([0.1, -0.1, 0.112, 0.15, 0.4, -0.4])
    assert (_distance(frequency, 0.1, 1.0) < 0.011).tolist() == [True, True, False, False, False, False]
    assert (_distance(frequency, 0.6, 1.0) < 0.011).tolist() == [False, False, False, False, True, True]


# Noise with a memory


def test_whitening_takes_off_what_was_seen_before_by_the_cosine_of_the_turn() -> None:
    rng = np.random.default_rng(5)
    unit = rng.normal(size=(260, 3))
    unit /= np.linalg.norm(unit, axis=1)[:, None]
    rows, coefficients = rng.normal(size=(260, 9)), rng.normal(size=250) * 0.05
    found = Whitener(coefficients, unit).white(rows)
    expected = np.array(rows)
    for row in range(260):
        for lag in range(1, min(row, 250) + 1):
            expected[row] -= coefficients[lag - 1] * (unit[row] @ unit[row - lag]) * rows[row - lag]
    assert found == pytest.approx(expected)


def test_a_covariance_at_a_lag_is_weighted_by_the_cosine() -> None:
    rng = np.random.default_rng(6)
    unit, e = rng.normal(size=(50, 3)), rng.normal(size=50)
    cosine = np.array([unit[k] @ unit[k + 3] for k in range(47)])
    expected = sum(e[k] * e[k + 3] * cosine[k] for k in range(47)) / sum(cosine**2)
    assert covariance(unit, e, 3) == pytest.approx(expected)
    assert covariance(unit, e, 0) == pytest.approx(sum(e**2 * (unit**2).sum(1)) / sum((unit**2).sum(1) ** 2))


def test_autoregression_is_least_squares_on_the_samples_before() -> None:
    """Eight lags, or a fiftieth of the samples; rows behind a pause are left out; nats by the drop in squares."""
    e = np.random.default_rng(7).normal(size=600)
    for row in range(1, 600):
        e[row] += 0.7 * e[row - 1]
    found, nats = autoregression(e, np.array([0, 300]))
    rows = np.array([row for row in range(8, 600) if not 300 <= row < 308])
    design = np.stack([e[rows - lag] for lag in range(1, 9)], axis=1)
    expected = np.linalg.lstsq(design, e[rows], rcond=None)[0]
    assert found == pytest.approx(expected)
    left = e[rows] - design @ expected
    gain = 0.5 * len(rows) * math.log((e[rows] @ e[rows]) / (left @ left))
    assert nats == pytest.approx(gain - 0.5 * 8 * math.log(600.0))
    assert len(autoregression(e[:150])[0]) == 3
    assert autoregression(e[:12])[1] != 0.0
    assert len(autoregression(e[:10])[0]) == 0


def test_a_long_memory_has_sixteen_free_lags_and_shares_the_rest() -> None:
    e = np.random.default_rng(8).normal(size=1100)
    found = long_memory(e)
    assert len(found) == 128
    assert found[16:32] == pytest.approx(np.full(16, found[16]))
    assert found[32:] == pytest.approx(np.full(96, found[32]))
    rows = np.arange(128, 1100)
    design = [e[rows - lag] for lag in range(1, 17)]
    design += [np.array([e[row - span : row].mean() for row in rows]) for span in (32, 128)]
    weights = np.linalg.lstsq(np.stack(design, axis=1), e[rows], rcond=None)[0]
    assert found[32] == pytest.approx(weights[17] / 128.0)
    assert found[16] == pytest.approx(weights[17] / 128.0 + weights[16] / 32.0)
    assert found[0] == pytest.approx(weights[0] + weights[16] / 32.0 + weights[17] / 128.0)
    assert len(long_memory(e[:200])) == 16


@pytest.mark.parametrize(("levels", "step"), [(2, 0.0), (3, 2.5)])
def test_a_lattice_needs_three_levels(levels: int, step: float) -> None:
    assert step_of(2.5 * (np.arange(60.0) % levels)) == pytest.approx(step)


# A track that goes on


def test_a_table_is_read_by_curves_that_bend_with_it() -> None:
    """A parabola is read exactly between the shifts of the table, column by column."""
    table = np.stack([far._SHIFTS_S**2, 3.0 - 2.0 * far._SHIFTS_S], axis=1)
    for shift in (-1200.0, -331.0, 0.0, 17.5, 1199.0):
        found = far._between(table, np.array([shift, shift]))
        assert found == pytest.approx([shift**2, 3.0 - 2.0 * shift], abs=1e-6)
    beyond = far._between(table, np.array([5000.0, -5000.0]))
    assert beyond[0] == pytest.approx((far._SHIFTS_S[-2]) ** 2, rel=1e-3)
    assert float(far._SHIFTS_S[0]) == -1320.0
    assert float(far._SHIFTS_S[-1]) == 1320.0


def test_places_go_on_along_their_circle() -> None:
    def at(angle: float, radius: float = 7000.0) -> Array:
        return radius * np.array([math.cos(angle), math.sin(angle), 0.0])

    found = far._on_circle(at(0.1), at(0.3), np.array([0.0, 1.0, 2.5]))
    assert found == pytest.approx(np.stack([at(0.3), at(0.5), at(0.8)]))
    assert far._on_circle(at(0.1), at(0.1), np.array([1.0])) == pytest.approx(at(0.1)[None])


def test_a_track_is_a_line_between_its_places_and_a_circle_beyond_them() -> None:
    """On a circle of one radius the places stay on it; the ends are carried on by the arc of two minutes."""
    time_s = 20.0 * np.arange(100.0)
    rate = 1.1e-3

    def at(times: Array) -> Array:
        return 7000.0 * np.stack([np.cos(rate * times), np.sin(rate * times), 0.0 * times], axis=1)

    wanted = np.array([-400.0, -10.0, 0.0, 55.0, 1980.0, 2300.0])
    assert far._ahead(timed(time_s), at(time_s), wanted) == pytest.approx(at(wanted), abs=0.5)


def test_beyond_its_ends_a_track_keeps_within_the_heights_that_it_had() -> None:
    time_s = 20.0 * np.arange(100.0)
    radius = 7000.0 + time_s / 100.0
    track = radius[:, None] * np.stack([np.cos(1.1e-3 * time_s), np.sin(1.1e-3 * time_s), 0.0 * time_s], axis=1)
    found = np.linalg.norm(far._ahead(timed(time_s), track, np.array([-300.0, 990.0, 2500.0])), axis=1)
    assert found[[0, 2]] == pytest.approx([7000.0, 7019.8])
    assert float(found[1]) == pytest.approx(7009.9, abs=0.5)  # a chord between two places is lower than the arc
