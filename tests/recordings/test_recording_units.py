import math

import numpy as np
import pytest

from magcal_service.base.units import CHANNEL_UNITS, FIELD_NT, LENGTH_KM, FieldUnit, LengthUnit


@pytest.mark.parametrize(
    ("unit", "earth"), [("nT", 5e4), ("uT", 50.0), ("mT", 0.05), ("T", 5e-5), ("mG", 500.0), ("G", 0.5)]
)
def test_the_earths_field_in_each_unit_is_the_same(unit: str, earth: float) -> None:
    assert earth * FIELD_NT[FieldUnit(unit)] == pytest.approx(5e4, rel=1e-15)


def test_every_field_unit_has_a_factor() -> None:
    assert set(FIELD_NT) == set(FieldUnit)


def test_every_length_unit_has_a_factor() -> None:
    assert set(LENGTH_KM) == set(LengthUnit)


@pytest.mark.parametrize(
    ("unit", "value", "base"),
    [
        ("degC", 21.5, 21.5),
        ("K", 273.15, 0.0),
        ("degF", 212.0, 100.0),
        ("mA", 250.0, 0.25),
        ("mA m2", 200.0, 0.2),
        ("deg/s", 180.0, math.pi),
        ("rpm", 60.0, 2 * math.pi),
        ("hPa", 1013.25, 101325.0),
        ("%", 50.0, 0.5),
        ("uT", 45.0, 45000.0),
        ("min", 2.0, 120.0),
        ("m", 500.0, 0.5),
        ("counts", 7.0, 7.0),
        ("", 3.0, 3.0),
    ],
)
def test_a_channel_value_is_converted_to_the_base_unit(unit: str, value: float, base: float) -> None:
    assert CHANNEL_UNITS[unit].to_base(value) == pytest.approx(base, abs=1e-12)


def test_every_base_unit_is_itself_a_unit_that_changes_nothing() -> None:
    values = np.array([[1.5, -2.0]])
    for unit in CHANNEL_UNITS.values():
        assert CHANNEL_UNITS[unit.base].to_base(values) is values


def test_units_of_one_quantity_share_one_base() -> None:
    bases = {(unit.quantity, unit.base) for unit in CHANNEL_UNITS.values()}
    assert len(bases) == len({quantity for quantity, _ in bases})
