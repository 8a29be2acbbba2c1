import gzip
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from magcal_service.base.errors import RecordingError
from magcal_service.recordings.reader import read_recording
from magcal_service.recordings.report import RowFault
from magcal_service.recordings.table import parse_numbers
from tests.recordings.recording_logs import HEADER, MAGNETOMETER, descriptor, row, write_log

GOOD = [row(1700000000), row(1700000001), row(1700000002)]
CHANNELS = '[channels]\nheat = { column = "temp", unit = "degC" }\nat = { columns = ["q0", "q1"] }\n'
POSITION = '[position]\ncolumns = ["x", "y", "z"]\nunit = "km"\nframe = "eci"\n'


def spoiled(folder: Path, bad: str, text: str | None = None) -> Path:
    """A log whose second row, on line 3, is bad."""
    return write_log(folder, text, [GOOD[0], bad, GOOD[2]])


REFUSED = {
    "time nan": (row("nan"), "time", RowFault.NOT_A_NUMBER),
    "time empty": (row(""), "time", RowFault.MISSING),
    "time text": (row("noon"), "time", RowFault.UNPARSABLE),
    "time infinite": (row("inf"), "time", RowFault.INFINITE),
    "time in milliseconds": (row("1700000001000000"), "time", RowFault.ABSURD),
    "field nan": (row(1700000001, "NaN"), "magnetometer", RowFault.NOT_A_NUMBER),
    "field empty": (row(1700000001, " "), "magnetometer", RowFault.MISSING),
    "field text": (row(1700000001, "12,5"), "row", RowFault.LONG_ROW),
    "field quoted": (row(1700000001, '"12,5"'), "magnetometer", RowFault.UNPARSABLE),
    "field hex": (row(1700000001, "0x1F"), "magnetometer", RowFault.UNPARSABLE),
    "field underscore": (row(1700000001, "1_0"), "magnetometer", RowFault.UNPARSABLE),
    "field infinite": (row(1700000001, "-Infinity"), "magnetometer", RowFault.INFINITE),
    "field overflows": (row(1700000001, "1e999"), "magnetometer", RowFault.INFINITE),
    "field beyond 1 mT": (row(1700000001, "1000.1"), "magnetometer", RowFault.ABSURD),
    "field binary": (row(1700000001, "\x00\x01"), "magnetometer", RowFault.UNPARSABLE),
    "short": ("1700000001,10,20", "row", RowFault.SHORT_ROW),
    "long": (row(1700000001) + ",7", "row", RowFault.LONG_ROW),
    "quote left open": (row(1700000001, '"10'), "row", RowFault.UNPARSABLE),
}


@pytest.mark.parametrize("case", REFUSED)
def test_a_row_that_cannot_be_used_is_refused_and_counted_by_kind(tmp_path: Path, case: str) -> None:
    bad, part, fault = REFUSED[case]
    recording = read_recording(spoiled(tmp_path, bad))
    (entry,) = recording.report.entries
    assert (entry.part, entry.fault, entry.count, entry.first_line, entry.kept) == (part, fault, 1, 3, False)


@pytest.mark.parametrize("case", REFUSED)
def test_the_rows_around_a_refused_one_are_used(tmp_path: Path, case: str) -> None:
    recording = read_recording(spoiled(tmp_path, REFUSED[case][0]))
    assert recording.time_ns.tolist() == [1_700_000_000_000_000_000, 1_700_000_002_000_000_000]
    assert (recording.report.rows, recording.report.used, recording.report.refused) == (3, 2, 1)


def test_a_row_with_two_faults_is_counted_once(tmp_path: Path) -> None:
    recording = read_recording(spoiled(tmp_path, row("nan", "nan")))
    assert sum(recording.report.counts.values()) == recording.report.refused == 1


