"""Logs as loggers write them: laid out in other ways than a plain .csv, and in several files."""

import gzip
from pathlib import Path

import numpy as np
import pytest

from magcal_service.base.errors import RecordingError
from magcal_service.recordings.in_memory import from_dataframe
from magcal_service.recordings.reader import read_recording
from magcal_service.recordings.recording import Recording
from magcal_service.recordings.report import RowFault

BY_NUMBER = '[time]\ncolumn = 1\nformat = "elapsed_s"\n[magnetometer]\ncolumns = [2, 3, 4]\nunit = "nT"\n'
BY_NAME = '[time]\ncolumn = "t"\nformat = "elapsed_s"\n[magnetometer]\ncolumns = ["x", "y", "z"]\nunit = "nT"\n'
CONSTANT = '[reference]\nconstant = 48000.0\nunit = "nT"\n'
WANTED = [[0.5, -1.0, 30000.25], [1.5, -2.0, 30001.0]]


def read(folder: Path, content: str, samples: str, rest: str, file: str = "LOG.TXT") -> Recording:
    data = content.encode()
    (folder / file).write_bytes(gzip.compress(data) if file.endswith(".gz") else data)
    (folder / "r.toml").write_text(f'version = 1\n[samples]\nfile = "{file}"\n{samples}\n{rest}{CONSTANT}')
    return read_recording(folder / "r.toml")


LAYOUTS = {
    "blanks, no header": (
        " 0  0.5 -1\t30000.25\n1 1.5  -2 30001\n",
        'delimiter = "whitespace"\nheader = false',
        BY_NUMBER,
    ),
    "blanks, quoted names": (
        '"t" "x"  "y" "z"\n0 0.5 -1 30000.25\n1 1.5 -2 30001\n',
        'delimiter = "whitespace"',
        BY_NAME,
    ),
    "bars": ("t|x|y|z\n0|0.5|-1|30000.25\n1|1.5|-2|30001\n", 'delimiter = "|"', BY_NAME),
    "decimal commas": (
        "t;x;y;z\n0;0,5;-1;30000,25\n1,0;1,5;-2,0;30001\n",
        'delimiter = ";"\ndecimal = ","',
        BY_NAME,
    ),
    "quoted decimal commas": ('t,x,y,z\n0,"0,5",-1,"30000,25"\n1,"1,5",-2,30001\n', 'decimal = ","', BY_NAME),
    "lines to skip, comments, header": (
        "Logger 3\n\n# a\nt,x,y,z\n# b\n0,0.5,-1,30000.25\n  # c\n1,1.5,-2,30001\n",
        'skip_lines = 1\ncomment = "#"',
        BY_NAME,
    ),
    "lines to skip, no header": (
        "a,b\nmore\n0,0.5,-1,30000.25\n1,1.5,-2,30001\n",
        "skip_lines = 2\nheader = false",
        BY_NUMBER,
    ),
}


@pytest.mark.parametrize("file", ["LOG.TXT", "a.log.gz", "noname"])
@pytest.mark.parametrize("case", LAYOUTS)
def test_a_log_is_read_as_it_is_laid_out(tmp_path: Path, case: str, file: str) -> None:
    recording = read(tmp_path, *LAYOUTS[case], file=file)
    assert recording.field_body_nt.tolist() == WANTED
    assert recording.time_ns.tolist() == [0, 1_000_000_000]
    assert (recording.report.rows, recording.report.entries) == (2, ())


def test_a_column_may_go_by_its_number_as_text_too(tmp_path: Path) -> None:
    channels = '[channels]\nmagnitude = { column = 2, unit = "nT" }\nheat = { columns = ["3"], unit = "degC" }\n'
    recording = read(tmp_path, "0,0.5,-1,30000.25\n1,1.5,-2,30001\n", "header = false", BY_NUMBER + channels)
    assert recording.channels["magnitude"].values[:, 0].tolist() == [0.5, 1.5]
    assert recording.channels["heat"].values[:, 0].tolist() == [-1.0, -2.0]


def test_rows_without_a_header_are_as_wide_as_most_of_them(tmp_path: Path) -> None:
    recording = read(tmp_path, "0,0.5\n0,0.5,-1,30000.25\n1,1.5,-2,30001\n", "header = false", BY_NUMBER)
    (entry,) = recording.report.entries
    assert (entry.fault, entry.first_line, entry.shows) == (RowFault.SHORT_ROW, 1, "2 cells where 4 are expected")


