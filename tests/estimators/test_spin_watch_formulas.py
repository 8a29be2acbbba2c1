"""The watch over a spin, its buffer and its search from nothing against their formulas, and their limits."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from magcal_service.base.snapshot import SnapshotError
from magcal_service.estimators.steady_spin.fit import Samples, SpinFit
from magcal_service.estimators.steady_spin.sample_buffer import CAPACITY, SampleBuffer
from magcal_service.estimators.steady_spin.start import _motion_about as motion_about
from magcal_service.estimators.steady_spin.start import (
    best_rotation,
    find_axis,
    rate_grid,
    wahba_gains,
)
from magcal_service.estimators.steady_spin.state import (
    Innovation,
)
from magcal_service.estimators.steady_spin.watch import FitQuality, SpinGate, SpinWatch, fit_quality
from tests.estimators.spin_states import RATE, state

# Watch


def watched(value: np.ndarray, spread: np.ndarray, field: np.ndarray) -> Innovation:
    return Innovation(value, field, spread, np.zeros((15, 3)), np.linalg.solve(spread, value))


def test_the_watch_compares_across_with_along_by_running_means() -> None:
    """Its recursions written out, for 700 samples: a memory of 300, blocks of 128 means in space, 8 of them."""
    rng = np.random.default_rng(4)
    watch = SpinWatch()
    along = across = drift = 1.0
    total, variance, blocks = np.zeros(3), 0.0, 0
    for count in range(1, 701):
        mixed = rng.normal(size=(3, 4)) * 100.0
        spread, field, value = mixed @ mixed.T + 1e4 * np.eye(3), rng.normal(size=3) * 3e4, rng.normal(size=3) * 200.0
        turn = Rotation.from_rotvec(rng.normal(size=3)).as_matrix()
        unit = field / np.linalg.norm(field)
        weight = 1.0 / min(count, 300)
        along_now, along_expected = float(unit @ value) ** 2, float(unit @ spread @ unit)
        along += weight * (along_now / along_expected - along)
        across += weight * ((value @ value - along_now) / (np.trace(spread) - along_expected) - across)
        total, variance = total + turn.T @ value, variance + np.trace(spread)
        if count % 128 == 0:
            blocks = min(blocks + 1, 8)
            drift += (total @ total / (variance * along) - drift) / blocks
            total, variance = np.zeros(3), 0.0
        watch.accepted(watched(value, spread, field), turn)
        np.testing.assert_allclose([watch._along, watch._across, watch._drift], [along, across, drift], rtol=1e-9)
        assert watch._blocks == blocks


NOISE = 100.0


ISOTROPIC = NOISE**2 * np.eye(3)


FIELD = np.array([0.0, 0.0, 4e4])


def fed(watch: SpinWatch, count: int, along: float, across: float, turn: np.ndarray | None = None) -> int | None:
    """Samples of so many sigmas along and across the field, signs that alternate; which of them loses the spin."""
    for number in range(count):
        sign = (-1.0) ** number
        value = NOISE * np.array([sign * across, sign * across, sign * along])
        if watch.accepted(watched(value, ISOTROPIC, FIELD), np.eye(3) if turn is None else turn) is not None:
            return number + 1
    return None


@pytest.mark.parametrize(("ratio", "lost"), [(1.59, None), (1.61, 300)])
def test_more_across_than_along_by_1_6_loses_the_spin_after_300_samples(ratio: float, lost: int | None) -> None:
    assert fed(SpinWatch(), 400, 1.0, math.sqrt(ratio)) == lost


@pytest.mark.parametrize(("squares", "lost"), [(9.9, None), (10.1, 128)])
def test_a_block_mean_of_more_than_ten_times_its_variance_loses_the_spin(squares: float, lost: int | None) -> None:
    """A third of the mean's square over its variance: 128 samples of 1 sigma along; a constant across beside it."""
    watch = SpinWatch()
    offset = math.sqrt(3.0 * squares / 128.0)
    for number in range(130):
        value = NOISE * np.array([offset, 0.0, (-1.0) ** number])
        found = watch.accepted(watched(value, ISOTROPIC, FIELD), np.eye(3))
        if found is not None:
            assert (found, number + 1) == (SpinGate.INCONSISTENT, lost)
            return
    assert lost is None


