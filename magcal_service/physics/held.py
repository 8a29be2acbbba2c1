"""Where nine errors hold that were fitted beside effects: at the value of a driver at which an effect adds nothing."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Final, Protocol

TOGETHER: Final = "all circuits"
"""Form that follows several channels at once, whose names are joined by ``+``."""


class Form(Protocol):
    """An effect's form, of the catalogue or of a ``physics.toml``."""

    @property
    def effect(self) -> str:
        """Name in the catalogue."""

    @property
    def driver(self) -> str:
        """``channel:NAME``, ``inferred:NAME`` or ``none``."""

    @property
    def variant(self) -> str:
        """Which form; empty for the plain one."""

    @property
    def constants(self) -> Mapping[str, float]:
        """By name."""

    @property
    def block_names(self) -> tuple[str, ...]:
        """Of its amplitudes."""


@dataclass(frozen=True, slots=True)
class HeldAt:
    """Where an effect adds nothing, so that nine errors beside it are those of the sensor there.

    Parameters
    ----------
    driver: ``channel:NAME`` or ``inferred:NAME``.
    value: of the driver, in the unit; 0 where what is inferred is off.
    unit: of it; "1" for a share of full sunlight, of a full current or of what is on, "" where nobody knows it.
    says: the same in words, as after *at*.
    """

    driver: str
    value: float
    unit: str
    says: str

    def __str__(self) -> str:
        return self.says

    def to_dict(self) -> dict[str, Any]:
        """As JSON has it."""
        return {"driver": self.driver, "value": self.value, "unit": self.unit, "says": self.says}


def at_zero_of(form: Form, unit: str) -> HeldAt:
    """Where a recorded driver is zero, in a unit; "" where it has none that is known.

    Of its other columns, which never change or go along with a fitted one, the bias has taken up what they make there.
    """
    name = form.driver.partition(":")[2]
    names = name.split("+") if form.variant == TOGETHER else [name]
    channels = f"channel{'s' if len(names) > 1 else ''} {' and '.join(names)}"
    return HeldAt(form.driver, 0.0, unit, f"{f'0 {unit}'.strip()} in the fitted columns of {channels}")


def held_in_words(held: Iterable[HeldAt]) -> str:
    """``28.2 degC of channel board``, several joined by ``and``; empty for none."""
    return " and ".join(map(str, held))
