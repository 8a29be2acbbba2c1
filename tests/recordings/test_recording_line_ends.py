"""Lines may end as any recorder ends them."""

from pathlib import Path

import pytest

from magcal_service.recordings.reader import read_recording
from tests.recordings.recording_logs import HEADER, row, write_log


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r", "\r\r\n"])
@pytest.mark.parametrize("last", [True, False])
def test_lines_end_with_any_of_the_usual_ends(end: str, last: bool, tmp_path: Path) -> None:
    path = write_log(tmp_path)
    rows = [HEADER, *(row(1_700_000_000 + second) for second in range(20))]
    (tmp_path / "log.csv").write_text(end.join(rows) + (end if last else ""), newline="")
    report = read_recording(path).report
    assert (report.rows, report.used) == (20, 20)


def test_a_header_that_ends_otherwise_than_the_rows(tmp_path: Path) -> None:
    path = write_log(tmp_path)
    rows = [row(1_700_000_000 + second) for second in range(20)]
    (tmp_path / "log.csv").write_text(HEADER + "\n" + "\r".join(rows) + "\r", newline="")
    assert read_recording(path).report.used == 20
