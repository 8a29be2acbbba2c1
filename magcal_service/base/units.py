"""Every unit a recording may be written in: a closed list, each with its quantity and its factor to the base unit.

The field's base unit is the nanotesla, the length's the kilometre; a channel keeps its own unit and ``to_base`` says
how to compare it with another.  A unit that is not listed is refused by name, never guessed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from types import MappingProxyType

import numpy as np
import numpy.typing as npt


class FieldUnit(StrEnum):
    """Units of a magnetic flux density; 1 G = 100 uT, so 1 mG = 100 nT."""

    NT = "nT"
    UT = "uT"
    MT = "mT"
    T = "T"
    MG = "mG"
    G = "G"


class LengthUnit(StrEnum):
    """Units of a position or an altitude."""

    KM = "km"
    M = "m"
    CM = "cm"
    MM = "mm"
    FT = "ft"


class AngleUnit(StrEnum):
    """Units of a latitude and a longitude; receivers and autopilots keep them in whole parts of a degree."""

    DEG = "deg"
    RAD = "rad"
    E7 = "1e-7 deg"
    E6 = "1e-6 deg"


FIELD_NT: Mapping[FieldUnit, float] = MappingProxyType(
    {
        FieldUnit.NT: 1.0,
        FieldUnit.UT: 1e3,
        FieldUnit.MT: 1e6,
        FieldUnit.T: 1e9,
        FieldUnit.MG: 1e2,
        FieldUnit.G: 1e5,
    }
)
"""Nanotesla per unit."""

LENGTH_KM: Mapping[LengthUnit, float] = MappingProxyType(
    {LengthUnit.KM: 1.0, LengthUnit.M: 1e-3, LengthUnit.CM: 1e-5, LengthUnit.MM: 1e-6, LengthUnit.FT: 3.048e-4}
)
"""Kilometres per unit."""

ANGLE_DEG: Mapping[AngleUnit, float] = MappingProxyType(
    {AngleUnit.DEG: 1.0, AngleUnit.RAD: 180.0 / math.pi, AngleUnit.E7: 1e-7, AngleUnit.E6: 1e-6}
)
"""Degrees per unit."""


@dataclass(frozen=True, slots=True)
class ChannelUnit:
    """What one telemetry unit measures.

    Parameters
    ----------
    quantity: kind of the channel, such as ``"temperature"`` or ``"current"``.
    base: unit that ``to_base`` converts to.
    factor, offset: value in base = factor * value + offset.
    """

    quantity: str
    base: str
    factor: float = 1.0
    offset: float = 0.0

    def to_base(self, values: npt.ArrayLike) -> npt.NDArray[np.float64]:
        """The values, any shape, in the base unit; those that are in it are the same array."""
        given = np.asarray(values, dtype=np.float64)
        return given if (self.factor, self.offset) == (1.0, 0.0) else self.factor * given + self.offset


def _family(quantity: str, base: str, factors: Mapping[str, float]) -> dict[str, ChannelUnit]:
    return {name: ChannelUnit(quantity, base, factor) for name, factor in factors.items()}


_DEG = math.pi / 180.0  # radians per degree

CHANNEL_UNITS: Mapping[str, ChannelUnit] = MappingProxyType(
    {
        "degC": ChannelUnit("temperature", "degC"),
        "K": ChannelUnit("temperature", "degC", 1.0, -273.15),
        "degF": ChannelUnit("temperature", "degC", 5.0 / 9.0, -160.0 / 9.0),
        **_family("current", "A", {"A": 1.0, "mA": 1e-3, "uA": 1e-6}),
        **_family("magnetic moment", "A m2", {"A m2": 1.0, "mA m2": 1e-3}),
        **_family("angular rate", "rad/s", {"rad/s": 1.0, "mrad/s": 1e-3, "deg/s": _DEG, "rpm": 2.0 * math.pi / 60.0}),
        **_family("angle", "rad", {"rad": 1.0, "deg": _DEG}),
        **_family("voltage", "V", {"V": 1.0, "mV": 1e-3}),
        **_family("power", "W", {"W": 1.0, "mW": 1e-3}),
        **_family("irradiance", "W/m2", {"W/m2": 1.0}),
        **_family("fraction", "1", {"%": 1e-2}),
        **_family("dimensionless", "1", {"": 1.0, "1": 1.0}),
        **_family("counts", "counts", {"counts": 1.0}),
        **_family("pressure", "Pa", {"Pa": 1.0, "hPa": 1e2, "kPa": 1e3, "mbar": 1e2, "bar": 1e5}),
        **_family("field", "nT", {unit.value: factor for unit, factor in FIELD_NT.items()}),
        **_family("length", "km", {unit.value: factor for unit, factor in LENGTH_KM.items()}),
        **_family("speed", "km/s", {"km/s": 1.0, "m/s": 1e-3}),
        **_family("acceleration", "m/s2", {"m/s2": 1.0, "g": 9.80665}),
        **_family("time", "s", {"s": 1.0, "ms": 1e-3, "min": 60.0, "h": 3600.0}),
        **_family("frequency", "Hz", {"Hz": 1.0}),
        **_family("torque", "N m", {"N m": 1.0, "mN m": 1e-3}),
    }
)
"""Every unit a telemetry channel may have."""

FACTORS = (1e-12, 1e12)
"""Of values in a unit without a name here, to one that has one: from a pico- to a tera-unit, and no sign."""
