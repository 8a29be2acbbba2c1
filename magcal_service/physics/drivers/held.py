"""The temperature at which nine errors hold that were fitted beside effects of heat."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol


class Form(Protocol):
    """An effect's form, of the catalogue or of a ``physics.toml``."""

    @property
    def driver(self) -> str:
        """``channel:NAME``, ``inferred:NAME`` or ``none``."""

    @property
    def constants(self) -> Mapping[str, float]:
        """By name."""


@dataclass(frozen=True, slots=True)
class HeldAt:
    """Where an effect of heat adds nothing, so that nine errors beside it are those of the sensor there.

    Parameters
    ----------
    driver: ``channel:NAME`` or ``inferred:temperature``.
    value: temperature [degC]; where that is inferred, the light that has it as its answer, over full sunlight [-].
    unit: of it.
    """

    driver: str
    value: float
    unit: str

    def __str__(self) -> str:
        if self.unit == "1":
            return f"the temperature that {self.value:.3g} of full sunlight keeps up, the mean here"
        return f"{self.value:.1f} {self.unit} of channel {self.driver.partition(':')[2]}"

    def to_dict(self) -> dict[str, Any]:
        """As JSON has it."""
        return {"driver": self.driver, "value": self.value, "unit": self.unit, "says": str(self)}


def held_at(forms: Iterable[Form]) -> tuple[HeldAt, ...]:
    """Where nine errors hold beside some effects, once for each driver; nothing where none follows a temperature."""
    found: dict[HeldAt, None] = {}
    for form in forms:
        if "zero_degc" in form.constants:
            found[HeldAt(form.driver, form.constants["zero_degc"], "degC")] = None
        elif "mean_light" in form.constants and form.driver == "inferred:temperature":
            found[HeldAt(form.driver, form.constants["mean_light"], "1")] = None
    return tuple(found)


def held_in_words(held: Iterable[HeldAt]) -> str:
    """``28.2 degC of channel board``, several joined by ``and``; empty for none."""
    return " and ".join(map(str, held))
