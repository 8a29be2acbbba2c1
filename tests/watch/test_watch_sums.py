"""The watch's sums and spectra against least squares, Whittle's likelihood and chi-squared written out."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from magcal_service.base.snapshot import SnapshotError
from magcal_service.estimators.interface import Phase, StateEstimate
from magcal_service.model import BIAS, D_SCALE, STATE_SIZE, calibrate, field_jacobian, without_radial_noise
from magcal_service.ticks.assembler import Tick
from magcal_service.watch import residual_watch as module
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
    ModelWatch,
    likely,
)
from magcal_service.wire.messages import Clock, TelemetrySample

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


def explained(name: str, gain_nats: float, columns: int = 3, tries: int = 1) -> Explanation:
    return Explanation((name,), "", gain_nats, columns, tries)


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


# Rows and sums


X = np.array([900.0, -1400.0, 2100.0, 0.05, -0.08, 0.11, 0.03, -0.04, 0.06])
ESTIMATE = StateEstimate(X, np.diag([1.0] * 3 + [1e-12] * 6), Phase.RUNNING, 100.0, 1000, 0, 0, None, False)


def ticks(count: int, noise_nt: float = 100.0, seed: int = 1, first: int = 0) -> list[Tick]:
    """Vectors of a craft with the errors ``X`` in all directions, |H| about 40 uT that moves slowly."""
    rng = np.random.default_rng(seed)
    found = []
    for index in range(first, first + count):
        magnitude = 40_000.0 + 5000.0 * math.sin(index / 200.0)
        direction = rng.normal(size=3)
        w = magnitude * direction / np.linalg.norm(direction) + noise_nt * rng.normal(size=3)
        field = np.linalg.solve(np.eye(3) + X[np.array([[3, 6, 7], [6, 4, 8], [7, 8, 5]])], w + X[:3])
        found.append(
            Tick(
                index,
                np.array([1000.0 + index]),
                field[None],
                np.array([magnitude]),
                time_ns=ns(index),
                clock=Clock.UTC,
            )
        )
    return found


def ns(seconds: float) -> int:
    return 1_750_000_000 * 10**9 + round(seconds * 1e9)


def told(watch: ModelWatch, seconds: float, value: float, channel: str = "t", unit: str = "degC") -> None:
    watch.drivers.telemetry(
        TelemetrySample(
            craft="c",
            source="t",
            sequence=0,
            time_ns=ns(seconds),
            clock=Clock.UTC,
            channel=channel,
            unit=unit,
            values=(value,),
        )
    )


def pushed(
    watch: ModelWatch, stream: list[Tick], estimate: StateEstimate = ESTIMATE, *, walks: bool = False
) -> list[bool]:
    return [watch.push(tick, estimate, walks=walks) for tick in stream]


def by_hand(
    stream: list[Tick], x: np.ndarray, driven: np.ndarray | None = None, reach: np.ndarray | None = None
) -> np.ndarray:
    """Columns of the sums, from the formulas: J, cubes, beyond the reach, slope, driver (bias and gain), residual."""
    field = np.concatenate([tick.field_body_nt for tick in stream])
    magnitude = np.concatenate([tick.reference_magnitude_nt for tick in stream])
    times = np.concatenate([tick.times_s for tick in stream])
    w_hat, b_hat = without_radial_noise(x, field, magnitude)
    unit = w_hat / magnitude[:, None]
    columns = [np.einsum("ni,nij->nj", unit, field_jacobian(b_hat)), unit * (b_hat / 5e4) ** 3]
    reach = np.abs(field).max(axis=0) if reach is None else reach
    columns.append(unit * np.sign(b_hat) * np.maximum(np.abs(b_hat) - reach, 0.0))
    columns.append(np.gradient(magnitude, times)[:, None])
    if driven is not None:
        columns += [unit * driven[:, None], unit * driven[:, None] * b_hat]
    residual = np.linalg.norm(calibrate(x, field), axis=1) - magnitude
    return np.column_stack([*columns, residual])


def test_a_chunk_adds_its_rows_to_the_block() -> None:
    """64 samples; a temperature that rises by 2 K from the window's first sample on drives bias and gain."""
    watch, stream = ModelWatch(6.0), ticks(64)
    told(watch, 0.0, 20.0)
    assert not watch.is_open
    for seconds, tick in enumerate(stream):
        assert watch._block is None
        told(watch, seconds + 1.0, 20.0 + 2.0 * (seconds + 1.0) / 64.0)
        watch.push(tick, ESTIMATE, walks=False)
        assert watch.is_open
    table = by_hand(stream, X, 2.0 * np.arange(64) / 64.0)
    expected = table.T @ table
    scale = np.sqrt(np.maximum(np.diagonal(expected), 1e-12))
    assert watch._block is not None
    np.testing.assert_allclose(watch._block / np.outer(scale, scale), expected / np.outer(scale, scale), atol=1e-5)
    assert watch._rows == []


