"""The errors that a field model has of its own, as correlated noise of the reference's magnitude.

A model of the main field leaves out the crust, the field's change since it was made, and currents outside: tens of nT,
smooth along the orbit, repeated where the craft comes by again.  Without them in the noise, what remains of the model
on a quiet craft is taken for physics.  The error of each Cartesian component is a Gaussian field over the sphere,

    cov(delta_i . h_i, delta_j . h_j) = (h_i . h_j) sum_n s_n^2 (r0^2 / (r_i r_j))^(n + 2) P_n(cos gamma_ij),

with gamma the angle between two places on the turning Earth, r their radii, h the direction of the field there and
s_n^2 the variance of one component by spherical-harmonic degree at r0.  Currents in the polar ionosphere come on top:
poleward of 60 degrees of geomagnetic latitude, over some hundred kilometres, and others in each pass.  Rows are
whitened by both in a basis of the few directions that matter.

Source of the variances (1 sigma of a component, in orbit): 19 nT for the core field, which is IGRF-13 against IGRF-14
in 2023, 33 nT of the vector (Alken et al. 2021 give the candidates' spread); 12 nT for what quiet currents in the
magnetosphere and their induction leave, degree 1 (Finlay et al. 2020, CHAOS-7); the crust by Lowes' spectrum, about
20 nT^2 for each degree beyond 13 at the ground (Thebault et al. 2010: 10 at degree 16, 30 at 60), continued upward as
(a / r)^(2 n + 4); 4 nT of |H| at high latitudes on quiet nights (4.3 nT are left there by Swarm and 3.1 elsewhere,
table 2 of doi 10.1186/s40623-015-0245-8), and several times that on others (Aakjaer et al. 2016).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from magcal_service.diagnosis.groups import Groups
from magcal_service.earth import geomagnetic
from magcal_service.earth.geomagnetic import LOWEST_ORBIT_KM
from magcal_service.earth.igrf14 import RADIUS_KM as IGRF_RADIUS_KM
from magcal_service.model import Array
from magcal_service.physics.scene.main_field import DIPOLE_ECEF
from magcal_service.physics.scene.scene import Scene
from magcal_service.recordings.inspect.motion import EARTH_RAD_S, kepler_rad_s

_CORE_NT: Final = 19.0  # IGRF-13 against IGRF-14
_EXTERNAL_NT: Final = 12.0  # quiet magnetosphere and induction
_CRUST_NT2: Final = 20.0
"""As the module says, with their sources."""

_CORE_DEGREE: Final = 13
"""Largest degree of IGRF; the error's variance falls as 1 / degree, for what is large is known relatively well."""

_DEGREE: Final = 45
"""Largest degree of the crust taken: at 300 km what lies beyond has 1 nT."""

_COMMON_KM: Final = 500.0
"""Altitude of a craft whose places are not known [km]: most small ones fly at 400 to 600."""

_HIGHEST_KM: Final = 600.0
"""Altitude up to which the core's errors have the size above [km]: models are held against craft at 400 to 500."""

_POLAR_NT: Final = 4.0  # currents in the polar ionosphere on a quiet night, in |H|
_POLAR_DEG: Final = (60.0, 4.0)
"""Geomagnetic latitude from which on they flow, and over which they set in [deg]."""

_COMMON_SHARE: Final = 0.58
"""Of them, what places that are not known have by rms: most orbits pass over the poles, a third of each beyond 60."""

_POLAR_S: Final = 60.0
"""Time over which they change along the orbit [s]: 450 km, electrojets and arcs are 100 to 1000 km wide."""

_KNOT_S: Final = 40.0  # 2.5 deg of the orbit
_MOST_KNOTS: Final = 900
"""Places at which the covariance is worked out: 2.5 deg of the orbit, a quarter of the shortest wave of degree 36."""

