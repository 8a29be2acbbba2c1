"""Logs of makers whose files are no rows: refused with what they are, and with the command that makes rows of them."""

from __future__ import annotations

import gzip
import json
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from magcal_service.base.errors import RecordingError
from magcal_service.recordings.describe.describe import describe
from tests.recordings.describe import maker_logs

FIELD = maker_logs.ground(300) / 1e3
PLACE = {"reference": "49.2 uT"}


def refusal(path: Path) -> str:
    with pytest.raises(RecordingError) as refused:
        describe(path, {})
    return str(refused.value)


@pytest.mark.parametrize(
    ("name", "begins", "words"),
    [
        ("00000001.BIN", b"\xa3\x95\x80\x80\x59FMT\0", "an ArduPilot log: mavlogdump.py --types MAG --format csv"),
        ("log.ulg", b"ULog\x01\x12\x35\x01\0", "a PX4 log: ulog2csv"),
        ("x.tlog", b"\0\5\xfe\x1c", "a telemetry log: mavlogdump.py"),
        ("LOG.BFL", b"H Product:Blackbox flight data recorder\n\0", "a Betaflight log: blackbox_decode"),
        ("phyphox.zip", b"PK\x03\x04\x14\0", "a packed file: unpack it (unzip "),
        ("x.ubx", b"\xb5\x62\x01\x07", "a u-blox receiver's log, which has places and no magnetometer: write"),
        ("x.fits", b"SIMPLE  =                    T", "a FITS file: write its table as CSV"),
        ("x.mat", b"MATLAB 5.0 MAT-file, Platform\0", "a MATLAB file: write it with writematrix"),
        ("x.h5", b"\x89HDF\r\n\x1a\n\0", "an HDF5 file"),
        ("x.parquet", b"PAR1\0", "a Parquet file"),
        ("x.npy", b"\x93NUMPY\1\0", "a numpy array"),
        ("x.db", b"SQLite format 3\0", "an SQLite file: sqlite3 -header -csv"),
        ("x.dat", b"\0\1\2\3", "a binary log has to be written as CSV by its own tool first"),
    ],
)
def test_a_binary_log_is_refused_with_the_tool_of_its_maker(
    name: str, begins: bytes, words: str, tmp_path: Path
) -> None:
    path = tmp_path / name
    path.write_bytes(begins + bytes(range(256)) * 8)
    assert words in refusal(path)
    packed = tmp_path / f"{name}.gz"
    packed.write_bytes(gzip.compress(path.read_bytes()))
    assert "is refused" in refusal(packed)


def rows(form: str) -> list[str]:
    """Each reading in a form, five a second from noon on."""
    found = []
    for index, (x, y, z) in enumerate(FIELD):
        clock = f"12:{index // 300:02d}:{index // 5 % 60:02d}.{index % 5 * 200:03d}"
        found.append(form.format(clock=clock, ms=index * 200 + 312, x=x, y=y, z=z))
    return found


STAMPED = {
    "serial monitor": ("{clock} -> {x:.3f},{y:.3f},{z:.3f}", "\r\n"),
    "brackets, tabs": ("[{clock}] {x:.3f}\t{y:.3f}\t{z:.3f}", "\n"),
    "brackets, blanks": ("[{clock}] {x:.3f} {y:.3f}  {z:.3f}", "\n"),
    "date and clock": ("[2025-07-01 {clock}] {x:.3f};{y:.3f};{z:.3f}", "\n"),
    "since boot": ("I ({ms}) MAG: {x:.3f} {y:.3f} {z:.3f}", "\n"),
    "sentences": ("$PMAG,{clock},{x:.3f},{y:.3f},{z:.3f}*3F", "\r\n"),
}


@pytest.mark.skipif(shutil.which("sed") is None, reason="the command is one of sed")
@pytest.mark.parametrize("kind", STAMPED)
def test_the_command_that_is_named_makes_a_log_that_is_described(kind: str, tmp_path: Path) -> None:
    """As somebody would: copied into a shell."""
    form, end = STAMPED[kind]
    path = tmp_path / "a log's dump.txt"
    path.write_text(end.join(rows(form)) + end, newline="")
    said = refusal(path)
    command = said[said.index("sed ") : said.index("> log.csv") + len("> log.csv")]
    subprocess.run(["sh", "-c", command], cwd=tmp_path, check=True)
    asked = describe(tmp_path / "log.csv", PLACE)
    answers = {question.key: question.candidates[0][0] for question in asked.questions if question.needed}
    assert set(answers) <= {"time.rate_hz", "time.format", "magnetometer.columns"}
    text = describe(tmp_path / "log.csv", PLACE | answers).text or ""
    assert 'columns = ["2", "3", "4"]\nunit = "uT"' in text
    assert "rate_hz = 5.0" in text or 'format = "elapsed_ms"' in text or 'format = "iso8601"' in text


@pytest.mark.parametrize(
    ("form", "words"),
    [
        ("mx={x:.2f} my={y:.2f} mz={z:.2f}", "values with their names in each line"),
        ("imu,sat=a x={x:.3f},y={y:.3f},z={z:.3f} {ms}", "values with their names in each line"),
        ("2025: MAG {{TimeUS : {ms}, MagX : {x:.0f}, MagY : {y:.0f}}}", "mavlogdump.py --types MAG --format csv"),
        ("ATT, {ms}, 1.2, 3.4\nMAG, {ms}, 0, {x:.0f}, {y:.0f}, {z:.0f}", "lines of several kinds ("),
    ],
)
def test_text_that_is_no_rows_is_refused_with_what_it_is(form: str, words: str, tmp_path: Path) -> None:
    path = tmp_path / "log.txt"
    path.write_text("\n".join(rows(form)))
    assert words in refusal(path)


