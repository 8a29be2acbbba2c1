"""``magcal inspect``: exit codes, the findings as lines and as JSON, and no control character on the terminal."""

import json
from pathlib import Path

import numpy as np

from tests.cli.cli_inputs import run
from tests.recordings.inspect.clean_logs import clean_log


def zeros(column: np.ndarray) -> np.ndarray:
    column[[700, 900]] = 0.0
    return column


def test_a_clean_recording(tmp_path: Path) -> None:
    done = run("inspect", clean_log().write(tmp_path), "--json", tmp_path / "found.json")
    assert (done.code, done.err) == (0, "")
    assert "no defect found; 1800 of 1800 rows can be used" in done.out
    assert json.loads((tmp_path / "found.json").read_text()) == {
        "usable": True,
        "rows": 1800,
        "used": 1800,
        "left_out": {"unreadable": 0, "defect": 0, "same_time": 0, "no_reference": 0},
        "findings": [],
    }


def test_a_defect_is_a_line_and_an_entry(tmp_path: Path) -> None:
    done = run("inspect", clean_log().spoiled("mx my mz", zeros).write(tmp_path), "--json", tmp_path / "found.json")
    assert done.code == 3
    assert "2 rows of 1800 read (0, 0, 0)" in done.out
    content = json.loads((tmp_path / "found.json").read_text())
    assert (content["usable"], content["rows"], content["used"]) == (True, 1800, 1798)
    assert content["left_out"] == {"unreadable": 0, "defect": 2, "same_time": 0, "no_reference": 0}
    assert "\nleft out: 2 with a certain defect\n" in done.out
    assert "1800 rows, 1800 read, 0 refused" in done.out
    (finding,) = content["findings"]
    assert {key: finding[key] for key in ("code", "rows", "first", "certain")} == {
        "code": "zero_rows",
        "rows": 2,
        "first": 702,
        "certain": True,
    }
    assert finding["says"]
    assert finding["remedy"]


def test_a_recording_that_is_refused(tmp_path: Path) -> None:
    path = (
        clean_log().described(magnetometer='[magnetometer]\ncolumns = ["mx", "my", "m"]\nunit = "nT"').write(tmp_path)
    )
    done = run("inspect", path)
    assert (done.code, done.out) == (2, "")
    assert "magnetometer.columns" in done.err


def test_a_file_that_cannot_be_written(tmp_path: Path) -> None:
    assert run("inspect", clean_log().write(tmp_path), "--json", tmp_path / "no" / "found.json").code == 2


def test_control_characters_of_a_header_are_shown_escaped(tmp_path: Path) -> None:
    path = clean_log().write(tmp_path)
    log = tmp_path / "log.csv"
    log.write_text(log.read_text().replace(",F,", ",\x1b]0;owned\x07\x1b[31mF\x9b2J\u202e,", 1))
    for command in ("inspect", "calibrate", "replay"):
        done = run(command, path)
        assert done.code == 2
        assert "\\x1b]0;owned\\x07\\x1b[31mF\\x9b2J\\u202e" in done.err
        assert all(one.isprintable() or one == "\n" for one in done.err + done.out)


def test_control_characters_of_a_descriptor_are_shown_escaped(tmp_path: Path) -> None:
    path = clean_log().described(reference='[reference]\nmagnitude = "F"\nunit = "n\\u001b[31mT"\n').write(tmp_path)
    path.write_text(path.read_text() + '"\\u001b[2Jkey" = 1\n')
    done = run("calibrate", path)
    assert done.code == 2
    assert all(one.isprintable() or one == "\n" for one in done.err + done.out)


def test_lists_of_columns_are_short(tmp_path: Path) -> None:
    path = (
        clean_log().described(magnetometer='[magnetometer]\ncolumns = ["a", "my", "mz"]\nunit = "nT"').write(tmp_path)
    )
    log = tmp_path / "log.csv"
    header, rest = log.read_text().split("\n", 1)
    log.write_text(header + "".join(f",column{number}" + "x" * 500 for number in range(2000)) + "\n" + rest)
    done = run("calibrate", path)
    assert done.code == 2
    assert len(done.err) < 6000
    assert " more" in done.err