KEPT = {
    "reference nan": ({"hx": "nan"}, "reference", RowFault.NOT_A_NUMBER),
    "reference zero": ({"hx": "0", "hy": "0", "hz": "0"}, "reference", RowFault.ABSURD),
    "reference beyond 1 mT": ({"hz": "2e6"}, "reference", RowFault.ABSURD),
    "position empty": ({"y": ""}, "position", RowFault.MISSING),
    "position within the Earth": ({"x": "0"}, "position", RowFault.ABSURD),
    "channel nan": ({"temp": "nan"}, "channels.heat", RowFault.NOT_A_NUMBER),
    "channel text": ({"q1": "x"}, "channels.at", RowFault.UNPARSABLE),
    "channel absurd": ({"temp": "1e30"}, "channels.heat", RowFault.ABSURD),
}


@pytest.mark.parametrize("case", KEPT)
def test_a_fault_beside_the_magnetometer_keeps_the_row_and_is_counted(tmp_path: Path, case: str) -> None:
    changes, part, fault = KEPT[case]
    recording = read_recording(spoiled(tmp_path, row(1700000001, **changes), descriptor(POSITION, CHANNELS)))
    (entry,) = recording.report.entries
    assert (entry.part, entry.fault, entry.count, entry.first_line, entry.kept) == (part, fault, 1, 3, True)
    assert len(recording) == recording.report.used == 3


@pytest.mark.parametrize("bad", ["nan", "2e6"])
def test_a_row_without_a_reference_has_nan_there_and_only_there(tmp_path: Path, bad: str) -> None:
    recording = read_recording(spoiled(tmp_path, row(1700000001, hx=bad)))
    assert np.isnan(recording.reference.magnitude_nt).tolist() == [False, True, False]
    assert recording.reference.vector_nt is not None
    assert np.isnan(recording.reference.vector_nt).all(axis=1).tolist() == [False, True, False]


def test_a_faulty_cell_of_a_channel_leaves_its_neighbour(tmp_path: Path) -> None:
    recording = read_recording(spoiled(tmp_path, row(1700000001, q1="x"), descriptor(CHANNELS)))
    np.testing.assert_array_equal(recording.channels["at"].values, [[1.0, 0.0], [1.0, np.nan], [1.0, 0.0]])