def test_signs_between_thousands_are_named(tmp_path: Path) -> None:
    path = tmp_path / "sheet.csv"
    head, fields = "t_s;mx_nT;my_nT;mz_nT", [f"54.49{i % 7},3;-35.95{i % 9},7;22.79{i % 5},0" for i in range(300)]
    path.write_text("\n".join([head, *(f"2025-07-01 12:00:{i % 60:02d};{row}" for i, row in enumerate(fields))]))
    assert "numbers have signs between thousands: export them without" in refusal(path)


def test_several_numbers_in_one_cell_are_named(tmp_path: Path) -> None:
    path = tmp_path / "vectors.csv"
    lines = [
        f'2025-07-01T00:{i // 60:02d}:{i % 60:02d}Z,"[{x:.1f}, {y:.1f}, {z:.1f}]"' for i, (x, y, z) in enumerate(FIELD)
    ]
    path.write_text("\n".join(["Timestamp,B_VFM", *lines]))
    (asked,) = (one for one in describe(path, PLACE).questions if one.key == "magnetometer.columns")
    assert "In 'B_VFM', cells such as '[" in asked.asks
    assert "hold several numbers: write each in a column of its own" in asked.asks


def test_of_labelled_values_given_twice_those_with_the_unit_are_the_field(tmp_path: Path) -> None:
    """As an example of a library prints them: counts, then the same in microtesla."""
    path = tmp_path / "monitor.txt"
    counts = np.round(FIELD * 68.42)
    lines = [
        f"X:  {a:.0f} Y:  {b:.0f} Z:  {c:.0f} X: {x:.2f} Y: {y:.2f} Z: {z:.2f} uTesla"
        for (a, b, c), (x, y, z) in zip(counts, FIELD, strict=True)
    ]
    path.write_text("\n".join(lines))
    text = describe(path, PLACE | {"time.rate_hz": "5"}).text or ""
    assert 'columns = ["8", "10", "12"]\nunit = "uT"' in text


def objects() -> list[str]:
    return [
        json.dumps({"t_s": index / 5, "mag": {"x": x, "y": y, "z": z}, "gyro": [0.1, 0.2, 0.3]})
        for index, (x, y, z) in enumerate(FIELD.tolist())
    ]


def in_hex() -> list[str]:
    """Counts of 6 nT in three bytes, below 0 in two's complement."""
    counts = np.round(FIELD * 1e3 / 6.0).astype(int) & 0xFFFFFF
    lines = [f"{i / 5},0x{x:06X},0x{y:06X},0x{z:06X}" for i, (x, y, z) in enumerate(counts.tolist())]
    return ["# 6.0 nT/LSB", "t_s,mx,my,mz", *lines]


@pytest.mark.parametrize(
    ("lines", "tool", "unit"),
    [
        (objects(), "jq", 'unit = "uT"'),
        (in_hex(), "perl", 'unit = "nT"\nfactor = 6.0'),
        (
            ["t_s^mx_uT^my_uT^mz_uT", *("^".join(row.split(",")) for row in rows("{ms},{x},{y},{z}"))],
            "tr",
            'unit = "uT"',
        ),
    ],
)
def test_other_text_is_refused_with_a_command_that_makes_rows_of_it(
    lines: list[str], tool: str, unit: str, tmp_path: Path
) -> None:
    if shutil.which(tool) is None:
        pytest.skip(f"no {tool} here")
    path = tmp_path / "a log's dump.txt"
    path.write_text("\n".join(lines))
    said = refusal(path)
    begin = said.index("(echo") if tool == "jq" else said.index(f"{tool} ")
    command = said[begin : said.index("> log.csv") + len("> log.csv")]
    subprocess.run(["sh", "-c", command], cwd=tmp_path, check=True)
    asked = describe(tmp_path / "log.csv", PLACE)
    answers = {question.key: question.form for question in asked.questions if question.needed}
    assert set(answers) <= {"time.format"}
    assert unit in (describe(tmp_path / "log.csv", PLACE | answers).text or "")


@pytest.mark.parametrize("indent", [None, 1])
@pytest.mark.parametrize("wrap", [lambda one: one, lambda one: [one]])
def test_a_document_of_json_is_refused(indent: int | None, wrap: Callable[[object], object], tmp_path: Path) -> None:
    """A result of ``calibrate`` was asked for its magnetometer."""
    path = tmp_path / "result.json"
    path.write_text(json.dumps(wrap({"trusted": False, "bias_nt": [1.5, 2.5, 3.5] * 30}), indent=indent) + "\n\n")
    assert "write the values as CSV, a row a line" in refusal(path) or "one line" in refusal(path)


@pytest.mark.parametrize("line", ["<a><b>1</b></a>", "{1, 2, 3}", "{}"])
def test_other_marked_up_text_is_refused_in_general_words(line: str, tmp_path: Path) -> None:
    path = tmp_path / "log.txt"
    path.write_text("\n".join([line] * 50))
    assert "write the values as CSV, a row a line" in refusal(path)
