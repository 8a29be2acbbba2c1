"""Rows on disk: torn ones are cut off, and a disk that is full stops the file and nothing else."""

from __future__ import annotations

import csv
import errno
import os
import threading
from pathlib import Path

import pytest

from magcal_service.base.errors import InputRefusedError, unwritable
from magcal_service.config.settings import Config, CraftConfig
from magcal_service.daemon.estimate_csv import COLUMNS, EstimateCsv
from magcal_service.daemon.pipeline import Pipeline
from magcal_service.daemon.rows import Rows
from magcal_service.daemon.service import Service
from magcal_service.links import Role, open_link
from magcal_service.links.base import Link
from magcal_service.wire.messages import CalibratedVector, Estimate, Message, Status
from tests.daemon.service_processes import stream

FULL = Path("/dev/full")
needs_full_disk = pytest.mark.skipif(not FULL.exists(), reason="/dev/full, a disk that is always full, is not here")


@pytest.fixture(scope="module")
def estimates() -> list[Estimate]:
    pipeline = Pipeline(CraftConfig("paper"))
    published = [answer for message in stream()[:60] for answer in pipeline.handle(message)]
    return [message for message in published if isinstance(message, Estimate)]


def rows(path: Path) -> list[list[str]]:
    with path.open(newline="") as file:
        return list(csv.reader(file))


def test_a_row_says_its_numbers_in_full_precision(tmp_path: Path, estimates: list[Estimate]) -> None:
    with EstimateCsv(tmp_path / "rows.csv") as out:
        out.add(estimates[5])
    row = dict(zip(COLUMNS, rows(tmp_path / "rows.csv")[1], strict=True))
    assert float(row["sigma_bx"]) == estimates[5].covariance[0] ** 0.5
    assert float(row["residual_rms_nt"]) == estimates[5].residual_rms_nt
    assert (row["craft"], int(row["time_ns"]), int(row["tick"])) == ("paper", estimates[5].time_ns, 6)


@pytest.mark.parametrize("kept_bytes", [1, 40, 300, 5000])
def test_a_restarted_daemon_goes_on_after_the_last_whole_row(
    kept_bytes: int, tmp_path: Path, estimates: list[Estimate]
) -> None:
    """However the file was cut short, it ends as whole rows; 1 byte is a header that was cut short."""
    path = tmp_path / "rows.csv"
    with EstimateCsv(path) as out:
        for estimate in estimates:
            out.add(estimate)
    content = path.read_bytes()
    path.write_bytes(content[:kept_bytes])
    whole = content[:kept_bytes].count(b"\n")
    with EstimateCsv(path, append=True) as out:
        out.add(estimates[0])
    assert len(rows(path)) == max(whole, 1) + 1
    assert {len(row) for row in rows(path)} == {len(COLUMNS)}


def test_whole_rows_are_left_as_they_are(tmp_path: Path, estimates: list[Estimate]) -> None:
    path = tmp_path / "rows.csv"
    with EstimateCsv(path) as out:
        out.add(estimates[0])
    with EstimateCsv(path, append=True) as out:
        out.add(estimates[1])
    assert [row[2] for row in rows(path)] == ["tick", "1", "2"]


@pytest.mark.parametrize("content", ["a note\nwithout an end", "craft,time_ns\n1,2", "\n", "ab"])
def test_a_file_that_holds_something_else_is_refused_and_left_as_it_is(content: str, tmp_path: Path) -> None:
    """Its last line without an end is no torn row of ours, and the columns of another version are not continued."""
    path = tmp_path / "notes.csv"
    path.write_text(content)
    with pytest.raises(
        InputRefusedError, match=r"notes.csv: '.*' is refused; a file of estimates with the same columns"
    ):
        EstimateCsv(path, append=True)
    assert path.read_text() == content


def test_a_file_that_another_daemon_writes_is_refused_and_left_as_it_is(
    tmp_path: Path, estimates: list[Estimate]
) -> None:
    path = tmp_path / "rows.csv"
    with EstimateCsv(path, append=True) as first:
        first.flush()
        with path.open("a") as torn:
            torn.write("half a row")
        with pytest.raises(InputRefusedError, match="'written by another process' is refused"):
            EstimateCsv(path, append=True)
        assert path.read_text().endswith("half a row")
    EstimateCsv(path, append=True).close()
    assert rows(path) == [list(COLUMNS)]


