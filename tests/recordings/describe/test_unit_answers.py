"""Units that have no name here: answered as the size of a cell, or stated by the log as the size of a count."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from magcal_service.base.errors import InputRefusedError
from magcal_service.recordings.describe.describe import Described, describe
from magcal_service.recordings.reader import read_recording
from tests.recordings.describe import maker_logs

COUNT_NT = 150.0
HEADER = "t_s,mx,my,mz,bus current [dA],temp [dC]"


def written(folder: Path, *lines: str, header: str = HEADER, count_nt: float = COUNT_NT) -> Path:
    """A sensor turned on the ground at 48.5 uT, in counts, with a bias."""
    rng = np.random.default_rng(3)
    turned = rng.normal(size=(300, 3))
    field = 48500.0 * turned / np.linalg.norm(turned, axis=1)[:, None] + [3000.0, -5000.0, 8000.0]
    counts = np.round(field / count_nt)
    rows = [f"{i / 10},{x:.0f},{y:.0f},{z:.0f},{5 + i % 7},{250 + i % 9}" for i, (x, y, z) in enumerate(counts)]
    log = folder / "log.csv"
    log.write_text("\n".join([*lines, header, *rows]))
    return log


def described(log: Path, **answers: str) -> Described:
    return describe(log, {"reference": "48.5 uT"} | {key.replace("__", "."): value for key, value in answers.items()})


def content(log: Path, **answers: str) -> dict[str, Any]:
    text = described(log, **answers).text
    assert text is not None
    return tomllib.loads(text)


@pytest.mark.parametrize(
    ("stated", "unit", "factor"),
    [
        ("# scale 0.15 uT/LSB", "uT", 0.15),
        ("# 1 LSB = 1.5 mG", "mG", 1.5),
        ("# sensitivity: 666.67 counts per gauss", "G", 1 / 666.67),
        ("# 150nT per count", "nT", 150.0),
    ],
)
def test_counts_whose_size_the_log_states_are_read(stated: str, unit: str, factor: float, tmp_path: Path) -> None:
    found = content(written(tmp_path, stated))["magnetometer"]
    assert found["unit"] == unit
    assert found["factor"] == pytest.approx(factor)


def test_a_stated_size_that_makes_no_field_is_offered_only(tmp_path: Path) -> None:
    (question,) = described(written(tmp_path, "# 0.4 nT/LSB", count_nt=6.0)).needed
    assert question.key == "magnetometer.unit"
    assert ("0.4 nT", "the log says '0.4 nT/LSB'") in question.candidates


def in_orbit(folder: Path, count_nt: float, stated: str = "") -> Path:
    """Counts along an orbit, with positions and instants."""
    flight = maker_logs.orbit()
    rows = [
        f"{t:.0f},{lat:.5f},{lon:.5f},500,{x:.0f},{y:.0f},{z:.0f}"
        for t, lat, lon, (x, y, z) in zip(
            flight.time_s, flight.latitude_deg, flight.longitude_deg, flight.field_nt / count_nt, strict=True
        )
    ]
    log = folder / "log.csv"
    log.write_text("\n".join([*([stated] if stated else []), "unix,lat,lon,alt_km,mx,my,mz", *rows]))
    return log


def test_counts_beside_a_unit_are_not_taken_for_it(tmp_path: Path) -> None:
    """1090 counts per gauss are 0.92 mG each: the field model's scale is nearest to mG."""
    (question,) = describe(in_orbit(tmp_path, 1e5 / 1090), {}).needed
    assert (question.key, question.candidates[0][0]) == ("magnetometer.unit", "mG")
    stated = describe(in_orbit(tmp_path, 1e5 / 1090, "# HMC5983, 1090 LSB per Gauss"), {}).text
    assert tomllib.loads(stated or "")["magnetometer"]["factor"] == pytest.approx(1 / 1090)
    plain = describe(in_orbit(tmp_path, 100.0), {}).text
    assert tomllib.loads(plain or "")["magnetometer"] == {"columns": ["mx", "my", "mz"], "unit": "mG"}


