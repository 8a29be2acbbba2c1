"""Tones that wander: found where their frequency moves, absent from noise, along the best of all tracks."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from magcal_service.diagnosis.linear import Workspace
from magcal_service.diagnosis.sweeps import Track, _best_path, _moved, tracks
from magcal_service.model import Array
from magcal_service.physics.scene.scene import Scene

COUNT, PERIOD_S, RATE_HZ = 9000, 2.0, 0.011
TIME_S = PERIOD_S * np.arange(float(COUNT))


def turning() -> Array:
    """(n, 3) directions of the field in a body that spins, and whose axis drifts."""
    polar = 1.1 + 0.6 * np.sin(TIME_S / 2900.0)
    angle = 2.0 * np.pi * RATE_HZ * TIME_S
    return np.stack([np.sin(polar) * np.cos(angle), np.sin(polar) * np.sin(angle), np.cos(polar)], axis=1)


UNIT = turning()
FIELD_NT = 3e4 * UNIT
SCENE = Scene(TIME_S, 0, False, FIELD_NT, FIELD_NT, FIELD_NT, np.full(COUNT, 3e4))


def noise(seed: int) -> Array:
    return np.random.default_rng([8741, seed]).normal(size=COUNT)


def wandering(amplitude: float) -> Array:
    """A field on two axes whose frequency rises from 0.07 to 0.16 Hz and falls again."""
    hz = 0.115 - 0.045 * np.cos(2.0 * np.pi * TIME_S / TIME_S[-1])
    phase = 2.0 * np.pi * PERIOD_S * np.cumsum(hz)
    field = np.outer(np.cos(phase), [0.8, 0.1, 0.5]) + np.outer(np.sin(phase), [-0.3, 0.7, 0.4])
    return amplitude * np.asarray(np.einsum("ni,ni->n", field, UNIT))


def nats(residual: Array, found: Track) -> float:
    """Evidence for a track after what choosing it costs, at a noise of 1."""
    return Workspace(residual, np.ones((COUNT, 1))).gain(found.rows, 1.0).nats - found.cost


def test_a_tone_that_wanders_is_found_where_it_is() -> None:
    """A sixth of the noise, and its frequencies to a bin."""
    residual = noise(0) + wandering(0.55)
    best = max(tracks(SCENE, residual, UNIT, RATE_HZ), key=lambda one: nats(residual, one))
    assert nats(residual, best) > 100.0
    assert best.from_hz == pytest.approx(0.07, abs=0.006)
    assert best.to_hz == pytest.approx(0.16, abs=0.006)


def test_noise_has_no_track() -> None:
    """The most of all tracks is what the cost of choosing it is for."""
    for seed in range(1, 13):
        residual = noise(seed)
        assert max(nats(residual, one) for one in tracks(SCENE, residual, UNIT, RATE_HZ)) < 0.0


def test_nothing_is_sought_near_the_spin_in_few_samples_and_in_passes() -> None:
    """A body's own turning is no tone; windows of a few samples hold none, and those of passes are mostly empty."""
    spinning = np.cos(2.0 * np.pi * RATE_HZ * TIME_S) * UNIT[:, 0]
    for one in tracks(SCENE, spinning, UNIT, RATE_HZ):
        assert one.to_hz < RATE_HZ - 1.2e-3 or one.from_hz > RATE_HZ + 1.2e-3
    few = slice(0, 1000)
    short = Scene(TIME_S[few], 0, False, FIELD_NT[few], FIELD_NT[few], FIELD_NT[few], np.full(1000, 3e4))
    assert tracks(short, noise(1)[few], UNIT[few], RATE_HZ) == []
    apart = TIME_S + 1e6 * (np.arange(COUNT) >= COUNT // 2)
    passes = Scene(apart, 0, False, FIELD_NT, FIELD_NT, FIELD_NT, np.full(COUNT, 3e4))
    assert tracks(passes, noise(1), UNIT, RATE_HZ) == []


def test_the_path_is_the_best_of_all() -> None:
    """Against every path there is, on grids that are small enough to try them."""
    levels, width = 3, 9
    every = list(itertools.product(range(levels), range(width)))
    for seed in range(20):
        power = np.random.default_rng([8742, seed]).exponential(size=(3, levels, width)).astype(np.float32)

        def leads(before: tuple[int, int], into: tuple[int, int]) -> bool:
            ahead = before[1] + _moved(into[0], before[0], levels)
            return abs(into[0] - before[0]) <= 1 and abs(into[1] - ahead) <= 1

        best = max(
            float(power[0][a] + power[1][b] + power[2][c])
            for a, b, c in itertools.product(every, repeat=3)
            if leads(a, b) and leads(b, c)
        )
        path = [(int(level), int(place)) for level, place in _best_path(power)]
        assert all(leads(one, two) for one, two in itertools.pairwise(path))
        assert sum(float(power[window][at]) for window, at in enumerate(path)) == pytest.approx(best, rel=1e-6)