@pytest.mark.parametrize("how", ["renamed", "deleted", "emptied", "replaced"])
def test_a_file_that_is_taken_away_is_begun_anew(
    how: str, tmp_path: Path, estimates: list[Estimate], caplog: pytest.LogCaptureFixture
) -> None:
    """As logrotate does, with and without ``copytruncate``: each file has its header and whole rows."""
    path, old = tmp_path / "rows.csv", tmp_path / "rows.csv.1"
    with EstimateCsv(path, append=True) as out:
        out.add(estimates[0])
        out.flush()
        if how == "emptied":
            path.write_bytes(b"")
        elif how == "deleted":
            path.unlink()
        else:
            path.rename(old)
        if how == "replaced":
            path.write_bytes(old.read_bytes())
        out.flush()
        out.add(estimates[1])
        out.flush()
        out.flush()
    before = ["1"] if how == "replaced" else []
    assert [row[2] for row in rows(path)] == ["tick", *before, "2"]
    if old.exists():
        assert [row[2] for row in rows(old)] == ["tick", "1"]
    told = {"emptied": "was made shorter", "replaced": "is another file"}.get(how, "is gone")
    assert [record.message for record in caplog.records] == [f"{path} {told}: rows go on at its end"]


def test_what_is_put_in_place_of_a_file_and_is_none_of_ours_is_left_as_it_is(
    tmp_path: Path, estimates: list[Estimate]
) -> None:
    path = tmp_path / "rows.csv"
    with EstimateCsv(path, append=True) as out:
        path.unlink()
        path.write_text("somebody's")
        with pytest.raises(InputRefusedError, match="a file of estimates"):
            out.flush()
    assert path.read_text() == "somebody's"


@needs_full_disk
def test_a_full_disk_is_told_by_name(estimates: list[Estimate]) -> None:
    out = EstimateCsv(FULL)
    with pytest.raises(InputRefusedError, match="/dev/full: no space is left on the disk"):
        out.flush()
    with pytest.raises(InputRefusedError):
        out.close()
    out.close()


def serve(link: Link, node: Link, out: EstimateCsv) -> tuple[Service, list[Message]]:
    """A service over 300 s of the paper's scenario; what its node heard."""
    service = Service(Config(link.address, (CraftConfig("paper"),)), link, out)
    stop = threading.Event()
    for message in stream()[:600]:
        node.send(message)
    for message in link.receive(1.0):
        service.handle(message)
    service.publish_status()
    stop.set()
    service.run(stop)
    return service, node.receive(1.0)


@needs_full_disk
def test_a_full_disk_stops_the_rows_and_not_the_service() -> None:
    with (
        open_link("loop:full", Role.SERVICE) as link,
        open_link("loop:full", Role.NODE) as node,
        EstimateCsv(FULL) as out,
    ):
        service, heard = serve(link, node, out)
    assert service.rows.error is not None
    assert sum(isinstance(message, CalibratedVector) for message in heard) == 300
    last = [message for message in heard if isinstance(message, Status)][-1]
    assert last.counters["csv_lost"] > 100


def test_a_craft_that_no_pipeline_serves_is_counted() -> None:
    with open_link("loop:unknown", Role.SERVICE) as link:
        service = Service(Config(link.address, (CraftConfig("other"),)), link)
        service.handle(stream()[0])
        assert service.counters == {"unknown_craft": 1}


def test_rows_go_on_when_the_disk_takes_them_again(
    tmp_path: Path, estimates: list[Estimate], caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One that is full twice is told once; the file has whole rows, of before and after."""
    caplog.set_level("INFO", "magcal")
    path, full = tmp_path / "rows.csv", [True]
    write = EstimateCsv.flush
    with EstimateCsv(path, append=True) as out:
        rows_of = Rows(out, retry_s=0.0)
        assert rows_of.add(estimates[0])
        rows_of.flush()

        def flush(csv: EstimateCsv) -> None:
            if full[0]:
                csv._file.buffer.raw.write(b"torn,")  # type: ignore[attr-defined]
                raise unwritable(path, OSError(errno.ENOSPC, ""))
            write(csv)

        monkeypatch.setattr(EstimateCsv, "flush", flush)
        for _ in range(2):
            rows_of.flush()
            assert (rows_of.add(estimates[1]), "no space is left" in rows_of.trouble) == (False, True)
        full[0] = False
        rows_of.flush()
        assert (rows_of.add(estimates[2]), bool(rows_of.trouble)) == (True, True)
        rows_of.flush()
        assert rows_of.trouble == ""
    assert [row[2] for row in rows(path)] == ["tick", "1", "3"]
    assert [record.levelname for record in caplog.records] == ["ERROR", "INFO"]


def test_a_pipe_that_nobody_reads_stops_the_rows_and_holds_nothing_up(
    tmp_path: Path, estimates: list[Estimate]
) -> None:
    """Put in place of the file, opened by nobody; then with a reader that does not read."""
    path = tmp_path / "rows.csv"
    with EstimateCsv(path, append=True) as out:
        rows_of = Rows(out, retry_s=0.0)
        path.unlink()
        os.mkfifo(path)
        rows_of.flush()
        assert rows_of.error is not None
        reading = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
        rows_of.flush()
        assert rows_of.error is None
        for estimate in estimates * 100:
            rows_of.add(estimate)
            rows_of.flush()
            if rows_of.error is not None:
                break
        assert rows_of.error is not None
        os.close(reading)
