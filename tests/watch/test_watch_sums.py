"""The watch's sums and spectra against least squares, Whittle's likelihood and chi-squared written out."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from magcal_service.model import BIAS, D_SCALE
from magcal_service.watch.evidence import (
    CLASS_NATS,
    Explanation,
    courses,
    gain,
    inverse_root,
    of_columns,
    of_course,
    spectral,
    without,
)
from magcal_service.watch.residual_watch import (
    ALARM_NATS,
    BLOCK,
    CHUNK,
    FIRST_EVALUATION,
    TICKS,
    Finding,
    likely,
)
from tests.watch.explanations import explained

# Evidence


def test_the_evidence_is_the_gain_less_what_numbers_and_choice_cost() -> None:
    """Schwarz: half a log of the samples for each number; and the log of how many were tried."""
    one = Explanation(("x",), "", 50.0, 3, 7)
    assert one.score(1000) == pytest.approx(50.0 - 1.5 * math.log(1000.0) - math.log(7.0), rel=1e-12)
    assert replace(one, tries=1).score(1000) - one.score(1000) == pytest.approx(math.log(7.0), rel=1e-12)
    assert one.score(0) == one.score(2) == pytest.approx(50.0 - 1.5 * math.log(2.0) - math.log(7.0), rel=1e-12)
    assert Explanation(("x",), "", 50.0, 3).tries == 1


def test_the_significance_is_that_of_twice_the_gain() -> None:
    """Two degrees of freedom: P(chi-squared > 2 g) = exp(-g)."""
    assert Explanation(("x",), "", 12.5, 2).significance() == pytest.approx(12.5, rel=1e-12)


def test_an_alarm_is_false_once_in_ten_years() -> None:
    """98 617 looks a year of 150 tests each."""
    assert math.exp(ALARM_NATS) == pytest.approx(31_557_600.0 / 320.0 * 150.0 / 0.1, rel=1e-12)
    assert (CHUNK, BLOCK, TICKS, FIRST_EVALUATION) == (64, 320, 5120, 960)


def squares(seed: int, columns: int, rows: int = 50) -> np.ndarray:
    table = np.random.default_rng(seed).normal(size=(rows, columns)) * 10.0 ** np.arange(columns)
    return table.T @ table


def test_the_inverse_root_is_one() -> None:
    matrix = squares(1, 5)
    root = inverse_root(matrix)
    np.testing.assert_allclose(root @ root.T @ matrix, np.eye(5), atol=1e-6)


@pytest.mark.parametrize(("share", "rank"), [(1e-8, 3), (1e-10, 2)])
def test_directions_with_hardly_any_information_are_left_out(share: float, rank: int) -> None:
    """Three columns of length one of which the third is nearly the second: eigenvalues 2, 1 and ``share``."""
    matrix = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 1.0 - share], [0.0, 1.0 - share, 1.0]])
    assert inverse_root(matrix * 7.0).shape == (3, rank)
    assert not np.isnan(inverse_root(np.zeros((3, 3)))).any()


@pytest.mark.parametrize(("left", "seen"), [(1.1e-4, True), (0.9e-4, False)])
def test_a_column_has_to_keep_a_ten_thousandth_of_its_square(left: float, seen: bool) -> None:
    """Orthonormal columns: nine errors, one column that is mostly the first of them, and the residual."""
    basis = np.linalg.qr(np.random.default_rng(2).normal(size=(40, 11)))[0]
    column = math.sqrt(1.0 - left) * basis[:, 0] + math.sqrt(left) * basis[:, 9]
    table = np.column_stack([basis[:, :9], column, basis[:, 9] + basis[:, 10]])
    rest = without(table.T @ table)
    assert bool(rest[0, 0] > 0.0) is seen
    assert rest[1, 1] == pytest.approx(2.0, rel=1e-9)
    assert of_columns(rest, [0], 40) == (pytest.approx(20.0 * math.log(2.0), rel=1e-6) if seen else 0.0)


def test_a_residual_that_the_nine_errors_explain_is_kept_as_what_is_left() -> None:
    basis = np.linalg.qr(np.random.default_rng(3).normal(size=(40, 11)))[0]
    table = np.column_stack([basis[:, :9], basis[:, 9], basis[:, 0] + 1e-4 * basis[:, 10]])
    assert without(table.T @ table)[-1, -1] == pytest.approx(1e-8, rel=1e-6)


def test_gains_of_nothing_and_of_everything() -> None:
    assert gain(np.zeros((2, 2)), 100) == 0.0
    assert gain(np.array([[1.0, 0.0], [0.0, 4.0]]), 100) == 0.0
    assert gain(np.array([[1.0, 1.0], [1.0, 4.0]]), 100) == pytest.approx(50.0 * math.log(4.0 / 3.0), rel=1e-12)
    assert gain(np.array([[1.0, 2.0], [2.0, 4.0]]), 100) == pytest.approx(50.0 * math.log(1e12), rel=1e-3)


def least_squares_gain(residual: np.ndarray, before: np.ndarray, more: np.ndarray) -> float:
    left = [
        float(np.sum((residual - columns @ np.linalg.lstsq(columns, residual, rcond=None)[0]) ** 2))
        for columns in (before, np.column_stack([before, more]))
    ]
    return 0.5 * len(residual) * math.log(left[0] / left[1])


@pytest.mark.parametrize("count", [7, 8])
def test_courses_are_those_of_least_squares_over_all_rows(count: int) -> None:
    """Lines, cubics from eight blocks on, the best step, the best step within a block, a bias in each block."""
    rng = np.random.default_rng(4)
    per_block, samples = 40, 40 * count
    nine, residual = rng.normal(size=(samples, 9)), rng.normal(size=samples)
    block = np.repeat(np.arange(count), per_block)
    residual += 0.4 * nine[:, 0] * (block >= 4) + 0.3 * nine[:, 4] * block / count
    times = 100.0 + 320.0 * np.arange(count) + rng.uniform(0.0, 100.0, count)
    table = np.column_stack([nine, residual])
    blocks = np.array([table[block == k].T @ table[block == k] for k in range(count)])
    phase = (times - times.mean()) / (times.max() - times.min())

    def of(part: slice, *functions: np.ndarray) -> float:
        more = np.column_stack([nine[:, part] * function[block, None] for function in functions])
        return least_squares_gain(residual, nine, more)

    number = np.arange(count)
    expected: list[tuple[float, int, int]] = []
    for part in (BIAS, D_SCALE):
        expected.append((of(part, phase), 3, 1))
        if count >= 8:
            expected.append((of(part, phase, phase**2, phase**3), 9, 1))
        expected.append((max(of(part, 1.0 * (number >= k)) for k in range(1, count)), 3, count - 1))
        within = [of(part, 1.0 * (number > k), 1.0 * (number == k)) for k in range(1, count - 1)]
        expected.append((max(within), 6, count - 2))
    expected.append((of(BIAS, *(1.0 * (number == k) for k in range(1, count))), 3 * (count - 1), 1))
    found = courses(blocks, times, samples)
    assert [(one.columns, one.tries) for one in found] == [(columns, tries) for _, columns, tries in expected]
    np.testing.assert_allclose([one.gain for one in found], [value for value, _, _ in expected], rtol=1e-7)
    half = (len(found) - 1) // 2
    names = ["bias_drift"] * (half - 2) + ["bias_step"] * 2 + ["scale_drift"] * (half - 2) + ["scale_step"] * 2
    assert [one.effects[0] for one in found[:half]] == names[:half]
    assert found[-1].effects == ("unknown",)
    basis = np.stack([phase], axis=1)
    assert of_course(blocks, BIAS, basis, samples) == pytest.approx(found[0].gain, rel=1e-9)


# Spectra


def whittle(power: np.ndarray, share: np.ndarray, shape: np.ndarray) -> float:
    """-sum of share (ln S + P / S) with the level of S fitted; bins that white noise would not fill are left out."""
    weight = np.where(share < 0.2 * share.max(), 0.0, share)
    level = np.divide(power, share, out=np.zeros_like(power), where=weight > 0.0)
    scale = (weight * level / shape).sum() / weight.sum()
    model = shape * scale
    return -float((weight * (np.log(model) + level / model)).sum())


CORRELATIONS = (-0.9, -0.75, -0.6, -0.45, -0.3, -0.15, 0.15, 0.3, 0.45, 0.6, 0.75, 0.9, 0.95)


@pytest.mark.parametrize("correlation", CORRELATIONS)
def test_a_memory_of_each_strength_is_found_as_such(correlation: float) -> None:
    """Expected spectra: the gain is that of Whittle's likelihood, and slow power is raised by (1 + r) / (1 - r)."""
    share = 80.0 * np.r_[0.5, np.ones(31), 0.5]
    angle = np.pi * np.arange(33) / 32
    shape = 1.0 / (1.0 - 2.0 * correlation * np.cos(angle) + correlation**2)
    found, raised = spectral(900.0 * share * shape, share)
    memory = found[0]
    expected = whittle(share * shape, share, shape) - whittle(share * shape, share, np.ones(33))
    assert memory.effects == ("coloured_noise",)
    assert (memory.gain, memory.columns, memory.tries) == (pytest.approx(expected, rel=1e-9), 1, 13)
    assert raised == pytest.approx(max(1.0, (1.0 + correlation) / (1.0 - correlation)), rel=1e-9)


