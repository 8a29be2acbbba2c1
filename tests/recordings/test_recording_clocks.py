"""Every form of a time, against instants worked out by hand."""

from pathlib import Path

import pytest

from magcal_service.base.errors import RecordingError
from magcal_service.recordings.reader import read_recording
from magcal_service.recordings.recording import Recording
from magcal_service.recordings.report import RowFault
from magcal_service.recordings.timestamps import ns_to_iso8601

REST = '[magnetometer]\ncolumns = ["x", "y", "z"]\nunit = "nT"\n[reference]\nconstant = 4e4\nunit = "nT"\n'
DATE_TIME = 'columns = ["a", "b"]\npattern = '
GPS = 'columns = ["a", "b"]\nformat = "gps_week_s"\n'


def read(folder: Path, a: str, b: str, time: str) -> Recording:
    (folder / "log.csv").write_text(f"a,b,x,y,z\n{a},{b},1,2,3\n")
    (folder / "r.toml").write_text(f'version = 1\n[samples]\nfile = "log.csv"\n[time]\n{time}\n{REST}')
    return read_recording(folder / "r.toml")


INSTANTS = {
    "date and time": ("24/08/2023", "14:44:09", DATE_TIME + '"%d/%m/%Y %H:%M:%S"', "2023-08-24T14:44:09.000000000Z"),
    "blanks around": (" 24/08/2023", " 14:44:09 ", DATE_TIME + '"%d/%m/%Y %H:%M:%S"', "2023-08-24T14:44:09.000000000Z"),
    "nanoseconds": (
        "2023.08.24",
        "14:44:09.123456789",
        DATE_TIME + '"%Y.%m.%d %H:%M:%S.%f"',
        "2023-08-24T14:44:09.123456789Z",
    ),
    "no fraction": ("2023.08.24", "14:44:09", DATE_TIME + '"%Y.%m.%d %H:%M:%S.%f"', "2023-08-24T14:44:09.000000000Z"),
    "fraction after a colon": (
        "2023.08.24",
        "14:44:09:5",
        DATE_TIME + '"%Y.%m.%d %H:%M:%S:%f"',
        "2023-08-24T14:44:09.500000000Z",
    ),
    "day of the year": ("2024-060", "0", 'column = "a"\npattern = "%Y-%j"', "2024-02-29T00:00:00.000000000Z"),
    "names and halves": ("24-Aug-23", "02:44 PM", DATE_TIME + '"%d-%b-%y %I:%M %p"', "2023-08-24T14:44:00.000000000Z"),
    "a zone": ("2023-08-24", "14:44+0200", DATE_TIME + '"%Y-%m-%d %H:%M%z"', "2023-08-24T12:44:00.000000000Z"),
    "before 1970": ("1969-12-31", "23:59:59.5", DATE_TIME + '"%Y-%m-%d %H:%M:%S.%f"', "1969-12-31T23:59:59.500000000Z"),
    "GPS, 18 leap seconds": ("2277", "398667", GPS, "2023-08-31T14:44:09.000000000Z"),
    "GPS, from 2017": ("1930", "18", GPS, "2017-01-01T00:00:00.000000000Z"),
    "GPS, before 2017": ("1930", "16.5", GPS, "2016-12-31T23:59:59.500000000Z"),
    "GPS, the leap second": ("1930", "17.5", GPS, "2017-01-01T00:00:00.500000000Z"),
    "GPS in ms": ("2277.0", "398667250", GPS.replace("_s", "_ms"), "2023-08-31T14:44:09.250000000Z"),
    "GPS begun again twice": ("229", "398667", GPS + "gps_rollovers = 2", "2023-08-31T14:44:09.000000000Z"),
    "GPS of the first week": ("0", "0", GPS + "gps_rollovers = 0", "1980-01-06T00:00:00.000000000Z"),
    "spreadsheet": ("45162.613993055556", "0", 'column = "a"\nformat = "excel_days"', "2023-08-24T14:44:09.000000038Z"),
    "Julian": ("2460181.113993055556", "0", 'column = "a"\nformat = "julian_days"', "2023-08-24T14:44:09.000000038Z"),
    "MATLAB": ("730486.5", "0", 'column = "a"\nformat = "matlab_days"', "2000-01-01T12:00:00.000000000Z"),
    "since 1950": ("18262.5", "0", 'column = "a"\nformat = "mjd1950_days"', "2000-01-01T12:00:00.000000000Z"),
    "modified Julian": ("51544.5", "0", 'column = "a"\nformat = "mjd_days"', "2000-01-01T12:00:00.000000000Z"),
}


