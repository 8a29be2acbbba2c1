"""What a group of three columns is: by its unit where that decides, else by its words."""

from __future__ import annotations

import re
from typing import Final

from magcal_service.base.units import FieldUnit
from magcal_service.recordings.describe.columns import Triple
from magcal_service.recordings.describe.vocabulary import Kind, kind_of

_MILLIGAUSS: Final = re.compile(r"mG|[Gg][Aa][Uu][Ss]|mgs", re.ASCII)
_BY_UNIT: Final = {
    "deg/s": Kind.GYRO,
    "rad/s": Kind.GYRO,
    "mrad/s": Kind.GYRO,
    "rpm": Kind.GYRO,
    "m/s2": Kind.ACCELEROMETER,
    "g": Kind.ACCELEROMETER,
    "A m2": Kind.TORQUER,
    "mA m2": Kind.TORQUER,
    "km": Kind.POSITION,
    "m": Kind.POSITION,
    "cm": Kind.POSITION,
    "mm": Kind.POSITION,
    "km/s": Kind.VELOCITY,
    "m/s": Kind.VELOCITY,
}


def may_be_milli_g(triple: Triple) -> bool:
    """Whether the unit is written as ``mg``: milligauss to some, and a thousandth of gravity to others."""
    return triple.unit == "mG" and not any(_MILLIGAUSS.search(column.name) for column in triple.columns)


def kind_of_triple(triple: Triple) -> Kind:
    """The kind of three columns."""
    kind = kind_of(triple.words)
    if may_be_milli_g(triple):
        return kind
    if triple.unit in list(FieldUnit):
        return kind if kind is Kind.REFERENCE else Kind.MAGNETOMETER
    return _BY_UNIT.get(triple.unit, kind)
