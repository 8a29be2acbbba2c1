"""Units as people write them in a log, to the units of a descriptor."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Final

_FIELD: Final = {
    "nT": ("nt", "ntesla", "nanotesla"),
    "uT": ("ut", "µt", "μt", "\ufffdt", "utesla", "microtesla", "microteslas", "mut"),
    "mT": ("mt", "millitesla", "mtesla"),
    "T": ("tesla",),
    "mG": ("mg", "mgauss", "milligauss", "mgs"),
    "G": ("gauss", "gs", "ga"),
}

_OTHER: Final = {
    "degC": ("degc", "°c", "ºc", "\ufffdc", "celsius", "deg_c", "centigrade", "oc", "cel"),
    "K": ("kelvin", "degk"),
    "degF": ("degf", "°f", "fahrenheit"),
    "A": ("amp", "amps", "ampere"),
    "mA": ("ma", "milliamp", "milliamps"),
    "uA": ("ua", "µa"),
    "A m2": ("am2", "a m2", "a*m2", "a.m2", "am^2", "a m^2", "a*m^2", "a·m²", "am²", "a m²"),
    "mA m2": ("mam2", "ma m2", "mam^2", "ma*m^2"),
    "rad/s": ("rad/s", "rads", "rad_s", "radps", "rps", "rad/sec", "rad s-1"),
    "mrad/s": ("mrad/s", "mrads", "mrad_s"),
    "deg/s": ("deg/s", "dps", "deg_s", "degps", "°/s", "\ufffd/s", "deg/sec", "degs"),
    "rpm": ("rpm",),
    "rad": ("rad", "radians"),
    "1e-7 deg": (
        "1e-7 deg",
        "1e-7deg",
        "1e-7 degrees",
        "1e7 deg",
        "deg*1e7",
        "deg * 1e7",
        "deg x 1e7",
        "dege7",
        "deg e7",
    ),
    "1e-6 deg": (
        "1e-6 deg",
        "1e-6deg",
        "1e-6 degrees",
        "1e6 deg",
        "deg*1e6",
        "deg * 1e6",
        "deg x 1e6",
        "dege6",
        "udeg",
    ),
    "deg": ("deg", "degree", "degrees", "°", "\ufffd"),
    "V": ("volt", "volts"),
    "mV": ("mv", "millivolt"),
    "W": ("watt", "watts"),
    "mW": ("mw",),
    "W/m2": ("w/m2", "w/m^2", "w/m²"),
    "%": ("%", "pct", "percent", "%rh"),
    "counts": ("counts", "count", "lsb", "raw", "adc"),
    "Pa": ("pa", "pascal"),
    "hPa": ("hpa",),
    "kPa": ("kpa",),
    "mbar": ("mbar",),
    "bar": ("bar",),
    "km": ("km", "kilometer", "kilometre"),
    "m": ("m", "meter", "metre", "meters", "metres", "masl"),
    "cm": ("cm", "centimeter", "centimetre", "centimeters", "centimetres"),
    "mm": ("mm", "millimeter", "millimetre", "millimeters", "millimetres"),
    "ft": ("ft", "feet", "foot"),
    "km/s": ("km/s", "kmps", "km_s"),
    "m/s": ("m/s", "mps", "m_s"),
    "m/s2": ("m/s2", "m/s^2", "m/s²", "m_s2", "mps2", "ms2", "m/s/s"),
    "s": ("s", "sec", "secs", "second", "seconds"),
    "ms": ("ms", "msec", "milli", "millis", "millisecond", "milliseconds"),
    "us": ("us", "µs", "μs", "\ufffds", "usec", "micros", "microsecond", "microseconds"),
    "ns": ("ns", "nsec", "nanos", "nanosecond", "nanoseconds"),
    "min": ("min", "minutes"),
    "h": ("hours",),
    "Hz": ("hz",),
}

_ALONE: Final = {
    "T": "T",
    "G": "G",
    "A": "A",
    "V": "V",
    "W": "W",
    "K": "K",
    "C": "degC",
    "F": "degF",
    "g": "g",
    "h": "h",
}
"""Single letters: a unit only where brackets or a line of units say so, and by their case."""

_BY_WORD: Final = {word: unit for table in (_FIELD, _OTHER) for unit, words in table.items() for word in words}
_SUFFIX: Final = {
    "A": "A",
    "a": "A",
    "V": "V",
    "v": "V",
    "c": "degC",
    "C": "degC",
    "K": "K",
    "k": "K",
    "F": "degF",
    "W": "W",
    "s": "s",
    "m": "m",
    "G": "G",
}
"""Single letters after a name; a T stands for a temperature as often as for a tesla, and is none."""

_BRACKETED: Final = re.compile(r"^(.*?)\s*[\[(<{]\s*([^\[\](){}<>]{1,14}?)\s*[\])>}]\s*(.*)$")
_INDEX: Final = re.compile(r"[\[(]\d+[\])]$")
_SLASHED: Final = re.compile(r"^(.*\w)\s*/\s*([A-Za-zµμ°²^/]{1,8}[0-9]?)$")
_COMPOSED: Final = re.compile(
    r"^(.+?)[_\s.\-]+(deg[_/]s|rad[_/]s|m[_/]s2|m[_/]s|km[_/]s|deg[_]c|a[_ ]m2)$", re.IGNORECASE
)
_SUFFIXED: Final = re.compile(r"^(.*?[^_\s.\-])[_\s.\-]+([A-Za-zµμ°%\ufffd/]{1,12}2?(?:[_/]s2?)?)$")


def unit_of(text: str) -> str:
    """The descriptor's unit for a text that is a unit and nothing else; empty where it is none."""
    text = text.strip().strip("[](){}<>").strip()
    if text in _ALONE:
        return _ALONE[text]
    return _BY_WORD.get(text.lower(), "")