def test_two_stated_sizes_are_asked_about(tmp_path: Path) -> None:
    log = written(tmp_path, "# range 1: 6 nT/LSB, range 2: 12 nT/LSB", count_nt=6.0)
    assert [value for value, _ in described(log).needed[0].candidates] == ["6 nT", "12 nT"]


def test_whole_numbers_in_a_named_unit_are_no_counts(tmp_path: Path) -> None:
    log = written(
        tmp_path, "# resolution 0.15 uT/LSB", header=HEADER.replace("mx,my,mz", "mx_mG,my_mG,mz_mG"), count_nt=100
    )
    assert "factor" not in content(log)["magnetometer"]


@pytest.mark.parametrize(
    "answers",
    [{"magnetometer__unit": "150 nT"}, {"magnetometer__unit": "nT", "magnetometer__factor": "150"}],
)
def test_the_size_of_a_count_can_be_answered(answers: dict[str, str], tmp_path: Path) -> None:
    log = written(tmp_path)
    text = described(log, **answers).text
    assert text is not None
    out = tmp_path / "RECORDING.toml"
    out.write_text(text)
    recording = read_recording(out)
    assert recording.field_body_nt[0] == pytest.approx(recording.field_body_nt[0].round(-1))
    assert np.ptp(recording.field_body_nt, axis=0) == pytest.approx(2 * 48500.0, rel=0.05)


def test_a_channel_in_an_unknown_unit_is_asked_with_the_way_to_say_its_size(tmp_path: Path) -> None:
    log = written(tmp_path, "# 0.15 uT/LSB")
    shown = "\n".join(described(log).lines())
    assert "the name says dA, which is no unit of current here" in shown
    assert "--answer 'channels.current.unit=0.1 A'" in shown
    channels = content(
        log, channels__current__unit="0.1 A", channels__temperature__unit="degC", channels__temperature__factor="0.1"
    )["channels"]
    assert channels["current"] == {"column": "bus current [dA]", "unit": "A", "factor": 0.1}
    assert channels["temperature"] == {"column": "temp [dC]", "unit": "degC", "factor": 0.1}


def test_a_height_and_a_reference_in_other_units_can_be_answered(tmp_path: Path) -> None:
    log = tmp_path / "log.csv"
    rows = [
        f"2025-06-01T00:00:{i:02d}Z,{30 + i % 3},{-20 + i % 5},{25 + i % 4},46.{i:02d},8.5,1.2,46100" for i in range(60)
    ]
    log.write_text("\n".join(["time,mx_uT,my_uT,mz_uT,lat,lon,alt_nmi,ref_gamma", *rows]))
    answers = {"reference.magnitude": "ref_gamma", "reference.unit": "1 nT", "position.altitude.unit": "1.852 km"}
    text = describe(log, answers).text
    assert text is not None
    assert tomllib.loads(text)["position"]["altitude"] == {"column": "alt_nmi", "unit": "km", "factor": 1.852}


@pytest.mark.parametrize(
    ("answers", "says"),
    [
        ({"magnetometer__factor": "150"}, "it goes with magnetometer.unit"),
        ({"magnetometer__unit": "150 furlong"}, "of another one its size"),
        ({"magnetometer__unit": "0 nT"}, "a number from 1e-12"),
        ({"magnetometer__unit": "3 nT", "magnetometer__factor": "2"}, "one of the two"),
        ({"magnetometer__unit": "nT", "magnetometer__factor": "x"}, "a number from 1e-12"),
    ],
)
def test_what_is_no_size_is_refused(answers: dict[str, str], says: str, tmp_path: Path) -> None:
    with pytest.raises(InputRefusedError, match=says):
        described(written(tmp_path), **answers)


def test_a_unit_is_offered_by_the_radius_where_the_bias_is_left_out(tmp_path: Path) -> None:
    """A sphere's radius has no bias in it: the longest reading is another number."""
    (question,) = described(written(tmp_path, count_nt=100.0)).needed
    assert question.key == "magnetometer.unit"
    offered = dict(question.candidates)
    assert offered["mG"].startswith("then the radius of the sphere through them is 48.5 uT")
