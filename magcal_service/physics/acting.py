"""What an effect acts on, what the watch sees of it, and its direct form for the live path."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Final, Protocol

import numpy as np

from magcal_service.model import Array

Vector3 = tuple[float, float, float]


class ActsOn(StrEnum):
    """What an effect disturbs, and so where it is detected and how it is compensated."""

    FIELD = "field"
    REFERENCE = "reference"
    REFERENCE_TIME = "reference time"
    SAMPLES = "samples"
    ATTITUDE = "attitude"
    NOISE = "noise"

    @property
    def is_reference(self) -> bool:
        """Whether the reference is wrong rather than the sensor."""
        return self in (ActsOn.REFERENCE, ActsOn.REFERENCE_TIME)


class Watched(StrEnum):
    """What the watch over the model sees of an effect in the residual of a running filter."""

    BIAS_BY = "a body field that follows a quantity"
    SCALE_BY = "a gain that follows a quantity"
    CUBE = "the cube of the reading"
    FLAT_TOP = "readings beyond the largest that repeats"
    SLOPE = "the slope of the reference's magnitude"
    MEMORY = "correlation from sample to sample"
    LINE = "a line of the spectrum"
    BIAS_COURSE = "a smooth course of the bias"
    SCALE_COURSE = "a smooth course of the gain"
    BIAS_STEP = "a step of the bias"
    SCALE_STEP = "a step of the gain"


LIGHT: Final = "light"
WARMTH: Final = "warmth"
"""Quantities that the watch infers from positions: the share of sunlight, and what follows it slowly."""


@dataclass(frozen=True, slots=True)
class Direct:
    """An effect at one moment from the newest value of one channel: d = sum_k s_k m_k, or d_i = -B_i sum_k s_k m_ki.

    Parameters
    ----------
    channel, quantity: which telemetry, and what kind it has to be.
    columns: which of its values are the signals s_k (in their base unit).
    zero: what is subtracted from each.
    matrix: (k, 3) amplitudes [nT per unit], or of a gain [1 per unit].
    is_gain: whether the field is multiplied.
    """

    channel: str
    quantity: str
    columns: tuple[int, ...]
    zero: float
    matrix: tuple[Vector3, ...]
    is_gain: bool = False

    def field(self, values: Sequence[float], measured_nt: Sequence[float]) -> list[float]:
        """d (3,) [nT] in the corrected body frame, of the channel's values and the measured vector (3,) [nT]."""
        d = [0.0, 0.0, 0.0]
        for column, row in zip(self.columns, self.matrix, strict=True):
            signal = values[column] - self.zero
            for i in range(3):
                d[i] += row[i] * (-signal * measured_nt[i] if self.is_gain else signal)
        return d


class Term(Protocol):
    """An effect of a ``physics.toml``: driver, form and numbers by name."""

    @property
    def driver(self) -> str:
        """``channel:NAME``, ``inferred:NAME`` or ``none``."""

    @property
    def variant(self) -> str:
        """The form; empty for the plain one."""

    @property
    def amplitudes(self) -> Mapping[str, Array]:
        """By name of the block."""

    @property
    def nonlinear(self) -> Mapping[str, float | Array]:
        """By name; several of one name as an array."""

    @property
    def constants(self) -> Mapping[str, float]:
        """By name."""


def direct(
    term: Term, quantity: str, block: str, columns: Sequence[int], zero: float = 0.0, *, is_gain: bool = False
) -> Direct | None:
    """The direct form of a term that one recorded channel drives; None where its numbers are not those of the form."""
    kind, _, channel = term.driver.partition(":")
    if kind != "channel" or term.nonlinear or set(term.amplitudes) != {block} or not columns or min(columns) < 0:
        return None
    amplitudes = np.asarray(term.amplitudes[block], dtype=np.float64)
    if amplitudes.shape not in ((len(columns), 3), *([(3,)] if len(columns) == 1 else [])):
        return None
    rows = tuple((x, y, z) for x, y, z in amplitudes.reshape(-1, 3).tolist())
    return Direct(channel, quantity, tuple(columns), zero, rows, is_gain)