@pytest.mark.parametrize(("squares", "lost"), [(2.75, None), (2.85, 8 * 128)])
def test_eight_blocks_at_2_8_lose_the_spin(squares: float, lost: int | None) -> None:
    watch = SpinWatch()
    offset = math.sqrt(3.0 * squares / 128.0)
    for number in range(9 * 128):
        value = NOISE * np.array([offset, 0.0, (-1.0) ** number])
        if watch.accepted(watched(value, ISOTROPIC, FIELD), np.eye(3)) is not None:
            assert number + 1 == lost
            return
    assert lost is None


def test_a_gap_begins_the_block_anew() -> None:
    watch = SpinWatch()
    fed(watch, 100, 1.0, 1.0)
    watch.gap()
    assert (watch._in_block, watch._sum_variance, watch._sum.tolist()) == (0, 0.0, [0.0, 0.0, 0.0])


@pytest.mark.parametrize(("good", "gates"), [(0, [None, None, "phase_lost"]), (1, [None, None, None])])
def test_three_rejections_right_after_a_gap_are_a_lost_phase(good: int, gates: list[str | None]) -> None:
    watch = SpinWatch()
    watch.gap()
    fed(watch, good, 1.0, 1.0)
    assert [watch.rejected() for _ in range(3)] == gates


def test_an_accepted_sample_ends_a_row_of_rejections() -> None:
    watch = SpinWatch()
    for _ in range(29):
        assert watch.rejected() is None
    fed(watch, 1, 1.0, 1.0)
    assert [watch.rejected() for _ in range(30)] == [None] * 29 + [SpinGate.INCONSISTENT]


@pytest.mark.parametrize("count", [100, 300, 1500])
def test_the_quality_of_a_fit_by_brute_force(count: int) -> None:
    """Mean squares along and across; block means of the newest whole blocks over what noise along the field leaves."""
    rng = np.random.default_rng(5)
    y, space, field = (
        rng.normal(size=(count, 3)) * 100.0,
        rng.normal(size=(count, 3)) * 120.0,
        rng.normal(size=(count, 3)) * 3e4,
    )
    found = fit_quality(SpinFit(state(), y, space, field))
    unit = field / np.linalg.norm(field, axis=1)[:, None]
    along = float(np.mean((y * unit).sum(axis=1) ** 2))
    total = float(np.mean((y**2).sum(axis=1)))
    assert found.residual_nt == pytest.approx(math.sqrt(total / 3.0), rel=1e-12)
    assert found.ratio == pytest.approx((total - along) / 2.0 / along, rel=1e-12)
    blocks = count // 128
    means = [space[count - 128 * (k + 1) : count - 128 * k].mean(axis=0) for k in range(blocks)]
    assert found.drift == pytest.approx(float(np.mean(np.square(means))) * 128.0 / along if blocks else 1.0, rel=1e-9)
    assert found.squared_sum_nt2 == pytest.approx(float((y**2).sum()), rel=1e-9)


