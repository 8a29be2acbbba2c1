"""The main field along an orbit (IGRF-14), and what a model leaves of the true one: core, crust and currents above."""

from __future__ import annotations

import math
from datetime import UTC, datetime

import numpy as np
import ppigrf

from tests.regimes.orbit import Floats, sidereal_angle, turned_about_z

_KNOT_S = 10.0
_RADIUS_KM = 6371.2
DIPOLE_ECEF = np.array([-1410.3, 4545.5, -29350.0]) / math.hypot(1410.3, 4545.5, 29350.0)
"""Direction of the Earth's dipole moment, g11, h11 and g10 of IGRF-14 in 2025 (it points south)."""


def igrf_ecef(ecef_km: Floats, unix_s: float) -> Floats:
    """IGRF-14 (n, 3) ECEF [nT] at ECEF places (n, 3) [km]."""
    x, y, z = ecef_km.T
    radius = np.linalg.norm(ecef_km, axis=1)
    theta, phi = np.arccos(z / radius), np.arctan2(y, x)
    date = datetime.fromtimestamp(unix_s, tz=UTC).replace(tzinfo=None)
    up, south, east = (np.ravel(part) for part in ppigrf.igrf_gc(radius, np.degrees(theta), np.degrees(phi), date))
    level = up * np.sin(theta) + south * np.cos(theta)
    return np.stack(
        [
            level * np.cos(phi) - east * np.sin(phi),
            level * np.sin(phi) + east * np.cos(phi),
            up * np.cos(theta) - south * np.sin(theta),
        ],
        axis=1,
    )


def along_track(t: Floats, position_km: Floats, unix_s: float, extra: object = None) -> Floats:
    """The field (n, 3) ECI [nT] at rising seconds t (n,) and ECI places (n, 3) [km].

    Worked out every ten seconds, with a cubic through four knots between.  ``extra`` (places ECEF (m, 3) to field ECEF
    (m, 3)) takes the place of IGRF.
    """
    step = max(1, round(_KNOT_S / float(np.median(np.diff(t)))))
    rows = np.unique(np.r_[np.arange(0, len(t), step), len(t) - 1])
    angle = sidereal_angle(unix_s + t[rows])
    places = turned_about_z(position_km[rows], angle)
    model = igrf_ecef(places, unix_s + float(t[len(t) // 2])) if extra is None else extra(places)  # type: ignore[operator]
    return cubic(t[rows], turned_about_z(model, -angle), t)


def cubic(knots: Floats, values: Floats, t: Floats) -> Floats:
    """Values (n, k) at t (n,) by the cubic through the four nearest of knots (m,) with values (m, k), m >= 4."""
    first = np.clip(np.searchsorted(knots, t, side="right") - 2, 0, len(knots) - 4)
    result = np.zeros((len(t), values.shape[1]))
    for j in range(4):
        weight = np.ones(len(t))
        for k in range(4):
            if k != j:
                weight *= (t - knots[first + k]) / (knots[first + j] - knots[first + k])
        result += weight[:, None] * values[first + j]
    return result


class BuriedDipoles:
    """A potential field of dipoles below the ground: deep ones stand for the core, shallow ones for the crust."""

    def __init__(self, rng: np.random.Generator, count: int, radius_km: float) -> None:
        direction = rng.standard_normal((count, 3))
        self.place_km = radius_km * direction / np.linalg.norm(direction, axis=1)[:, None]
        self.moment = rng.standard_normal((count, 3))

    def __call__(self, ecef_km: Floats) -> Floats:
        """Field (n, 3), of no stated size, at places (n, 3) [km]."""
        total = np.zeros_like(ecef_km)
        for place, moment in zip(self.place_km, self.moment, strict=True):
            away = (ecef_km - place) / _RADIUS_KM
            distance = np.linalg.norm(away, axis=1)[:, None]
            along = (away @ moment)[:, None]
            total += 3.0 * along * away / distance**5 - moment / distance**3
        return total


def ring_current(ecef_km: Floats) -> Floats:
    """A uniform field against the dipole, with the part it induces in the Earth, per unit (n, 3) ECEF."""
    outer = np.broadcast_to(DIPOLE_ECEF, ecef_km.shape)
    radius = np.linalg.norm(ecef_km, axis=1)[:, None]
    up = ecef_km / radius
    dipole = (3.0 * (up @ DIPOLE_ECEF)[:, None] * up - outer) * (_RADIUS_KM / radius) ** 3
    return outer - 0.27 * dipole


def model_error(
    rng: np.random.Generator, t: Floats, position_km: Floats, unix_s: float
) -> tuple[Floats, dict[str, float]]:
    """What the true field has over the model (n, 3) ECI [nT], and rms of its parts [nT]; together 10 to 100 nT."""
    sources = {
        "secular": BuriedDipoles(rng, 12, 3000.0),
        "crust": BuriedDipoles(rng, 150, 6250.0),
        "external": ring_current,
    }
    share = rng.dirichlet(np.ones(3))
    size = float(np.exp(rng.uniform(np.log(10.0), np.log(100.0))))
    total, parts = np.zeros((len(t), 3)), {}
    for (name, source), part in zip(sources.items(), share, strict=True):
        field = along_track(t, position_km, unix_s, source)
        if name == "external":  # a storm comes and goes
            field = (
                field * (1.0 + 0.4 * np.sin(2.0 * np.pi * t / rng.uniform(2e4, 6e4) + rng.uniform(0.0, 6.28)))[:, None]
            )
        parts[name] = size * float(np.sqrt(part))
        total += field * (parts[name] / np.sqrt(np.mean((field**2).sum(axis=1))))
    return total, parts