_TOGETHER: Final = 16  # columns that lines are carried on to, or gathered from, at a time: a core's cache holds them
_LEAST: Final = 0.03
"""Of the white noise's variance: directions in which the model's error has less change no weight by 2 %."""


class Scale(NamedTuple):
    """How large errors are beside the usual: of degree 13 and less, and those that change over shorter ways."""

    coarse: float = 1.0
    fine: float = 1.0

    def is_within(self, other: Scale) -> bool:
        """Whether neither is larger than another's."""
        return self.coarse <= other.coarse and self.fine <= other.fine

    def at_least(self, other: Scale) -> Scale:
        """The larger one of each."""
        return Scale(max(self.coarse, other.coarse), max(self.fine, other.fine))


_COARSE: Final = {0.25: -2.3, 1.0: 0.0, 2.0: -1.0, 4.0: -2.3}
"""How large the errors of low degree may be beside the usual, each with the logarithm of its prior odds: one recording
in ten has a model fitted to its own weeks, or a strong storm or a model ten years old."""

_FINE: Final = {1.0: 0.0, 3.0: -1.0, 9.0: -2.3}
"""The same of shorter ways: most days are no quiet nights at the poles, and one model in ten is cut off early."""

SCALES: Final = {Scale(c, f): odds + more for c, odds in _COARSE.items() for f, more in _FINE.items()}
"""Both together, with the logarithm of the prior odds."""


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
    def _lengths(self) -> NDArray[np.intp]:
        """Rows (q - 1,) of each line, of which the last has both of its ends."""
        return np.diff(np.append(self.at[:-1], self.count))

    @cached_property
    def _share(self) -> Array:
        """How far (n,) along its line a row is."""
        first, last = (np.repeat(ends, self._lengths) for ends in (self.at[:-1], self.at[1:]))
        return np.asarray((np.arange(self.count) - first) / (last - first))

    def _carry(self, values: Array, out: Array) -> None:
        """Values (k, q) at all rows (k, n)."""
        for some in _together(len(values)):
            out[some] = np.repeat(np.diff(values[some], axis=1), self._lengths, axis=1)
            out[some] *= self._share
            out[some] += np.repeat(values[some, :-1], self._lengths, axis=1)

    def carried_on(self, values: Array) -> Array:
        """Values (q, k) at all rows (n, k), each column in one piece."""
        result = np.empty((values.shape[1], self.count))
        self._carry(np.ascontiguousarray(values.T), result)
        return result.T

    def less(self, rows: Array, values: Array) -> Array:
        """Rows (n, k) less values (q, k) carried on, each column in one piece."""
        result = self.carried_on(values).T
        return np.subtract(rows.T, result, out=result).T

    def gathered(self, rows: Array) -> Array:
        """The transpose: rows (n, k) to (q, k)."""
        found = np.zeros((rows.shape[1], len(self.at)))
        for some in _together(len(found)):
            columns = np.ascontiguousarray(rows.T[some])
            found[some, :-1] = np.add.reduceat(columns, self.at[:-1], axis=1)
            at_ends = np.add.reduceat(columns * self._share, self.at[:-1], axis=1)
            found[some, :-1] -= at_ends
            found[some, 1:] += at_ends
        return found.T

    def gathered_groups(self, rows: Array, groups: Groups) -> Array:
        """What ``gathered`` makes of each group's part of rows (n, a): (q, g a), of the first group first.

        A row counts for its own group only, so each is added once, not once for every group.
        """
        lines = len(self.at) - 1
        among = np.repeat(np.arange(lines), self._lengths)
        found = np.zeros((groups.count, rows.shape[1], lines + 1))
        for number, column in enumerate(rows.T):
            at_ends = column * self._share
            found[:, number, :-1] += groups.sums(column - at_ends, among, lines)
            found[:, number, 1:] += groups.sums(at_ends, among, lines)
        return found.reshape(-1, lines + 1).T

    def weighed(self, values: Array) -> Array:
        """What ``gathered`` makes of values (q, k) carried on (q, k): a line overlaps with its neighbours only."""
        own, beside = self._overlaps
        found = own[:, None] * values
        found[:-1] += beside[:, None] * values[1:]
        found[1:] += beside[:, None] * values[:-1]
        return np.asarray(found)

    @cached_property
    def _overlaps(self) -> tuple[Array, Array]:
        """Products of each line's weights with themselves (q,), and with those of the next (q - 1,)."""
        at_start, at_end = 1.0 - self._share, self._share
        first, both, last = (
            np.add.reduceat(product, self.at[:-1])
            for product in (at_start * at_start, at_start * at_end, at_end * at_end)
        )
        return np.append(first, 0.0) + np.append(0.0, last), both