def test_rows_out_of_order_and_doubled_stay_in_file_order_and_are_counted(tmp_path: Path) -> None:
    seconds = [5, 6, 4, 6, 6, 7, 4]
    recording = read_recording(write_log(tmp_path, None, [row(1700000000 + s) for s in seconds]))
    assert ((recording.time_ns // 10**9) - 1700000000).tolist() == seconds
    assert recording.report.count("time", RowFault.OUT_OF_ORDER) == 1
    assert recording.report.count("time", RowFault.DOUBLED_TIME) == 3


def test_rows_that_are_in_order_already_are_not_copied(tmp_path: Path) -> None:
    """Of hundreds of channels a copy is half of the recording's memory."""
    rows = [row(1700000000 + second, 10 + second) for second in range(3)]
    batch = read_recording(write_log(tmp_path, None, rows))
    assert np.shares_memory(batch.sorted_unique().field_body_nt, batch.field_body_nt)
    doubled = read_recording(write_log(tmp_path, None, [rows[0], *rows]))
    assert doubled.sorted_unique().field_body_nt.tolist() == batch.field_body_nt.tolist()


def test_sorted_unique_keeps_the_first_of_each_time_that_has_a_reference(tmp_path: Path) -> None:
    rows = [row(1700000002, 12), row(1700000001, 11), row(1700000002, 13), row(1700000003, 14, hx="nan")]
    batch = read_recording(write_log(tmp_path, None, rows)).sorted_unique()
    assert batch.field_body_nt[:, 0].tolist() == [11000.0, 12000.0]


def test_blank_lines_are_counted_as_rows_that_are_not_used(tmp_path: Path) -> None:
    report = read_recording(write_log(tmp_path, None, [GOOD[0], "", "  ", GOOD[1]])).report
    assert (report.used, report.refused, report.count("row", RowFault.BLANK_LINE)) == (2, 2, 2)


@pytest.mark.parametrize("ending", ["\n", "\r\n"])
def test_line_endings_of_either_kind_are_read(tmp_path: Path, ending: str) -> None:
    path = write_log(tmp_path)
    quoted = row(1700000003, q3='"0"')
    (tmp_path / "log.csv").write_text(ending.join([HEADER, *GOOD, quoted, ""]), newline="")
    report = read_recording(path).report
    assert (report.used, report.entries) == (4, ())


def test_a_byte_order_mark_and_blanks_in_the_header_do_no_harm(tmp_path: Path) -> None:
    path = write_log(tmp_path, header="\ufeff" + HEADER.replace(",", " , "))
    assert len(read_recording(path)) == 3


def test_a_last_line_without_a_line_break_is_read(tmp_path: Path) -> None:
    path = write_log(tmp_path)
    (tmp_path / "log.csv").write_text("\n".join([HEADER, *GOOD]))
    assert len(read_recording(path)) == 3


def test_a_trailing_delimiter_on_every_row_is_no_long_row(tmp_path: Path) -> None:
    assert read_recording(write_log(tmp_path, None, [f"{line}," for line in GOOD])).report.entries == ()


def test_another_delimiter_is_read_where_stated(tmp_path: Path) -> None:
    text = descriptor().replace("[time]", 'delimiter = ";"\n[time]', 1)
    path = write_log(tmp_path, text, [line.replace(",", ";") for line in GOOD], HEADER.replace(",", ";"))
    assert len(read_recording(path)) == 3


def test_a_packed_log_gives_the_same_arrays(tmp_path: Path) -> None:
    plain = read_recording(write_log(tmp_path))
    (tmp_path / "log.csv.gz").write_bytes(gzip.compress((tmp_path / "log.csv").read_bytes()))
    packed = read_recording(write_log(tmp_path, descriptor(file="log.csv.gz")))
    np.testing.assert_array_equal(packed.field_body_nt, plain.field_body_nt)


def test_a_packed_log_that_ends_early_gives_its_first_rows_and_counts_the_rest(tmp_path: Path) -> None:
    rng = np.random.default_rng(7)
    rows = [row(1700000000 + second, rng.normal()) for second in range(2000)]
    path = write_log(tmp_path, descriptor(file="log.csv.gz"), rows)
    packed = gzip.compress((tmp_path / "log.csv").read_bytes())
    (tmp_path / "log.csv.gz").write_bytes(packed[: len(packed) // 2])
    recording = read_recording(path)
    assert recording.report.count("row", RowFault.TRUNCATED_FILE) == 1
    assert 500 < len(recording) < 1500


def test_a_packed_row_that_was_cut_within_its_last_cell_is_not_used(tmp_path: Path) -> None:
    path = write_log(tmp_path, descriptor(file="log.csv.gz"), [GOOD[0], GOOD[1], row(1700000002, q3="0.12345")])
    stored = gzip.compress((tmp_path / "log.csv").read_bytes(), compresslevel=0)
    (tmp_path / "log.csv.gz").write_bytes(stored[: stored.index(b"0.12345") + 4])
    report = read_recording(path).report
    assert (report.rows, report.used, report.count("row", RowFault.TRUNCATED_FILE)) == (3, 2, 1)
    assert report.entries[0].first_line == 4


@pytest.mark.parametrize("content", [b"", b"not gzip at all", gzip.compress(b"time,mx\n", mtime=0)[:12]])
def test_what_is_no_gzip_is_refused(tmp_path: Path, content: bytes) -> None:
    path = write_log(tmp_path, descriptor(file="log.csv.gz"))
    (tmp_path / "log.csv.gz").write_bytes(content)
    with pytest.raises(RecordingError, match=r"log\.csv\.gz"):
        read_recording(path)


def test_a_missing_log_is_refused_by_name(tmp_path: Path) -> None:
    path = write_log(tmp_path)
    (tmp_path / "log.csv").unlink()
    with pytest.raises(RecordingError, match=r"log\.csv: there is no such file or folder; give"):
        read_recording(path)
    (tmp_path / "lgo.csv").write_text("", encoding="utf-8")
    with pytest.raises(RecordingError, match=r"no such file or folder; did you mean lgo\.csv\? give a readable log"):
        read_recording(path)


def test_a_log_without_a_line_of_names_is_told_once(tmp_path: Path) -> None:
    """Of 31 columns each was refused by itself, with all the numbers of the first row as known names."""
    path = write_log(tmp_path, header=",".join(map(str, range(len(HEADER.split(","))))))
    with pytest.raises(RecordingError) as refused:
        read_recording(path)
    (line,) = str(refused.value).splitlines()
    assert "the first line of log.csv holds numbers and no names; header = false under [samples]" in line


def test_an_empty_log_is_refused(tmp_path: Path) -> None:
    path = write_log(tmp_path)
    (tmp_path / "log.csv").write_bytes(b"")
    with pytest.raises(RecordingError, match="header line"):
        read_recording(path)


def test_a_column_that_is_not_there_is_refused_with_the_nearest(tmp_path: Path) -> None:
    path = write_log(tmp_path, descriptor(magnetometer=MAGNETOMETER.replace('"mx"', '"mxx"')))
    with pytest.raises(RecordingError, match=r"log\.toml: magnetometer\.columns: 'mxx'.*log\.csv.*did you mean 'mx'"):
        read_recording(path)


def test_every_missing_column_is_named_at_once(tmp_path: Path) -> None:
    extra = '[channels]\na = { column = "nowhere" }\nb = { columns = ["temp", "no", "none"] }\n'
    with pytest.raises(RecordingError) as refused:
        read_recording(write_log(tmp_path, descriptor(extra)))
    assert [fault.value for fault in refused.value.faults] == ["nowhere", "no", "none"]


def test_a_column_that_stands_twice_in_the_header_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"'mx'.*2 times in the header"):
        read_recording(write_log(tmp_path, header=HEADER.replace("lat", "mx")))


def test_a_log_without_a_usable_row_is_refused_with_the_account(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"no usable row.*time: unparsable x 1.*magnetometer: not_a_number x 2"):
        read_recording(write_log(tmp_path, None, [row("x"), row(1, "nan"), row(2, "nan")]))


def test_a_log_without_any_reference_is_refused_with_the_account(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"reference: 'no usable value'.*reference: missing x 3"):
        read_recording(write_log(tmp_path, None, [row(second, hy="") for second in range(3)]))


def test_the_report_says_in_words_what_was_not_used(tmp_path: Path) -> None:
    report = read_recording(spoiled(tmp_path, row(1700000001, "nan"))).report
    expected = ["3 rows, 2 read, 1 refused", "magnetometer: not_a_number x 1, first on line 3, refused"]
    assert report.lines() == expected


CELLS = st.one_of(st.floats().map(repr), st.sampled_from(["", "nan", "inf", "x", "1_0", '"', "1e5", "\x00"]), st.text())


@given(st.lists(CELLS, max_size=8))
def test_every_cell_is_a_finite_number_or_has_a_fault(cells: list[str]) -> None:
    values, codes = parse_numbers(cells)
    assert np.array_equal(np.isfinite(values), codes == 0)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=60, deadline=None)
@given(st.lists(st.lists(CELLS, max_size=20).map(",".join), max_size=6))
@example([",".join(["0.0"] * 6 + ["1.3e154"] + ["0.0"] * 12)])
def test_garbage_rows_never_raise_and_always_add_up(tmp_path: Path, garbage: list[str]) -> None:
    path = write_log(tmp_path)
    content = "\n".join([HEADER, GOOD[0], *garbage, GOOD[1], ""])
    (tmp_path / "log.csv").write_bytes(content.encode(errors="surrogatepass"))
    report = read_recording(path).report
    refused = sum(e.count for e in report.entries if not e.kept)
    assert report.used >= 2
    assert refused == report.refused