def test_a_blocks_spectrum_is_that_of_its_chunks_without_the_nine_errors() -> None:
    watch, stream = ModelWatch(6.0), ticks(128)
    pushed(watch, stream)
    power, share = np.zeros(33), np.zeros(33)
    weight = np.r_[0.5, np.ones(31), 0.5]
    for first in (0, 64):
        table = by_hand(stream[first : first + 64], X)
        basis = np.linalg.qr(table[:, :9])[0]
        left = table[:, -1] - basis @ (basis.T @ table[:, -1])
        power += np.abs(np.fft.rfft(left)) ** 2 * weight / 64.0
        share += weight * (1.0 - (np.abs(np.fft.rfft(basis, axis=0)) ** 2).sum(axis=1) / 64.0)
    np.testing.assert_allclose(watch._power, power, rtol=1e-6)
    np.testing.assert_allclose(watch._share, share, rtol=1e-6)


def spiked(stream: list[Tick], where: dict[int, float]) -> list[Tick]:
    """The stream with some calibrated vectors longer by so much [nT]."""
    matrix = np.eye(3) + X[np.array([[3, 6, 7], [6, 4, 8], [7, 8, 5]])]
    found = list(stream)
    for row, length_nt in where.items():
        w = calibrate(X, stream[row].field_body_nt[0])
        w = w * (1.0 + length_nt / np.linalg.norm(w))
        found[row] = replace(stream[row], field_body_nt=np.linalg.solve(matrix, w + X[:3])[None])
    return found


@pytest.mark.parametrize(
    ("where", "left", "clipped_nt"),
    [
        ({}, 64, None),
        ({5: 620.0}, 63, None),  # far off by itself
        ({5: 580.0}, 64, None),  # within six sigmas of 100 nT
        ({5: 700.0, 20: -700.0}, 62, None),
        ({5: 700.0, 20: -700.0, 40: 700.0}, 0, None),  # three by themselves: the chunk goes
        ({5: 700.0, 6: 700.0}, 64, None),  # two in a row are no spikes
        ({5: 5000.0, 6: -5000.0}, 64, 1200.0),  # and count as if at twice the gate
        ({0: 700.0, 63: 700.0}, 62, None),
    ],
)
def test_samples_far_off_by_themselves_are_left_out(
    where: dict[int, float], left: int, clipped_nt: float | None
) -> None:
    estimate = replace(ESTIMATE, covariance=np.zeros((9, 9)))
    watch, stream = ModelWatch(6.0), spiked(ticks(64, 1.0), where)
    pushed(watch, stream, estimate)
    reach = np.abs(np.concatenate([tick.field_body_nt for tick in stream])).max(axis=0)
    table = by_hand(stream, X, reach=reach)
    far = np.abs(table[:, -1]) > 600.0
    alone = [
        row
        for row in range(64)
        if far[row] and not far[max(row - 1, 0)] * (row > 0) and not (row < 63 and far[min(row + 1, 63)])
    ]
    table[alone if left else slice(None)] = 0.0
    assert watch._block is not None
    assert int((table[:, -1] != 0.0).sum()) == left
    if clipped_nt is not None:
        table[:, -1] = np.clip(table[:, -1], -clipped_nt, clipped_nt)
    assert watch._block[-1, -1] == pytest.approx(float(table[:, -1] @ table[:, -1]), rel=1e-6, abs=1e-6)
    assert bool(watch._power.any()) is (left > 0)


