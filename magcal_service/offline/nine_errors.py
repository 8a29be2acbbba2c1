"""What every result that holds the nine errors can do with them."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from magcal_service.base.errors import Fault, InputRefusedError
from magcal_service.model import BIAS, Array, calibrate, d_matrix


class NineErrors:
    """Bias and D with their sigmas, of a dataclass that has ``x`` (9,) and ``covariance`` (9, 9) [nT, -].

    Source: equation (5) of the method, w = (I + D) B - b.
    """

    __slots__ = ()
    x: Array
    covariance: Array

    @property
    def bias_nt(self) -> Array:
        """b (3,) [nT], sensor axes."""
        return np.asarray(self.x[BIAS])

    @property
    def D(self) -> Array:
        """Symmetric matrix of scale and non-orthogonality (3, 3) [-]."""
        return d_matrix(self.x)

    @property
    def sigma_bias_nt(self) -> Array:
        """1 sigma of b (3,) [nT]."""
        return np.asarray(np.sqrt(np.diagonal(self.covariance))[BIAS])

    @property
    def sigma_D(self) -> Array:
        """1 sigma of each element of D (3, 3) [-]."""
        return d_matrix(np.sqrt(np.diagonal(self.covariance)))

    def apply(self, B: npt.ArrayLike) -> Array:
        """Calibrate measured vectors by equation (5).

        Parameters
        ----------
        B: measured vectors (n, 3) [nT], sensor axes.

        Returns the calibrated vectors (n, 3) [nT]; a row with a NaN stays one.  Raises InputRefusedError for another
        shape.
        """
        return np.asarray(calibrate(self.x, vectors("B", B)))

    def _table(self) -> str:
        """Three lines: bias and its 3 sigma, D's diagonal, D's off-diagonal elements."""
        found = zip("xyz", self.bias_nt, self.sigma_bias_nt, strict=True)
        bias = ", ".join(f"b{axis} {value:.1f} +- {3 * sigma:.1f}" for axis, value, sigma in found)
        pairs = (((0, 0), (1, 1), (2, 2)), ((0, 1), (0, 2), (1, 2)))
        rows = [
            ", ".join(f"D{i + 1}{j + 1} {self.D[i, j]:.5f} +- {3 * self.sigma_D[i, j]:.5f}" for i, j in row)
            for row in pairs
        ]
        return "\n".join(f"  {line}" for line in (f"{bias} nT (3 sigma)", *rows))


def vectors(name: str, values: npt.ArrayLike) -> Array:
    """An array (n, 3) of numbers; InputRefusedError with its shape where it is none."""
    try:
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        accepted = "an array of shape (n, 3) of numbers [nT] is accepted"
        raise InputRefusedError([Fault(name, type(values).__name__, accepted)]) from None
    if array.ndim != 2 or array.shape[1] != 3:
        accepted = "an array of shape (n, 3) is accepted: one row per sample, columns x y z [nT]"
        raise InputRefusedError([Fault(f"shape of {name}", array.shape, accepted)])
    return array
