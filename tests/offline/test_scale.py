"""A factor that all axes share: a wrong unit, or a sensor."""

from pathlib import Path

import numpy as np
import pytest

import magcal_service as magcal
from magcal_service.cli.calibrate import _table
from magcal_service.offline.calibrate import calibrate
from magcal_service.offline.scale import scale_doubt
from tests.offline.hand_turned import hand_turned

SIGMA = np.diag([100.0**2] * 3 + [0.01**2] * 6)


def errors(*diagonal: float, off: float = 0.0) -> np.ndarray:
    return np.array([3000.0, -2000.0, 500.0, *diagonal, off, off, -off])


@pytest.mark.parametrize(
    ("x", "said"),
    [
        (errors(0.58, 0.53, 0.56), "too little alike, by a factor of 1.56"),
        (errors(-0.36, -0.34, -0.37), "too much alike, by a factor of 1.55"),
        (errors(9.0, 9.1, 8.9), "too little alike, by a factor of 10.00"),
        (errors(0.10, -0.05, 0.02), ""),  # a sensor
        (errors(0.27, 0.24, 0.30), ""),  # a poor one, or a wrong reference
        (errors(0.58, 0.10, 0.56), ""),  # no unit does that to two axes
        (errors(-1.4, -1.4, -1.4), ""),  # a mirror
    ],
)
def test_only_a_factor_beyond_a_sensor_on_all_axes_is_remarked(x: np.ndarray, said: str) -> None:
    text = scale_doubt(x, SIGMA)
    assert (said in text) if said else text == ""


def test_an_estimate_that_is_not_sure_says_nothing() -> None:
    assert scale_doubt(errors(0.58, 0.53, 0.56), 100.0 * SIGMA) == ""


@pytest.mark.parametrize("unit", [1.0, 1.0 / 1.5])
def test_a_calibration_says_so_on_screen_and_in_its_json(unit: float, tmp_path: Path) -> None:
    """Counts of 0.15 uT that were called mG."""
    time_s, field_nt, magnitude_nt = hand_turned(3)
    result = calibrate(magcal.Recording.from_arrays(time_s, unit * field_nt, magnitude_nt, noise_nt=100.0))
    said = unit != 1.0
    assert (result.to_dict()["scale_doubt"] != "") is said
    assert ("scale: all axes read too little alike" in _table(result, tmp_path / "RECORDING.toml")) is said
