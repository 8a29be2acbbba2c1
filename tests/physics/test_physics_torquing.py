"""Torquers that nobody recorded: what their search proposes, against patterns made here by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from magcal_service.diagnosis.explain import Search
from magcal_service.diagnosis.problem import Problem
from magcal_service.diagnosis.screen import ACCEPTED_NATS, hypotheses_of
from magcal_service.diagnosis.solution import solve
from magcal_service.model import Array, measure
from magcal_service.physics.catalogue import effect_named
from magcal_service.physics.interface import Hypothesis
from magcal_service.physics.scene.scene import Scene
from magcal_service.physics.segments import Segments
from tests.physics.scenes import COUNT, NOISE_NT, RATE_RAD_S, X, scene, spoiled

TORQUER = effect_named("torquer")
COILS_NT = np.array([[90.0, -30.0, 20.0], [10.0, 120.0, -40.0], [-60.0, 15.0, 70.0]])
STRETCH = (2000.0, 5200.0)


def silent(of: Scene) -> Scene:
    """Without any telemetry."""
    return replace(of, channels={})


def searched(disturbance_nt: Array, variant: str) -> tuple[Hypothesis, Array, float]:
    """A form of torquer, its numbers and nats, on a clean craft with a field (n, 3) added."""
    noise = np.random.default_rng(4).normal(0.0, NOISE_NT, (COUNT, 3))
    clean = scene()
    flown = silent(spoiled(measure(X, clean.calibrated_nt + disturbance_nt + noise), clean))
    problem = Problem(flown, NOISE_NT)
    baseline = solve(problem, X)
    search = Search(problem, [h for h in hypotheses_of([TORQUER], problem) if h.variant == variant], [TORQUER])
    best = search.screen(search.workspace(baseline), baseline, baseline.rms_nt)[0]
    return best.hypothesis, best.theta, best.nats


def detumbling_nt() -> Array:
    """Full coils against dB/dt, 8 s of every 20 s, between two instants; dB/dt by the exact turn of the field."""
    at = scene()
    slope = -np.cross(RATE_RAD_S * np.array([0.36, 0.48, 0.8]), at.calibrated_nt)
    cycle = np.floor(at.time_s / 20.0)
    begins = np.minimum((cycle * 5).astype(np.intp), COUNT - 1)  # five samples a cycle
    on = (at.time_s - 20.0 * cycle < 8.0) & (at.time_s >= STRETCH[0]) & (at.time_s < STRETCH[1])
    return np.asarray((-np.sign(slope[begins]) * on[:, None]) @ COILS_NT.T)


def dumping_nt() -> Array:
    """A dipole along B x h for 130 s every 520 s, as it follows the field."""
    at = scene()
    dipole = np.cross(at.unit, [0.3, -0.8, 0.52]) * (np.mod(at.time_s - 90.0, 520.0) < 130.0)[:, None]
    return np.asarray(dipole @ (5.0 * COILS_NT.T))


def test_detumbling_for_a_part_of_the_time_is_found_with_its_cycle_and_its_part() -> None:
    """8 s of every 20 s, from 2000 to 5200 s: the cycle comes out exactly, the ends to a twentieth of the recording."""
    _, theta, nats = searched(detumbling_nt(), "sign of dB/dt on a duty")
    assert nats > 5.0 * ACCEPTED_NATS
    assert theta[0] == pytest.approx(20.0)
    assert theta[1] == pytest.approx(0.4, abs=0.11)
    assert theta[4:] == pytest.approx(STRETCH, abs=0.05 * COUNT * 4.0)


def test_dumped_momentum_is_found_with_its_interval() -> None:
    """130 s of every 520 s: the interval comes out to half a per cent, the share to a twentieth."""
    _, theta, nats = searched(dumping_nt(), "momentum dumped at intervals")
    assert nats > 5.0 * ACCEPTED_NATS
    assert theta[0] == pytest.approx(520.0, rel=0.005)
    assert theta[1] == pytest.approx(0.25, abs=0.05)


@pytest.mark.parametrize("variant", ["sign of dB/dt on a duty", "momentum dumped at intervals"])
def test_nothing_is_proposed_on_a_craft_without_torquers(variant: str) -> None:
    """White noise alone leaves the best of all patterns below what counts."""
    assert searched(np.zeros((COUNT, 3)), variant)[2] < ACCEPTED_NATS


def test_sums_over_stretches_give_the_drop_of_columns_that_are_made() -> None:
    """Any choice of stretches: the drop in squares is that of a least-squares fit of gated columns."""
    rng = np.random.default_rng(8)
    model, columns, residual = rng.normal(size=(400, 5)), rng.normal(size=(400, 3)), rng.normal(size=400)
    basis = np.linalg.qr(model)[0]
    left = residual - basis @ (basis.T @ residual)
    firsts = np.arange(0, 400, 50)
    parts = [slice(first, first + 50) for first in firsts.tolist()]
    scaled = columns / np.sqrt(np.mean(columns**2, axis=0))
    segments = Segments(
        np.stack([scaled[part].T @ scaled[part] for part in parts]),
        np.stack([basis[part].T @ scaled[part] for part in parts]),
        np.stack([scaled[part].T @ left[part] for part in parts]),
    )
    chosen = np.array([[1, 1, 0, 0, 1, 0, 0, 1], [0, 1, 1, 1, 0, 0, 0, 0]], dtype=float)
    for row, drop in zip(chosen, segments.drop(chosen), strict=True):
        both = np.concatenate([model, columns * np.repeat(row, 50)[:, None]], axis=1)
        after = residual - both @ np.linalg.lstsq(both, residual, rcond=None)[0]
        assert drop == pytest.approx(float(left @ left - after @ after), rel=1e-4)