def test_the_reference_states_own_uncertainty_widens_the_gate() -> None:
    """Sigma of the bias 300 nT beside 100 nT of noise: the gate is 6 x 316 = 1897 nT."""
    estimate = replace(ESTIMATE, covariance=np.diag([300.0**2] * 3 + [0.0] * 6))
    sums = []
    for length_nt in (1880.0, 1915.0):
        watch = ModelWatch(6.0)
        pushed(watch, spiked(ticks(64, 1.0), {5: length_nt}), estimate)
        assert watch._block is not None
        sums.append(watch._block[-1, -1])
    assert sums[0] > 1800.0**2
    assert sums[1] < 1000.0


def test_blocks_make_a_window_and_the_first_look_is_after_three() -> None:
    """The sums of 5 chunks are a block; blocks of nine errors and residual are kept with their times."""
    watch, stream = ModelWatch(6.0), ticks(FIRST_EVALUATION)
    looks: list[float] = []
    watch._evaluate = lambda minutes, *, walks: bool(looks.append(minutes))  # type: ignore[method-assign]
    pushed(watch, stream)
    assert looks == [pytest.approx((FIRST_EVALUATION - 1) / 60.0)]
    assert (len(watch._blocks), watch._times) == (3, [1000.0 + BLOCK * k - 1 for k in (1, 2, 3)])
    table = by_hand(stream[:BLOCK], X)[:, [*range(9), -1]]
    scale = np.sqrt(np.diagonal(table.T @ table))
    np.testing.assert_allclose(
        watch._blocks[0] / np.outer(scale, scale), table.T @ table / np.outer(scale, scale), atol=1e-6
    )
    assert watch._rest is not None
    assert watch._rest[:10, :10][0, 0] == pytest.approx(sum(block[0, 0] for block in watch._blocks), rel=1e-9)


def test_a_window_ends_after_5120_ticks_and_a_quiet_one_ends_a_finding(monkeypatch: pytest.MonkeyPatch) -> None:
    watch = ModelWatch(6.0)
    monkeypatch.setattr(watch, "explanations", lambda walks: [])
    watch.finding = Finding(("a",), "", 50.0, 30.0)
    watch._quiet = False
    changed = pushed(watch, ticks(TICKS))
    assert (any(changed), watch.is_open, watch.finding is not None) == (False, False, True)  # something in it was told
    changed = pushed(watch, ticks(TICKS))
    assert (changed.index(True), sum(changed)) == (TICKS - 1, 1)
    assert watch.finding is None


@pytest.mark.parametrize(
    ("before", "now", "ticks_seen", "kept", "changed"),
    [
        (None, ("a", 50.0), 960, "a", True),
        (("a", 40.0), ("a", 50.0), 960, "a", False),
        (("a", 60.0), ("a", 50.0), 4800, "a", False),
        (("b", 60.0), ("a", 50.0), 2240, "b", False),  # the window before knew more, and this one is young
        (("b", 60.0), ("a", 50.0), 2560, "a", True),
        (("b", 40.0), ("a", 50.0), 960, "a", True),
    ],
)
def test_a_finding_gives_way_to_a_better_or_an_older_one(
    before: tuple[str, float] | None, now: tuple[str, float], ticks_seen: int, kept: str, changed: bool
) -> None:
    watch = ModelWatch(6.0)
    watch._samples = ticks_seen
    watch.finding = None if before is None else Finding((before[0],), "", before[1], 10.0)
    watch.explanations = lambda *, walks: [explained(now[0], now[1])]  # type: ignore[method-assign]
    assert watch._evaluate(12.0, walks=False) is changed
    assert watch.finding is not None
    assert watch.finding.effects == (kept,)
    took = kept == now[0] and (before is None or now[1] > before[1] or before[0] != kept)
    assert watch.finding.minutes == (12.0 if took else 10.0)


def test_a_channel_that_comes_later_begins_a_new_window_at_the_blocks_end() -> None:
    watch, stream = ModelWatch(6.0), ticks(BLOCK)
    pushed(watch, stream[:10])
    told(watch, 10.0, 20.0)
    pushed(watch, stream[10:-1])
    assert watch.is_open
    pushed(watch, stream[-1:])
    assert not watch.is_open


