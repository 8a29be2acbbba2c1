"""The errors that a field model has of its own, as correlated noise of the reference's magnitude.

A model of the main field leaves out the crust, the field's change since it was made, and currents outside: tens of nT,
smooth along the orbit, repeated where the craft comes by again.  Without them in the noise, what remains of the model
on a quiet craft is taken for physics.  The error of each Cartesian component is a Gaussian field over the sphere,

    cov(delta_i . h_i, delta_j . h_j) = (h_i . h_j) sum_n s_n^2 P_n(cos gamma_ij),

with gamma the angle between two places on the turning Earth, h the direction of the field there and s_n^2 the variance
of one component by spherical-harmonic degree.  Rows are whitened by it in a basis of the few directions that matter.

Source of the variances (1 sigma of a component, in orbit): 19 nT for the core field, which is IGRF-13 against IGRF-14
in 2023, 33 nT of the vector (Alken et al. 2021 give the candidates' spread); 12 nT for what quiet currents in the
magnetosphere and their induction leave, degree 1 (Finlay et al. 2020, CHAOS-7); the crust by Lowes' spectrum, about
20 nT^2 for each degree beyond 13 at the ground (Thebault et al. 2010: 10 at degree 16, 30 at 60), continued upward as
(a / r)^(2 n + 4).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

from magcal_service.earth import geomagnetic
from magcal_service.earth.geomagnetic import LOWEST_ORBIT_KM
from magcal_service.earth.igrf14 import RADIUS_KM as IGRF_RADIUS_KM
from magcal_service.model import Array
from magcal_service.physics.scene.scene import Scene

_CORE_NT: Final = 19.0  # IGRF-13 against IGRF-14
_EXTERNAL_NT: Final = 12.0  # quiet magnetosphere and induction
_CRUST_NT2: Final = 20.0
"""As the module says, with their sources."""

_CORE_DEGREE: Final = 13
"""Largest degree of IGRF; the error's variance falls as 1 / degree, for what is large is known relatively well."""

_DEGREE: Final = 45
"""Largest degree of the crust taken: at 300 km what lies beyond has 1 nT."""

_KNOT_S: Final = 40.0  # 2.5 deg of the orbit
_MOST_KNOTS: Final = 900
"""Places at which the covariance is worked out: 2.5 deg of the orbit, a quarter of the shortest wave of degree 36."""

_TOGETHER: Final = 16  # lines; between 8 and 32 nothing changes
_LEAST: Final = 0.03
"""Of the white noise's variance: directions in which the model's error has less change no weight by 2 %."""

SCALES: Final = {0.25: -2.3, 1.0: 0.0, 2.0: -1.0, 4.0: -2.3}
"""How large the errors may be beside the usual, each with the logarithm of its prior odds: one recording in ten has a
model fitted to its own weeks, or a strong storm or a model ten years old."""


@dataclass(frozen=True, slots=True, eq=False)
class _Stretch:
    """The lines of some rows in a row: their weights (r, v) on the values that they lie between."""

    rows: slice
    values: slice
    weights: Array


@dataclass(frozen=True, eq=False)
class Lines:
    """Straight lines between rows: values at ``at`` (q,), rising from the first row to the last, carried on to all n.

    Parameters
    ----------
    at: numbers of the rows that have values (q,).
    count: n.
    """

    at: NDArray[np.intp]
    count: int

    @cached_property
    def _stretches(self) -> list[_Stretch]:
        """All rows, ``_TOGETHER`` lines at a time: products of small dense matrices are faster than sums by row."""
        before = np.repeat(np.arange(len(self.at) - 1), np.diff(np.append(self.at[:-1], self.count)))
        share = (np.arange(self.count) - self.at[before]) / (self.at[before + 1] - self.at[before])
        found = []
        for first in range(0, len(self.at) - 1, _TOGETHER):
            last = min(first + _TOGETHER, len(self.at) - 1)
            rows = slice(int(self.at[first]), self.count if last == len(self.at) - 1 else int(self.at[last]))
            weights = np.zeros((rows.stop - rows.start, last - first + 1))
            row, left = np.arange(len(weights)), before[rows] - first
            weights[row, left], weights[row, left + 1] = 1.0 - share[rows], share[rows]
            found.append(_Stretch(rows, slice(first, last + 1), weights))
        return found

    def carried_on(self, values: Array) -> Array:
        """Values (q, k) at all rows (n, k)."""
        result = np.empty((self.count, values.shape[1]))
        for stretch in self._stretches:
            np.matmul(stretch.weights, values[stretch.values], out=result[stretch.rows])
        return result

    def less(self, rows: Array, values: Array) -> Array:
        """Rows (n, k) less values (q, k) carried on, each column in one piece."""
        result, turned = np.empty(rows.shape[::-1]), np.ascontiguousarray(values.T)
        for stretch in self._stretches:
            np.matmul(turned[:, stretch.values], stretch.weights.T, out=result[:, stretch.rows])
        return np.subtract(rows.T, result, out=result).T

    def gathered(self, rows: Array) -> Array:
        """The transpose: rows (n, k) to (q, k)."""
        found = np.zeros((len(self.at), rows.shape[1]))
        for stretch in self._stretches:
            found[stretch.values] += stretch.weights.T @ rows[stretch.rows]
        return found


