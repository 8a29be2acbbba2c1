"""A reference vector that is off by the same all the time, in axes of its own: three unknowns of whole vectors.

What a building's iron adds to the field that is stated for it, a declination that is a degree off, a cage that is not
at zero where it says so: fixed in the axes of the reference, so it turns in the body as the reference does, and looks
like no bias.  It belongs to the reference, as the mounting does to the body: w = (I + D) B - b - d is compared with
R A (H + o), o tied to zero by its usual size.  Directions of o that the nine errors and the mounting take up are left
out: the reference is as stated there, as it is wherever magnitudes are compared.  So in a steady field nothing is known
of o along it, which is a gain of all axes.

Sizes: a declination or inclination that is off by a degree is 300 to 900 nT, and buildings do as much; a field model
errs by about 130 nT of each component near the ground, mostly for the crust (Chulliat et al. 2020, the error model of
WMM2020: 131, 94 and 157 nT).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np

from magcal_service.model import Array
from magcal_service.recordings.channels import Axes
from magcal_service.recordings.specs import PlatformKind, PlatformSpec

_BUILDING_NT: Final = 500.0  # as the module says
_CRUST_NT: Final = 130.0  # of WMM2020

_LEAST_SEEN: Final = 0.03**2
"""Of a direction's square, what nine errors and mounting leave at least of an unknown: as of an effect."""


@dataclass(frozen=True, eq=False)
class Offset:
    """The unknowns of a reference that is off.

    Parameters
    ----------
    sensor_from_axes: (n, 3, 3) from the reference's axes to the sensor's, by attitude and first guess of the mounting.
    axes: of the reference.
    usual_nt: 1 sigma of each unknown [nT].
    seen: (3, k) directions in these axes, orthonormal, along each of which it has an unknown [nT].
    """

    sensor_from_axes: Array
    axes: Axes
    usual_nt: float
    seen: Array

    @classmethod
    def of(cls, sensor_from_axes: Array, axes: Axes, platform: PlatformSpec | None, products: Array) -> Offset:
        """Along those directions that a fit without any of it leaves to be seen.

        Parameters
        ----------
        products: (p + 3, p + 3) of the fit's white columns with one another and, last, with those of an offset along
            each of the axes: ``sensor_from_axes`` as rows of the residual (3 n, 3).
        """
        in_air = platform is not None and platform.kind is PlatformKind.AIR  # no building is near
        usual_nt = _CRUST_NT if in_air else _BUILDING_NT
        return cls(sensor_from_axes, axes, usual_nt, _seen(products))

    @property
    def size(self) -> int:
        """Unknowns."""
        return int(self.seen.shape[1])

    @cached_property
    def columns(self) -> Array:
        """(n, 3, k) what each unknown adds to the reference in the sensor's axes."""
        return np.asarray(self.sensor_from_axes @ self.seen)

    def part(self, last: int) -> Offset:
        """Of the first rows only."""
        return replace(self, sensor_from_axes=self.sensor_from_axes[:last])

    def continued(self, rotation: Array) -> Offset:
        """With as many samples more, of a craft turned by rotations (n, 3, 3) beside what it did."""
        further = rotation @ self.sensor_from_axes
        return replace(self, sensor_from_axes=np.concatenate([self.sensor_from_axes, further]))


def _seen(products: Array) -> Array:
    """(3, k) directions along which an offset is not taken up by what was fitted, orthonormal."""
    known = len(products) - 3
    scale = np.sqrt(np.maximum(np.diagonal(products)[:known], 1e-300))
    beside, own = products[:known, known:] / scale[:, None], products[known:, known:]
    inverse = np.linalg.pinv(products[:known, :known] / np.outer(scale, scale), rcond=1e-12, hermitian=True)
    left = own - beside.T @ inverse @ beside
    to_unit = np.linalg.inv(np.linalg.cholesky(own))
    shares, vectors = np.linalg.eigh(to_unit @ left @ to_unit.T)
    directions, _ = np.linalg.qr(to_unit.T @ vectors[:, shares > _LEAST_SEEN])
    return np.asarray(directions)
