"""How high a craft in a round orbit is, by how fast its latitude and longitude go on."""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]

_MU_KM3_S2: Final = 398600.4418  # of the Earth
_TURN_RAD_S: Final = 7.292115e-5  # of the Earth
_RADIUS_KM: Final = 6371.0  # mean, of the Earth
_E2: Final = 6.69438e-3  # squared eccentricity of WGS84
_OVER_S: Final = (60.0, 900.0)
"""A piece of the way is as long as this: whole seconds do not count then, and it is far from half a turn."""


def orbit_height_km(latitude_deg: FloatArray, longitude_deg: FloatArray, time_s: FloatArray) -> float | None:
    """The mean height [km] over the mean radius of a round orbit that moves so; None where the rows are too few.

    Parameters
    ----------
    latitude_deg, longitude_deg, time_s: (n,) geodetic, and seconds; NaN where there is none.

    The orbit's angle per second gives its size by Kepler's third law.  Within 5 km for a low orbit of an eccentricity
    below 0.002 and rows over an hour; an eccentric one is off by its radius times the eccentricity at worst.
    """
    good = np.isfinite(latitude_deg) & np.isfinite(longitude_deg) & np.isfinite(time_s)
    latitude, longitude, time = latitude_deg[good], longitude_deg[good], time_s[good]
    if len(time) < 2:
        return None
    geocentric = np.arctan((1.0 - _E2) * np.tan(np.radians(latitude)))
    inertial = np.radians(longitude) + _TURN_RAD_S * (time - time[0])
    across = np.cos(geocentric)
    place = np.column_stack([across * np.cos(inertial), across * np.sin(inertial), np.sin(geocentric)])
    later = np.searchsorted(time, time + _OVER_S[0])
    first = np.flatnonzero(later < len(time))
    step = time[later[first]] - time[first]
    first, step = first[step < _OVER_S[1]], step[step < _OVER_S[1]]
    if len(first) < 2:
        return None
    cosine = np.clip((place[first] * place[later[first]]).sum(axis=1), -1.0, 1.0)
    rate = float(np.arccos(cosine).sum() / step.sum())
    return None if rate <= 0.0 else float((_MU_KM3_S2 / rate**2) ** (1.0 / 3.0)) - _RADIUS_KM