def is_unit(text: str) -> bool:
    """Whether a cell of a line of units says a unit, or that there is none."""
    text = text.strip().strip("[](){}<>").strip()
    return bool(unit_of(text)) or text.lower() in {
        "-",
        "--",
        "1",
        "none",
        "n/a",
        "unitless",
        "utc",
        "date",
        "iso",
        "iso8601",
        "sec",
        "[]",
    }


def are_units(cells: Sequence[str]) -> bool:
    """Whether the cells of a line without numbers are units, most of them."""
    return sum(is_unit(cell) for cell in cells) * 2 >= sum(bool(cell) for cell in cells)


_LENGTH: Final = re.compile(r"^(.+)[_\s.\-](nmi?|mi|miles?|yd|yards?|kft)$", re.IGNORECASE)
"""A name that ends in a length for which the house has no unit, and is no more than asked about."""


def unknown_unit(name: str) -> str:
    """What stands in brackets in a name and is no unit that is known here, or a length that it ends in, as ``nmi``;
    empty where nothing does."""
    match = _BRACKETED.match(name) or _LENGTH.match(name)
    text = match.group(2) if match else ""
    return text if re.fullmatch(r"[A-Za-z]{1,6}", text) and not unit_of(text) else ""


def split_unit(name: str) -> tuple[str, str]:
    """A column's name without its unit, and the unit; empty where the name says none."""
    index = _INDEX.search(name)
    if index:  # as magnetometer_ga[0]
        stem, unit = split_unit(name[: index.start()])
        return stem + index.group(), unit
    match = _BRACKETED.match(name)
    if match and unit_of(match.group(2)):
        return (match.group(1) + match.group(3)).strip(), unit_of(match.group(2))
    for pattern in (_COMPOSED, _SLASHED, _SUFFIXED):
        match = pattern.match(name)
        if match:
            stem, last = match.groups()
            unit = unit_of(last) if len(last) > 1 else _SUFFIX.get(last, "")
            if unit:
                return stem, unit
    match = re.match(r"^(.*[a-z])(US|MS|NS)$", name)  # as TimeUS of an autopilot
    if match:
        return match.group(1), match.group(2).lower()
    return name, ""
