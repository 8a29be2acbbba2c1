"""The rows, blocks and windows of the watch against sums written out, and what ends or begins each."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from magcal_service.base.snapshot import SnapshotError
from magcal_service.estimators.interface import Phase, StateEstimate
from magcal_service.model import STATE_SIZE, calibrate, field_jacobian, without_radial_noise
from magcal_service.ticks.assembler import Tick
from magcal_service.watch import residual_watch as module
from magcal_service.watch.residual_watch import (
    BLOCK,
    CHUNK,
    FIRST_EVALUATION,
    TICKS,
    Finding,
    ModelWatch,
)
from magcal_service.wire.messages import Clock, TelemetrySample
from tests.watch.explanations import explained

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
