"""What may be wrong with the sensor, its clock, and what is stated of the craft: in plain arithmetic."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np

from magcal_service.model import Array
from magcal_service.studies.unseen.flight import Sent, reconfigured

HALF: Final = 0.5
"""Share of a flight after which what happens once happens: an orbit or nearly so has been trusted then."""


def turned_axes(matrix: Array) -> Callable[[Sent], None]:
    """Readings turned by a matrix (3, 3) from half of the flight on."""

    def spoil(sent: Sent) -> None:
        late = sent.late(HALF)[:, None] > 0.0
        sent.post.append(lambda field: np.where(late, field @ matrix.T, field))

    return spoil


def stuck(axes: list[int]) -> Callable[[Sent], None]:
    """Axes that keep their value from half of the flight on."""

    def spoil(sent: Sent) -> None:
        first = int(np.argmax(sent.late(HALF) > 0.0))

        def hold(field: Array) -> Array:
            held = field.copy()
            held[first:, axes] = field[first, axes]
            return held

        sent.post.append(hold)

    return spoil


def clipped(sent: Sent) -> None:
    """Readings end at 25 uT."""
    sent.post.append(lambda field: np.asarray(np.clip(field, -25_000.0, 25_000.0)))


def held_readings(sent: Sent) -> None:
    """A sensor that is asked four times for each reading."""
    index = np.arange(len(sent.noise))
    sent.post.append(lambda field: np.asarray(field[index - index % 4]))


def dead(sent: Sent) -> None:
    """z reads 0 from half of the flight on."""
    late = np.outer(sent.late(HALF), [0.0, 0.0, 1.0]) > 0.0
    sent.post.append(lambda field: np.where(late, 0.0, field))


def corrupted(sent: Sent) -> None:
    """One reading in ten points anywhere, its length kept, as after a lost bit of a sign or of an exponent."""
    hit = sent.rng.random(len(sent.noise)) < 0.1
    towards = sent.rng.standard_normal((int(hit.sum()), 3))
    towards /= np.linalg.norm(towards, axis=1)[:, None]
    sent.noise[hit] = np.linalg.norm(sent.field_nt[hit], axis=1)[:, None] * towards - sent.field_nt[hit]


def clock(seconds: float) -> Callable[[Sent], None]:
    """Sample times ahead by so much from half of the flight on [s]."""

    def spoil(sent: Sent) -> None:
        sent.sample_ns += (sent.late(HALF) * seconds * 1e9).astype(np.int64)

    return spoil


def spin(factor: float) -> Callable[[Sent], None]:
    """The spin's rate is stated wrongly, by a factor."""

    def spoil(sent: Sent) -> None:
        if sent.config.spin is not None:
            sent.config = reconfigured(sent.config, spin={"rate_rpm": factor * sent.config.spin.rate_rpm})

    return spoil


def other_axis(sent: Sent) -> None:
    """The spin's axis is stated 3 deg off."""
    sent.config = reconfigured(sent.config, spin={"axis": (0.05, 0.0, 0.99875)})


def noise_misstated(factor: float) -> Callable[[Sent], None]:
    """The noise is stated wrongly, by a factor."""

    def spoil(sent: Sent) -> None:
        sent.config = reconfigured(sent.config, sensor={"noise_nt": factor * sent.noise_nt})

    return spoil
