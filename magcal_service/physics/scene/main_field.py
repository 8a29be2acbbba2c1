"""The Earth's main field beside a recording: its dipole, where its model holds, and how densely it is worked out."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from magcal_service.base.errors import ExtraMissingError, InputRefusedError
from magcal_service.earth import geomagnetic
from magcal_service.model import Array

_LATITUDE, _LONGITUDE = np.radians((80.8, -72.8))  # geomagnetic north pole (IGRF-14, epoch 2025)
DIPOLE_ECEF = np.array(
    [np.cos(_LATITUDE) * np.cos(_LONGITUDE), np.cos(_LATITUDE) * np.sin(_LONGITUDE), np.sin(_LATITUDE)]
)
"""(3,) axis of the Earth's dipole, towards geomagnetic north, Earth-fixed."""

_KNOT_S = 10.0  # between knots the field of a model, and its differences, are taken as linear


def dipole_eci(time_ns: NDArray[np.int64]) -> Array:
    """(n, 3) axis of the Earth's dipole at UTC times (n,) [ns], towards geomagnetic north, ECI."""
    return geomagnetic.eci_from_ecef(time_ns, np.broadcast_to(DIPOLE_ECEF, (len(time_ns), 3)))


def knots(time_s: Array, period_s: float, pauses: NDArray[np.intp]) -> NDArray[np.intp]:
    """Rows (k,) between which a slowly changing field may be interpolated: 10 s apart, and around each gap.

    Parameters
    ----------
    time_s: (n,) [s], of samples usually ``period_s`` apart.
    pauses: rows at which stretches begin, row 0 among them.
    """
    bins = np.floor(time_s / max(_KNOT_S, period_s)).astype(np.int64)
    first = np.flatnonzero(np.diff(bins, prepend=bins[0] - 1))
    return np.unique(np.concatenate([first, pauses, pauses[1:] - 1, [len(time_s) - 1]])).astype(np.intp)


def is_modelled(time_ns: NDArray[np.int64], position_ecef_km: NDArray[np.float64]) -> bool:
    """Whether the model can be evaluated at UTC times (k,) [ns] and places (k, 3): its years, range and package."""
    try:
        geomagnetic.igrf_ecef_nt(time_ns, position_ecef_km)
    except (InputRefusedError, ExtraMissingError):
        return False
    return True
