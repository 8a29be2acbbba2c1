"""What is found on a recording holds for every command: the same rows, the same verdict, no physics out of a defect."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from magcal_service.recordings.inspect.inspection import inspect
from magcal_service.recordings.reader import read_recording
from tests.cli.cli_inputs import run
from tests.diagnosis.diagnosis_runs import undrawn
from tests.recordings.inspect.clean_logs import CleanLog, Kind, clean_log

CASES = Path(__file__).resolve().parents[3] / "shared" / "cases"
TUMBLING = Kind(rates_deg_s=(1.7, 0.9), reference="magnitude", place="none", channels=False)
ROWS = 1800
D_ROWS, D_COLUMNS = [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]
TRUTH = np.array([*TUMBLING.bias_nt, *TUMBLING.D])


def zeros(log: CleanLog, share: float) -> CleanLog:
    rows = np.random.default_rng(3).random(len(log.time_ns)) < share
    return log.spoiled("mx my mz", lambda column: np.where(rows, 0.0, column))


def spoiled(case: str, noise_stated: bool) -> CleanLog:
    kind = Kind(**{**TUMBLING.__dict__, "rows": ROWS, "noise_stated": noise_stated})
    if case == "held":
        kind = Kind(**{**kind.__dict__, "rows": 2 * ROWS, "step_s": 0.5})
        held = np.arange(2 * ROWS) // 3 * 3
        return clean_log(kind).spoiled("mx my mz", lambda column: column[held])
    if case == "sentinel":
        return clean_log(kind).spoiled("mx my mz", lambda column: np.where(np.arange(ROWS) % 40 == 7, -9999.0, column))
    return zeros(clean_log(kind), {"one zero": 0.001, "zeros": 0.3}[case])


def verdicts(path: Path, folder: Path) -> tuple[list[tuple[int, bool, list[str]]], str]:
    """Exit code, trust and the codes of the findings of calibrate and diagnose; what replay says."""
    folder.mkdir()
    calibrated = run("calibrate", path, "--json", folder / "calibrated.json")
    with undrawn():
        diagnosed = run("diagnose", path, "--out", folder)
    found = []
    for done, file in ((calibrated, "calibrated.json"), (diagnosed, "diagnosis.json")):
        content = json.loads((folder / file).read_text())
        found.append((done.code, content["trusted"], [one["code"] for one in content["findings"]]))
    replayed = run("replay", path)
    assert replayed.code == calibrated.code
    assert all(code in replayed.out for code in found[0][2])
    return found, replayed.out


@pytest.mark.parametrize(
    ("case", "code", "noise_stated"),
    [
        ("one zero", "zero_rows", True),
        ("zeros", "zero_rows", True),
        ("zeros", "zero_rows", False),
        ("held", "held_readings", False),
        ("sentinel", "sentinel", True),
    ],
)
def test_what_is_certain_is_left_out_by_every_command(case: str, code: str, noise_stated: bool, tmp_path: Path) -> None:
    path = spoiled(case, noise_stated).write(tmp_path)
    found, _ = verdicts(path, tmp_path / "out")
    assert found == [(0, True, [code]), (0, True, [code])]
    assert json.loads((tmp_path / "out" / "diagnosis.json").read_text())["verdict"] == "none"
    result = json.loads((tmp_path / "out" / "calibrated.json").read_text())
    error = np.array([*result["bias_nt"], *np.array(result["D"])[D_ROWS, D_COLUMNS]]) - TRUTH
    assert error @ np.linalg.solve(result["covariance"], error) < 28.0  # chi-squared of 9: once in 1000
    assert result["residual_rms_nt"]["after"] == pytest.approx(50.0, rel=0.1)
    assert result["residual_rms_nt"]["noise_floor"] == pytest.approx(50.0, rel=0.1)


def test_what_is_likely_is_answered_first_and_nothing_is_named(tmp_path: Path) -> None:
    kind = Kind(reference="igrf", channels=False)
    log = clean_log(kind).described(
        position='[position]\ncolumns = ["lat", "lon"]\naltitude = { column = "alt", unit = "m" }'
    )
    path = log.write(tmp_path)
    found, replayed = verdicts(path, tmp_path / "out")
    assert found == [(3, False, ["altitude_unit"]), (3, False, ["altitude_unit"])]
    diagnosed = json.loads((tmp_path / "out" / "diagnosis.json").read_text())
    assert [entry["effect"] for entry in diagnosed["effects"] if entry["effect"] != "unknown"] == []
    assert diagnosed["reasons"][0] == "recording_doubtful"
    assert "altitude_unit" in diagnosed["effects"][0]["says"]
    calibrated = json.loads((tmp_path / "out" / "calibrated.json").read_text())
    assert calibrated["reasons"][0] == "recording_doubtful"
    assert (calibrated["model_doubt"], "model_doubtful" in calibrated["reasons"]) == ("", False)
    assert "looks like" not in replayed


def test_a_recording_with_too_few_times_of_its_own_says_so(tmp_path: Path) -> None:
    log = clean_log(Kind(**{**TUMBLING.__dict__, "rows": 900, "time_format": "iso8601"}))
    path = log.at(log.time_ns // 60_000_000_000 * 60_000_000_000).write(tmp_path)
    for command in (["calibrate", path], ["replay", path], ["diagnose", path, "--out", tmp_path / "out"]):
        done = run(*command)
        assert done.code == 2
        assert "885 of 900 rows have the time of another row" in done.err
        assert "rate_hz = 1 " in done.err


def test_a_clean_recording_is_replayed_as_it_is(tmp_path: Path) -> None:
    recording = read_recording(clean_log(TUMBLING).write(tmp_path))
    assert inspect(recording).to_replay is recording
    assert inspect(recording).to_diagnose is recording


@pytest.mark.parametrize(
    ("case", "code", "open_ones"),
    [
        ("zero-row", "zero_rows", 0),
        ("many-zero-rows", "zero_rows", 0),
        ("held-readings", "held_readings", 0),
        ("position-without-fix", "position_zero", 0),
        ("altitude-unit", "altitude_unit", 1),
        ("millisecond-times", "time_unit", 1),
        ("minute-stamps", "shared_times", 1),
    ],
)
def test_reported_cases(case: str, code: str, open_ones: int) -> None:
    path = CASES / case / "RECORDING.toml"
    if not path.exists():
        pytest.skip(f"the case {case} is not in ../shared/cases")
    inspection = inspect(read_recording(path))
    assert [str(one.code) for one in inspection.findings] == [code]
    assert len(inspection.open) == open_ones
