"""What field models err by, as covariances between places: in orbit, and near the ground.

A model of the main field leaves out the crust, the field's change since it was made, and currents outside: tens of nT,
smooth along the orbit, repeated where the craft comes by again.  The error of each Cartesian component is a Gaussian
field over the sphere,

    cov(delta_i . h_i, delta_j . h_j) = (h_i . h_j) sum_n s_n^2 (r0^2 / (r_i r_j))^(n + 2) P_n(cos gamma_ij),

with gamma the angle between two places on the turning Earth, r their radii, h the direction of the field there and
s_n^2 the variance of one component by spherical-harmonic degree at r0.  Currents in the polar ionosphere come on top:
poleward of 60 degrees of geomagnetic latitude, over some hundred kilometres, and others in each pass.

Source of the variances (1 sigma of a component, in orbit): 19 nT for the core field, which is IGRF-13 against IGRF-14
in 2023, 33 nT of the vector (Alken et al. 2021 give the candidates' spread); 12 nT for what quiet currents in the
magnetosphere and their induction leave, degree 1 (Finlay et al. 2020, CHAOS-7); the crust by Lowes' spectrum, about
20 nT^2 for each degree beyond 13 at the ground (Thebault et al. 2010: 10 at degree 16, 30 at 60), continued upward as
(a / r)^(2 n + 4); 4 nT of |H| at high latitudes on quiet nights (4.3 nT are left there by Swarm and 3.1 elsewhere,
table 2 of doi 10.1186/s40623-015-0245-8), and several times that on others (Aakjaer et al. 2016).

Near the ground all degrees of the crust count.  The sum over a flat spectrum has a closed form,

    cov = s0^2 2 z0 / sqrt((z_i + z_j + 2 z0)^2 + d^2),

with d the way between two places, z_i their heights, z0 the depth of the sources and s0 what they make at the ground.
Lowes' spectrum from 6 km makes 60 nT.  The error model of WMM2020 has 131, 94 and 157 nT of the three components
(Chulliat et al. 2020), 130 nT rms, nearly all of it crust; the rest, 115 nT, is taken from 1.3 km.  It is the rms over
the globe, which few places make: a third is usual.  What all places of a recording have in common is left out: it is a
gain and a bias, or whole vectors have an unknown for it (``offset``).
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from magcal_service.earth import geomagnetic
from magcal_service.earth.igrf14 import RADIUS_KM as IGRF_RADIUS_KM
from magcal_service.model import Array
from magcal_service.physics.scene.main_field import DIPOLE_ECEF
from magcal_service.recordings.inspect.motion import EARTH_RAD_S, kepler_rad_s

_CORE_NT: Final = 19.0  # IGRF-13 against IGRF-14
_EXTERNAL_NT: Final = 12.0  # quiet magnetosphere and induction
_CRUST_NT2: Final = 20.0
"""As the module says, with their sources."""

_CORE_DEGREE: Final = 13
"""Largest degree of IGRF; the error's variance falls as 1 / degree, for what is large is known relatively well."""

_DEGREE: Final = 45
"""Largest degree of the crust taken: at 300 km what lies beyond has 1 nT."""

COMMON_KM: Final = 500.0
"""Altitude of a craft whose places are not known [km]: most small ones fly at 400 to 600."""

_HIGHEST_KM: Final = 600.0
"""Altitude up to which the core's errors have the size above [km]: models are held against craft at 400 to 500."""

_POLAR_NT: Final = 4.0  # currents in the polar ionosphere on a quiet night, in |H|
_POLAR_DEG: Final = (60.0, 4.0)
"""Geomagnetic latitude from which on they flow, and over which they set in [deg]."""

COMMON_SHARE: Final = 0.58
"""Of them, what places that are not known have by rms: most orbits pass over the poles, a third of each beyond 60."""

_POLAR_S: Final = 60.0
"""Time over which they change along the orbit [s]: 450 km, electrojets and arcs are 100 to 1000 km wide."""

_DEEP_KM: Final = 6.0  # of the sources that Lowes' spectrum is of; choice: in the upper third of the crust
_SHALLOW_KM: Final = 1.3  # of the others; choice: their errors change over a few km
_SHALLOW_NT: Final = 115.0 / 3.0  # of WMM2020's 130 nT what the deep ones leave, and of that what is usual

_PLATEAU_KM: Final = 1.0
"""Height that the ground itself may have: most of the inhabited land is below; a place is no higher above it [km]."""


def common_orbit(time_s: Array) -> NDArray[np.float64]:
    """Places (k, 3), Earth-fixed, of a craft on a circle of 500 km at 60 degrees [km]."""
    along = kepler_rad_s(IGRF_RADIUS_KM + COMMON_KM) * time_s
    east = EARTH_RAD_S * time_s
    x, y, z = np.cos(along), 0.5 * np.sin(along), math.sqrt(0.75) * np.sin(along)
    direction = np.stack([x * np.cos(east) + y * np.sin(east), y * np.cos(east) - x * np.sin(east), z], axis=1)
    return np.asarray((IGRF_RADIUS_KM + COMMON_KM) * direction)


