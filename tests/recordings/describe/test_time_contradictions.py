"""A time that another column, a stated rate or an orbit contradicts is asked about, and a true one is not."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from magcal_service.recordings.describe.describe import describe
from tests.recordings.describe.test_doubts import question
from tests.recordings.describe.test_places import ORBITS, orbit
from tests.recordings.describe.test_times import at, times_of, unix

TRUE: dict[str, tuple[str, Callable[[int], str]]] = {
    "seconds and microseconds": ("t_s;t_us", lambda i: f"{0.5 * i};{500000 * i}"),
    "a clock 3 % fast": ("t_s;sensor_time_ms", lambda i: f"{0.5 * i};{515 * i + 77}"),
    "a count beside the time": ("t_s;dose_ms", lambda i: f"{0.5 * i};{31 * i}"),
    "instants and their text": ("unix;utc", lambda i: f"{unix(i):.3f};{at(i).isoformat()}"),
    "instants and a date": ("unix;date", lambda i: f"{unix(i):.3f};{at(i):%Y-%m-%d}"),
    "seconds of latency": ("unix;received", lambda i: f"{unix(i):.3f};{unix(i) + 2 + i % 3:.1f}"),
    "a week and its instants": ("gps_week;tow_s;unix", lambda i: f"2375;{1000 + 0.5 * i};{unix(i):.1f}"),
}

FALSE: dict[str, tuple[str, Callable[[int], str], list[str], str]] = {
    "rows 5 s and 5 ms apart": (
        "t_s;t_us",
        lambda i: f"{5 * i};{5000 * i}",
        ["t_s", "t_us"],
        "runs 0.001 times as fast",
    ),
    "ms called us": ("time_ms;time_us", lambda i: f"{500 * i};{500 * i}", ["time_ms", "time_us"], "runs 0.001 times"),
    "two clocks that differ": ("t_s;uptime_s", lambda i: f"{i};{1.8 * i}", ["t_s", "uptime_s"], "runs 1.8 times"),
    "a zone": (
        "unix;time",
        lambda i: f"{unix(i) + 7200:.1f};{at(i):%Y-%m-%dT%H:%M:%S}",
        ["unix", "time"],
        "2 h beside",
    ),
    "half an hour of zone": (
        "unix;time",
        lambda i: f"{unix(i) - 19800:.1f};{at(i):%Y-%m-%dT%H:%M:%S}",
        ["unix", "time"],
        "5.5 h beside",
    ),
}


@pytest.mark.parametrize("case", TRUE)
def test_columns_that_agree_are_no_question(case: str, tmp_path: Path) -> None:
    header, cell = TRUE[case]
    times, draft = times_of(header, cell, tmp_path)
    assert times is not None
    assert not draft.questions


@pytest.mark.parametrize("case", FALSE)
def test_columns_that_contradict_one_another_are_asked_about(case: str, tmp_path: Path) -> None:
    header, cell, offered, says = FALSE[case]
    times, draft = times_of(header, cell, tmp_path)
    assert times is None
    (asked,) = draft.questions
    assert asked.key == "time.columns"
    assert sorted(value for value, _ in asked.candidates) == sorted(offered)
    assert says in asked.asks
    for name in offered:
        times, draft = times_of(header, cell, tmp_path, columns=name)
        assert times is not None
        assert f'column = "{name}"' in draft.sections["time"]


@pytest.mark.parametrize(
    ("rate", "header", "step", "asked"),
    [
        ("Sample rate: 50 Hz", "t_ms", 20.0, ""),
        ("Sample rate: 50 Hz", "t_ms", 22.0, ""),
        ("Sample rate: 1000 Hz", "t_s", 1.0, "elapsed_ms"),
        ("fs = 10 Hz", "t_us", 100.0, "elapsed_ms"),
        ("no word of it", "t_s", 1.0, ""),
    ],
)
def test_a_stated_rate_that_another_unit_bears_out_is_asked_about(
    rate: str, header: str, step: float, asked: str, tmp_path: Path
) -> None:
    log = tmp_path / "log.csv"
    rows = [f"{step * row:g};{row % 7}.5" for row in range(200)]
    log.write_text("\n".join([f"# {rate}", f"{header};mx_nT", *rows]))
    assert (asked in question(describe(log, {}), "time.format")) if asked else True
    assert bool(question(describe(log, {}), "time.format")) is bool(asked)
    if asked:
        told = describe(log, {"time.format": asked})
        assert not question(told, "time.format")
        assert any(line.startswith(f"time = '{header}' as {asked}") for line in told.said)


def test_a_stated_rate_that_no_unit_bears_out_is_said(tmp_path: Path) -> None:
    log = tmp_path / "log.csv"
    log.write_text("\n".join(["# Sample rate: 7 Hz", "t_s;mx_nT", *(f"{0.5 * row};{row % 7}.5" for row in range(200))]))
    result = describe(log, {})
    assert not question(result, "time.format")
    assert any("state 7 rows a second, and by 't_s' there are 2" in line for line in result.said)


@pytest.mark.parametrize(("name", "factor"), [("t_s", 1e3), ("t_us", 1e3), ("t_ms", 1e3), ("t_s", 1.0)])
@pytest.mark.parametrize("orbit_of", ORBITS[:3])
def test_a_time_by_which_an_orbit_is_too_fast_or_slow_is_asked_about(
    name: str, factor: float, orbit_of: tuple[float, float, float], tmp_path: Path
) -> None:
    way = orbit(*orbit_of, 30.0)
    columns = [(way.time_s - way.time_s[0]) * factor, way.latitude_deg, way.longitude_deg]
    log = tmp_path / "log.csv"
    lines = [",".join(f"{value:.9g}" for value in row) for row in np.column_stack(columns)]
    log.write_text("\n".join([f"{name},lat,lon", *lines]))
    asked = question(describe(log, {}), "time.format")
    true = (name, factor) in {("t_ms", 1e3), ("t_s", 1.0)}
    assert bool(asked) is not true
    assert true or asked.index("could be elapsed_ms") < asked.index(f"could be elapsed_{name[2:]}")
