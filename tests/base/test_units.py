"""Units against values that anybody can look up (SI brochure, 9th edition; NIST SP 811 for degF, g and bar)."""

from __future__ import annotations

import pytest

from magcal_service.base.units import ANGLE_DEG, CHANNEL_UNITS, FIELD_NT, LENGTH_KM, AngleUnit, FieldUnit, LengthUnit

ONE_IN_BASE = {
    "degC": 1.0, "K": -272.15, "degF": -17.22222222222222, "A": 1.0, "mA": 0.001, "uA": 0.000001,
    "A m2": 1.0, "mA m2": 0.001, "rad/s": 1.0, "mrad/s": 0.001, "deg/s": 0.017453292519943295,
    "rpm": 0.10471975511965977,
    "rad": 1.0, "deg": 0.017453292519943295, "V": 1.0, "mV": 0.001, "W": 1.0, "mW": 0.001, "W/m2": 1.0, "%": 0.01,
    "": 1.0, "1": 1.0, "counts": 1.0, "Pa": 1.0, "hPa": 100.0, "kPa": 1000.0, "mbar": 100.0, "bar": 100000.0,
    "nT": 1.0, "uT": 1000.0, "mT": 1e6, "T": 1e9, "mG": 100.0, "G": 100000.0,
    "km": 1.0, "m": 0.001, "cm": 0.00001, "mm": 0.000001, "ft": 0.0003048,
    "km/s": 1.0, "m/s": 0.001, "m/s2": 1.0, "g": 9.80665,
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


def test_units_of_the_field_and_of_lengths() -> None:
    """1 T = 1e4 G, and 1e9 nT; whoever writes a descriptor has one of these names."""
    nanotesla = {"nT": 1.0, "uT": 1e3, "mT": 1e6, "T": 1e9, "mG": 100.0, "G": 100_000.0}
    assert {unit.value: FIELD_NT[unit] for unit in FieldUnit} == nanotesla
    assert {unit.value: LENGTH_KM[unit] for unit in LengthUnit} == {
        "km": 1.0,
        "m": 0.001,
        "cm": 0.00001,
        "mm": 0.000001,
        "ft": 0.0003048,
    }
    degrees = {unit.value: ANGLE_DEG[unit] for unit in AngleUnit}
    assert degrees == {"deg": 1.0, "rad": pytest.approx(57.29577951308232), "1e-7 deg": 1e-7, "1e-6 deg": 1e-6}


QUANTITIES = {
    "temperature": ("degC", {"degC", "K", "degF"}),
    "current": ("A", {"A", "mA", "uA"}),
    "magnetic moment": ("A m2", {"A m2", "mA m2"}),
    "angular rate": ("rad/s", {"rad/s", "mrad/s", "deg/s", "rpm"}),
    "angle": ("rad", {"rad", "deg"}),
    "voltage": ("V", {"V", "mV"}),
    "power": ("W", {"W", "mW"}),
    "irradiance": ("W/m2", {"W/m2"}),
    "fraction": ("1", {"%"}),
    "dimensionless": ("1", {"", "1"}),
    "counts": ("counts", {"counts"}),
    "pressure": ("Pa", {"Pa", "hPa", "kPa", "mbar", "bar"}),
    "field": ("nT", {"nT", "uT", "mT", "T", "mG", "G"}),
    "length": ("km", {"km", "m", "cm", "mm", "ft"}),
    "speed": ("km/s", {"km/s", "m/s"}),
    "acceleration": ("m/s2", {"m/s2", "g"}),
    "time": ("s", {"s", "ms", "min", "h"}),
    "frequency": ("Hz", {"Hz"}),
    "torque": ("N m", {"N m", "mN m"}),
}


def test_what_each_unit_measures_and_what_it_is_converted_to() -> None:
    found = {name: (unit.quantity, unit.base) for name, unit in CHANNEL_UNITS.items()}
    expected = {unit: (quantity, base) for quantity, (base, units) in QUANTITIES.items() for unit in units}
    assert found == expected
