"""Projections, evidence and held-out blocks against the same numbers worked out the long way."""

from __future__ import annotations

import numpy as np
import pytest

from magcal_service.diagnosis.linear import BLOCKS, FOLDS, Workspace, evidence, fold_solutions, folds
from magcal_service.model import Array

SIGMA = 3.0


def drawn(seed: int, count: int, *widths: int) -> tuple[Array, ...]:
    """A residual (m,) of unit noise times ``SIGMA``, and columns of each width (m, k), far from orthogonal."""
    rng = np.random.default_rng(seed)
    common = rng.normal(size=count)
    parts = [rng.normal(size=(count, width)) + 0.7 * common[:, None] for width in widths]
    return SIGMA * rng.normal(size=count), *parts


def log_marginal(residual: Array, columns: Array, spread: float) -> float:
    """ln p(residual) with amplitudes of prior sigma ``spread`` integrated out, by the dense covariance."""
    covariance = SIGMA**2 * np.eye(len(residual)) + spread**2 * columns @ columns.T
    logarithm = float(np.linalg.slogdet(2.0 * np.pi * covariance)[1])
    return -0.5 * (logarithm + float(residual @ np.linalg.solve(covariance, residual)))


def test_evidence_is_the_marginal_likelihood_at_its_best_spread() -> None:
    """ln E is the largest ln p(with) - ln p(without) over prior spreads, to the coarseness of the spreads tried."""
    for seed in range(4):
        noise, columns = drawn(seed, 60, 3)
        residual = noise + columns @ np.array([4.0, -2.0, 1.0])
        found = evidence(columns.T @ columns, columns.T @ residual, np.ones(3), SIGMA)
        alone = log_marginal(residual, columns, 0.0)
        direct = max(log_marginal(residual, columns, spread) for spread in np.geomspace(0.1, 100.0, 150)) - alone
        assert found.nats == pytest.approx(direct, abs=0.05)


def test_evidence_for_noise_is_small() -> None:
    """Columns that explain nothing gain next to nothing, however many there are."""
    gains = []
    for seed in range(20):
        residual, columns = drawn(100 + seed, 80, 6)
        gains.append(evidence(columns.T @ columns, columns.T @ residual, np.ones(6), SIGMA).nats)
    assert max(gains) < 5.0
    assert float(np.median(gains)) < 0.5


def test_evidence_pays_for_amplitudes_that_the_data_do_not_need() -> None:
    """The same signal is worth less with three idle columns beside it."""
    residual, columns, idle = drawn(3, 400, 1, 3)
    residual = residual + columns @ np.array([1.0])
    both = np.concatenate([columns, idle], axis=1)
    narrow = evidence(columns.T @ columns, columns.T @ residual, np.ones(1), SIGMA)
    wide = evidence(both.T @ both, both.T @ residual, np.ones(4), SIGMA)
    assert narrow.nats > wide.nats + 1.0


def test_gain_is_the_drop_of_an_explicit_fit() -> None:
    """Squares and amplitudes are those of least squares with the model beside, where data outweigh the prior."""
    residual, model, columns = drawn(7, 500, 9, 3)
    residual = residual + columns @ np.array([30.0, -50.0, 20.0]) + model @ np.arange(9.0)
    gain = Workspace(residual, model).gain(columns, SIGMA)
    both = np.concatenate([model, columns], axis=1)
    solution, squares = np.linalg.lstsq(both, residual, rcond=None)[:2]
    before = np.linalg.lstsq(model, residual, rcond=None)[1]
    assert gain.squares == pytest.approx(float(before[0] - squares[0]), rel=1e-6)
    assert gain.amplitudes == pytest.approx(solution[9:], rel=2e-3)
    assert gain.effective == pytest.approx(3.0, abs=0.01)


def test_gain_knows_no_unit() -> None:
    """Columns in another unit give the same evidence, and amplitudes in the other unit."""
    residual, model, columns = drawn(8, 300, 4, 3)
    residual = residual + columns @ np.array([1.0, 2.0, -1.0])
    units = np.array([1e-6, 1.0, 1e5])
    space = Workspace(residual, model)
    one, other = space.gain(columns, SIGMA), space.gain(columns * units, SIGMA)
    assert other.nats == pytest.approx(one.nats, rel=1e-9)
    assert other.amplitudes * units == pytest.approx(one.amplitudes, rel=1e-9)


def test_columns_of_the_model_gain_nothing() -> None:
    """What the model holds already is worth nothing, to rounding."""
    residual, model = drawn(9, 300, 5)
    gain = Workspace(residual, model).gain(model[:, :3] * 2.0 + model[:, 3:4], SIGMA)
    assert gain.nats == pytest.approx(0.0, abs=1e-6)
    assert gain.squares == pytest.approx(0.0, abs=1e-6)


def test_a_model_of_linearly_dependent_columns_is_no_fault() -> None:
    """A column that comes twice, or is zero, changes neither residual nor gain."""
    residual, model, columns = drawn(10, 200, 3, 2)
    doubled = np.concatenate([model, model[:, :1], np.zeros((200, 1))], axis=1)
    once, twice = Workspace(residual, model), Workspace(residual, doubled)
    assert twice.residual == pytest.approx(once.residual, abs=1e-9)
    assert twice.gain(columns, SIGMA).nats == pytest.approx(once.gain(columns, SIGMA).nats, abs=1e-9)


