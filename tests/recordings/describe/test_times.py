"""The time of a log to be described: its columns, form and instants; what is open is asked, not guessed."""

from __future__ import annotations

import datetime
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from magcal_service.base.errors import InputRefusedError
from magcal_service.recordings.describe.columns import read_log
from magcal_service.recordings.describe.describe import describe
from magcal_service.recordings.describe.draft import Answers, Draft
from magcal_service.recordings.describe.layout import find_layout
from magcal_service.recordings.describe.sample import read_sample
from magcal_service.recordings.describe.times import Times, find_times

START = datetime.datetime(2025, 7, 14, 22, 59, 50, tzinfo=datetime.UTC)
STEP_S = 0.5
ROWS = 200


def times_of(header: str, cell: Callable[[int], str], folder: Path, **answers: str) -> tuple[Times | None, Draft]:
    """The times of a log of whose rows ``cell`` gives the first cells."""
    log = folder / "log.csv"
    log.write_text("\n".join([f"{header};mx_nT", *(f"{cell(row)};{row % 7}.5" for row in range(ROWS))]))
    sample = read_sample(log)
    given = Answers({f"time.{key}": value for key, value in answers.items()})
    draft = Draft(read_log(sample, find_layout(sample)), given, folder)
    return find_times(draft), draft


def at(row: int) -> datetime.datetime:
    return START + datetime.timedelta(seconds=STEP_S * row)


def unix(row: int) -> float:
    return at(row).timestamp()


SURE: dict[str, tuple[str, Callable[[int], str], str]] = {
    "iso": ("time", lambda i: at(i).isoformat(), 'format = "iso8601"'),
    "unix s": ("unix", lambda i: f"{unix(i):.3f}", 'format = "unix_s"'),
    "unix ms": ("timestamp", lambda i: f"{unix(i) * 1e3:.0f}", 'format = "unix_ms"'),
    "unix us": ("t", lambda i: f"{unix(i) * 1e6:.0f}", 'format = "unix_us"'),
    "unix ns": ("time", lambda i: f"{unix(i) * 1e9:.0f}", 'format = "unix_ns"'),
    "excel": ("Date/Time", lambda i: f"{unix(i) / 86400 + 25569:.9f}", 'format = "excel_days"'),
    "julian": ("JD", lambda i: f"{unix(i) / 86400 + 2440587.5:.9f}", 'format = "julian_days"'),
    "matlab": ("datenum", lambda i: f"{unix(i) / 86400 + 719529:.9f}", 'format = "matlab_days"'),
    "since 1950": ("time_cnes", lambda i: f"{unix(i) / 86400 + 7305:.9f}", 'format = "mjd1950_days"'),
    "mjd": ("mjd", lambda i: f"{unix(i) / 86400 + 40587:.9f}", 'format = "mjd_days"'),
    "day first": ("when", lambda i: f"{at(i):%d/%m/%Y %H:%M:%S.%f}", 'pattern = "%d/%m/%Y %H:%M:%S.%f"'),
    "apart": ("Date;Time", lambda i: f"{at(i):%Y-%m-%d;%H:%M:%S.%f}", 'pattern = "%Y-%m-%d %H:%M:%S.%f"'),
    "american": ("Date;Time", lambda i: f"{at(2 * i):%m/%d/%Y;%I:%M:%S %p}", 'pattern = "%m/%d/%Y %I:%M:%S %p"'),
    "month's name": ("time", lambda i: f"{at(2 * i):%d-%b-%Y %H:%M:%S}", 'pattern = "%d-%b-%Y %H:%M:%S"'),
    "day of year": ("t", lambda i: f"{at(2 * i):%Y-%jT%H:%M:%S}Z", 'pattern = "%Y-%jT%H:%M:%SZ"'),
    "six columns": (
        "year;month;day;hour;minute;second",
        lambda i: f"{at(i):%Y;%m;%d;%H;%M;%S.%f}",
        'pattern = "%Y %m %d %H %M %S.%f"',
    ),
}
SURE["six columns, decimal comma"] = (
    "year;month;day;hour;minute;second;speed",
    lambda i: f"{at(i):%Y;%m;%d;%H;%M;%S,%f};2,5",
    'pattern = "%Y %m %d %H %M %S,%f"',
)
WHOLE_SECONDS = {"american", "month's name", "day of year"}
"""Forms without a fraction, written every other row's time."""


@pytest.mark.parametrize("form", SURE)
def test_an_instant_is_read_in_any_form(form: str, tmp_path: Path) -> None:
    header, cell, line = SURE[form]
    times, draft = times_of(header, cell, tmp_path)
    assert times is not None
    assert times.absolute
    assert line in draft.sections["time"]
    step = np.median(np.diff(times.seconds))
    expected = np.array([START.timestamp() + step * row for row in range(ROWS)])
    np.testing.assert_allclose(times.seconds, expected, atol=1e-3)
    assert step == pytest.approx(2 * STEP_S if form in WHOLE_SECONDS else STEP_S, abs=1e-4)


