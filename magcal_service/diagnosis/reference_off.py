"""What a fit found that the reference vector is off by, in words and numbers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from magcal_service.diagnosis.problem import Fit
from magcal_service.model import STATE_SIZE, Array
from magcal_service.recordings.channels import Axes

_SEEN_SIGMA: Final = 4.0
"""Of its own sigma, from which on it is said that a reference is off: by chance in one of 16 000."""

_FARTHEST: Final = 3.0
"""Times its usual size, beyond which a reference is off by something else: 1500 nT, or 390 in the air.  An attitude
whose axes are turned by 8 degrees against the reference's takes 3000 nT, and half a per cent of all gains."""


@dataclass(frozen=True, slots=True, eq=False)
class ReferenceOff:
    """What a fit found of it.

    Parameters
    ----------
    off_nt: (3,) what the reference is off by: add it to what is stated [nT].
    sigma_nt: (3,) 1 sigma of each, along the directions that are seen.
    axes: its axes.
    seen: (3, k) directions that it is known along.
    squares: its chi-square, of k degrees of freedom.
    """

    off_nt: Array
    sigma_nt: Array
    axes: Axes
    seen: Array
    squares: float

    @property
    def is_certain(self) -> bool:
        """Whether it is more than chance: as rare as ``_SEEN_SIGMA`` of one number, for what each further may add."""
        return bool(self.squares > _SEEN_SIGMA**2 + 3.0 * (self.seen.shape[1] - 1))

    def __str__(self) -> str:
        return (
            f"The reference vector is off by {_numbers(self.off_nt)} nT, 1 sigma {_numbers(self.sigma_nt)} nT, in its "
            f"own frame ({self.axes}){self._hidden}; or the attitude's axes are turned against it by as much."
        )

    @property
    def _hidden(self) -> str:
        """What could not be seen of it."""
        count = self.seen.shape[1]
        if count == 3:
            return ""
        if count == 1:
            return f", along {_numbers(self.seen[:, 0], 2)} alone: the nine errors or the mounting take up the rest"
        along = np.cross(self.seen[:, 0], self.seen[:, 1])
        sign = 1.0 if along[int(np.argmax(np.abs(along)))] > 0.0 else -1.0
        return f", across {_numbers(sign * along, 2)}: along that the nine errors take it up"

    def as_json(self) -> dict[str, Any]:
        """The object of ``diagnosis.json``."""
        return {
            "off_nt": self.off_nt.tolist(),
            "sigma_nt": self.sigma_nt.tolist(),
            "axes": str(self.axes),
            "seen_along": self.seen.T.tolist(),
            "is_certain": self.is_certain,
        }


def reference_off_of(fit: Fit) -> ReferenceOff | None:
    """What a fit found; None where it compared no whole vectors, or nothing of it could be seen."""
    aimed = fit.problem.aimed
    if aimed is None or aimed.offset is None or not aimed.offset.size:
        return None
    offset, own = aimed.offset, slice(STATE_SIZE + 3, STATE_SIZE + 3 + aimed.offset.size)
    covariance, found = fit.covariance[own, own], fit.x[own]
    sigma = np.sqrt(np.maximum(np.diagonal(offset.seen @ covariance @ offset.seen.T), 0.0))
    squares = float(found @ np.linalg.solve(covariance, found))
    return ReferenceOff(offset.seen @ found, sigma, offset.axes, offset.seen, squares)


def is_too_far_off(fit: Fit) -> bool:
    """Whether a reference would have to be off by more than a building or the crust makes it."""
    off = reference_off_of(fit)
    if off is None or fit.problem.aimed is None or fit.problem.aimed.offset is None:
        return False
    return float(np.linalg.norm(off.off_nt)) > _FARTHEST * fit.problem.aimed.offset.usual_nt


def _numbers(values: Array, places: int = 0) -> str:
    return "(" + ", ".join(f"{value + 0.0:.{places}f}" for value in np.round(values, places).tolist()) + ")"