def _together(count: int) -> Iterator[slice]:
    """So many columns, a few at a time."""
    return (slice(first, first + _TOGETHER) for first in range(0, count, _TOGETHER))


@dataclass(frozen=True, eq=False)
class FieldError:
    """Covariance U diag(v) U' of the errors of |H| at the samples; U is kept by its values at the knots of its lines.

    Parameters
    ----------
    lines: from knots to samples.
    courses: U at the knots (q, k); its columns are orthonormal at the samples.
    variance: v (k,) [nT^2].
    noise_nt: 1 sigma of the white noise that comes on top [nT].
    scale: beside what is usual.
    coarse, fine: usual covariances (q, q) between the knots [nT^2].
    """

    lines: Lines
    courses: Array
    variance: Array
    noise_nt: float
    scale: Scale
    coarse: Array
    fine: Array

    @classmethod
    def of(cls, scene: Scene, noise_nt: float) -> FieldError | None:
        """For a craft in orbit; None elsewhere, or where the noise hides it all.

        Without places those of a common orbit are taken: errors fade with the way flown, wherever that leads.
        """
        if not scene.in_orbit or len(scene) < 2:
            return None
        given, at = scene.position_ecef_km, _knots(scene)
        place = _common_orbit(scene.time_s[at]) if given is None else given[at]
        altitude_km = _COMMON_KM if given is None else float(np.median(np.linalg.norm(given, axis=1))) - IGRF_RADIUS_KM
        if not altitude_km > LOWEST_ORBIT_KM:  # the crust is no small error there
            return None
        coarse, fine = (part * _alignment(scene, at) for part in _by_place(place, altitude_km))
        polar = np.full(len(at), _COMMON_SHARE) if given is None else _polar(place)
        fine += _of_currents(polar, scene.time_s[at])
        return cls._made(Lines(at, len(scene)), noise_nt, Scale(), coarse, fine)

    @classmethod
    def _made(cls, lines: Lines, noise_nt: float, scale: Scale, coarse: Array, fine: Array) -> FieldError | None:
        values, vectors = np.linalg.eigh(scale.coarse**2 * coarse + scale.fine**2 * fine)
        useful = values * lines.count > _LEAST * noise_nt**2
        if not useful.any():
            return None
        courses = vectors[:, useful] * np.sqrt(values[useful])
        squares, turn = np.linalg.eigh(courses.T @ lines.weighed(courses))
        kept = squares > _LEAST * noise_nt**2
        if not kept.any():
            return None
        courses = courses @ turn[:, kept] / np.sqrt(squares[kept])
        return cls(lines, courses, squares[kept], noise_nt, scale, coarse, fine)

    @property
    def basis(self) -> Array:
        """U (n, k), orthonormal columns."""
        return self.lines.carried_on(self.courses)

    def scaled(self, scale: Scale) -> FieldError:
        """The usual errors at a scale; what is so small then that the noise hides it is kept at that level."""
        if scale not in self._at:
            made = self._made(self.lines, self.noise_nt, scale, self.coarse, self.fine)
            none = np.zeros(1)
            found = made or replace(self, courses=self.courses[:, :1], variance=none, scale=scale)
            found.__dict__["_at"] = self._at
            self._at[scale] = found
        return self._at[scale]

    @cached_property
    def _at(self) -> dict[Scale, FieldError]:
        """All that were made so far, by scale; one table for all of them."""
        return {self.scale: self}

    def whitened(self, rows: Array) -> Array:
        """Rows (n,) or (n, k) in which the noise is white again, of the white noise's own level."""
        shrink = 1.0 - 1.0 / np.sqrt(1.0 + self.variance / self.noise_nt**2)
        table = rows.reshape(len(rows), -1)
        inside = self.courses.T @ self.lines.gathered(table)
        return self.lines.less(table, self.courses @ (shrink[:, None] * inside)).reshape(rows.shape)

    def products(self, rows: Array, groups: Groups | None = None) -> Array:
        """(k, k) products with one another of what ``whitened`` makes of rows (n, k), without making it.

        With ``groups`` of each group's part of rows (n, a), one group's after another's: (g a, g a).
        """
        if groups is None:
            plain: Array = rows.T @ rows
            gathered = self.lines.gathered(rows)
        else:
            plain, gathered = groups.products(rows), self.lines.gathered_groups(rows, groups)
        inside = self.courses.T @ gathered
        share = self.variance / (self.variance + self.noise_nt**2)
        found: Array = plain - inside.T @ (share[:, None] * inside)
        return found

    @property
    def rms_nt(self) -> float:
        """rms of the errors at the samples, 1 sigma [nT]."""
        return float(np.sqrt(self.variance.sum() / self.lines.count))

    @property
    def no_larger_than_usual(self) -> FieldError:
        """The same, or what is usual where they are larger."""
        return self.scaled(Scale(min(self.scale.coarse, 1.0), min(self.scale.fine, 1.0)))

    @property
    def usual_nt(self) -> float:
        """The same of the errors that are usual [nT]."""
        return float(np.sqrt(np.mean(np.diagonal(self.coarse + self.fine))))

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


