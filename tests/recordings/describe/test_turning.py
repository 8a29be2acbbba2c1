"""A steady spin is offered where the field shows one; a gyro's unit is what the field turns by."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from magcal_service.base.errors import InputRefusedError
from magcal_service.recordings.describe.describe import Described, describe
from magcal_service.recordings.describe.spin import steady_spin
from tests.recordings.describe import maker_logs

FloatArray = npt.NDArray[np.float64]

REFERENCE = {"reference": "45 uT"}
ROWS = 2400


def spinning(rate_rpm: float, axis: int, rows: int = ROWS, late_rpm: float | None = None) -> FloatArray:
    """A field of 45 uT in a body that spins about one of its axes, a row a second, with bias and 300 nT of noise."""
    rng = np.random.default_rng(5)
    rates = np.linspace(rate_rpm, rate_rpm if late_rpm is None else late_rpm, rows) * np.pi / 30.0
    phase = np.cumsum(rates)
    around = np.roll(np.arange(3), -axis)  # axis, and the two that it turns one into the other
    field = np.empty((rows, 3))
    slow = 0.3 * np.sin(2.0 * np.pi * np.arange(rows) / 5600.0)  # along the axis, as on the way round the Earth
    field[:, around[0]] = 45000.0 * np.sin(0.4 + slow)
    field[:, around[1]] = 45000.0 * np.cos(0.4 + slow) * np.cos(phase)
    field[:, around[2]] = -45000.0 * np.cos(0.4 + slow) * np.sin(phase)  # the body turns on, the field goes back
    return field + maker_logs.BIAS_NT + 300.0 * rng.standard_normal((rows, 3))


def log_of(folder: Path, field: FloatArray, head: str = "t_s,mx_nT,my_nT,mz_nT", *more: FloatArray) -> Path:
    path = folder / "log.csv"
    table = np.column_stack([np.arange(len(field), dtype=np.float64), field, *more])
    path.write_text("\n".join([head, *(",".join(f"{value:.10g}" for value in row) for row in table)]))
    return path


def asked(result: Described, key: str) -> str:
    return "\n".join(line for one in result.questions if one.key == key for line in one.lines())


@pytest.mark.parametrize(("rate_rpm", "axis", "letter"), [(2.0, 1, "y"), (-7.7, 2, "z"), (0.4, 0, "x")])
def test_a_steady_spin_is_offered_with_its_rate_and_taken_by_an_answer(
    rate_rpm: float, axis: int, letter: str, tmp_path: Path
) -> None:
    log = log_of(tmp_path, spinning(rate_rpm, axis))
    question = asked(describe(log, REFERENCE), "spin.axis")
    assert f"at {rate_rpm:.3g} rpm about the sensor's {letter} (" in question
    assert question.startswith("open")
    told = describe(log, REFERENCE | {"spin.axis": letter}).text or ""
    spin = tomllib.loads(told)["spin"]
    assert spin["axis"] == letter
    assert spin["rate_rpm"] == pytest.approx(rate_rpm, rel=1e-3)
    other = describe(log, REFERENCE | {"spin.axis": "1,1,1", "spin.rate_rpm": "-3"}).text or ""
    assert "axis = [0.57735" in other
    assert "rate_rpm = -3.0" in other


def test_a_measured_rate_has_no_more_digits_than_are_sure(tmp_path: Path) -> None:
    """The field of an orbit turns by up to 0.02 rpm: 3.1205 of a craft at 3.1 was diagnosed as another rate."""
    told = describe(log_of(tmp_path, spinning(3.1205, 2)), REFERENCE | {"spin.axis": "z"}).text or ""
    assert tomllib.loads(told)["spin"]["rate_rpm"] == 3.1
    slow = describe(log_of(tmp_path, spinning(0.3141, 2)), REFERENCE | {"spin.axis": "z"}).text or ""
    assert tomllib.loads(slow)["spin"]["rate_rpm"] == pytest.approx(0.314, abs=2e-3)


@pytest.mark.parametrize("field", [maker_logs.ground(), maker_logs.orbit().field_nt, spinning(2.0, 1, 600, 5.0)])
def test_no_spin_is_offered_of_a_hand_a_tumble_or_a_rate_that_changes(field: FloatArray, tmp_path: Path) -> None:
    assert not asked(describe(log_of(tmp_path, field), REFERENCE), "spin.axis")


def test_a_craft_that_looks_at_the_earth_does_not_spin(tmp_path: Path) -> None:
    """Twice round in an orbit, for three orbits, a row every ten seconds."""
    field = spinning(0.02 * 10.0, 1)
    path = log_of(tmp_path, field)
    lines = path.read_text().splitlines()
    slow = [lines[0], *(f"{10 * int(row.partition(',')[0])},{row.partition(',')[2]}" for row in lines[1:])]
    path.write_text("\n".join(slow))
    assert not asked(describe(path, REFERENCE), "spin.axis")


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("spin.axis", "w", "x, y, z or a vector"),
        ("spin.axis", "0,0,0", "x, y, z or a vector"),
        ("spin.axis", "0,0,nan", "x, y, z or a vector"),
        ("spin.rate_rpm", "2", "spin.axis is to be answered as well"),
    ],
)
def test_an_answer_that_is_no_spin_is_refused(key: str, value: str, words: str, tmp_path: Path) -> None:
    log = log_of(tmp_path, spinning(2.0, 1))
    with pytest.raises(InputRefusedError, match=words):
        describe(log, REFERENCE | {key: value})


def gyro_of(folder: Path, per_deg_s: float, whole: bool, head: str = "gx,gy,gz") -> Described:
    """A gyro beside a spin of 4 rpm about y, 24 deg/s."""
    rates = np.tile([0.0, 24.0 * per_deg_s, 0.0], (ROWS, 1))
    rates = np.round(rates) if whole else rates
    return describe(log_of(folder, spinning(4.0, 1), f"t_s,mx_nT,my_nT,mz_nT,{head}", rates), REFERENCE)


@pytest.mark.parametrize(("per_deg_s", "one"), [(131.0, "0.00762"), (16.4, "0.061"), (-65.5, "-0.0152")])
def test_counts_of_a_gyro_are_called_so_with_their_size(per_deg_s: float, one: str, tmp_path: Path) -> None:
    """Those of a deg/s that are usual; 16.4 of them make 1.06 mrad/s of one, which is no mrad/s."""
    result = gyro_of(tmp_path, per_deg_s, whole=True)
    (line,) = (line for line in result.said if line.startswith("channels: 'gx'"))
    size = float(line.partition("one of them is ")[2].partition(" deg/s")[0])
    assert size == pytest.approx(float(one), rel=0.02)
    assert line.endswith("deg/s: counts; write them in deg/s to have the channel")
    assert "gyro" not in (result.text or "")


@pytest.mark.parametrize(("per_deg_s", "unit"), [(1.0, "deg/s"), (np.pi / 180.0, "rad/s"), (17.453, "mrad/s")])
def test_a_gyro_without_a_unit_has_that_by_which_the_field_turns(per_deg_s: float, unit: str, tmp_path: Path) -> None:
    assert f'unit = "{unit}"' in (gyro_of(tmp_path, per_deg_s, whole=False).text or "").partition("gyro")[2]


def test_a_gyro_whose_name_has_another_unit_than_the_field_turns_by_is_asked_about(tmp_path: Path) -> None:
    head = "gx_dps,gy_dps,gz_dps"
    question = asked(gyro_of(tmp_path, np.pi / 180.0, False, head), "channels.gyro.unit")
    assert "the name says deg/s, but as the measured field turns rad/s, in which it turns" in question
    assert question.index("could be rad/s") < question.index("could be deg/s")
    assert not asked(gyro_of(tmp_path, 1.0, False, head), "channels.gyro.unit")


@pytest.mark.parametrize("seed", range(6))
def test_the_spin_that_is_offered_is_as_good_as_it_says(seed: int) -> None:
    rng = np.random.default_rng(seed)
    rate_rpm = float(rng.uniform(0.5, 5.0))
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    turn *= np.linalg.det(turn)
    field = (spinning(rate_rpm, 2) - maker_logs.BIAS_NT) @ turn.T + maker_logs.BIAS_NT
    found = steady_spin(field, np.arange(ROWS, dtype=np.float64), np.zeros(ROWS, dtype=np.int64))
    assert found is not None
    same = np.sign(found.axis @ turn[:, 2])
    assert abs(found.rate_rpm * same - rate_rpm) < 5.0 * found.rate_sigma_rpm + 1e-4
    assert np.degrees(np.arccos(min(abs(found.axis @ turn[:, 2]), 1.0))) < 5.0 * found.axis_sigma_deg
    assert found.rate_sigma_rpm < 2e-3 * rate_rpm
    assert found.axis_sigma_deg < 1.0