@pytest.mark.parametrize(("weight", "raised"), [(9.9, False), (10.1, True)])
def test_a_memory_of_less_than_ten_nats_raises_nothing(weight: float, raised: bool) -> None:
    share = np.r_[0.5, np.ones(31), 0.5]
    shape = 1.0 / (1.0 - 0.9 * np.cos(np.pi * np.arange(33) / 32) + 0.45**2)
    one = whittle(share * shape, share, shape) - whittle(share * shape, share, np.ones(33))
    factor = spectral(weight / one * share * shape, weight / one * share)[1]
    assert factor == (pytest.approx(1.45 / 0.55, rel=1e-9) if raised else 1.0)


@pytest.mark.parametrize("at", [1, 12, 31])
def test_a_line_takes_three_bins_of_its_own(at: int) -> None:
    """Whittle's likelihood with the powers of three bins free, and one level for all others."""
    rng = np.random.default_rng(6)
    share = 80.0 * np.r_[0.5, np.ones(31), 0.5]
    level = rng.uniform(0.8, 1.2, 33)
    level[at - 1 : at + 2] *= [3.0, 9.0, 3.0]
    own = np.isin(np.arange(33), (at - 1, at, at + 1))
    shape = np.where(own, level, (share * level)[~own].sum() / share[~own].sum())
    log_likelihood = -float((share * (np.log(shape) + level / shape)).sum())
    line = spectral(share * level, share)[0][1]
    assert line.effects == ("tone",)
    assert line.gain == pytest.approx(log_likelihood - whittle(share * level, share, np.ones(33)), rel=1e-9)
    assert (line.columns, line.tries) == (3, 31)


