"""How wrong the vector was and is, on vectors whose errors are known by hand."""

from __future__ import annotations

import numpy as np
import pytest

from magcal_service.wire.messages import Estimate, Verdict
from sim_sensor.demo.before_after import before_after
from sim_sensor.simulation import Block

VARIANCES = (16.0, 9.0, 9.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def estimate(bias_nt: tuple[float, float, float]) -> Estimate:
    covariance = tuple(VARIANCES[row] if row == column else 0.0 for row in range(9) for column in range(row, 9))
    return Estimate(
        craft="sat", source="magcal", sequence=0, time_ns=1, method="ukf", tick=1, bias_nt=bias_nt, D=(0.0,) * 6,
        covariance=covariance, verdict=Verdict.TRUSTED, residual_rms_nt=0.0, noise_nt=1.0, samples_used=1,
        protection_nt=209.0, protection_by="gain_step",
    )  # fmt: skip


def test_errors_before_and_after_against_a_known_bias() -> None:
    field = np.array([[30000.0, 0.0, 0.0], [0.0, 40000.0, 0.0]])
    bias = np.array([3000.0, 4000.0, 0.0])
    noise = np.array([[0.0, 0.0, 10.0], [0.0, 0.0, -10.0]])
    attitude, biases = np.tile(np.eye(3), (2, 1, 1)), np.tile(bias, (2, 1))
    flown = Block(np.arange(2), field + bias + noise, field, field, attitude, biases, np.zeros((2, 6)))
    found = before_after(flown, estimate((3003.0, 4004.0, 0.0)))
    assert (found.nine_rms.raw_nt, found.nine_rms.calibrated_nt) == pytest.approx((5000.0, 5.0))
    assert found.sample_rms.calibrated_nt == pytest.approx(np.sqrt(5.0**2 + 10.0**2))
    assert found.residual_rms.calibrated_nt == pytest.approx(np.sqrt((3.0**2 + 4.0**2) / 2.0), abs=0.01)
    assert found.bound_nt == pytest.approx(12.0)
    assert "was 5000 nT off by its nine errors, and is 5.0 nT off now" in found.text()
    assert "209 nT for what is not seen yet (gain_step;" in found.text()
    assert max(map(len, found.text().splitlines())) <= 80
