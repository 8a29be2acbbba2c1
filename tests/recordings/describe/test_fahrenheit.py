"""A cold craft's degF under a name of degC, or under none, is asked about; degC stay degC."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from magcal_service.recordings.describe.describe import Described, describe
from tests.recordings.describe import maker_logs
from tests.recordings.describe.test_doubts import question

FloatArray = npt.NDArray[np.float64]

FIELD = maker_logs.ground(400)
ORBIT = 2.0 * np.pi * np.arange(400) / 180.0
COLD = -12.0 + 9.0 * np.sin(ORBIT)
ROOM = 22.0 + 1.5 * np.sin(0.3 * ORBIT)
KEY = "channels.temperature.unit"


def degf(degc: FloatArray) -> FloatArray:
    return 1.8 * degc + 32.0


def written(folder: Path, name: str, cells: list[str], second: tuple[str, FloatArray] | None = None) -> Described:
    """A log with a temperature, and a second one."""
    rows = []
    for i, (vector, cell) in enumerate(zip(FIELD, cells, strict=True)):
        row = [f"{0.5 * i}", *(f"{value:.1f}" for value in vector), cell]
        rows.append(",".join(row + ([f"{second[1][i]:.2f}"] if second else [])))
    log = folder / "log.csv"
    log.write_text("\n".join([f"t_s,mx_nT,my_nT,mz_nT,{name}{',' + second[0] if second else ''}", *rows]))
    return describe(log, {"reference": "49.2 uT"})


@pytest.mark.parametrize("name", ["temp", "temp_degC"])
@pytest.mark.parametrize(("steps", "digits"), [(1, 1), (2, 1), (4, 2), (8, 2), (16, 2), (16, 4)])
@pytest.mark.parametrize("true", [COLD, ROOM - 8.0], ids=["cold", "cool"])
def test_the_steps_of_a_thermometer_show_degf(
    name: str, steps: int, digits: int, true: FloatArray, tmp_path: Path
) -> None:
    true = true if steps > 2 or true is COLD else true + 4.0 * np.sin(ORBIT)  # eight values at least
    stepped = np.round(true * steps) / steps
    asked = question(written(tmp_path, name, [f"{value:.{digits}f}" for value in degf(stepped)]), KEY)
    assert "degC turned into degF" in asked
    assert "could be degF" in asked.splitlines()[1]
    right = written(tmp_path, name, [f"{value:.{digits}f}" for value in stepped])
    assert not question(right, KEY)
    assert 'unit = "degC"' in (right.text or "")


@pytest.mark.parametrize("name", ["temp", "temp_degC"])
@pytest.mark.parametrize(("lag", "gain", "offset"), [(0, 1.0, 0.0), (3, 1.05, 1.0), (6, 0.95, -2.0)])
def test_another_channel_shows_degf(name: str, lag: int, gain: float, offset: float, tmp_path: Path) -> None:
    board = -12.0 + 9.0 * gain * np.sin(ORBIT - 0.03 * lag) + offset
    noisy = degf(board + np.random.default_rng(4).normal(0.0, 0.2, 400))
    asked = question(written(tmp_path, name, [f"{value:.1f}" for value in noisy], ("batt_temp_degC", COLD)), KEY)
    assert "it is what 'batt_temp_degC' has in degC, in degF" in asked


@pytest.mark.parametrize("name", ["temp", "temp_degC"])
@pytest.mark.parametrize("middle", [-25.0, -12.0, 0.0, 20.0, 30.0])
@pytest.mark.parametrize("gain", [0.4, 1.0, 1.8, 2.5])
@pytest.mark.parametrize("digits", [1, 2, 4])
def test_degc_of_two_places_stay_so(name: str, middle: float, gain: float, digits: int, tmp_path: Path) -> None:
    panel = middle + 9.0 * gain * np.sin(ORBIT) + np.random.default_rng(6).normal(0.0, 0.2, 400)
    cells = [f"{value:.{digits}f}" for value in panel]
    result = written(tmp_path, name, cells, ("batt_temp_degC", middle + 9.0 * np.sin(ORBIT)))
    asked = question(result, KEY)
    assert "turned into degF" not in asked
    assert "in degC, in degF" not in asked


def test_degc_that_no_name_says_come_with_what_degf_would_be(tmp_path: Path) -> None:
    result = written(tmp_path, "temp", [f"{value:.3f}" for value in ROOM])
    (line,) = (line for line in result.said if line.startswith("channels.temperature"))
    assert "; in degF it would be -6.27 to -4.72 degC" in line