def test_bins_without_a_share_of_white_noise_are_no_line() -> None:
    """As the slowest, which the nine errors take up: a flat spectrum has no line there either."""
    share = 80.0 * np.r_[np.zeros(6), np.ones(27)]
    line = spectral(share, share)[0][1]
    assert line.effects == ("tone",)
    assert line.gain == pytest.approx(0.0, abs=1e-9)


def test_anything_at_all_takes_every_bin() -> None:
    rng = np.random.default_rng(7)
    share = 80.0 * np.r_[0.5, np.ones(31), 0.5]
    level = rng.uniform(0.5, 2.0, 33)
    free = spectral(share * level, share)[0][2]
    expected = whittle(share * level, share, level) - whittle(share * level, share, np.ones(33))
    assert (free.effects, free.driver, free.columns) == (("unknown",), "fast", 32)
    assert free.gain == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize(("share_left", "used"), [(0.21, True), (0.19, False)])
def test_bins_that_the_nine_errors_take_are_no_evidence(share_left: float, used: bool) -> None:
    """A bin of which less than a fifth is left is not looked at, whatever power is in it."""
    share = 80.0 * np.r_[0.5, np.ones(31), 0.5]
    share[7] *= share_left
    power = share.copy()
    power[7] *= 50.0
    found, _ = spectral(power, share)
    assert (found[1].gain > 10.0) is used
    assert (found[1].tries, found[2].columns) == ((31, 32) if used else (30, 31))


# Which explanation is told


def test_what_chance_explains_is_not_told() -> None:
    """Two columns: the significance is the gain."""
    assert likely([explained("a", ALARM_NATS + 0.01, 2)], 1000) != []
    assert likely([explained("a", ALARM_NATS - 0.01, 2)], 1000) == []


@pytest.mark.parametrize(("behind", "names"), [(2.99, ["a", "b"]), (3.01, ["a"])])
def test_what_is_within_three_nats_of_the_best_is_named_beside_it(behind: float, names: list[str]) -> None:
    found = likely([explained("b", 100.0 - behind), explained("a", 100.0)], 1000)
    assert [one.effects[0] for one in found] == names
    assert CLASS_NATS == 3.0


@pytest.mark.parametrize(("share", "unknown"), [(1.26, True), (1.24, False)])
def test_the_unknown_is_told_where_the_best_name_leaves_a_fifth(share: float, unknown: bool) -> None:
    name = explained("a", 100.0)
    cost = 100.0 - name.score(1000)
    other = explained("unknown", share * name.score(1000) + cost)
    assert [one.effects[0] for one in likely([name, other], 1000)] == (["unknown"] if unknown else ["a"])
    assert likely([other, explained("a", 1.0)], 1000) == [other]


def test_a_finding_in_words() -> None:
    finding = Finding(("a", "b"), "channel t", 33.6, 45.4)
    assert str(finding) == "looks like a or b (channel t), 34 nats over 45 min"
    assert str(replace(finding, effects=("unknown",), driver="")) == "looks like something unknown, 34 nats over 45 min"