def test_days_that_a_bare_name_leaves_open_are_offered_as_days_since_1950_and_asked(tmp_path: Path) -> None:
    _, draft = times_of("mjd", lambda i: f"{unix(i) / 86400 + 7305:.9f}", tmp_path)
    assert any("mjd1950_days" in str(question) for question in draft.questions)


@pytest.mark.parametrize(
    ("header", "cell", "line"),
    [
        ("millis", lambda i: f"{20 * i + 812}", 'format = "elapsed_ms"'),
        ("TimeUS", lambda i: f"{20000 * i + 812}", 'format = "elapsed_us"'),
        ("t", lambda i: f"{0.02 * i - 576459995.027:.3f}", 'format = "elapsed_s"'),
        ("time_s", lambda i: f"{20 * i}", 'format = "elapsed_s"'),
    ],
)
def test_a_time_since_some_start(header: str, cell: Callable[[int], str], line: str, tmp_path: Path) -> None:
    times, draft = times_of(header, cell, tmp_path)
    assert times is not None
    assert not times.absolute
    assert line in draft.sections["time"]


def test_gps_weeks_are_columns_together(tmp_path: Path) -> None:
    def cell(row: int) -> str:
        week, of_week = divmod(unix(row) - 315964800, 604800)
        return f"{week:.0f};{of_week:.3f}"

    times, draft = times_of("gps_week;tow", cell, tmp_path)
    assert times is not None
    assert draft.sections["time"] == ['columns = ["gps_week", "tow"]', 'format = "gps_week_s"']
    assert times.seconds[7] == pytest.approx(unix(7), abs=1e-3)


def weeks(row: int) -> tuple[int, float]:
    week, of_week = divmod(unix(row) - 315964800, 604800)
    return int(week), of_week


def test_a_week_that_no_name_says_is_asked_about_and_taken_by_an_answer(tmp_path: Path) -> None:
    log = tmp_path / "log.txt"
    log.write_text("\n".join("{} {:.1f} {}.5".format(*weeks(row), row % 7) for row in range(ROWS)))
    (question,) = [one for one in describe(log, {}).questions if one.key.startswith("time.")]
    assert (question.key, question.form) == ("time.format", "gps_week_s")
    for answers in ({"time.format": "gps_week_s"}, {"time.columns": "1,2", "time.format": "gps_week_s"}):
        said = describe(log, answers).said
        assert any(line.startswith("time = column 1 + column 2 as gps_week_s: by your answer") for line in said)


def test_a_week_in_columns_of_other_names_is_taken_by_an_answer_alone(tmp_path: Path) -> None:
    def cell(row: int) -> str:
        return "{};{:.1f}".format(*weeks(row))

    times, draft = times_of("a;b", cell, tmp_path, columns="a,b", format="gps_week_s")
    assert times is not None
    assert times.seconds[7] == pytest.approx(unix(7), abs=1e-3)
    assert draft.sections["time"] == ['columns = ["a", "b"]', 'format = "gps_week_s"']
    with pytest.raises(InputRefusedError, match=r"time\.columns=WEEK,SECONDS as well"):
        times_of("a;b", cell, tmp_path, format="gps_week_s")


ASKED: dict[str, tuple[str, Callable[[int], str], str]] = {
    "20 of what": ("time", lambda i: f"{20 * i}", "time.format"),
    "20.5 of what": ("time", lambda i: f"{20.5 * i:.1f}", "time.format"),
    "unit and numbers differ": ("t_ms", lambda i: f"{0.5 * i}", "time.format"),
    "day or month": ("when", lambda i: f"05/06/2025 {at(2 * i % 80):%H:%M:%S}", "time.pattern"),
    "seconds within a minute": ("second", lambda i: f"{at(i).second + at(i).microsecond / 1e6}", "time.rate_hz"),
    "time of day": ("clock", lambda i: f"{at(i):%H:%M:%S.%f}", "time.rate_hz"),
    "ten bits of week": ("week;tow", lambda i: f"325;{1000 + i}.0", "time.gps_rollovers"),
    "none": ("speed", lambda i: f"{i * 37 % 11}.5", "time.rate_hz"),
}


@pytest.mark.parametrize("doubt", ASKED)
def test_what_leaves_a_doubt_is_asked(doubt: str, tmp_path: Path) -> None:
    header, cell, key = ASKED[doubt]
    _, draft = times_of(header, cell, tmp_path)
    assert [question.key for question in draft.questions] == [key]


