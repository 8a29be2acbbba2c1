"""``[[empirical]]`` of ``physics.toml``: a curve over a driver, without a name, for use inside its range only.

A piecewise linear curve f over the driver's values x: growth of the reference's magnitude m = f(x) [nT], a body field
d_i = f_i(x) [nT], or a gain, d_i = -f_i(x) B_i.  Its values are those beyond the mean of the recording it comes from,
which the nine errors hold.  Outside its range it adds nothing.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

import numpy as np
from numpy.typing import NDArray

from magcal_service.base.typed_toml import nearest
from magcal_service.base.typed_toml.keys import choice, numbers, special, text, whole
from magcal_service.base.typed_toml.record import Reading
from magcal_service.base.units import CHANNEL_UNITS
from magcal_service.model import Array
from magcal_service.physics.apply.named_arrays import MOST_NUMBERS, array_of
from magcal_service.physics.drivers.computed import COMPUTED, driver_values
from magcal_service.physics.scene.scene import Scene

NAME: Final = "empirical"
"""What stands for an effect's name in counters and in what is said."""

OUTSIDE: Final = f"{NAME}.driver_outside"
"""The same where the driver is there, and beyond the range of the curve."""

MOST_CURVES: Final = 8
"""In one file; a choice: a diagnosis writes three at the most."""

MOST_KNOTS: Final = MOST_NUMBERS // 3
"""Of one curve: three numbers each fit into one array."""

_MOST_COLUMN: Final = 63  # a channel has 64 values at the most

_LARGEST_NT: Final = 1e6  # 1 mT: more than this is no magnetometer reading
_LARGEST_GAIN: Final = 1.0  # of the reading itself

_CHANNEL: Final = re.compile(r"channel:[^\s\x00-\x1f]{1,200}")


class Kind(StrEnum):
    """What a curve adds to."""

    MAGNITUDE = "magnitude"
    BIAS = "bias"
    GAIN = "gain"

    @property
    def axes(self) -> int:
        """Numbers of one knot."""
        return 1 if self is Kind.MAGNITUDE else 3

    @property
    def unit(self) -> str:
        """Unit of its values."""
        return "1" if self is Kind.GAIN else "nT"


def _check_driver(reading: Reading, key: str, driver: str) -> None:
    kind, _, name = driver.partition(":")
    if kind == "computed" and name not in COMPUTED:
        reading.table.refuse(key, driver, f"unknown quantity; {nearest(name, COMPUTED)}")
    elif kind != "computed" and not _CHANNEL.fullmatch(driver):
        accepted = f'"channel:NAME" or "computed:NAME" with NAME of {", ".join(COMPUTED)} is accepted'
        reading.table.refuse(key, driver, accepted)


def _check_kind(reading: Reading, key: str, kind: Kind) -> None:
    driver: str = reading.values["driver"]
    computed = COMPUTED.get(driver.partition(":")[2]) if driver.startswith("computed:") else None
    if kind is Kind.MAGNITUDE and computed is not None and computed.of_sensor:
        reading.table.refuse(key, str(kind), f"a reference cannot follow {driver}; bias or gain is accepted")


def _check_quantity(reading: Reading, key: str, quantity: str) -> None:
    known = {unit.quantity for unit in CHANNEL_UNITS.values()}
    is_channel = reading.values["driver"].startswith("channel:")
    if is_channel and quantity not in known:
        reading.table.refuse(key, quantity, nearest(quantity, known))
    elif not is_channel and quantity:
        reading.table.refuse(key, quantity, "what is computed has its own; leave it out")


def _array(reading: Reading, key: str, accepted: str) -> Array | None:
    """A finite array of the key; None, and a fault, where there is none."""
    table = reading.table
    found = array_of(table.content.get(key)) if table.has(key) else None
    if found is None:
        table.refuse_or_lack(key, accepted)
    return found


def _knots(reading: Reading, key: str) -> Array:
    accepted = f"2 to {MOST_KNOTS} rising finite numbers are accepted"
    found = _array(reading, key, accepted)
    if found is None:
        return np.array([0.0, 1.0])
    if found.ndim != 1 or not 2 <= len(found) <= MOST_KNOTS or not (np.diff(found) > 0.0).all():
        reading.table.refuse(key, found.tolist(), accepted)
        return np.array([0.0, 1.0])
    return found