@pytest.mark.parametrize("count", [100, 1280])
def test_a_fit_is_steady_within_five_sigmas_of_chance_and_a_margin(count: int) -> None:
    blocks = max(count // 128, 1)
    ratio, drift = 1.2 + 5.0 * math.sqrt(3.0 / count), 1.5 + 5.0 * math.sqrt(2.0 / (3.0 * blocks))
    assert FitQuality(100.0, ratio - 0.01, drift - 0.01, count).steady
    assert not FitQuality(100.0, ratio + 0.01, 1.0, count).steady
    assert not FitQuality(100.0, 1.0, drift + 0.01, count).steady


# Buffer


def rows(first: int, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    times = np.arange(first, first + count, dtype=float)
    return times, np.outer(times, [1.0, 2.0, 3.0]), np.outer(times, [4.0, 5.0, 6.0])


def test_a_buffer_gives_back_what_it_was_given_with_times_before_the_newest() -> None:
    buffer = SampleBuffer()
    for first in range(0, 1000, 7):
        buffer.add(*rows(first, 7))
    found = buffer.samples()
    assert (buffer.count, found.times_s[0], found.times_s[-1]) == (1001, -1000.0, 0.0)
    np.testing.assert_array_equal(found.field_nt, rows(0, 1001)[1])
    np.testing.assert_array_equal(found.reference_eci_nt, rows(0, 1001)[2])


def test_a_full_buffer_gives_up_its_oldest_quarter() -> None:
    buffer = SampleBuffer()
    buffer.add(*rows(0, CAPACITY - 1))
    assert not buffer.full
    buffer.add(*rows(CAPACITY - 1, 1))
    assert buffer.full
    buffer.add(*rows(CAPACITY, 2))
    assert (buffer.count, CAPACITY) == (12_288 + 2, 16_384)
    np.testing.assert_array_equal(buffer.samples().field_nt[:, 0], np.arange(4096.0, CAPACITY + 2))


def test_a_buffer_is_restored_whole() -> None:
    buffer, other = SampleBuffer(), SampleBuffer()
    buffer.add(*rows(5, 300))
    other.add(*rows(0, 9))
    other.restore_state(buffer.export_state())
    np.testing.assert_array_equal(other.samples().field_nt, buffer.samples().field_nt)
    assert other.count == 300


@pytest.mark.parametrize(
    ("shape", "fits"), [((2 * CAPACITY, 7), True), ((2 * CAPACITY + 1, 7), False), ((5, 6), False), ((7,), False)]
)
def test_a_saved_buffer_has_rows_of_seven_and_is_not_endless(shape: tuple[int, ...], fits: bool) -> None:
    saved = {"rows": [list(shape), np.zeros(shape).tobytes()]}
    if fits:
        SampleBuffer().restore_state(saved)
    else:
        with pytest.raises(SnapshotError, match="state has the shape"):
            SampleBuffer().restore_state(saved)
    with pytest.raises(SnapshotError):
        SampleBuffer().restore_state(3)


# The search from nothing


@pytest.mark.parametrize(("contrast", "found"), [(2.05, True), (1.95, False)])
def test_an_axis_stands_out_by_a_factor_of_two(contrast: float, found: bool) -> None:
    """What is left across it over what is left along it; H has no part in these vectors."""
    rng = np.random.default_rng(6)
    basis = np.linalg.qr(rng.normal(size=(60, 6)))[0]
    reference, rest = basis[:, :3] * 1e4, basis[:, 3:] * np.array([5.0, 1.0, contrast]) * 100.0
    axis = find_axis(reference @ rng.normal(size=(3, 3)) + rest, reference)
    assert (axis is not None) is found
    if axis is not None:
        np.testing.assert_allclose(np.abs(axis), [0.0, 1.0, 0.0], atol=1e-6)


@pytest.mark.parametrize(("span_s", "count"), [(100.0, 41), (99.0, 41), (1.0, 3), (102.6, 43)])
def test_trial_rates_are_a_radian_over_the_span_apart(span_s: float, count: int) -> None:
    rates = rate_grid(0.1, 0.5, span_s)
    assert (len(rates), rates[0], rates[-1]) == (count, pytest.approx(0.1), pytest.approx(0.5))
    assert count == 3 or np.diff(rates).max() * span_s <= 1.0 + 1e-9


def test_wahbas_gain_is_that_of_the_vectors_turned_back() -> None:
    """For each rate: the sum of w_k H_k' turned back by the phase; singular values with the sign of its hand."""
    rng = np.random.default_rng(7)
    axis = RATE / np.linalg.norm(RATE)
    some = Samples(-np.arange(30.0)[::-1], rng.normal(size=(30, 3)), rng.normal(size=(30, 3)))
    rates = np.array([0.3, -0.8, 0.05])
    gains, matrices = wahba_gains(some, some.field_nt, axis, rates)
    for number, rate in enumerate(rates):
        back = [Rotation.from_rotvec(axis * rate * t).as_matrix() for t in some.times_s]
        matrix = sum(
            turn @ np.outer(w, h) for turn, w, h in zip(back, some.field_nt, some.reference_eci_nt, strict=True)
        )
        np.testing.assert_allclose(matrices[number], matrix, atol=1e-9)
        one, two, three = np.linalg.svd(matrix)[1] * [1.0, 1.0, np.sign(np.linalg.det(matrix))]
        np.testing.assert_allclose(gains[number], [one + two + three, one + two - three], rtol=1e-9)
        rotation = best_rotation(matrix)
        assert np.linalg.det(rotation) == pytest.approx(1.0)
        assert np.trace(rotation.T @ matrix) == pytest.approx(one + two + three, rel=1e-9)


def test_the_motion_of_the_field_about_an_axis() -> None:
    times = np.linspace(-50.0, 0.0, 80)
    axis = np.array([0.0, 0.6, 0.8])
    start = np.array([3e4, 1e4, -2e4])
    turned_field = Rotation.from_rotvec(np.outer(0.13 * times, axis)).apply(start)
    some = Samples(times, turned_field, turned_field)
    assert motion_about(axis, some) == pytest.approx(0.13, rel=1e-9)
    assert motion_about(-axis, some) == pytest.approx(-0.13, rel=1e-9)