@pytest.mark.parametrize(
    ("answers", "seconds"),
    [({"format": "elapsed_ms"}, 0.02), ({"column": "1", "format": "elapsed_s"}, 20.0), ({"rate_hz": "50"}, 0.02)],
)
def test_an_answer_decides(answers: dict[str, str], seconds: float, tmp_path: Path) -> None:
    times, draft = times_of("time", lambda i: f"{20 * i}", tmp_path, **answers)
    assert times is not None
    assert not draft.questions
    np.testing.assert_allclose(np.diff(times.seconds), seconds)


@pytest.mark.parametrize(
    ("name", "first", "step_s", "form", "asks"),
    [
        ("", 45000.0, 1.0 / 86400.0, "excel_days", False),  # a row a second
        ("", 45000.0, 300.0 / 86400.0, "excel_days elapsed_s", True),
        ("", 36000.0, 0.1, "elapsed_s", True),  # seconds of a day, from 10 h on
        ("time", 36000.0, 0.1, "elapsed_s", False),
        ("t", 55000.0, 0.25, "elapsed_s", False),
        ("mjd", 60000.0, 300.0 / 86400.0, "mjd_days", False),
        ("time", 60000.0, 1.0 / 86400.0, "mjd_days", False),
        ("", 1.75e9, 1.0, "unix_s", False),
        ("", 1.75e9, 5.0, "unix_s", False),
        ("", 1.75e9, 100.0, "unix_s elapsed_ms", True),  # 20 days of uptime in ms are as likely
        ("gps_time", 1.43e9, 1.0, "unix_s", True),  # of 2025 as GPS seconds
        ("time", 8.02e8, 1.0, "unix_s", True),  # of 2025 as seconds since 2000
        ("unix", 8.02e8, 1.0, "unix_s", False),
        ("gps_time", 1.75e9, 1.0, "unix_s", False),
        ("tick_s", 1.75e9, 1.0, "unix_s", False),  # a counter would have run for 55 years
        ("uptime", 1.75e9, 1.0, "unix_s elapsed_s", True),  # in ms it is 20 days
        ("tick_ms", 1.75e12, 200.0, "unix_ms", False),
        ("tick_ms", 1.75e9, 200.0, "elapsed_ms", False),
    ],
)
def test_a_time_by_its_numbers_alone_is_sure_only_where_no_other_is_as_likely(
    name: str, first: float, step_s: float, form: str, asks: bool, tmp_path: Path
) -> None:
    log = tmp_path / "log.csv"
    rng = np.random.default_rng(2)
    rows = [
        f"{first + i * step_s:.10f},{x:.1f},{y:.1f},{z:.1f}"
        for i, (x, y, z) in enumerate(rng.normal(size=(200, 3)) * 28e3)
    ]
    log.write_text("\n".join([f"{name},mx_nT,my_nT,mz_nT"] * bool(name) + rows))
    answers = {"reference": "48 uT", "magnetometer.unit": "nT"} | ({} if name else {"magnetometer.columns": "2,3,4"})
    described = describe(log, answers)
    if asks:
        (question,) = (one for one in described.questions if one.key == "time.format")
        assert " ".join(value for value, _ in question.candidates if value in form.split()) == form
    else:
        assert described.text is not None
        assert f'format = "{form}"' in described.text


def text_times(folder: Path, header: str, cell: Callable[[int], str]) -> tuple[Times | None, Draft]:
    return times_of(header, lambda row: cell(row), folder)


@pytest.mark.parametrize(
    ("header", "form"),
    [
        ("date;time;tz", "{:%Y-%m-%d;%H:%M:%S}.{};+02:00"),
        ("tz;day;clock", "+0200;{:%d.%m.%Y;%H:%M:%S}.{}"),
        ("timestamp;offset", "{:%Y-%m-%d %H:%M:%S}.{};+02:00"),
    ],
)
def test_a_zone_in_a_column_of_its_own_is_read(header: str, form: str, tmp_path: Path) -> None:
    def cell(row: int) -> str:
        instant = START + datetime.timedelta(seconds=row * STEP_S, hours=2)
        return form.format(instant, f"{instant.microsecond // 100000}")

    times, _ = text_times(tmp_path, header, cell)
    assert times is not None
    assert times.seconds[7] == pytest.approx(unix(7), abs=1e-3)


def test_a_zone_that_is_not_read_is_told(tmp_path: Path) -> None:
    times, draft = text_times(
        tmp_path, "date;time;tz", lambda row: f"2025-07-14;22:{row // 60:02d}:{row % 60:02d};CEST"
    )
    assert times is not None
    assert any(line.startswith("warning: UTC is taken, and 'tz' says 'CEST'") for line in draft.said)
