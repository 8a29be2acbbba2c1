"""Estimates as a converging filter would send them, for tests of what is shown."""

from __future__ import annotations

import numpy as np

from magcal_service.wire.messages import Estimate, Verdict
from sim_sensor.view.history import History

TRUTH = (5000.0, 3000.0, 4000.0, 0.05, 0.10, 0.05, 0.05, 0.05, 0.05)
START_NS = 1_750_000_000_000_000_000
FINAL_SIGMA = (3.0, 3.0, 4.0, *(2e-4,) * 6)


def estimate(
    x: tuple[float, ...],
    sigma: tuple[float, ...],
    *,
    time_s: float = 100.0,
    verdict: Verdict = Verdict.TRUSTED,
    reasons: tuple[str, ...] = (),
    remedy: str = "",
    residual_rms_nt: float = 301.0,
) -> Estimate:
    """One estimate with a diagonal covariance."""
    covariance = np.diag(np.square(sigma))[np.triu_indices(9)]
    return Estimate(
        craft="paper",
        source="magcal",
        sequence=int(time_s),
        time_ns=START_NS + round(time_s * 1e9),
        method="ukf",
        tick=int(time_s),
        bias_nt=(x[0], x[1], x[2]),
        D=(x[3], x[4], x[5], x[6], x[7], x[8]),
        covariance=tuple(covariance.tolist()),
        verdict=verdict,
        reasons=reasons,
        remedy=remedy,
        residual_rms_nt=residual_rms_nt,
        noise_nt=300.0,
        samples_used=int(time_s),
    )


def converging(seconds: int = 3000, seed: int = 1, known: bool = True) -> History:
    """A history whose errors follow sigma = final * sqrt(seconds / t) with one fixed draw per parameter."""
    rng = np.random.default_rng(seed)
    history = History(START_NS)
    final = np.array(FINAL_SIGMA)
    draw, wave = rng.uniform(-1.5, 1.5, 9), rng.uniform(0.0, 6.28, 9)
    for t in range(1, seconds + 1):
        sigma = final * np.sqrt(seconds / t) * (1.0 + 400.0 * np.exp(-t / (0.02 * seconds)))
        x = np.array(TRUTH) + sigma * (draw + 0.5 * np.sin(wave + 30.0 * np.log(t)))
        verdict = Verdict.TRUSTED if t > seconds // 5 else Verdict.CONVERGING
        message = estimate(tuple(x), tuple(sigma), time_s=float(t), verdict=verdict, residual_rms_nt=300.0 + 9e4 / t)
        history.add(message, TRUTH if known else None)
    return history
