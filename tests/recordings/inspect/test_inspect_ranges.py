"""Ends of ranges, axes that stand still, and a recorder that begins badly."""

from pathlib import Path

import numpy as np
import pytest

from magcal_service.recordings.inspect.finding import Code
from tests.recordings.inspect.clean_logs import Kind, clean_log


@pytest.mark.parametrize("resolution_nt", [0.0, 1.0])
def test_numbers_that_wrap_round_16_bits_are_left_out(resolution_nt: float, tmp_path: Path) -> None:
    log = clean_log(Kind(bias_nt=(20_000.0, -3000.0, 4000.0), rows=3000, resolution_nt=resolution_nt))
    beyond = np.flatnonzero(log.columns["mx"] >= 32_768.0)
    assert len(beyond) > 20
    inspection = log.spoiled("mx", lambda column: (column + 32_768.0) % 65_536.0 - 32_768.0).inspected(tmp_path)
    (finding,) = inspection.findings
    assert (finding.code, finding.certain, finding.rows) == (Code.WRAPPED, True, len(beyond))
    assert finding.first == beyond[0] + 2
    assert len(inspection.usable) == 3000 - len(beyond)


@pytest.mark.parametrize("end", [1.0, -1.0])
def test_an_axis_that_stops_at_its_range_is_left_out(end: float, tmp_path: Path) -> None:
    log = clean_log(Kind(rows=3000))
    limit = 0.8 * float(np.abs(end * log.columns["my"]).max())
    clipped = np.count_nonzero(end * log.columns["my"] >= limit)
    inspection = log.spoiled("my", lambda column: end * np.minimum(end * column, limit)).inspected(tmp_path)
    (finding,) = inspection.findings
    assert (finding.code, finding.certain) == (Code.SATURATED, True)
    assert f"{clipped} rows of 3000 stop at " in finding.says
    near = finding.rows - clipped
    assert 0 < near < 20
    assert f"; {near} more would be at it or within its noise" in finding.says
    assert len(inspection.usable) == 3000 - finding.rows
    assert inspection.to_diagnose is inspection.recording  # which names it


@pytest.mark.parametrize("stated", [True, False])
def test_a_stop_on_a_lattice_is_left_out_though_its_end_comes_no_oftener(stated: bool, tmp_path: Path) -> None:
    """At 1.5 noise sigmas of lattice the end comes less than five times as often as the levels beside it."""
    log = clean_log(Kind(rows=6000, noise_nt=200.0, noise_stated=stated))
    limit = 300.0 * round(float(np.quantile(log.columns["my"], 0.993)) / 300.0)
    stopped = log.spoiled("mx my mz", lambda column: np.round(column / 300.0) * 300.0)
    stopped = stopped.spoiled("my", lambda column: np.minimum(column, limit))
    counts = np.unique(stopped.columns["my"], return_counts=True)[1]
    assert counts[-1] < 5.0 * counts[-6:-1].max()
    inspection = stopped.inspected(tmp_path)
    (finding,) = inspection.findings
    assert (finding.code, finding.certain) == (Code.SATURATED, True)
    assert f"{counts[-1]} rows of 6000 stop at {limit:g} nT on y" in finding.says
    assert inspection.account.left_out["defect"] == finding.rows == 6000 - len(inspection.usable)


def test_an_axis_that_stands_still_is_left_out(tmp_path: Path) -> None:
    def stand(column: np.ndarray) -> np.ndarray:
        column[800:950] = column[800]
        return column

    inspection = clean_log().spoiled("mz", stand).inspected(tmp_path)
    (finding,) = inspection.findings
    assert (finding.code, finding.certain, finding.rows, finding.first) == (Code.STUCK_AXIS, True, 150, 802)
    assert len(inspection.usable) == 1650
    assert inspection.to_diagnose is inspection.recording


def test_a_coarse_axis_along_the_spin_stands_for_no_fault(tmp_path: Path) -> None:
    log = clean_log(Kind(step_s=0.1, noise_nt=5.0))
    angle = 0.05 * np.arange(1800)
    spinning = log.changed(
        mx=np.round(200.0 * np.cos(angle)) * 150.0,
        my=np.round(200.0 * np.sin(angle)) * 150.0,
        mz=np.round(50.0 + 0.02 * np.sin(0.01 * angle)) * 150.0,
        F=np.full(1800, 31_000.0),
    )
    without = spinning.described(channels="", position="")
    finding = without.found(tmp_path).get(Code.STUCK_AXIS)
    assert finding is None or not finding.certain


def test_a_table_that_turns_about_a_coarse_axis_for_a_while_holds_no_stuck_one(tmp_path: Path) -> None:
    """In steps of 520 nT z moves while the table turns about x, and stays while it turns about z."""
    angle = 0.2 * np.arange(1800)
    field = np.stack([20e3 + 0.0 * angle, 35e3 * np.cos(angle), 35e3 * np.sin(angle)], axis=1)
    field[900:] = np.stack([30e3 * np.cos(angle), 26e3 * np.sin(angle), 11.7e3 + 0.0 * angle], axis=1)[900:]
    noise = np.random.default_rng(9151).normal(0.0, 60.0, field.shape)
    columns = dict(zip(("mx", "my", "mz"), (520.0 * np.round((field + noise) / 520.0)).T, strict=True))
    turned = clean_log(Kind(step_s=1.0, noise_nt=60.0)).changed(**columns, F=np.full(1800, 40_311.0))
    assert turned.described(channels="", position="").found(tmp_path).get(Code.STUCK_AXIS) is None


@pytest.mark.parametrize("count", [1, 5, 20])
def test_rows_of_a_recorder_that_begins_badly_are_left_out(count: int, tmp_path: Path) -> None:
    def begin(column: np.ndarray) -> np.ndarray:
        column[:count] = 0.3 * column[:count] + 900.0
        return column

    inspection = clean_log().spoiled("mx my mz", begin).inspected(tmp_path)
    (finding,) = inspection.findings
    assert (finding.code, finding.certain, finding.rows, finding.first) == (Code.START_TRANSIENT, True, count, 2)
    assert len(inspection.usable) == 1800 - count


@pytest.mark.filterwarnings("error")
def test_an_axis_that_is_dead_from_the_beginning_is_asked_about(tmp_path: Path) -> None:
    dead = clean_log().changed(mz=np.full(1800, 120.0))
    finding = dead.found(tmp_path)[Code.STUCK_AXIS]
    assert (finding.certain, finding.rows) == (False, 1800)