def _shaped(reading: Reading, key: str) -> Array:
    """Numbers (k,) of a magnitude, (k, 3) otherwise, for the k knots."""
    kind, count = reading.values["kind"], len(reading.values["knots"])
    shape = (count,) if kind is Kind.MAGNITUDE else (count, 3)
    largest = _LARGEST_GAIN if kind is Kind.GAIN else _LARGEST_NT
    each = "a number" if kind is Kind.MAGNITUDE else "three numbers"
    accepted = f"{each} for each of the {count} knots, from {-largest:g} to {largest:g}, is accepted"
    found = _array(reading, key, accepted)
    if found is None:
        return np.zeros(shape)
    if found.shape != shape or not (np.abs(found) <= largest).all():
        reading.table.refuse(key, found.tolist(), accepted)
        return np.zeros(shape)
    return found


def _sigma(reading: Reading, key: str) -> Array:
    if not reading.table.has(key):
        return np.zeros_like(reading.values["values"])
    found = _shaped(reading, key)
    if (found < 0.0).any():
        reading.table.refuse(key, found.tolist(), "1 sigma of each value, none below 0, is accepted")
    return found


def _check_span(reading: Reading, key: str, span: tuple[float, float]) -> None:
    knots: Array = reading.values["knots"]
    first, last = float(knots[0]), float(knots[-1])
    if not first <= span[0] < span[1] <= last:
        reading.table.refuse(
            key, list(span), f"two rising numbers from {first!r} to {last!r}, the knots', are accepted"
        )


def _only(reading: Reading, key: str) -> bool:
    value = reading.table.content.get(key)
    reading.table.has(key)
    if value is not True:
        reading.table.refuse_or_lack(key, "true is accepted: nothing is known of the curve beyond its range")
    return True


@dataclass(frozen=True, slots=True, eq=False)
class Empirical:
    """A curve.

    Parameters
    ----------
    driver: ``channel:NAME`` or ``computed:NAME``.
    kind: what it adds to.
    quantity: of the channel; empty for what is computed.
    column: which of the channel's values, from 0.
    knots: (k,) values of the driver, rising, in its base unit.
    values, sigma: (k,) of a magnitude, (k, 3) otherwise, with 1 sigma; linear between the knots.
    span: of the driver, from and to: beyond it the curve adds nothing.
    interpolating_only: that it is so; nothing else is accepted.
    """

    driver: str = text(check=_check_driver, file_only=True)
    kind: Kind = choice(Kind, check=_check_kind, file_only=True)
    quantity: str = text("", check=_check_quantity, file_only=True)
    column: int = whole(0, 0, _MOST_COLUMN, file_only=True)
    knots: Array = special(_knots)
    values: Array = special(_shaped)
    sigma: Array = special(_sigma)
    span: tuple[float, float] = numbers(2, name="range", check=_check_span)
    interpolating_only: bool = special(_only, True)

    @property
    def is_recorded(self) -> bool:
        """Whether a channel drives it."""
        return self.driver.startswith("channel:")

    def covers(self, x: Array | float) -> NDArray[np.bool_]:
        """Where values of the driver are inside its range."""
        return np.asarray((self.span[0] <= np.asarray(x)) & (np.asarray(x) <= self.span[1]))

    def at(self, x: Array) -> Array:
        """The curve (n,) or (n, 3) at values (n,) of the driver, 0 outside its range."""
        rows = self.values.reshape(len(self.knots), -1)
        found = np.stack([np.interp(x, self.knots, column) for column in rows.T], axis=1)
        found[~self.covers(x)] = 0.0
        return found[:, 0] if self.kind is Kind.MAGNITUDE else found

    def disturbance(self, x: Array, field_nt: Array) -> tuple[Array, Array]:
        """Body field (n, 3) and growth of the magnitude (n,) [nT] at values (n,) of the driver and readings (n, 3)."""
        found = self.at(x)
        if self.kind is Kind.MAGNITUDE:
            return np.zeros((len(x), 3)), found
        return (-found * field_nt if self.kind is Kind.GAIN else found), np.zeros(len(x))

    def followed(self, scene: Scene) -> Array | None:
        """Values (n,) of its driver on a scene; None where the scene lacks it."""
        return driver_values(scene, self.driver, self.column, self.quantity)


def hats(x: Array, knots: Array) -> Array:
    """Weights (n, k) of the knots' values in a piecewise linear curve at x (n,); the ends are held beyond them."""
    found = np.zeros((len(x), len(knots)))
    if len(knots) < 2:
        return found + 1.0
    rows = np.arange(len(x))
    left = np.clip(np.searchsorted(knots, x, side="right") - 1, 0, len(knots) - 2)
    since, slope = np.clip(x, knots[0], knots[-1]) - knots[left], 1.0 / np.diff(knots)[left]
    at_end = x >= knots[-1]
    found[rows, left] = np.where(at_end, 0.0, 1.0 - slope * since)
    found[rows, left + 1] = np.where(at_end, 1.0, slope * since)
    return found
