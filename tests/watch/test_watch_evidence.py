"""Evidence from sums: what least squares over all rows gives."""

from __future__ import annotations

import math

import numpy as np
import pytest

from magcal_service.model import BIAS, D_SCALE
from magcal_service.watch.evidence import Explanation, of_columns, of_course, spectral, without

ROWS = 400


def rows(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Nine sensitivities, two more columns, and a residual that follows them a little."""
    rng = np.random.default_rng(seed)
    nine, more = rng.standard_normal((ROWS, 9)), rng.standard_normal((ROWS, 2))
    more[:, 1] += nine[:, 0]
    return nine, more, nine @ rng.standard_normal(9) + more @ np.array([0.2, -0.1]) + rng.standard_normal(ROWS)


def least_squares_gain(residual: np.ndarray, before: np.ndarray, after: np.ndarray) -> float:
    left = [np.linalg.lstsq(columns, residual, rcond=None)[1][0] for columns in (before, after)]
    return 0.5 * len(residual) * math.log(left[0] / left[1])


def test_the_gain_of_columns_is_that_of_least_squares() -> None:
    nine, more, residual = rows(1)
    table = np.column_stack([nine, more, residual])
    expected = least_squares_gain(residual, nine, np.column_stack([nine, more]))
    assert of_columns(without(table.T @ table), [0, 1], ROWS) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("part", [BIAS, D_SCALE], ids=["bias", "scale"])
def test_the_gain_of_a_course_is_that_of_least_squares(part: slice) -> None:
    """A step and a line over eight blocks, from the blocks' sums alone."""
    nine, _, residual = rows(2)
    block = np.repeat(np.arange(8), ROWS // 8)
    basis = np.stack([np.arange(8) >= 3, np.arange(8) / 8.0], axis=1)
    table = np.column_stack([nine, residual])
    blocks = np.array([table[block == k].T @ table[block == k] for k in range(8)])
    after = np.column_stack([nine, *(nine[:, part] * basis[block, q, None] for q in range(2))])
    expected = least_squares_gain(residual, nine, after)
    assert of_course(blocks, part, basis, ROWS) == pytest.approx(expected, rel=1e-9)


def test_a_column_that_the_nine_errors_absorb_gains_nothing() -> None:
    """A rest at the level of rounding is no column: divided by it, noise would look like evidence."""
    nine, more, residual = rows(3)
    more[:, 0] = nine @ np.arange(1.0, 10.0) + 1e-6 * more[:, 1]
    table = np.column_stack([nine, more[:, :1], residual])
    assert of_columns(without(table.T @ table), [0], ROWS) == 0.0


def named(explanations: list[Explanation], samples: int) -> str:
    return max(explanations, key=lambda one: one.score(samples)).effects[0]


def test_spectra_of_a_line_and_of_a_memory_are_told_apart() -> None:
    """Expected spectra, 80 chunks long: one bin high is a tone, a slope is a memory; a flat one is neither."""
    share = 80.0 * np.r_[0.5, np.ones(31), 0.5]
    line = share * (1.0 + 1.5 * (np.arange(33) == 12))
    angle = np.pi * np.arange(33) / 32
    memory = share / (1.25 - np.cos(angle))
    assert named(spectral(line, share)[0], 5120) == "tone"
    found, raised = spectral(memory, share)
    assert named(found, 5120) == "coloured_noise"
    assert raised == pytest.approx(3.0, rel=0.35)  # (1 + r) / (1 - r) at r = 0.5
    flat, raised = spectral(share, share)
    assert max(one.score(5120) for one in flat) < 0.0
    assert raised == 1.0