def by_place(place_km: NDArray[np.float64], altitude_km: float) -> tuple[Array, Array]:
    """sum_n s_n^2 (r0^2 / (r_i r_j))^(n + 2) P_n(cos gamma_ij) between places (k, 3), to degree 13 and beyond (k, k)
    [nT^2]: what comes from inside fades with the height of each place, what comes from far outside does not.

    Parameters
    ----------
    altitude_km: usual one of the craft; r0 is its radius, or that of the highest orbit that the variances are of.
    """
    reference_km = min(altitude_km, _HIGHEST_KM)
    radius = np.linalg.norm(place_km, axis=1)
    nearer = (IGRF_RADIUS_KM + reference_km) / radius
    nearer2 = np.outer(nearer, nearer)
    cosine = np.clip((place_km / radius[:, None]) @ (place_km / radius[:, None]).T, -1.0, 1.0)
    variance = degree_variances(reference_km)
    variance[1] -= _EXTERNAL_NT**2
    step, square = nearer2 * cosine, nearer2**2
    low, high = np.zeros_like(cosine), np.zeros_like(cosine)
    before, here = np.ones_like(cosine), step  # q^n P_n(cosine), by Bonnet's recursion
    for degree in range(1, len(variance)):
        total = low if degree <= _CORE_DEGREE else high
        total += variance[degree] * here
        before, here = here, ((2 * degree + 1) * step * here - degree * square * before) / (degree + 1)
    return square * low + _EXTERNAL_NT**2 * cosine, square * high


def outside(alike: Array) -> Array:
    """Covariance (k, k) [nT^2] of what is uniform, from far outside, along the field at each place.

    Parameters
    ----------
    alike: (k, k) products of the field's directions at two places each, Earth-fixed.
    """
    return np.asarray(_EXTERNAL_NT**2 * alike)


def polar(place_km: NDArray[np.float64]) -> Array:
    """(k,) share of the currents in the polar ionosphere that places (k, 3) have: 1 poleward of where they flow."""
    sets_in, over = _POLAR_DEG
    upwards = place_km / np.linalg.norm(place_km, axis=1)[:, None]
    latitude = np.degrees(np.arcsin(np.clip(np.abs(upwards @ DIPOLE_ECEF), 0.0, 1.0)))
    return np.asarray(np.clip((latitude - sets_in) / over + 0.5, 0.0, 1.0))


def of_currents(share: Array, time_s: Array) -> Array:
    """Covariance (k, k) [nT^2] of what flows in the polar ionosphere, at places of a share (k,) and their times.

    It is rough: of the kernel (1 + t) exp(-t), t the time between two places over ``_POLAR_S``.
    """
    apart = np.abs(time_s[:, None] - time_s) / _POLAR_S
    return np.asarray(_POLAR_NT**2 * np.outer(share, share) * (1.0 + apart) * np.exp(-apart))


def degree_variances(altitude_km: float) -> Array:
    """(46,) variance of one component by degree, 0 to 45 [nT^2]."""
    degree = np.arange(_DEGREE + 1, dtype=np.float64)
    variance = np.zeros(_DEGREE + 1)
    core = slice(1, _CORE_DEGREE + 1)
    variance[core] = _CORE_NT**2 * (1.0 / degree[core]) / float((1.0 / degree[core]).sum())
    variance[1] += _EXTERNAL_NT**2
    crust = slice(_CORE_DEGREE + 1, None)
    upward = (IGRF_RADIUS_KM / (IGRF_RADIUS_KM + altitude_km)) ** (2.0 * degree[crust] + 4.0)
    variance[crust] = _CRUST_NT2 * upward / 3.0
    return variance


def near_ground(place_km: NDArray[np.float64]) -> tuple[Array, Array]:
    """Covariances of one component between places (k, 3), Earth-fixed, of an aircraft, a balloon or a vehicle: to
    degree 13 and beyond (k, k) [nT^2], without what all of them have in common."""
    low, _ = by_place(place_km, 0.0)
    deep_nt2 = _CRUST_NT2 / 3.0 * IGRF_RADIUS_KM / (2.0 * _DEEP_KM)
    coarse = low + deep_nt2 * _of_sources(place_km, _DEEP_KM)
    return _without_mean(coarse), _without_mean(_SHALLOW_NT**2 * _of_sources(place_km, _SHALLOW_KM))


def _of_sources(place_km: NDArray[np.float64], depth_km: float) -> Array:
    """(k, k) covariance between places (k, 3) of what sources of a depth make, 1 at the ground."""
    height = heights_km(place_km)
    apart = np.linalg.norm(place_km[:, None] - place_km, axis=2)
    return np.asarray(2.0 * depth_km / np.hypot(height[:, None] + height + 2.0 * depth_km, apart))


def heights_km(place_km: NDArray[np.float64]) -> Array:
    """Heights (k,) above the ground that places (k, 3), Earth-fixed, have at least [km]."""
    return np.asarray(np.maximum(geomagnetic.geodetic_from_ecef(place_km)[2] - _PLATEAU_KM, 0.0))


def reach_km(place_km: NDArray[np.float64]) -> Array:
    """Ways (k,) over which the crust's errors change at places (k, 3) [km]."""
    return 2.0 * (heights_km(place_km) + _SHALLOW_KM)


def _without_mean(covariance: Array) -> Array:
    """Of what is left once the mean over all places is taken off."""
    rows = covariance - covariance.mean(axis=0)
    return np.asarray(rows - rows.mean(axis=1)[:, None])