@pytest.mark.parametrize("case", INSTANTS)
def test_a_time_is_the_instant_that_it_says(tmp_path: Path, case: str) -> None:
    a, b, time, instant = INSTANTS[case]
    assert ns_to_iso8601(int(read(tmp_path, a, b, time).time_ns[0])) == instant


def test_numbers_of_a_time_may_have_decimal_commas(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text("a;x;y;z\n1,25;1;2;3\n")
    form = '[samples]\nfile = "log.csv"\ndelimiter = ";"\ndecimal = ","\n[time]\ncolumn = "a"\nformat = "elapsed_ms"\n'
    (tmp_path / "r.toml").write_text(f"version = 1\n{form}{REST}")
    assert read_recording(tmp_path / "r.toml").time_ns.tolist() == [1_250_000]


NONE = {
    "the 31st of June": (
        "31/06/2023",
        "14:44:09",
        DATE_TIME + '"%d/%m/%Y %H:%M:%S"',
        "'31/06/2023 14:44:09' where a time as %d",
    ),
    "a week of ten bits": ("229", "398667", GPS, r"'229' '398667'.*gps_rollovers = 2"),
    "a full week, begun again": ("2277", "398667", GPS + "gps_rollovers = 2", "absurd"),
    "a time beyond the week": ("2277", "398667250", GPS, "gps_week_ms"),
    "no days": ("1e999999999", "0", 'column = "a"\nformat = "mjd_days"', "where a number of days is expected"),
}


@pytest.mark.parametrize("case", NONE)
def test_what_is_no_time_is_counted_and_shown(tmp_path: Path, case: str) -> None:
    a, b, time, says = NONE[case]
    with pytest.raises(RecordingError, match=says):
        read(tmp_path, a, b, time)


REFUSED = {
    "no date": ('column = "a"\npattern = "%H:%M:%S"', "time.pattern.*year, month and day"),
    "unknown sign": ('column = "a"\npattern = "%Y-%m-%d %q"', "%q is not known; known: .*%Y"),
    "the machine's zone": ('column = "a"\npattern = "%Y-%m-%d %Z"', "%Z is not known"),
    "pattern and format": (
        'column = "a"\npattern = "%Y-%m-%d"\nformat = "unix_s"',
        "time.format.*without pattern only",
    ),
    "column and columns": ('column = "a"\ncolumns = ["a", "b"]\npattern = "%Y-%m-%d"', "time.column: 'a'"),
    "columns of a number": ('columns = ["a", "b"]\nformat = "unix_s"', "time.columns.*go with pattern"),
    "GPS in one column": ('column = "a"\nformat = "gps_week_s"', r'time.columns: .a. .*\["week", "tow"\]'),
    "rollovers of no weeks": ('column = "a"\nformat = "unix_s"\ngps_rollovers = 1', "time.gps_rollovers"),
    "pattern beside a rate": ('rate_hz = 1.0\npattern = "%Y-%m-%d"', "time.pattern.*without rate_hz only"),
    "format": ('column = "a"\nformat = "excel_day"', "did you mean 'excel_days'"),
    "no column": ('format = "unix_s"', "time.column: missing.*columns ="),
}


@pytest.mark.parametrize("case", REFUSED)
def test_a_time_that_cannot_be_is_refused_in_one_line(tmp_path: Path, case: str) -> None:
    time, says = REFUSED[case]
    with pytest.raises(RecordingError, match=says) as refused:
        read(tmp_path, "1", "2", time)
    assert len(refused.value.faults) == 1


def test_each_part_of_a_time_that_is_missing_is_counted(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text("a,b,x,y,z\n,,1,2,3\n2277,1,1,2,3\n")
    (tmp_path / "r.toml").write_text(f'version = 1\n[samples]\nfile = "log.csv"\n[time]\n{GPS}\n{REST}')
    assert read_recording(tmp_path / "r.toml").report.count("time", RowFault.MISSING) == 1