def test_comments_are_no_rows_where_rows_come_evenly(tmp_path: Path) -> None:
    rest = "[time]\nrate_hz = 2.0\n" + BY_NAME[BY_NAME.index("[magn") :]
    recording = read(tmp_path, "x,y,z\n1,2,3\n# 1\n# 2\nbad,2,3\n1,2,3\n", 'comment = "#"', rest)
    assert recording.time_ns.tolist() == [0, 1_000_000_000]


SHOWN = {
    "a text": ("oops", "'oops' in x where a number with a decimal comma is expected"),
    "a point beside decimal commas": ("1.5", "'1.5' in x where a number with a decimal comma is expected"),
    "control characters": ("\x1b[2J", "'\\x1b[2J' in x where"),
    "a long one": ("y" * 1000, f"'{'y' * 40}'... in x where"),
    "beyond 1 mT": ("2e9", "'2e9' '-1' '30000'"),
}


@pytest.mark.parametrize("case", SHOWN)
def test_the_first_cell_that_cannot_be_read_is_shown(tmp_path: Path, case: str) -> None:
    cell, shows = SHOWN[case]
    recording = read(tmp_path, f"t;x;y;z\n0;1;2;3\n1;{cell};-1;30000\n", 'delimiter = ";"\ndecimal = ","', BY_NAME)
    (line,) = recording.report.lines()[1:]
    assert line.startswith("magnetometer: ")
    assert f"first on line 3 ({shows}" in line
    assert len(line) < 200


def test_a_time_that_cannot_be_read_is_shown_in_a_refusal(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"first on line 2 \('noon' where an ISO 8601 instant is expected\)"):
        read(tmp_path, "t,x,y,z\nnoon,1,2,3\n", "", BY_NAME.replace("elapsed_s", "iso8601"))


def test_the_remedy_of_another_layout_is_named(tmp_path: Path) -> None:
    content = 't;x;y;z\n0;"0,5";2;3\n'
    with pytest.raises(RecordingError, match="one cell: check delimiter"):
        read(tmp_path, content, "", BY_NAME)
    with pytest.raises(RecordingError, match="'0,5' in x where a number is expected; decimal = \",\" under"):
        read(tmp_path, content, 'delimiter = ";"', BY_NAME)
    (tmp_path / "LOG.TXT").write_text("t,x,y,z\n0,1,2,3\n", encoding="utf-16")
    with pytest.raises(RecordingError, match="iconv -f UTF-16"):
        read_recording(tmp_path / "r.toml")


