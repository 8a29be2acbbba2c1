"""Where names and numbers differ, or an answer contradicts the numbers: asked or warned, and not concluded."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from magcal_service.base.errors import InputRefusedError
from magcal_service.recordings.describe.describe import Described, describe
from tests.recordings.describe import maker_logs


def write(folder: Path, head: str, *columns: object) -> Path:
    """A log of columns, each (n,) or (n, k) numbers."""
    table = np.column_stack([np.asarray(column, dtype=np.float64) for column in columns])
    log = folder / "log.csv"
    log.write_text("\n".join([head, *(",".join(f"{value:.14g}" for value in row) for row in table)]))
    return log


def question(result: Described, key: str) -> str:
    """The question of a key, as printed; empty where it is not asked."""
    return "\n".join(line for one in result.questions if one.key == key for line in one.lines())


def clock(vectors: object) -> object:
    """Seconds from 0, two rows in each."""
    return 0.5 * np.arange(len(np.asarray(vectors)))


@pytest.mark.parametrize("head", ["ref_uT", "ref_x_uT,ref_y_uT,ref_z_uT"])
def test_a_reference_stronger_than_the_earth_s_field_is_asked_about(head: str, tmp_path: Path) -> None:
    field = maker_logs.ground() / 200.0  # milligauss of a field of half the strength, called microtesla
    reference = np.full(len(field), 246.0) if head == "ref_uT" else np.tile([100.0, 4.0, 224.7], (len(field), 1))
    log = write(tmp_path, f"t_s,mx_uT,my_uT,mz_uT,{head}", clock(field), field, reference)
    asked = question(describe(log, {}), "reference.unit")
    assert "as uT their usual size is 246 uT, outside the 18 to 75 uT" in asked
    assert asked.index("could be mG") < asked.index("could be uT")
    frame = {} if head == "ref_uT" else {"reference.frame": "ned"}
    told = describe(log, {"reference.unit": "uT"} | frame)
    assert told.text is not None
    assert any(
        line.startswith("warning: by your answer reference.unit=uT the reference is 246 uT") for line in told.said
    )


@pytest.mark.parametrize(("answer", "unit"), [("48.7", "uT"), ("487", "mG"), ("0.0487", "mT"), ("48700", "nT")])
def test_a_field_without_a_unit_says_which_was_taken(answer: str, unit: str, tmp_path: Path) -> None:
    field = maker_logs.ground()
    log = write(tmp_path, "t_s,mx_nT,my_nT,mz_nT", clock(field), field)
    result = describe(log, {"reference": answer})
    assert any(f"; {answer}: no unit given, {unit} taken, for it lies within" in line for line in result.said)
    assert f'constant = {float(answer)}\nunit = "{unit}"' in (result.text or "")


@pytest.mark.parametrize("answer", ["48.7 ut", "0 uT", "-48 uT", "4.8.7 uT", "5", "48.7uT nT", "1e30 T", "3 mT"])
def test_a_bad_field_is_refused_with_the_units(answer: str, tmp_path: Path) -> None:
    field = maker_logs.ground()[:40]
    log = write(tmp_path, "t_s,mx_nT,my_nT,mz_nT", clock(field), field)
    for key in ("reference", "reference.constant"):
        with pytest.raises(InputRefusedError) as refusal:
            describe(log, {key: answer})
        assert str(refusal.value).startswith(f"--answer {key}: '{answer}' is refused; ")
        assert str(refusal.value).endswith("units: nT uT mT T mG G")


def test_an_answered_unit_that_the_numbers_contradict_is_taken_with_a_warning(tmp_path: Path) -> None:
    field = maker_logs.ground()
    log = write(tmp_path, "t_s,mx,my,mz", clock(field), field / 1e2)
    result = describe(log, {"magnetometer.unit": "uT", "reference": "48500 nT"})
    assert result.text is not None
    (warning,) = (line for line in result.said if line.startswith("warning"))
    assert "magnetometer.unit=uT" in warning
    assert "is 491956 nT, where the reference has 48500 nT" in warning
    right = describe(log, {"magnetometer.unit": "mG", "reference": "48500 nT"})
    assert not any(line.startswith("warning") for line in right.said)


ABSURD = {
    "far too strong": (1.0, "mT", {"reference": "48500 nT"}, "49.2 T, where 48.5 uT are expected", "nT"),
    "beyond any sensor": (1e-3, "mT", {}, "49.2 mT, where 18 to 75 uT are usual near the Earth", "uT"),
    "far too weak": (1e-3, "nT", {"reference": "48500 nT"}, "49.2 nT, where 48.5 uT are expected", "uT"),
    "by its size": (1.0, "1000 uT", {"reference": "48500 nT"}, "49.2 T, where 48.5 uT are expected", "nT"),
}


@pytest.mark.parametrize("case", ABSURD)
def test_a_unit_that_makes_the_field_absurd_is_refused_with_the_likely_one(case: str, tmp_path: Path) -> None:
    """By hundreds: every row would be refused later, or a scale of a thousand estimated."""
    scale, unit, given, said, likely = ABSURD[case]
    field = maker_logs.ground() * scale
    log = write(tmp_path, "t_s,mx,my,mz", clock(field), field)
    with pytest.raises(InputRefusedError) as refusal:
        describe(log, {"magnetometer.unit": unit} | given)
    (line,) = str(refusal.value).splitlines()
    assert line.startswith(f"--answer magnetometer.unit: '{unit}' is refused; the radius of the sphere through 'mx', ")
    assert f"would be {said}; by the numbers {likely} is likelier; " in line
    assert describe(log, {"magnetometer.unit": likely, "reference": "48500 nT"}).text is not None


def test_a_unit_that_makes_the_reference_absurd_is_refused(tmp_path: Path) -> None:
    field = maker_logs.ground()
    log = write(tmp_path, "t_s,mx_nT,my_nT,mz_nT,ref", clock(field), field, np.full(len(field), 48500.0))
    with pytest.raises(
        InputRefusedError, match=r"^--answer reference.unit: 'mT' is refused; the reference would be 48"
    ):
        describe(log, {"reference.columns": "ref", "reference.unit": "mT"})


def test_stamps_that_repeat_are_counted_and_another_time_is_named(tmp_path: Path) -> None:
    field = maker_logs.ground()
    seconds = np.arange(len(field)) / 10.0
    log = write(
        tmp_path,
        "unix_time,count,uptime_s,mx_nT,my_nT,mz_nT",
        np.floor(seconds) + maker_logs.START_S,
        np.arange(len(field)),
        seconds,
        field,
    )
    said = describe(log, {"reference": "49.2 uT"}).said
    (line,) = (line for line in said if line.startswith("time: "))
    assert "540 of 600 rows have the stamp of the row before" in line
    assert line.endswith("--answer time.column=uptime_s")
    assert not any("rises from row to row" in line for line in said)
    rows = [row.split(",") for row in log.read_text().splitlines()]
    clocks = ["cur_time", *(f"{i // 600:02d}:{i // 10 % 60:02d}.{i % 10}" for i in range(len(field)))]
    log.write_text("\n".join(",".join([row[0], clock, *row[3:]]) for row, clock in zip(rows, clocks, strict=True)))
    (line,) = (line for line in describe(log, {"reference": "49.2 uT"}).said if line.startswith("time: "))
    assert "'cur_time' repeats less and is called a time" in line
    even = write(tmp_path, "unix_time,mx_nT,my_nT,mz_nT", seconds + maker_logs.START_S, field)
    assert not any("stamp" in line for line in describe(even, {"reference": "49.2 uT"}).said)


def test_of_nameless_columns_those_on_the_roundest_sphere_are_offered_first(tmp_path: Path) -> None:
    first = maker_logs.ground()
    other = 1.2 * first[:, 2:] + 0.3 * first[:, :1]  # an axis of a second sensor, mounted otherwise
    log = write(tmp_path, "t_s,c1,c22,c35,c48", clock(first), other, first)
    asked = question(describe(log, {}), "magnetometer.columns")
    assert "could be c22,c35,c48: as nT, on a sphere of 49.2 uT, round to 0.1%" in asked.splitlines()[1]


def test_mg_alone_makes_no_magnetometer(tmp_path: Path) -> None:
    field = maker_logs.ground() / 100.0
    log = write(tmp_path, "t_s,x_mg,y_mg,z_mg", clock(field), field)
    asked = question(describe(log, {}), "magnetometer.columns")
    assert "The mg of 'x_mg', 'y_mg', 'z_mg' may be milligauss or milli-g" in asked
    assert "could be x_mg,y_mg,z_mg: as mG, on a sphere of 49.2 uT" in asked
    accelerometer = write(tmp_path, "t_s,acc_x_mg,acc_y_mg,acc_z_mg", clock(field), field)
    assert question(describe(accelerometer, {}), "magnetometer.columns")
    for head in ("x_mG,y_mG,z_mG", "mag_x_mg,mag_y_mg,mag_z_mg", "x_mgauss,y_mgauss,z_mgauss"):
        sure = describe(write(tmp_path, f"t_s,{head}", clock(field), field), {})
        assert not question(sure, "magnetometer.columns")
        assert any(line.startswith("magnetometer.unit = mG") for line in sure.said)


def test_a_short_name_whose_length_does_not_follow_the_model_is_asked_about(tmp_path: Path) -> None:
    flight = maker_logs.orbit()
    answers = {"position.altitude_km": "500"}

    def of(field: object) -> str:
        columns = (flight.time_s, flight.latitude_deg, flight.longitude_deg, field)
        return question(describe(write(tmp_path, "unix,lat,lon,m1,m2,m3", *columns), answers), "magnetometer.columns")

    assert not of(flight.field_nt / 1e3)
    asked = of(maker_logs.ground(len(flight.time_s)) / 1e3)
    assert "'m1', 'm2', 'm3' have a magnetometer's name, but their length does not follow IGRF" in asked
    assert "could be m1,m2,m3" in asked


def test_what_is_asked_about_is_not_listed_as_not_described(tmp_path: Path) -> None:
    field = maker_logs.ground()
    for head, asked in (("a,b1,c", "magnetometer.columns"), ("mag_x,mag_y,mag_z", "magnetometer.unit")):
        columns = np.round(field / 7.0) if "unit" in asked else field
        log = write(tmp_path, f"t_s,{head},mode,mag", clock(field), columns, np.ones(len(field)), np.ones(len(field)))
        result = describe(log, {})
        assert question(result, asked)
        (line,) = (line for line in result.said if line.startswith("not described"))
        assert line.startswith("not described: 'mode', 'mag';")


def test_a_latitude_beyond_the_pole_is_asked_about_the_other_way_round(tmp_path: Path) -> None:
    field = maker_logs.ground()
    there = np.tile([139.7, 35.7], (len(field), 1))
    log = write(tmp_path, "t_s,mx_nT,my_nT,mz_nT,lat,lon", clock(field), field, there)
    asked = question(describe(log, {}), "position.columns")
    assert "a latitude of 139.7 is none in degrees" in asked
    assert "could be lon,lat: the same two the other way round" in asked


@pytest.mark.parametrize(("most", "possible"), [(75.0, "degF"), (40.0, "")])
def test_a_room_too_hot_in_celsius_is_asked_about(most: float, possible: str, tmp_path: Path) -> None:
    field = maker_logs.ground()
    log = write(
        tmp_path, "t_s,mx_nT,my_nT,mz_nT,temp_degC", clock(field), field, np.linspace(most - 6, most, len(field))
    )
    asked = question(describe(log, {"reference": "48 uT"}), "channels.temperature.unit")
    assert bool(asked) is bool(possible)
    assert not possible or f"could be {possible}" in asked


@pytest.mark.parametrize(("unit", "step", "right"), [("s", 100.0, "ms"), ("s", 1000.0, "ms"), ("ms", 1.0, "s")])
def test_a_unit_of_time_that_makes_no_usual_log_is_asked_about(
    unit: str, step: float, right: str, tmp_path: Path
) -> None:
    field = maker_logs.ground()
    log = write(tmp_path, f"t_{unit},mx_nT,my_nT,mz_nT", step * np.arange(len(field)), field)
    asked = question(describe(log, {"reference": "48 uT"}), "time.format")
    assert f"could be elapsed_{right}" in asked
    for answer in (unit, right):
        text = describe(log, {"reference": "48 uT", "time.format": f"elapsed_{answer}"}).text
        assert f'format = "elapsed_{answer}"' in (text or "")


@pytest.mark.parametrize(("names", "frame"), [("IGRF_N,IGRF_E,IGRF_D", "ned"), ("igrf_n,igrf_e,igrf_u", "")])
def test_a_reference_whose_names_differ_in_n_e_and_d_is_in_north_east_and_down(
    names: str, frame: str, tmp_path: Path
) -> None:
    field = maker_logs.ground()
    reference = np.tile([20.0, 2.0, 43.0], (len(field), 1))
    log = write(tmp_path, f"t_s,mx_uT,my_uT,mz_uT,{names}", clock(field), field / 1e3, reference)
    named = describe(log, {"reference.columns": names, "reference.unit": "uT"})
    assert ("reference.frame = ned: the names differ in n, e and d" in named.said) == bool(frame)
    assert bool(question(named, "reference.frame")) != bool(frame)


@pytest.mark.parametrize(
    ("answer", "told"),
    [
        ("teme", "its axes are read as eci: did you mean 'eci'? known: ecef, eci, ned"),
        ("J2000", "its axes are read as eci: did you mean 'eci'? known: ecef, eci, ned"),
        ("itrf", "its axes are read as ecef: did you mean 'ecef'? known: ecef, eci, ned"),
        ("enu", "known: ecef, eci, ned"),
        ("body", "known: ecef, eci, ned"),
    ],
)
def test_a_frame_by_another_word_is_refused_with_the_one_that_it_is(answer: str, told: str, tmp_path: Path) -> None:
    field = maker_logs.ground()
    reference = np.tile([20.0, 2.0, 43.0], (len(field), 1))
    log = write(tmp_path, "t_s,mx_uT,my_uT,mz_uT,hx_uT,hy_uT,hz_uT", clock(field), field / 1e3, reference)
    with pytest.raises(InputRefusedError) as refusal:
        describe(log, {"reference.frame": answer})
    assert str(refusal.value) == f"--answer reference.frame: {answer!r} is refused; {told}"
    assert describe(log, {"reference.frame": "ECI"}).text is not None


@pytest.mark.parametrize(("turns", "first"), [(False, "ned"), (True, "eci")])
def test_a_reference_that_is_one_vector_is_hardly_inertial(turns: bool, first: str, tmp_path: Path) -> None:
    """No craft in orbit has one; where it turns, an inertial one comes first."""
    field = maker_logs.ground()
    angle = np.linspace(0.0, 3.0 * turns, len(field))
    reference = np.stack([20.0 * np.cos(angle), 20.0 * np.sin(angle), np.full(len(field), 43.0)], axis=1)
    log = write(tmp_path, "t_s,mx_uT,my_uT,mz_uT,hx_uT,hy_uT,hz_uT", clock(field), field / 1e3, reference)
    asked = question(describe(log, {}), "reference.frame")
    assert f"--answer reference.frame={first}" in asked
