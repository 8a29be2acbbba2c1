"""Readings that are none are found, with their rows; the neighbours of each kind too."""

from pathlib import Path

import numpy as np
import pytest

from magcal_service.recordings.inspect.finding import Code, rows_that
from tests.recordings.inspect.clean_logs import CleanLog, Kind, clean_log

SOME = np.array([100, 101, 350, 900, 1500])
BODY = "mx my mz"


def with_value(log: CleanLog, columns: str, rows: np.ndarray, value: float) -> CleanLog:
    def spoil(column: np.ndarray) -> np.ndarray:
        column[rows] = value
        return column

    return log.spoiled(columns, spoil)


@pytest.mark.parametrize("rows", [SOME[:1], np.arange(0, 1800, 3)])
def test_rows_of_zeros_are_left_out(rows: np.ndarray, tmp_path: Path) -> None:
    inspection = with_value(clean_log(), BODY, rows, 0.0).inspected(tmp_path)
    (finding,) = inspection.findings
    assert (finding.code, finding.certain) == (Code.ZERO_ROWS, True)
    assert (finding.rows, finding.first) == (len(rows), rows[0] + 2)
    assert len(inspection.usable) == 1800 - len(rows)


@pytest.mark.parametrize(
    ("count", "verb", "of", "says"),
    [
        (1, "have", 20, "1 row of 20 has"),
        (2, "have", 20, "2 rows of 20 have"),
        (1, "reach", 20, "1 row of 20 reaches"),
        (1, "stop at", 20, "1 row of 20 stops at"),
        (1, "lie", None, "1 row lies"),
        (12, "lie", None, "12 rows lie"),
    ],
)
def test_what_is_said_of_one_row_is_said_of_one(count: int, verb: str, of: int | None, says: str) -> None:
    assert rows_that(count, verb, of) == says


@pytest.mark.parametrize(
    ("columns", "value"), [(BODY, -9999.0), (BODY, 32767.0), ("my", 150_000.0), ("mz", -32768.0), ("mx", -99_999.0)]
)
def test_a_value_that_stands_for_no_reading_is_left_out(columns: str, value: float, tmp_path: Path) -> None:
    inspection = with_value(clean_log(), columns, SOME, value).inspected(tmp_path)
    (finding,) = inspection.findings
    assert (finding.code, finding.certain, finding.rows, finding.first) == (Code.SENTINEL, True, 5, 102)
    assert f"{value:g}" in finding.says
    assert len(inspection.usable) == 1795


def test_two_sentinels_are_both_found(tmp_path: Path) -> None:
    log = with_value(with_value(clean_log(), BODY, SOME, -9999.0), "mx", np.array([20, 30, 40]), 190_000.0)
    assert sorted(one.rows for one in log.inspected(tmp_path).findings) == [3, 5]


def test_texts_for_no_number_are_counted(tmp_path: Path) -> None:
    finding = with_value(clean_log(), BODY, SOME, np.nan).found(tmp_path)[Code.SENTINEL]
    assert (finding.certain, finding.rows, finding.first) == (True, 5, 102)


def test_a_sentinel_beyond_what_a_magnetometer_reads_is_counted(tmp_path: Path) -> None:
    finding = with_value(clean_log(Kind(unit="uT")), BODY, SOME, 32767.0).found(tmp_path)[Code.SENTINEL]
    assert (finding.certain, finding.rows) == (True, 5)


@pytest.mark.parametrize("repeats", [2, 3, 4, 10])
@pytest.mark.parametrize("resolution_nt", [0.0, 13.0])
def test_held_readings_leave_one_row_each(repeats: int, resolution_nt: float, tmp_path: Path) -> None:
    log = clean_log(Kind(step_s=0.25, rates_deg_s=(3.0, 1.0), resolution_nt=resolution_nt))
    held = np.arange(1800) // repeats * repeats
    inspection = log.spoiled(BODY, lambda column: column[held]).inspected(tmp_path)
    finding = {one.code: one for one in inspection.findings}[Code.HELD_READINGS]
    assert finding.certain
    assert len(inspection.usable) == pytest.approx(1800 / repeats, abs=3)
    assert np.array_equal(inspection.usable.time_ns, log.time_ns[::repeats])


def test_a_coarse_sensor_that_stands_still_holds_nothing(tmp_path: Path) -> None:
    log = clean_log(Kind(step_s=0.1, rates_deg_s=(0.02, 0.01), noise_nt=5.0, resolution_nt=100.0))
    steps = np.diff(np.stack([log.columns[name] for name in BODY.split()], axis=1), axis=0)
    assert np.count_nonzero(~steps.any(axis=1)) > 900
    assert log.found(tmp_path) == {}