@dataclass(frozen=True, eq=False)
class FieldError:
    """Covariance U diag(v) U' of the errors of |H| at the samples; U is kept by its values at the knots of its lines.

    Parameters
    ----------
    lines: from knots to samples.
    courses: U at the knots (q, k); its columns are orthonormal at the samples.
    variance: v (k,) [nT^2].
    noise_nt: 1 sigma of the white noise that comes on top [nT].
    scale: times what field models usually err by.
    """

    lines: Lines
    courses: Array
    variance: Array
    noise_nt: float
    scale: float = 1.0

    @classmethod
    def of(cls, scene: Scene, noise_nt: float) -> FieldError | None:
        """For a craft in orbit with known places; None where there is none or the noise hides it all."""
        place = scene.position_ecef_km
        if place is None or not scene.in_orbit or len(scene) < 2:
            return None
        radius = np.linalg.norm(place, axis=1)
        altitude_km = float(np.median(radius)) - IGRF_RADIUS_KM
        if not altitude_km > LOWEST_ORBIT_KM:  # the crust is no small error there
            return None
        at = _knots(scene)
        covariance = _by_angle(place[at] / radius[at, None], altitude_km) * _alignment(scene, at)
        values, vectors = np.linalg.eigh(covariance)
        useful = values * len(scene) > _LEAST * noise_nt**2
        if not useful.any():
            return None
        lines = Lines(at, len(scene))
        courses = vectors[:, useful] * np.sqrt(values[useful])
        squares, turn = np.linalg.eigh(courses.T @ lines.gathered(lines.carried_on(courses)))
        kept = squares > _LEAST * noise_nt**2
        if not kept.any():
            return None
        return cls(lines, courses @ turn[:, kept] / np.sqrt(squares[kept]), squares[kept], noise_nt)

    @property
    def basis(self) -> Array:
        """U (n, k), orthonormal columns."""
        return self.lines.carried_on(self.courses)

    def scaled(self, scale: float) -> FieldError:
        """The same with errors ``scale`` times as large."""
        return replace(self, variance=self.variance * scale**2, scale=self.scale * scale)

    def whitened(self, rows: Array) -> Array:
        """Rows (n,) or (n, k) in which the noise is white again, of the white noise's own level."""
        shrink = 1.0 - 1.0 / np.sqrt(1.0 + self.variance / self.noise_nt**2)
        table = rows.reshape(len(rows), -1)
        inside = self.courses.T @ self.lines.gathered(table)
        return self.lines.less(table, self.courses @ (shrink[:, None] * inside)).reshape(rows.shape)

    def products(self, rows: Array) -> Array:
        """(k, k) products with one another of what ``whitened`` makes of rows (n, k), without making it."""
        inside = self.courses.T @ self.lines.gathered(rows)
        share = self.variance / (self.variance + self.noise_nt**2)
        found: Array = rows.T @ rows - inside.T @ (share[:, None] * inside)
        return found

    @property
    def rms_nt(self) -> float:
        """rms of the errors at the samples, 1 sigma [nT]."""
        return float(np.sqrt(self.variance.sum() / self.lines.count))

    def log_volume(self) -> float:
        """Half of ln det of the whitening: what a likelihood loses by the wider noise [nats]."""
        return 0.5 * float(np.log1p(self.variance / self.noise_nt**2).sum())


def _knots(scene: Scene) -> NDArray[np.intp]:
    """Rows at which the covariance is worked out, the first and the last included."""
    span_s = float(scene.time_s[-1] - scene.time_s[0])
    count = int(np.clip(np.ceil(span_s / _KNOT_S), 2, min(_MOST_KNOTS, len(scene))))
    times = np.linspace(scene.time_s[0], scene.time_s[-1], count)
    found: NDArray[np.intp] = np.unique(np.clip(np.searchsorted(scene.time_s, times), 0, len(scene) - 1))
    return found


def _by_angle(direction: NDArray[np.float64], altitude_km: float) -> Array:
    """sum_n s_n^2 P_n(cos gamma) between places (k, 3) on the unit sphere: (k, k) [nT^2]."""
    cosine = np.clip(direction @ direction.T, -1.0, 1.0)
    return np.asarray(legendre.legval(cosine, degree_variances(altitude_km)))


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


def _alignment(scene: Scene, at: NDArray[np.intp]) -> Array:
    """h_i . h_j (k, k), Earth-fixed; ones where the reference has no direction."""
    if scene.reference_eci_nt is None:
        return np.ones((len(at), len(at)))
    field = geomagnetic.ecef_from_eci(scene.time_ns[at], np.asarray(scene.reference_eci_nt[at], dtype=np.float64))
    unit = field / np.maximum(np.linalg.norm(field, axis=1, keepdims=True), 1e-9)
    return np.asarray(unit @ unit.T)
