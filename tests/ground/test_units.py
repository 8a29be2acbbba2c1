"""Units against values that anybody can look up (SI brochure, 9th edition; NIST SP 811 for degF, g and bar)."""

from __future__ import annotations

import pytest

from magcal_service.units import CHANNEL_UNITS

ONE_IN_BASE = {
    "degC": 1.0, "K": -272.15, "degF": -17.22222222222222, "A": 1.0, "mA": 0.001, "uA": 0.000001,
    "A m2": 1.0, "mA m2": 0.001, "rad/s": 1.0, "mrad/s": 0.001, "deg/s": 0.017453292519943295,
    "rpm": 0.10471975511965977,
    "rad": 1.0, "deg": 0.017453292519943295, "V": 1.0, "mV": 0.001, "W": 1.0, "mW": 0.001, "W/m2": 1.0, "%": 0.01,
    "": 1.0, "1": 1.0, "counts": 1.0, "Pa": 1.0, "hPa": 100.0, "kPa": 1000.0, "mbar": 100.0, "bar": 100000.0,
    "nT": 1.0, "uT": 1000.0, "mT": 1e6, "T": 1e9, "mG": 100.0, "G": 100000.0,
    "km": 1.0, "m": 0.001, "km/s": 1.0, "m/s": 0.001, "m/s2": 1.0, "g": 9.80665,
    "s": 1.0, "ms": 0.001, "min": 60.0, "h": 3600.0, "Hz": 1.0, "N m": 1.0, "mN m": 0.001,
}  # fmt: skip


@pytest.mark.parametrize("unit", ONE_IN_BASE, ids=str)
def test_one_of_a_unit_in_its_base_unit(unit: str) -> None:
    assert float(CHANNEL_UNITS[unit].to_base([1.0])[0]) == pytest.approx(ONE_IN_BASE[unit], rel=1e-12)


def test_every_unit_is_looked_up() -> None:
    assert set(CHANNEL_UNITS) == set(ONE_IN_BASE)


def test_water_boils_at_100_degc() -> None:
    assert float(CHANNEL_UNITS["degF"].to_base([212.0])[0]) == pytest.approx(100.0)
    assert float(CHANNEL_UNITS["K"].to_base([373.15])[0]) == pytest.approx(100.0)
