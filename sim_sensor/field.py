"""The field along the orbit: the true one, and the one that the reference states.

The two differ only where a scenario asks: by a ring current, a reference of another time tag, place or epoch.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from magcal_service.base.typed_toml.keys import number
from magcal_service.earth import geomagnetic
from sim_sensor.declarations import instant
from sim_sensor.orbit import Orbit

Floats = npt.NDArray[np.float64]
Times = npt.NDArray[np.int64]

# Geomagnetic north of the centred dipole in ECEF, from IGRF-14 at 2025.0: -(g11, h11, g10) = (1410.3, -4545.5, 29350.0)
DIPOLE_NORTH_ECEF = np.array([1410.3, -4545.5, 29350.0]) / np.linalg.norm([1410.3, -4545.5, 29350.0])


@dataclass(frozen=True)
class FieldModel:
    """Main field from IGRF-14 and how truth and reference differ.

    Parameters
    ----------
    ring_current_nt: uniform field along the dipole's north axis in the truth [nT]; negative in a storm, -20 to -400
        (the Dst index without its induced part; Alken et al. 2021).
    reference_time_offset_s: the reference is that of this much later [s]; up to 130 nT per second.
    reference_along_track_km: the reference is that of a place this far ahead on the orbit [km]; about 10 nT/km.
    reference_radial_km: and this much higher [km]; about 25 nT/km.
    reference_epoch_ns: coefficients of the reference are frozen at this time; up to 80-100 nT per year locally.
    """

    ring_current_nt: float = number(0.0, -2000.0, 2000.0, unit="nT")
    reference_time_offset_s: float = number(0.0, -3600.0, 3600.0, unit="s")
    reference_along_track_km: float = number(0.0, -2000.0, 2000.0, unit="km")
    reference_radial_km: float = number(0.0, -100.0, 1000.0, unit="km")
    reference_epoch_ns: int | None = instant(None, name="reference_epoch")

    def true_eci_nt(self, orbit: Orbit, times_utc_ns: Times) -> Floats:
        """Field that acts on the sensor (n, 3) [nT], ECI."""
        main = geomagnetic.igrf_eci_nt(times_utc_ns, orbit.position_eci_km(times_utc_ns))
        if self.ring_current_nt == 0.0:
            return main
        axis = np.broadcast_to(DIPOLE_NORTH_ECEF, main.shape)
        return main + self.ring_current_nt * geomagnetic.eci_from_ecef(times_utc_ns, axis)

    def reference_eci_nt(self, orbit: Orbit, times_utc_ns: Times) -> Floats:
        """Field that the reference states (n, 3) [nT], ECI, equation (1)'s H."""
        places_at = times_utc_ns + round(self.reference_time_offset_s * 1e9)
        position = orbit.position_eci_km(places_at)
        position = self._displaced(position, orbit, places_at)
        if self.reference_epoch_ns is None:
            return geomagnetic.igrf_eci_nt(places_at, position)
        epoch = np.full_like(places_at, self.reference_epoch_ns)
        field_ecef_nt = geomagnetic.igrf_ecef_nt(epoch, geomagnetic.ecef_from_eci(places_at, position))
        return geomagnetic.eci_from_ecef(places_at, field_ecef_nt)

    def _displaced(self, position: Floats, orbit: Orbit, times: Times) -> Floats:
        if self.reference_along_track_km == 0.0 and self.reference_radial_km == 0.0:
            return position
        radius = np.linalg.norm(position, axis=-1, keepdims=True)
        up = position / radius
        half_s = 0.5
        half_ns = round(half_s * 1e9)
        motion = orbit.position_eci_km(times + half_ns) - orbit.position_eci_km(times - half_ns)
        ahead = motion - up * np.sum(motion * up, axis=-1, keepdims=True)
        ahead = ahead / np.linalg.norm(ahead, axis=-1, keepdims=True)
        angle = self.reference_along_track_km / radius
        return np.asarray((radius + self.reference_radial_km) * (np.cos(angle) * up + np.sin(angle) * ahead))

    @property
    def differs(self) -> bool:
        """Whether the reference is anything but the truth."""
        return self != FieldModel()
