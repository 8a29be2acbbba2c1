"""What a cause is, and the telemetry that goes with it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np

from tests.blind.sensor import Spoiling
from tests.blind.vectors import Floats
from tests.blind.world import World

Parameters = Mapping[str, Any]


class Measure(Enum):
    """How the strength and the detectability of a cause are measured; see ``strength.py``."""

    VECTOR = "vector"
    SCALAR = "scalar"
    TURNED = "turned"
    WIDENED = "widened"
    COLOURED = "coloured"


@dataclass(frozen=True, slots=True, eq=False)
class Telemetry:
    """One recorded channel.

    Parameters
    ----------
    name: key in the descriptor; its columns are named after it.
    values: (n, k), NaN where a cell is empty.
    unit: of the recording contract, or empty.
    frame: axes of a vector, or empty.
    decimals: written after the point.
    """

    name: str
    values: Floats
    unit: str
    frame: str = ""
    decimals: int = 3

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns in the log."""
        width = self.values.shape[1]
        return (self.name,) if width == 1 else tuple(f"{self.name}_{index + 1}" for index in range(width))


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Cause:
    """One effect in one world, its strength still open.

    Parameters
    ----------
    name: of the effect in the catalogue, or of the kind that is in no catalogue.
    world: the world it acts in, which it may have changed (a despin) before it acts.
    spoil: what it changes, from its scale; scale 0 changes nothing.
    parameters: what the answer says of it, from its scale.
    drivers: telemetry that records what drives it.
    scale: where the search for the wanted strength begins.
    largest_scale: beyond it the cause is no longer what it says.
    fixed: the scale is final: the strength follows from what was drawn.
    measure: how strength and detectability are measured.
    needs_place: place and UTC have to be recorded.
    needs_spin: the descriptor has to state the spin.
    stated_rpm: the rate that it states then, where that is not the true one.
    noise: the noise (n, 3) [nT] that it puts in place of the white one (n, 3), from its scale.
    also: names of effects that are true beside it, because it needs them.
    absorbed: the calibration takes it up whole, so that nothing of it shows.
    """

    name: str
    world: World
    spoil: Callable[[float], Spoiling]
    parameters: Callable[[float], Parameters]
    drivers: tuple[Telemetry, ...] = ()
    scale: float = 1.0
    largest_scale: float = float("inf")
    fixed: bool = False
    measure: Measure = Measure.VECTOR
    needs_place: bool = False
    needs_spin: bool = False
    stated_rpm: float | None = None
    noise: Callable[[float, Floats], Floats] | None = None
    also: tuple[str, ...] = ()
    absorbed: bool = False

    @property
    def scalar(self) -> bool:
        """Does the magnitude show it?"""
        return self.measure in {Measure.VECTOR, Measure.SCALAR} and not self.absorbed


Builder = Callable[[World, bool], Cause]
"""Makes a cause in a world, for a case whose drivers are recorded or not; it draws from the world's streams."""


def rounded(values: Floats, step: float) -> Floats:
    """Values as a converter of that step gives them."""
    return np.asarray(np.round(values / step) * step, dtype=np.float64)


def plain(values: Floats) -> object:
    """An array as lists of numbers."""
    return np.asarray(values).tolist()
