"""What the summary says of a noise level that was taken with the nine errors alone, with a fast cause in it."""

from __future__ import annotations

import numpy as np
import pytest

from magcal_service.diagnosis.diagnose import diagnose
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
def test_less_than_the_noise_is_left_only_where_it_held_the_cause(noise_nt: float | None) -> None:
    diagnosis = diagnose(switching(noise_nt))
    lines = summary(diagnosis, entries(diagnosis), held_out_rms(diagnosis), ())
    assert lines[0].startswith("verdict: named")
    assert any("this noise was taken with nine errors alone" in line for line in lines) is (noise_nt is None)
