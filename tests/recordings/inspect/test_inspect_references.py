"""Field against reference, gyro and attitude: scales, held references, shifted columns, axes."""

from pathlib import Path

import numpy as np
import pytest

from magcal_service.recordings.inspect.finding import Code
from tests.recordings.inspect.clean_logs import CleanLog, Kind, clean_log

TURNING = Kind(step_s=0.5, rates_deg_s=(6.0, 2.0), reference="vector", place="none")
GYRO = '[channels]\ngyro = { columns = ["wx", "wy", "wz"], unit = "rad/s" }'
ATTITUDE = '[channels]\nattitude = {{ columns = ["q0", "q1", "q2", "q3"], order = "wxyz", from = "{}", to = "{}" }}'


@pytest.mark.parametrize("factor", [0.01, 0.1, 10.0])
def test_a_field_of_another_scale_is_asked_about(factor: float, tmp_path: Path) -> None:
    finding = clean_log().spoiled("mx my mz", lambda column: column * factor).found(tmp_path)[Code.FIELD_SCALE]
    assert not finding.certain
    assert f"about {factor:g} times" in finding.says
    assert "[magnetometer]" in finding.remedy


@pytest.mark.parametrize("factor", [0.001, 0.1, 10.0])
def test_a_reference_of_another_scale_is_asked_about(factor: float, tmp_path: Path) -> None:
    finding = clean_log().spoiled("F", lambda column: column * factor).found(tmp_path)[Code.FIELD_SCALE]
    assert not finding.certain
    assert "[reference]" in finding.remedy


@pytest.mark.parametrize("repeats", [5, 30])
@pytest.mark.parametrize("reference", ["magnitude", "vector"])
def test_a_reference_that_is_held_is_used_where_it_is_renewed(repeats: int, reference: str, tmp_path: Path) -> None:
    held = np.arange(1800) // repeats * repeats
    log = clean_log(Kind(reference=reference, rates_deg_s=(1.0, 0.3)))
    inspection = log.spoiled("F hx hy hz", lambda column: column[held]).inspected(tmp_path)
    (finding,) = inspection.findings
    assert (finding.code, finding.certain) == (Code.REFERENCE_REPEATS, True)
    assert finding.rows == 1800 - 1800 // repeats
    assert len(inspection.usable) == 1800
    assert np.count_nonzero(np.isfinite(inspection.usable.reference.magnitude_nt)) == 1800 // repeats


def test_a_coil_that_is_driven_in_steps_is_no_reference_that_is_held(tmp_path: Path) -> None:
    """Readings jump with it, and hold still in between but for their noise."""
    held = np.arange(1800) // 30 * 30
    log = clean_log(Kind(reference="vector", rates_deg_s=(1.0, 0.3), place="none"))
    noise = np.random.default_rng(71).normal(0.0, 20.0, (3, 1800))
    stepped = log.spoiled("F hx hy hz mx my mz", lambda column: column[held])
    noisy = {name: stepped.columns[name] + each for name, each in zip(("mx", "my", "mz"), noise, strict=True)}
    assert Code.REFERENCE_REPEATS not in stepped.changed(**noisy).found(tmp_path)


def test_a_rounded_reference_is_not_held(tmp_path: Path) -> None:
    log = clean_log(Kind(step_s=0.1, rates_deg_s=(6.0, 2.0)))
    assert log.spoiled("F", lambda column: np.round(column, -2)).found(tmp_path) == {}


def test_a_column_that_is_a_clock_is_asked_about(tmp_path: Path) -> None:
    log = clean_log().changed(mx=1000.0 + 10.0 * np.arange(1800.0))
    assert log.found(tmp_path)[Code.SHIFTED_COLUMNS].certain is False


def test_a_header_that_is_shifted_against_its_data_is_asked_about(tmp_path: Path) -> None:
    log = clean_log(Kind(place="none", channels=False))
    columns = log.columns
    shifted = log.changed(mx=columns["my"], my=columns["mz"], mz=columns["F"])
    finding = shifted.found(tmp_path)[Code.SHIFTED_COLUMNS]
    assert "column mz" in finding.says


def swapped(log: CleanLog) -> CleanLog:
    return log.changed(mx=log.columns["my"], my=log.columns["mx"])


def flipped(log: CleanLog) -> CleanLog:
    return log.changed(mz=-log.columns["mz"])


def turned(log: CleanLog) -> CleanLog:
    return log.changed(mx=log.columns["my"], my=-log.columns["mx"])


@pytest.mark.parametrize("spoil", [swapped, flipped, turned])
@pytest.mark.parametrize("channels", [GYRO, ATTITUDE.format("eci", "body")])
def test_axes_that_are_others_are_asked_about(spoil, channels: str, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    log = spoil(clean_log(TURNING)).described(channels=channels)
    (finding,) = log.inspected(tmp_path).findings
    assert (finding.code, finding.certain) == (Code.AXES, False)


def test_an_attitude_that_is_the_other_way_round_is_asked_about(tmp_path: Path) -> None:
    log = clean_log(TURNING).described(channels=ATTITUDE.format("body", "eci"))
    (finding,) = log.inspected(tmp_path).findings
    assert finding.code is Code.AXES
    assert "exchange from and to" in finding.remedy


@pytest.mark.parametrize(
    ("unit", "per_rad_s"), [("rad/s", np.degrees(1.0)), ("deg/s", 1.0), ("mrad/s", 1.0), ("rpm", 1.0)]
)
def test_a_gyro_in_another_unit_is_asked_about(unit: str, per_rad_s: float, tmp_path: Path) -> None:
    log = clean_log(TURNING).spoiled("wx wy wz", lambda column: column * per_rad_s)
    finding = log.described(channels=GYRO.replace("rad/s", unit)).found(tmp_path)[Code.GYRO_UNIT]
    assert not finding.certain
    right = "deg/s" if per_rad_s != 1.0 else "rad/s"
    assert f'unit = "{right}"' in finding.remedy


@pytest.mark.parametrize("rates_deg_s", [(6.0, 2.0), (1.0, 0.3), (0.06, 0.0), (0.0, 0.0)])
def test_a_gyro_in_its_unit_is_not_asked_about(rates_deg_s: tuple[float, float], tmp_path: Path) -> None:
    log = clean_log(Kind(step_s=0.5, rates_deg_s=rates_deg_s, reference="vector", place="none"))
    assert Code.GYRO_UNIT not in log.described(channels=GYRO).found(tmp_path)


@pytest.mark.parametrize("spoil", [swapped, flipped, turned])
@pytest.mark.parametrize("rows", [100, None])
def test_axes_that_become_others_at_a_row_are_asked_about(spoil, rows: int | None, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    """No gyro and no attitude: the service saw it in flight, and a diagnosis named a jump of the bias, trusted."""
    whole = clean_log(TURNING).described(channels="")
    there = np.zeros(len(whole.time_ns), dtype=bool)
    there[900 : None if rows is None else 900 + rows] = True
    others = {name: column for name, column in spoil(whole).columns.items() if name in ("mx", "my", "mz")}
    log = whole.changed(**{name: np.where(there, column, whole.columns[name]) for name, column in others.items()})
    (finding,) = log.inspected(tmp_path).findings
    assert (finding.code, finding.certain, finding.first) == (Code.AXES_CHANGED, False, 902)
    assert finding.rows == there.sum()
