"""Which values of a hypothesis' nonlinear numbers are tried first."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from magcal_service.diagnosis.lines import ORBIT_SIDE_HZ
from magcal_service.model import Array
from magcal_service.physics.interface import Nonlinear

_SLOWEST_DUTY_HZ: Final = 1.0 / 300.0  # a duty of more than five minutes is steps, which are another hypothesis
_SLOWEST_TONE_SPUN_HZ: Final = 1.0 / 600.0
"""Converters, wheels and heaters are faster, and what is slower follows the orbit or the attitude; a choice."""

_SLOWEST_TONE_HZ: Final = 1.0 / 120.0
"""On a craft that does not spin faster: what is slower may be the crust of the field model, degree 45 of an orbit."""

OF_LINES: Final = ("frequency", "period")  # roles of numbers that are tried at the lines of a residual


def tried_first(number: Nonlinear, lines: Array | None, spin_hz: float | None) -> Array:
    """Values to try first; a period may show as a separate line, as side lines of the spin, or by its third wave alone,
    where the first is near the spin's own line."""
    if number.role not in OF_LINES:
        return number.grid
    if lines is None or not len(lines):
        return np.zeros(0)
    if number.role == "frequency":
        spins = spin_hz is not None and spin_hz > _SLOWEST_TONE_HZ  # it moves what is fixed in the body out of the way
        return lines[lines > (_SLOWEST_TONE_SPUN_HZ if spins else _SLOWEST_TONE_HZ)]
    beside = [] if spin_hz is None else [np.abs(lines - spin_hz), lines + spin_hz, _hidden(lines / 3.0, spin_hz)]
    found = np.unique(np.round(np.concatenate([lines, *beside]), 7))
    return 1.0 / found[found > _SLOWEST_DUTY_HZ]


def _hidden(waves: Array, spin_hz: float) -> Array:
    """Those of some waves (m,) [Hz] that would be no lines of their own, so near the spin's rate or its double."""
    near = [np.abs(waves - multiple * spin_hz) < ORBIT_SIDE_HZ for multiple in (1, 2)]
    return np.asarray(waves[near[0] | near[1]])


def combinations(grids: Sequence[Array]) -> Array:
    """Every combination of the grids' values (m, k)."""
    return np.stack([axis.ravel() for axis in np.meshgrid(*grids, indexing="ij")], axis=1)