REFUSED = {
    "decimal": ('decimal = "x"', "samples.decimal"),
    "blank comment": ('comment = " "', "samples.comment"),
    "unknown key": ("skip_line = 2", "samples.skip_line: .*did you mean 'skip_lines'"),
    "too many lines skipped": ("skip_lines = 9", "LOG.TXT: '3 lines' .*check skip_lines"),
    "a number with a header": ("\n".join(["", "[time]", 'column = "1"', 'format = "elapsed_s"']), "header = false"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_a_layout_that_cannot_be_is_refused(tmp_path: Path, case: str) -> None:
    samples, says = REFUSED[case]
    rest = BY_NAME[BY_NAME.index("[magn") :] if "[time]" in samples else BY_NAME
    with pytest.raises(RecordingError, match=says):
        read(tmp_path, "t,x,y,z\n0,1,2,3\n", samples, rest)


@pytest.mark.parametrize("name", ["MAG00017", "flight.bin", "a b.TXT"])
def test_a_log_in_place_of_its_descriptor_is_sent_to_what_makes_one(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_text("t,x,y,z\n0,1,2,3\n")
    with pytest.raises(RecordingError, match=r"log without its descriptor.*magcal describe .* --out .*RECORDING.toml"):
        read_recording(tmp_path / name)


def test_a_descriptor_under_any_name_is_read(tmp_path: Path) -> None:
    read(tmp_path, "t,x,y,z\n0,1,2,3\n", "", BY_NAME)
    (tmp_path / "described").write_text("# a log\n\n" + (tmp_path / "r.toml").read_text())
    assert len(read_recording(tmp_path / "described")) == 1


def test_rows_in_memory_have_no_layout() -> None:
    with pytest.raises(RecordingError, match="samples: 'decimal' is refused"):
        from_dataframe({"t": np.arange(2)}, {"samples": {"decimal": ","}})


MAG = "t,x,y,z\n10,1,2,3\n11,1,2,3\n12.5,1,2,3\n20,1,2,3\n"
GPS = "s;heat\n10500;7,5\n9000;6\nx;1\n12500;bad\n12500;8\n"
JOIN = """[[samples.join]]
file = "gps.dat"
name = "gps"
delimiter = ";"
decimal = ","
tolerance_s = 2.0
time = { column = "s", format = "elapsed_ms" }
"""
HEAT = '[channels]\nheat = { column = "gps.heat", unit = "degC" }\n'


def joined(folder: Path, join: str = JOIN, heat: str = HEAT) -> Recording:
    (folder / "gps.dat").write_text(GPS)
    return read(folder, MAG, join, BY_NAME + heat)


def test_a_row_takes_the_newest_joined_row_that_is_not_later_within_the_tolerance(tmp_path: Path) -> None:
    recording = joined(tmp_path)
    assert recording.channels["heat"].values[:, 0].tolist() == pytest.approx([6.0, 7.5, 8.0, np.nan], nan_ok=True)
    counted = {(one.part, one.fault): (one.count, one.first_line) for one in recording.report.entries}
    assert counted == {
        ("gps.time", RowFault.UNPARSABLE): (1, 4),
        ("gps", RowFault.UNMATCHED): (1, 5),
        ("channels.heat", RowFault.MISSING): (1, 5),
    }
    assert recording.descriptor.files[-1] == tmp_path / "gps.dat"


REFUSED_JOINS = {
    "no such column": (JOIN, HEAT.replace("gps.heat", "gps.heatt"), "did you mean 'gps.heat'"),
    "no such file": (JOIN.replace("gps.dat", "none.dat"), HEAT, "none.dat: there is no such file"),
    "another clock": (JOIN.replace("elapsed_ms", "unix_ms"), HEAT, r"samples.join\[0\].time: 'utc'"),
    "no such time": (JOIN.replace('"s"', '"q"'), HEAT, r"samples.join\[0\].time.column: 'q'"),
    "no tolerance": (JOIN.replace("tolerance_s = 2.0", ""), HEAT, r"samples.join\[0\].tolerance_s: missing"),
    "twice a name": (JOIN + JOIN, HEAT, "a name of its own"),
}


@pytest.mark.parametrize("case", REFUSED_JOINS)
def test_a_join_that_cannot_be_is_refused(tmp_path: Path, case: str) -> None:
    join, heat, says = REFUSED_JOINS[case]
    with pytest.raises(RecordingError, match=says):
        joined(tmp_path, join, heat)


@pytest.mark.parametrize("units", ["s,nT,nT,nT,nT", "[s],[nT],[nT],[nT],-", "s;nT;nT;nT;"])
def test_a_line_of_units_is_no_row_and_is_held_against_the_description(units: str, tmp_path: Path) -> None:
    lines = [f"{i},{30000 + i},-20000,{100 * (i % 7)},48000" for i in range(60)]
    text = "\n".join(["t,x,y,z,f", units.replace(";", ","), *lines, ""])
    descriptor = (
        'version = 1\n[samples]\nfile = "log.csv"\n[time]\ncolumn = "t"\nformat = "elapsed_s"\n[magnetometer]\n'
    )
    descriptor += 'columns = ["x", "y", "z"]\nunit = "nT"\n[reference]\nmagnitude = "f"\nunit = "nT"\n'
    (tmp_path / "log.csv").write_text(text)
    (tmp_path / "RECORDING.toml").write_text(descriptor)
    report = read_recording(tmp_path / "RECORDING.toml").report
    assert (report.rows, report.used, report.entries) == (60, 60, ())
    assert report.remarks == ("a line of units stands below the header and is no row",)
    (tmp_path / "log.csv").write_text(text.replace("nT", "mG"))
    (remark,) = read_recording(tmp_path / "RECORDING.toml").report.remarks
    assert "mG of 'x', which the descriptor takes in nT" in remark
    (tmp_path / "log.csv").write_text(text.replace(units.replace(";", ","), "s,nT,nT,broken,0.5"))
    assert read_recording(tmp_path / "RECORDING.toml").report.refused == 1
