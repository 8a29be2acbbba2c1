"""Times that are none of the rows' own are found."""

from pathlib import Path

import numpy as np
import pytest

from magcal_service.base.errors import RecordingError
from magcal_service.recordings.inspect.finding import Code
from magcal_service.recordings.reader import read_recording
from magcal_service.recordings.timestamps import ns_to_iso8601
from tests.recordings.inspect.clean_logs import START_NS, CleanLog, Kind, clean_log

SECOND = 1_000_000_000


@pytest.mark.parametrize(("stamp_s", "certain"), [(60, False), (10, False), (1, True)])
def test_stamps_that_many_rows_share(stamp_s: int, certain: bool, tmp_path: Path) -> None:
    log = clean_log(Kind(step_s=0.5, time_format="iso8601"))
    stamp = stamp_s * SECOND
    inspection = log.at(log.time_ns // stamp * stamp).inspected(tmp_path)
    (finding,) = inspection.findings
    assert (finding.code, finding.certain) == (Code.SHARED_TIMES, certain)
    assert finding.rows == 1800 - 900 // stamp_s
    assert "rate_hz = 2 " in finding.remedy


def test_rows_that_come_evenly_need_no_times(tmp_path: Path) -> None:
    log = clean_log(Kind(step_s=0.5, time_format="iso8601"))
    log = log.at(log.time_ns // (60 * SECOND) * 60 * SECOND)
    inspection = log.described(time='[time]\nrate_hz = 2.0\nstart = "2025-03-01T00:00:00Z"').inspected(tmp_path)
    assert inspection.findings == ()
    assert np.array_equal(inspection.recording.time_ns, START_NS + np.arange(1800) * SECOND // 2)


@pytest.mark.parametrize("form", ["elapsed_s", "unix_s"])
@pytest.mark.parametrize(("name", "unit"), [("ms", 10**3), ("us", 10**6), ("ns", 10**9)])
def test_times_in_another_unit_are_asked_about(form: str, name: str, unit: int, tmp_path: Path) -> None:
    log = clean_log(Kind(time_format=form, place="none"))
    cells = [str((value - START_NS) * unit // SECOND) for value in log.time_ns.tolist()]
    if unit == 10**9:
        cells = cells[:9]  # more of them lie beyond the times that can be held
        log = log.take(np.arange(9))
    finding = log.at(log.time_ns, cells).found(tmp_path)[Code.TIME_UNIT]
    assert not finding.certain
    assert f'format = "{form[:-1]}{name}"' in finding.remedy


@pytest.mark.parametrize(("name", "unit"), [("ms", 10**3), ("us", 10**6), ("ns", 10**9)])
@pytest.mark.parametrize("kind", ["elapsed", "unix"])
def test_every_unit_of_time_is_read(kind: str, name: str, unit: int, tmp_path: Path) -> None:
    log = clean_log(Kind(time_format=f"{kind}_{name}"))
    zero = START_NS if kind == "elapsed" else 0
    cells = [str((value - zero) * unit // SECOND) for value in log.time_ns.tolist()]
    inspection = log.at(log.time_ns, cells).inspected(tmp_path)
    assert inspection.findings == ()
    assert np.array_equal(np.diff(inspection.recording.time_ns), np.diff(log.time_ns))


def test_fast_rows_show_their_unit_by_their_orbit(tmp_path: Path) -> None:
    log = clean_log(Kind(step_s=0.02, time_format="elapsed_s"))
    cells = [str((value - START_NS) // 10**6) for value in log.time_ns.tolist()]  # steps of 20, as of slow seconds
    finding = log.at(log.time_ns, cells).found(tmp_path)[Code.TIME_UNIT]
    assert 'format = "elapsed_ms"' in finding.remedy


@pytest.mark.parametrize("start", [0, 315_964_800, 1_740_787_200 - 1024 * 604_800, 1_740_787_200 - 946_728_000])
def test_another_epoch_is_asked_about(start: int, tmp_path: Path) -> None:
    log = clean_log()
    finding = log.at(log.time_ns - START_NS + start * SECOND).found(tmp_path)[Code.TIME_EPOCH]
    assert not finding.certain
    assert ns_to_iso8601(start * SECOND)[:10] in finding.says


@pytest.mark.parametrize(("declared", "written", "unit"), [("ms", "s", 1), ("us", "ms", 1000), ("ns", "s", 1)])
def test_a_time_since_1970_in_another_unit_is_told_with_it(
    declared: str, written: str, unit: int, tmp_path: Path
) -> None:
    """The year 1970 for the date of the log: the epoch was asked about, and a start for it."""
    log = clean_log(Kind(time_format=f"unix_{declared}", step_s=10.0))
    cells = [str(value * unit // SECOND) for value in log.time_ns.tolist()]
    finding = log.at(log.time_ns, cells).found(tmp_path)[Code.TIME_EPOCH]
    assert finding.remedy == f'check the unit of the times; if they are in {written}, write format = "unix_{written}"'
    assert f"around 2025-03-01 if they are in {written}" in finding.says


def test_rows_before_the_clock_was_set_are_left_out(tmp_path: Path) -> None:
    log = clean_log()
    times = log.time_ns.copy()
    times[:40] -= START_NS
    inspection = log.at(times).inspected(tmp_path)
    (finding,) = inspection.findings
    assert (finding.code, finding.certain, finding.rows) == (Code.TIME_EPOCH, True, 40)
    assert len(inspection.usable) == 1760


@pytest.mark.parametrize(("wrap_s", "certain"), [(86_400, False), (3600, False), (1234, True)])
def test_times_that_go_back(wrap_s: int, certain: bool, tmp_path: Path) -> None:
    log = clean_log(Kind(time_format="elapsed_s", place="none"))
    times = log.time_ns.copy()
    times[1000:] -= wrap_s * SECOND
    finding = log.at(times + 7200 * SECOND).found(tmp_path)[Code.TIME_ORDER]
    assert finding.certain is certain
    assert finding.first == 1002


@pytest.mark.parametrize(("name", "unit"), [("ms", 10**3), ("us", 10**6), ("ns", 10**9)])
def test_times_since_1970_in_another_unit_are_refused_by_that(name: str, unit: int, tmp_path: Path) -> None:
    log = clean_log()
    path = log.at(log.time_ns, [str(value * unit // SECOND) for value in log.time_ns.tolist()]).write(tmp_path)
    with pytest.raises(RecordingError, match=f'"unix_{name}"'):
        read_recording(path)


def in_bursts(pause_s: float) -> CleanLog:
    """Twelve rows at 10 Hz, then a pause, 150 times."""
    log = clean_log(Kind(step_s=0.1, rows=int(150 * (12 + pause_s / 0.1))))
    return log.take(np.flatnonzero(np.arange(len(log.time_ns)) % int(12 + pause_s / 0.1) < 12))


def test_rows_in_bursts_have_no_rate(tmp_path: Path) -> None:
    by_rate = in_bursts(0.5).described(time="[time]\nrate_hz = 7.0588")
    assert by_rate.found(tmp_path)[Code.BURSTS].says.startswith("rows seem to come in bursts of 12")
    assert by_rate.described(time="[time]\nrate_hz = 10").take(np.arange(12)).found(tmp_path).keys() == set()
    log = in_bursts(0.5)
    found = log.at(log.time_ns // SECOND * SECOND).found(tmp_path)
    assert set(found) == {Code.SHARED_TIMES}
    assert "in bursts of 12" in found[Code.SHARED_TIMES].says
    assert "write rate_hz" not in found[Code.SHARED_TIMES].remedy
    even = clean_log(Kind(step_s=0.1)).described(time="[time]\nrate_hz = 10.0")
    assert even.inspected(tmp_path).findings == ()


def test_no_rate_is_advised_where_stamps_have_unequal_numbers_of_rows(tmp_path: Path) -> None:
    log = clean_log(Kind(step_s=0.1))
    drawn = np.random.default_rng(3).random(len(log.time_ns)) < 0.6
    log = log.take(np.flatnonzero(drawn))
    finding = log.at(log.time_ns // SECOND * SECOND).found(tmp_path)[Code.SHARED_TIMES]
    assert "write rate_hz" not in finding.remedy