def test_gated_gains_are_those_of_each_instant_by_itself() -> None:
    """Columns that set in at a row gain what ``gain`` gives for columns with zeros before it."""
    residual, model, columns = drawn(11, 240, 9, 3)
    rows = np.array([1, 40, 41, 133, 220])
    residual[133:] += columns[133:] @ np.array([2.0, -3.0, 1.0])
    space = Workspace(residual, model)
    for row, found in zip(rows.tolist(), space.gated(columns, rows, SIGMA), strict=True):
        late = columns * (np.arange(240) >= row)[:, None]
        inside = late - model @ np.linalg.lstsq(model, late, rcond=None)[0]
        scale = np.sqrt(np.mean(columns**2, axis=0))
        alone = evidence(inside.T @ inside / np.outer(scale, scale), late.T @ space.residual / scale, scale, SIGMA)
        assert found.nats == pytest.approx(alone.nats, rel=1e-6)
        assert found.amplitudes == pytest.approx(alone.amplitudes, rel=1e-6)


def test_gated_gains_peak_where_the_change_is() -> None:
    """The best of the instants is the true one, to two samples."""
    residual, model, columns = drawn(12, 400, 3, 2)
    residual[250:] += columns[250:] @ np.array([9.0, -9.0])
    rows = np.arange(5, 395)
    gains = Workspace(residual, model).gated(columns, rows, SIGMA)
    assert abs(int(rows[np.argmax([gain.nats for gain in gains])]) - 250) <= 2


def test_folds_are_contiguous_blocks_dealt_out_in_turn() -> None:
    """Every fold holds a tenth of the fifty blocks, each block one stretch of rows."""
    numbers = folds(np.arange(5000.0))
    changes = np.flatnonzero(np.diff(numbers)) + 1
    assert len(changes) == BLOCKS - 1
    assert np.array_equal(changes, np.arange(1, BLOCKS) * 100)
    assert np.bincount(numbers).tolist() == [5000 // FOLDS] * FOLDS


def test_the_solution_of_a_fold_is_the_refit_without_it() -> None:
    """Each fold's solution is the least-squares fit to the rows of the others."""
    residual, columns = drawn(13, 500, 4)
    residual = residual + columns @ np.array([5.0, 1.0, -2.0, 0.5])
    fold = folds(np.arange(500.0))
    found = fold_solutions(residual, columns, fold, np.zeros(4))
    for number in range(FOLDS):
        out = fold == number
        solution = np.linalg.lstsq(columns[~out], residual[~out], rcond=None)[0]
        assert found[number] == pytest.approx(solution, abs=1e-9)


def test_the_solution_of_a_fold_respects_the_tie() -> None:
    """A tie is a ridge: refits with it in the normal matrix give the same rows."""
    residual, columns = drawn(14, 300, 3)
    residual, fold, tie = residual + columns @ np.ones(3), folds(np.arange(300.0)), np.array([50.0, 0.0, 500.0])
    found = fold_solutions(residual, columns, fold, tie)
    out = fold == 2
    part = columns[~out]
    solution = np.linalg.solve(part.T @ part + np.diag(tie), part.T @ residual[~out])
    assert found[2] == pytest.approx(solution, abs=1e-9)


def test_fold_solutions_rms_grows_with_idle_columns() -> None:
    """Columns that only fit noise lower the residual inside and raise it on held-out blocks."""
    residual, idle = drawn(15, 400, 40)
    inside = Workspace(residual, idle).squares
    fold = folds(np.arange(400.0))
    solutions = np.stack(fold_solutions(residual, idle, fold, np.zeros(40)))
    outside = residual - np.einsum("mp,mp->m", idle, solutions[fold])
    assert inside < float(residual @ residual) < float(outside @ outside)


@pytest.mark.parametrize("stretches", [7, 300])
def test_sums_over_few_and_many_stretches_are_those_of_their_rows(stretches: int) -> None:
    """Of columns of unit rms, with one another, with the model's basis and with the residual; the first rows are in
    none."""
    residual, model, columns = drawn(21, 900, 4, 2)
    space = Workspace(residual, model)
    first = np.linspace(20, 900, stretches, endpoint=False).astype(np.intp)
    found = space.segments(columns, first)
    columns = columns / np.sqrt(np.mean(columns**2, axis=0))
    for number, (low, high) in enumerate(zip(first, np.append(first[1:], 900), strict=True)):
        rows = slice(low, high)
        assert found.normal[number] == pytest.approx(columns[rows].T @ columns[rows])
        assert found.right[number] == pytest.approx(columns[rows].T @ space.residual[rows])
    whole = columns[20:].T @ columns[20:] - found.normal.sum(axis=0)
    assert whole == pytest.approx(np.zeros((2, 2)), abs=1e-9)
    inside = found.inside.sum(axis=0)
    basis = np.linalg.qr(model)[0][20:]
    assert inside.T @ inside == pytest.approx(columns[20:].T @ basis @ basis.T @ columns[20:])


class Noiseless:
    """A whitening that leaves rows as they are."""

    def white(self, rows: Array) -> Array:
        return rows

    def white_products(self, rows: Array) -> Array:
        return np.asarray(rows.T @ rows)


def test_products_of_so_many_rows_that_they_are_summed_in_parts_are_those_of_all_rows() -> None:
    residual, model, columns = drawn(9, 20_011, 20, 3)
    space = Workspace(residual, model)
    before = space.products_before(columns, Noiseless())
    left = columns - model @ np.linalg.lstsq(model, columns, rcond=None)[0]
    for found in (space.products(columns), before):
        assert found.normal * np.outer(found.scale, found.scale) == pytest.approx(left.T @ left, rel=1e-9, abs=1e-6)
        assert found.right * found.scale == pytest.approx(left.T @ residual, rel=1e-9, abs=1e-6)