@pytest.mark.parametrize("walks", [True, False])
def test_process_noise_that_comes_or_goes_begins_a_new_window_at_the_blocks_end(walks: bool) -> None:
    """Sums with and without the nine errors' columns cannot be added; nothing of the window's finding is lost."""
    watch = ModelWatch(6.0)
    watch.finding = Finding(("a",), "", 50.0, 30.0)
    pushed(watch, ticks(BLOCK), walks=not walks)
    assert not any(pushed(watch, ticks(BLOCK - 1, first=BLOCK), walks=walks))
    assert watch.is_open
    pushed(watch, ticks(1, first=2 * BLOCK - 1), walks=walks)
    assert (watch.is_open, watch.finding is not None) == (False, True)
    pushed(watch, ticks(FIRST_EVALUATION, first=2 * BLOCK), walks=walks)
    assert watch._rest is not None
    assert len(watch._rest) == watch._size() - (STATE_SIZE if walks else 0)


def test_a_channel_that_ends_is_void_from_then_on() -> None:
    watch, stream = ModelWatch(6.0), ticks(CHUNK)
    told(watch, -1.0, 20.0)
    told(watch, 0.0, 20.0)
    pushed(watch, stream)
    assert watch._void == [True]
    assert [one[1] for one in watch._columns_of() if one[1]] == []


def test_a_top_is_flat_where_the_largest_reading_of_an_axis_repeats_ten_times() -> None:
    for repeats, flat in ((9, False), (10, True)):
        watch, stream = ModelWatch(6.0), ticks(60)
        clipped = [
            replace(tick, field_body_nt=np.where([[True, False, False]], 60_000.0, tick.field_body_nt))
            for tick in stream
        ]
        pushed(watch, [*clipped[:repeats], *stream[repeats:]])
        assert watch._topped[0] == repeats
        assert ([3, 4, 5] in [columns for _, _, columns, _ in watch._columns_of()]) is flat
        watch.reset()
        assert watch._topped[0] == repeats


def test_columns_of_each_explanation() -> None:
    """Own columns first: cubes 0-2, beyond 3-5, slope 6; a temperature has a gain beside its field, a current none."""
    watch = ModelWatch(6.0)
    told(watch, 0.0, 20.0, "t")
    told(watch, 0.0, 0.5, "i", "A")
    watch.drivers.telemetry(
        TelemetrySample(
            craft="c",
            source="t",
            sequence=0,
            time_ns=ns(0.0),
            clock=Clock.UTC,
            channel="m",
            unit="A m2",
            values=(1.0, 2.0),
        )
    )
    pushed(watch, ticks(1))
    found = [(driver, columns, tries) for _, driver, columns, tries in watch._columns_of()]
    assert found == [
        ("", [0, 1, 2], 1),
        ("", [6], 1),
        ("channel t", [7, 8, 9], 4),
        ("channel t", [10, 11, 12], 4),
        ("channel t", [7, 8, 9, 10, 11, 12], 4),
        ("channel i", [13, 14, 15], 4),
        ("channel m", [16, 17, 18], 4),
        ("channel m", [19, 20, 21], 4),
        ("channel m", [16, 17, 18, 19, 20, 21], 1),
    ]


@pytest.mark.parametrize(
    "change",
    [
        lambda saved: saved.update(_samples=saved["_samples"] + 1),
        lambda saved: saved.update(_zero=[1.0]),
        lambda saved: saved.update(_void=[True]),
        lambda saved: saved.update(_times=[1.0]),
        lambda saved: saved.update(_reach=[1.0, 2.0]),
        lambda saved: saved.update(_topped=[1, 2, 3, 4]),
        lambda saved: saved["_rows"].append([1.0] * 5),
        lambda saved: saved["_rows"].__setitem__(0, [1.0] * 6),
        lambda saved: saved.update(_block=None),
    ],
)
def test_a_memory_whose_parts_do_not_belong_together_is_refused(change: object) -> None:
    watch = ModelWatch(6.0)
    pushed(watch, ticks(70))
    saved = watch.export_state()
    ModelWatch(6.0).restore_state(saved)
    change(saved)  # type: ignore[operator]
    with pytest.raises(SnapshotError):
        ModelWatch(6.0).restore_state(saved)


def test_a_spans_columns_are_orthonormal_and_hold_the_same() -> None:
    columns = np.random.default_rng(9).normal(size=(64, 3)) * [1.0, 1e6, 1e-6]
    columns = np.column_stack([columns, columns[:, 0] + columns[:, 1] * 1e-6])
    span = module._span(columns)
    assert span.shape == (64, 3)
    np.testing.assert_allclose(span.T @ span, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(span @ (span.T @ columns), columns, rtol=1e-6, atol=1e-6)
