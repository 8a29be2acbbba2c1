"""What an effect that is no field is given: raw samples, the residual, the turn of the craft, the noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from magcal_service.model import Array
from magcal_service.physics.scene.scene import Scene
from magcal_service.physics.scene.steady_spin import SpinSolution, Turn


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """One stage of a diagnosis.

    Parameters
    ----------
    scene: the samples.
    residual_nt: (n,) scalar residual [nT].
    noise_nt: white noise, 1 sigma per axis [nT].
    spin: attitude of a steady spin, None where there is none or the reference is no vector.
    alone: the turn about a known axis where there is no such attitude.
    range_nt: full scale of each axis as the descriptor states it [nT].
    nominal_axis, nominal_rate_rad_s: as the descriptor states them.
    stated_noise_nt: noise as the descriptor states it.
    """

    scene: Scene
    residual_nt: Array
    noise_nt: float
    spin: SpinSolution | None = None
    nominal_axis: Array | None = None
    nominal_rate_rad_s: float | None = None
    stated_noise_nt: float | None = None
    alone: Turn | None = None
    range_nt: float | None = None

    @property
    def turn(self) -> Turn | None:
        """The angle about one axis, with or without an attitude."""
        return self.alone if self.spin is None else self.spin.turn


def runs(equal: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First and last-plus-one row of every stretch of a flag (n,)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], equal, [False]]).astype(np.int8)))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))
