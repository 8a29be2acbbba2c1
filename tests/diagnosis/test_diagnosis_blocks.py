"""Evidence over blocks: the gain by hand, a dispersion of 1 for a true model, more for one that resembles it."""

from __future__ import annotations

import numpy as np
import pytest

from magcal_service.diagnosis.blocks import correlation_samples, gain_over, numbered, steady_gain

COUNT = 6000
SIGMA = 3.0


def noise(seed: int) -> np.ndarray:
    return SIGMA * np.random.default_rng(seed).standard_normal(COUNT)


def test_the_gain_is_the_drop_in_squares() -> None:
    """d_b = sum (r^2 - q^2) / (2 sigma^2), over all blocks, and the blocks that gain are counted."""
    before, after = np.array([3.0, 1.0, 2.0, 2.0]), np.array([1.0, 1.0, 2.0, 4.0])
    gain = gain_over(before, after, np.array([0, 0, 1, 1]), 2.0)
    assert gain.nats == pytest.approx((9.0 - 1.0 + 4.0 - 16.0) / 4.0)
    assert (gain.seen, gain.expected) == (1, 2)
    # d = (2, -3), e = (1, 1): (1 + 16) / (2 * 2)
    assert gain.dispersion == pytest.approx(17.0 / 4.0)
    assert gain.tempered == pytest.approx(gain.nats / 4.25)


@pytest.mark.parametrize("seed", range(4))
def test_a_true_model_under_white_noise_has_no_dispersion(seed: int) -> None:
    """If the second model is the truth, the gains scatter as it says: a ratio of 1 to within its sampling error."""
    signal = 0.8 * SIGMA * np.sin(0.01 * np.arange(COUNT))
    after = noise(seed)
    gain = gain_over(after + signal, after, numbered(after), SIGMA**2)
    assert gain.dispersion < 1.0 + 4.0 * np.sqrt(2.0 / 50.0)
    assert gain.nats == pytest.approx(float((signal**2).sum()) / (2.0 * SIGMA**2), rel=0.1)
    assert gain.seen >= 0.9 * gain.expected


def test_noise_that_remembers_disperses_by_its_length() -> None:
    """A first-order memory of rho makes sums (1 + rho) / (1 - rho) as wide: 19 for 0.9, seen against a slow signal."""
    rng = np.random.default_rng(7)
    coloured = np.zeros(COUNT)
    for k in range(1, COUNT):
        coloured[k] = 0.9 * coloured[k - 1] + rng.standard_normal()
    signal = 1.5 * np.std(coloured) * np.sin(0.003 * np.arange(COUNT))
    gain = gain_over(coloured + signal, coloured, numbered(coloured), float(np.var(coloured)))
    assert 19.0 / 2.0 < gain.dispersion < 19.0 * 2.0


def test_the_one_block_with_most_does_not_speak_against_what_all_others_bear_out() -> None:
    """A cause shows everywhere, a hundred times as much in one block, where its size is foretold a third wrong."""
    after = noise(21)
    signal = 0.5 * SIGMA * np.sin(0.01 * np.arange(COUNT))
    number = numbered(after)
    event = number == 20
    assert np.count_nonzero(event) == 120
    foretold = np.where(event, 0.65, 1.0)
    cause = np.where(event, 20.0 * signal, signal)
    before, left = after + cause, after + cause * (1.0 - foretold)
    whole = gain_over(before, left, number, SIGMA**2)
    others = steady_gain(before, left, number, SIGMA**2)
    assert whole.tempered < 15.0
    assert others.dispersion < 1.8
    assert others.nats == pytest.approx(float((signal[~event] ** 2).sum()) / (2.0 * SIGMA**2), rel=0.15)


def test_a_block_that_loses_is_not_left_out() -> None:
    before, after = noise(22), noise(22)
    after[:120] += 9.0 * SIGMA
    both = [one(before, after, numbered(noise(22)), SIGMA**2).nats for one in (gain_over, steady_gain)]
    assert both[0] == both[1] < 0.0


def test_a_model_that_only_resembles_the_truth_disperses() -> None:
    """A straight line in the place of a step: where it is wrong, blocks lose what it says they gain."""
    after = noise(11)
    step = np.where(np.arange(COUNT) < COUNT // 2, -3.0 * SIGMA, 3.0 * SIGMA)
    line = np.linspace(-4.5 * SIGMA, 4.5 * SIGMA, COUNT)
    true = gain_over(after + step, after, numbered(after), SIGMA**2)
    false = gain_over(after + step, after + step - line, numbered(after), SIGMA**2)
    assert true.dispersion < 2.0 < 10.0 < false.dispersion


def test_white_residuals_have_fifty_blocks_and_slow_ones_fewer() -> None:
    """Blocks are as long as the residual remembers, between 8 and 50 of them."""
    assert len(np.unique(numbered(noise(3)))) == 50
    slow = np.repeat(np.random.default_rng(5).standard_normal(COUNT // 200), 200)
    assert 8 <= len(np.unique(numbered(slow))) < 20
    assert correlation_samples(noise(3)) < 2.0 < 100.0 < correlation_samples(slow)


def test_rows_of_one_sample_share_a_block() -> None:
    """Three components of a sample are one observation of its time."""
    number = numbered(np.repeat(noise(4), 3), 3)
    assert np.array_equal(number[::3], number[2::3])
