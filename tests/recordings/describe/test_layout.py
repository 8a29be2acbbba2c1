"""The form of a log's text: what cuts it, where its rows begin, and what its columns are called."""

from __future__ import annotations

from pathlib import Path

import pytest

from magcal_service.recordings.describe.columns import read_log, triples
from magcal_service.recordings.describe.layout import Layout, find_layout
from magcal_service.recordings.describe.sample import read_sample
from magcal_service.recordings.unit_words import split_unit


def layout_of(text: str, folder: Path) -> Layout:
    log = folder / "log.txt"
    log.write_text(text, encoding="utf-8")
    return find_layout(read_sample(log))


def rows(line: str, count: int = 9) -> str:
    return "".join(line.replace("#", str(number)) + "\n" for number in range(count))


FORMS = {
    "comma": ("t,x,y\n" + rows("#,1.5,2"), (",", ".", "", 0, True), ("t", "x", "y")),
    "semicolon, decimal comma": ("t;x;y\n" + rows("#;1,5;-2,25"), (";", ",", "", 0, True), ("t", "x", "y")),
    "tab, decimal comma": ("t\tx\ty\n" + rows("#\t1,5\t2,0"), ("\t", ",", "", 0, True), ("t", "x", "y")),
    "pipe": ("t|x|y\n" + rows("#|1.5|2"), ("|", ".", "", 0, True), ("t", "x", "y")),
    "blanks": ("t x y\n" + rows("  #   1.5 2"), ("whitespace", ".", "", 0, True), ("t", "x", "y")),
    "blanks, decimal comma": (rows("# 1,5 -2,5 3,5"), ("whitespace", ",", "", 0, False), ("",) * 4),
    "no header": (rows("#,1.5,2"), (",", ".", "", 0, False), ("", "", "")),
    "date in blanks": (rows("2025-07-01 00:00:0# 1.5"), ("whitespace", ".", "", 0, False), ("", "", "")),
    "preamble": ("Logger 7\nSerial: 12\n\nt,x,y\n" + rows("#,1.5,2"), (",", ".", "", 3, True), ("t", "x", "y")),
    "comments": ("# made by\n# hand\nt,x,y\n" + rows("#,1.5,2"), (",", ".", "#", 0, True), ("t", "x", "y")),
    "names in a comment": ("% t x y\n" + rows("# 1.5 2"), ("whitespace", ".", "%", 1, False), ("t", "x", "y")),
    "line of units": ("t;x;y\n[s];[uT];[uT]\n" + rows("#;1.5;2"), (";", ".", "", 0, True), ("t", "x", "y")),
    "name twice": ("t,x,x\n" + rows("#,1.5,2"), (",", ".", "", 1, False), ("t", "x", "x")),
    "row numbers": ("t,x,y\n" + rows("1#,0.5,1.5,2"), (",", ".", "", 1, False), ("", "t", "x", "y")),
    "a name too few": ("t,x,y\n" + rows("0.#,0.5,1.5,2"), (",", ".", "", 1, False), ("",) * 4),
    "trailing delimiter": ("t,x,y\n" + rows("#,1.5,2,"), (",", ".", "", 0, True), ("t", "x", "y", "")),
    "labels": (rows("X: 1.# Y: 2.# Z: 3 uT"), ("whitespace", ".", "", 0, False), ("", "X", "", "Y", "", "Z", "")),
}


@pytest.mark.parametrize("form", FORMS)
def test_the_form_of_a_text(form: str, tmp_path: Path) -> None:
    text, wanted, names = FORMS[form]
    found = layout_of(text, tmp_path)
    assert (found.delimiter, found.decimal, found.comment, found.skip_lines, found.header) == wanted
    assert found.names == names


def test_units_come_from_names_and_from_a_line_of_them(tmp_path: Path) -> None:
    log = tmp_path / "log.csv"
    log.write_text("t,mx,my,mz\ns,uT,uT,uT\n" + rows("#,1.5,2,3"))
    sample = read_sample(log)
    table = read_log(sample, find_layout(sample))
    assert [column.unit for column in table.columns] == ["s", "uT", "uT", "uT"]
    assert table.rows == 9


@pytest.mark.parametrize(
    ("name", "stem", "unit"),
    [
        ("mx_uT", "mx", "uT"),
        ("mag_x [mG]", "mag_x", "mG"),
        ("Magnetic field x (µT)", "Magnetic field x", "uT"),
        ("Bx/nT", "Bx", "nT"),
        ("B_G", "B", "G"),
        ("TimeUS", "Time", "us"),
        ("gyro_x_deg/s", "gyro_x", "deg/s"),
        ("temp_degC", "temp", "degC"),
        ("magnetometer_ga[0]", "magnetometer[0]", "G"),
        ("imu_T", "imu_T", ""),
        ("sun_x", "sun_x", ""),
        ("lat", "lat", ""),
    ],
)
def test_a_name_gives_its_unit(name: str, stem: str, unit: str) -> None:
    assert split_unit(name) == (stem, unit)


def test_three_axes_are_found_whatever_their_name_is_built_like(tmp_path: Path) -> None:
    log = tmp_path / "log.csv"
    names = "t,mx,my,mz,B_x_raw,B_y_raw,B_z_raw,B_x,B_y,B_z,q0,q1,q2,q3,gyrox,gyroy,gyroz,mag[0],mag[1],mag[2]"
    log.write_text(f"{names}\n" + rows("#" + ",1.5" * names.count(",")))
    sample = read_sample(log)
    found = triples(read_log(sample, find_layout(sample)))
    assert [triple.columns[0].name for triple in found] == ["mx", "B_x_raw", "B_x", "gyrox", "mag[0]"]
    assert [triple.unit for triple in found] == ["", "counts", "", "", ""]
