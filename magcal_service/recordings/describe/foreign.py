"""Logs that are no rows of values as they stand, by their makers' formats, and the command that makes rows of them."""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from shlex import quote
from typing import Final

from magcal_service.base.errors import printable

_MOSTLY: Final = 0.8  # of the lines looked at have to have the form
_KINDS: Final = (2, 40)  # of lines in one log: fewer are a label, more are names of something else
_FEWEST_VALUES: Final = 3  # with their names in one line, to be rows of such
_SHOWN: Final = 4  # kinds of lines that are named

_BINARY: Final = (
    (b"\xa3\x95", "an ArduPilot log", "mavlogdump.py --types MAG --format csv {log} > MAG.csv (of pymavlink)"),
    (b"ULog\x01\x12\x35", "a PX4 log", "ulog2csv {log} (of pyulog) makes a file of each topic, sensor_mag among them"),
    (b"H Product:Blackbox", "a Betaflight log", "blackbox_decode {log} (of blackbox-tools) makes a .csv"),
    (
        b"\xb5\x62",
        "a u-blox receiver's log, which has places and no magnetometer",
        "write its NAV-PVT messages as CSV, with pyubx2 say, and join them to the magnetometer's log",
    ),
    (b"SIMPLE  =", "a FITS file", "write its table as CSV: astropy.table.Table.read(...).write('log.csv')"),
    (b"PK\x03\x04", "a packed file", "unpack it (unzip {log}); of a spreadsheet, save the sheet as CSV"),
    (b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1", "a spreadsheet", "save the sheet as CSV"),
    (b"MATLAB 5.0 MAT-file", "a MATLAB file", "write it with writematrix or writetable in MATLAB, as .csv"),
    (b"\x89HDF\r\n\x1a\n", "an HDF5 file (.h5, .nc, .mat 7.3)", "write its columns as CSV, with h5py or pandas say"),
    (b"PAR1", "a Parquet file", "write its columns as CSV: pandas.read_parquet(...).to_csv(...)"),
    (b"\xcd\xf3\x00\x01", "a CDF file", "write its variables as CSV, with cdflib say"),
    (b"\xcd\xf2\x60\x02", "a CDF file", "write its variables as CSV, with cdflib say"),
    (b"CDF\x01", "a netCDF file", "write its variables as CSV, with xarray say"),
    (b"CDF\x02", "a netCDF file", "write its variables as CSV, with xarray say"),
    (b"\x93NUMPY", "a numpy array", "write it as CSV: numpy.savetxt(..., numpy.load(...), delimiter=',')"),
    (b"SQLite format 3\x00", "an SQLite file", "sqlite3 -header -csv {log} 'SELECT * FROM TABLE' > log.csv"),
    (b"#ROSBAG", "a ROS bag", "rostopic echo -b {log} -p TOPIC > mag.csv"),
)  # fmt: skip
"""How such a file begins, what it is, and what makes rows of it.

Tried: pymavlink 2.4.50 and pyulog 1.3.0, pandas, numpy, sqlite3.  The others are as their makers say.
"""

_STAMP: Final = re.compile(
    r"\s*(?P<open>\[)?(?P<date>\d[\d-]*[ T])?\d\d?:\d\d:\d\d[\d.:]*(?P<close>\])?\s*(?P<arrow>->)?\s*(?P<rest>\S.*)"
)
_BOOT: Final = re.compile(r"[A-Z] \(\d+\) [^:]*:\s*(?P<rest>\S.*)")
_NAMED: Final = re.compile(r"[A-Za-z_]\w*=-?[\d.]|[A-Za-z_]+:-?[\d.]")
_SENTENCE: Final = re.compile(r"\$[A-Z]+,.*\*[0-9A-Fa-f]{2}\s*")
_THOUSANDS: Final = re.compile(r"-?\d{1,3}([.,]\d{3})+[.,]\d+")
_APART: Final = "have signs between thousands: export them without"
_KIND: Final = re.compile(r"\s*(?P<kind>[A-Za-z$][\w$]*)\s*,")
_VECTOR: Final = re.compile(r"[\[(]\s*-?[\d.]")
_HEX: Final = re.compile(r"\b0x[0-9A-Fa-f]+\b")
_PLAIN: Final = re.compile(r"(\.[A-Za-z_][A-Za-z0-9_]*|\.?\[\d+\])+", re.ASCII)
_MAVLINK: Final = re.compile(r"\w+ \{\w+ : ")


def _named(path: Path) -> str:
    """A file's name as a shell takes it."""
    return printable(quote(str(path)))


def of_binary(path: Path, piece: bytes) -> str:
    """What a binary log is, and what makes rows of it; general words where its beginning is not known."""
    for magic, what, makes in _BINARY:
        if piece.startswith(magic):
            return f"{what}: {makes.format(log=_named(path))}"
    if path.suffix.lower() == ".tlog":
        return f"a telemetry log: mavlogdump.py --types RAW_IMU --format csv {_named(path)} > log.csv (of pymavlink)"
    return "text in rows is accepted: a binary log has to be written as CSV by its own tool first"


def of_text(path: Path, lines: Sequence[str]) -> str:
    """Why lines are no rows as they stand, and what makes rows of them; empty where nothing speaks against them."""
    log = _named(path)
    if _share(lines, _MAVLINK.search):
        return "messages with their fields' names: mavlogdump.py --types MAG --format csv LOG.BIN > MAG.csv writes rows"
    if _share(lines, _SENTENCE.fullmatch):
        kinds = [line.strip().split(",")[0] for line in lines]
        names = [name for name, _ in Counter(kinds).most_common()]
        return (
            f"sentences with checksums ({', '.join(names[:_SHOWN])}): "
            f"sed -n -E 's/^\\{names[0]},(.*)\\*...?$/\\1/p' {log} > log.csv takes one kind of them"
        )
    stamped = _stamped(lines, log)
    if stamped:
        return stamped
    if _share(lines, lambda line: len(_NAMED.findall(line)) >= _FEWEST_VALUES):
        return "values with their names in each line: write them as CSV, the names once in a line above"
    if _share(lines, lambda line: sum(bool(_THOUSANDS.fullmatch(cell)) for cell in re.split(r"[;|\t]", line)) > 1):
        return f"numbers {_APART}"
    return ""


def _share(lines: Sequence[str], fits: Callable[[str], object]) -> bool:
    return bool(lines) and sum(bool(fits(line)) for line in lines) >= _MOSTLY * len(lines)


def _stamped(lines: Sequence[str], log: str) -> str:
    """A terminal's stamp before each line: in brackets, or with an arrow behind it."""
    found = [match for line in lines if (match := _STAMP.fullmatch(line)) and (match["close"] or match["arrow"])]
    boot = [match for line in lines if (match := _BOOT.fullmatch(line))]
    if lines and len(found) >= _MOSTLY * len(lines):
        dated = bool(found[0]["date"])
        stamp, kept = (r"([0-9-]+)[ T]([0-9:.]+)", r"\1T\2") if dated else ("([0-9:.]+)", r"\1")
        step, rest = rf"s/^ *\[?{stamp}\]? *(->)? */{kept}", found[-1]["rest"]
    elif lines and len(boot) >= _MOSTLY * len(lines):
        step, rest = r"s/^[A-Z] \(([0-9]+)\) [^:]*: */\1", boot[-1]["rest"]
    else:
        return ""
    sign = next((one for one in (";", "\t", ",") if one in rest), "")
    between = {"": ",", "\t": r"\t"}.get(sign, sign)
    blanks = "" if sign else r"; s/[ \t]+/,/g"
    return f"a stamp stands before each row: sed -E '{step}{between}/{blanks}' {log} > log.csv cuts it off as a column"


def of_unequal(path: Path, lines: Sequence[str]) -> str:
    """Why no delimiter cuts lines into equally many values; empty where nothing is known."""
    if _share(lines, lambda line: len(_HEX.findall(line)) >= _FEWEST_VALUES):
        step = "s/0x([0-9A-Fa-f]+)/$n=hex $1; $m=16**length $1; $n<$m\\/2?$n:$n-$m/ge"
        return (
            f"numbers are hexadecimal: perl -pe '{step}' {_named(path)} > log.csv makes decimals of them, the upper "
            "half of what the digits can be below 0"
        )
    if _share(lines, lambda line: line.count('"') > 1 and line.strip().startswith('"')):
        return f"rows stand in quotes, or have them doubled: tr -d '\"' < {_named(path)} > log.csv takes them out"
    kinds = [match["kind"] for line in lines if (match := _KIND.match(line))]
    names = [name for name, _ in Counter(kinds).most_common()]
    if lines and len(kinds) >= _MOSTLY * len(lines) and _KINDS[0] <= len(names) <= _KINDS[1]:
        shown = ", ".join(names[:_SHOWN])
        return (
            f"lines of several kinds ({shown}): keep one kind, as by grep '^MAG' {_named(path)} > MAG.csv; of an "
            "ArduPilot log, mavlogdump.py --types MAG --format csv does it with the names"
        )
    return ""


def of_marked_up(path: Path, line: str) -> str:
    """What makes rows of a log in JSON or XML."""
    try:
        leaves = [leaf for leaf in _leaves(json.loads(line), "") if _PLAIN.fullmatch(leaf)]
    except ValueError:
        leaves = []
    if not leaves:
        return "a text file of rows is accepted; write the values as CSV, a row a line"
    names = ",".join(leaf.lstrip(".") for leaf in leaves)
    program = f"[{', '.join(leaves)}] | @csv"
    return (
        f"an object a line: (echo {quote(names)}; jq -r {quote(program)} {_named(path)}) > log.csv makes rows of them"
    )


def _leaves(value: object, path: str) -> list[str]:
    """Where the values of an object lie, as jq writes it."""
    if isinstance(value, dict):
        return [leaf for key, one in value.items() for leaf in _leaves(one, f"{path}.{key}")]
    if isinstance(value, list):
        return [leaf for at, one in enumerate(value) for leaf in _leaves(one, f"{path or '.'}[{at}]")]
    return [path] if path else []


def of_cells(cells: Sequence[str]) -> str:
    """Why filled cells are no numbers; empty where nothing is known."""
    filled = [cell.strip() for cell in cells if cell.strip()]
    if sum(bool(_THOUSANDS.fullmatch(cell)) for cell in filled) * 2 > len(filled):
        return f"numbers such as {filled[0]!r} {_APART}"
    if sum(bool(_VECTOR.match(cell)) for cell in filled) * 2 > len(filled):
        return f"cells such as {filled[0]!r} hold several numbers: write each in a column of its own"
    return ""
