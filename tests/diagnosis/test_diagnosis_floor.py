"""The noise that a diagnosis says is one number everywhere, and holds nothing of a fast cause that was found."""

from __future__ import annotations

import json

import numpy as np
import pytest

from magcal_service.diagnosis.content import as_json
from magcal_service.diagnosis.diagnose import diagnose
from magcal_service.diagnosis.handover import model_of
from magcal_service.diagnosis.result import entries, held_out_rms
from magcal_service.diagnosis.summary import summary
from magcal_service.recordings.recording import Recording

NOISE_NT = 60.0


def switching(noise_nt: float | None) -> Recording:
    """A coil that is switched from sample to sample beside a sensor that tumbles."""
    count = 3000
    rng = np.random.default_rng(3)
    time_s = np.arange(count) * 1.0
    orbit, spin, tumble = (2.0 * np.pi * time_s / period_s for period_s in (5400.0, 41.0, 700.0))
    x, y, z = 30e3 * np.cos(orbit) + 5e3, 15e3 * np.sin(2.0 * orbit), 25e3 * np.sin(orbit)
    x, y = np.cos(spin) * x + np.sin(spin) * y, np.cos(spin) * y - np.sin(spin) * x
    y, z = np.cos(tumble) * y + np.sin(tumble) * z, np.cos(tumble) * z - np.sin(tumble) * y
    reference_nt = np.stack([x, y, z], axis=-1)
    current = rng.choice([0.0, 1.0], count)
    made = current[:, None] * np.array([150.0, 80.0, -60.0]) + rng.normal(0.0, NOISE_NT, (count, 3))
    channels = {"coil": (current, "A")}
    return Recording.from_arrays(time_s, reference_nt + made, reference_nt, noise_nt=noise_nt, channels=channels)


@pytest.mark.parametrize("noise_nt", [None, NOISE_NT])
def test_the_noise_is_the_sensors_in_all_that_is_said_and_handed_over(noise_nt: float | None) -> None:
    """With nine errors alone the switched coil made it 79 nT where it was not stated, of 60."""
    diagnosis = diagnose(switching(noise_nt))
    found = entries(diagnosis)
    told = " ".join(" ".join(summary(diagnosis, found, held_out_rms(diagnosis), ())).split())
    noise = json.loads(as_json(diagnosis, found))["fit"]["noise_floor_nt"]
    assert told.startswith("verdict: named")
    assert noise == pytest.approx(NOISE_NT, rel=0.0 if noise_nt else 0.03)
    assert f"noise {noise:.1f} nT {'stated' if noise_nt else 'estimated'}" in told
    assert model_of(diagnosis, found, "switching").noise_nt == noise
    assert (diagnosis.prepared.problem.noise_nt > 1.2 * NOISE_NT) is (noise_nt is None)
