"""Nine errors that are no sensor's, as the false minima of the scalar residual have them."""

from __future__ import annotations

from typing import Final

import numpy as np

from magcal_service.model import STATE_SIZE, Array, d_matrix

COLLAPSED: Final = (0.4, 2.5)
"""Range of the eigenvalues of I + D of a sensor; false minima of the scalar cost lie at 0.25 and below (Alonso &
Shuster 2002 on the centred cost), and flight sensors with their axes 30 deg askew at 0.5."""


def is_collapsed(x: Array) -> bool:
    """Whether nine errors (9 or more,) are no sensor's: an eigenvalue of I + D outside ``COLLAPSED``."""
    values = np.linalg.eigvalsh(np.eye(3) + d_matrix(x[:STATE_SIZE]))
    return bool(values[0] < COLLAPSED[0] or values[-1] > COLLAPSED[1])