def _common_orbit(time_s: Array) -> NDArray[np.float64]:
    """Places (k, 3), Earth-fixed, of a craft on a circle of 500 km at 60 degrees [km]."""
    along = kepler_rad_s(IGRF_RADIUS_KM + _COMMON_KM) * time_s
    east = EARTH_RAD_S * time_s
    x, y, z = np.cos(along), 0.5 * np.sin(along), math.sqrt(0.75) * np.sin(along)
    direction = np.stack([x * np.cos(east) + y * np.sin(east), y * np.cos(east) - x * np.sin(east), z], axis=1)
    return np.asarray((IGRF_RADIUS_KM + _COMMON_KM) * direction)


def _by_place(place_km: NDArray[np.float64], altitude_km: float) -> tuple[Array, Array]:
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


def _polar(place_km: NDArray[np.float64]) -> Array:
    """(k,) share of the currents in the polar ionosphere that places (k, 3) have: 1 poleward of where they flow."""
    sets_in, over = _POLAR_DEG
    upwards = place_km / np.linalg.norm(place_km, axis=1)[:, None]
    latitude = np.degrees(np.arcsin(np.clip(np.abs(upwards @ DIPOLE_ECEF), 0.0, 1.0)))
    return np.asarray(np.clip((latitude - sets_in) / over + 0.5, 0.0, 1.0))


def _of_currents(share: Array, time_s: Array) -> Array:
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


def _alignment(scene: Scene, at: NDArray[np.intp]) -> Array:
    """h_i . h_j (k, k), Earth-fixed; ones where the reference has no direction."""
    if scene.reference_eci_nt is None:
        return np.ones((len(at), len(at)))
    field = geomagnetic.ecef_from_eci(scene.time_ns[at], np.asarray(scene.reference_eci_nt[at], dtype=np.float64))
    unit = field / np.maximum(np.linalg.norm(field, axis=1, keepdims=True), 1e-9)
    return np.asarray(unit @ unit.T)
