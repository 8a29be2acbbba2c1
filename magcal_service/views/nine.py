"""The nine errors as they are shown: names, units, digits, values with sigma."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from magcal_service.wire.messages import Estimate


@dataclass(frozen=True, slots=True)
class Parameter:
    """One of the nine errors, as it is shown.

    Parameters
    ----------
    name, unit: the paper's letters and the unit, ``-`` for a pure number.
    decimals: digits after the point.
    settled: an error below this counts as settled.  50 nT, and 0.001 because that moves a field of
        50 000 nT by the same 50 nT.
    """

    name: str
    unit: str
    decimals: int
    settled: float

    def text(self, value: float, sign: str = "") -> str:
        """The value in this parameter's own number format."""
        return f"{value:{sign}.{self.decimals}f}"


PARAMETERS: Final[tuple[Parameter, ...]] = (
    *(Parameter(name, "nT", 1, 50.0) for name in ("bx", "by", "bz")),
    *(Parameter(name, "-", 5, 1e-3) for name in ("D11", "D22", "D33", "D12", "D13", "D23")),
)
_SIZE: Final = len(PARAMETERS)
# Places of the variances in the upper triangle, row by row, of a 9x9 covariance: 0, 9, 17, 24, ...
_DIAGONAL: Final = tuple(row * _SIZE - row * (row - 1) // 2 for row in range(_SIZE))


def values(estimate: Estimate) -> tuple[float, ...]:
    """The nine errors in the order of ``PARAMETERS`` [nT and -]."""
    return (*estimate.bias_nt, *estimate.D)


def sigmas(estimate: Estimate) -> tuple[float, ...]:
    """One standard deviation of each of the nine errors [nT and -]; NaN where a variance is negative."""
    variances = (estimate.covariance[place] for place in _DIAGONAL)
    return tuple(math.sqrt(variance) if variance >= 0.0 else math.nan for variance in variances)
