"""The errors that a field model has of its own, as correlated noise of the reference's magnitude or vectors.

Without them in the noise, what remains of the model on a quiet craft is taken for physics.  What they are is in
``model_errors``.  Rows are whitened by them in a basis of the few directions that matter.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from magcal_service.diagnosis.groups import Groups
from magcal_service.diagnosis.knots import Lines, TurnedLines
from magcal_service.diagnosis.model_errors import (
    COMMON_KM,
    COMMON_SHARE,
    by_place,
    common_orbit,
    near_ground,
    of_currents,
    outside,
    polar,
    reach_km,
)
from magcal_service.earth import geomagnetic
from magcal_service.earth.geomagnetic import LOWEST_ORBIT_KM
from magcal_service.earth.igrf14 import RADIUS_KM as IGRF_RADIUS_KM
from magcal_service.model import Array
from magcal_service.physics.scene.scene import Scene

_KNOT_S: Final = 40.0  # 2.5 deg of the orbit
_MOST_KNOTS: Final = 900
"""Places at which the covariance is worked out: 2.5 deg of the orbit, a quarter of the shortest wave of degree 36."""

_FEWEST_KNOTS: Final = 8  # of a craft that hardly moves
_STEP: Final = 0.25
"""Of the way over which the crust changes, from one knot to the next at the most: lines are off by 1 % of it then."""

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
class FieldError:
    """Covariance U diag(v) U' of the errors of |H|, or of H, at the rows; U is kept by its values at the knots.

    Parameters
    ----------
    lines: from knots to rows.
    courses: U at the knots (q, k), or (3 q, k) of whole vectors; its columns are orthonormal at the rows.
    variance: v (k,) [nT^2].
    noise_nt: 1 sigma of the white noise that comes on top [nT].
    scale: beside what is usual.
    coarse, fine: usual covariances (q, q) of one number between the knots [nT^2].
    outside: (q, q) [nT^2] of a field that is the same everywhere, which the nine errors take up; no part of the noise.
        None of whole vectors, which have unknowns for it, and near the ground.
    """

    lines: Lines | TurnedLines
    courses: Array
    variance: Array
    noise_nt: float
    scale: Scale
    coarse: Array
    fine: Array
    outside: Array | None = None

    @classmethod
    def of(cls, scene: Scene, noise_nt: float, onto: Array | None = None) -> FieldError | None:
        """For a craft in orbit, or one that moves through the air or on the ground; None elsewhere, or where the noise
        hides it all.

        Without places those of a common orbit are taken: errors fade with the way flown, wherever that leads.

        Parameters
        ----------
        onto: (n, 3, 3) from the reference's axes to a sample's white rows, where whole vectors are compared; else rows
            are along the field.
        """
        given = scene.position_ecef_km
        if len(scene) < 2 or (given is None and not scene.in_orbit):
            return None
        altitude_km = COMMON_KM if given is None else float(np.median(np.linalg.norm(given, axis=1))) - IGRF_RADIUS_KM
        high = altitude_km > LOWEST_ORBIT_KM
        if high and not scene.in_orbit:  # a coil that plays an orbit
            return None
        at = _knots(scene) if high or given is None else _knots_on_the_way(scene, given)
        place = common_orbit(scene.time_s[at]) if given is None else given[at]
        aligned = _alignment(scene, at) if onto is None else None
        alike = 1.0 if aligned is None else aligned
        coarse, fine = (part * alike for part in (by_place(place, altitude_km) if high else near_ground(place)))
        if high:
            share = np.full(len(at), COMMON_SHARE) if given is None else polar(place)
            fine += of_currents(share, scene.time_s[at])
        lines = Lines(at, len(scene))
        common = outside(aligned) if high and aligned is not None else None
        onto_rows = lines if onto is None else TurnedLines(lines, onto)
        return cls._made(onto_rows, noise_nt, Scale(), coarse, fine, common)

    @classmethod
    def _made(
        cls,
        lines: Lines | TurnedLines,
        noise_nt: float,
        scale: Scale,
        coarse: Array,
        fine: Array,
        common: Array | None,
    ) -> FieldError | None:
        values, vectors = np.linalg.eigh(scale.coarse**2 * coarse + scale.fine**2 * fine)
        useful = values * lines.count > _LEAST * noise_nt**2
        if not useful.any():
            return None
        courses = vectors[:, useful] * np.sqrt(values[useful])
        if isinstance(lines, TurnedLines):
            courses = np.kron(courses, np.eye(3))
        squares, turn = np.linalg.eigh(courses.T @ lines.weighed(courses))
        kept = squares > _LEAST * noise_nt**2
        if not kept.any():
            return None
        courses = courses @ turn[:, kept] / np.sqrt(squares[kept])
        return cls(lines, courses, squares[kept], noise_nt, scale, coarse, fine, common)

    @property
    def beside_noise(self) -> Array | None:
        """(q, q) covariance at the knots of what a recording's reference may be off by beside what is counted as noise:
        what is the same everywhere, and what is usual where the noise has less, because the residual shows less: what
        the nine errors took up it does not show [nT^2].  None where ``outside`` is."""
        if self.outside is None:
            return None
        coarse, fine = (1.0 - min(one, 1.0) ** 2 for one in self.scale)
        return np.asarray(coarse * self.coarse + fine * self.fine + self.outside)

    @property
    def basis(self) -> Array:
        """U (n, k), orthonormal columns."""
        return self.lines.carried_on(self.courses)

    def scaled(self, scale: Scale) -> FieldError:
        """The usual errors at a scale; what is so small then that the noise hides it is kept at that level."""
        if scale not in self._at:
            made = self._made(self.lines, self.noise_nt, scale, self.coarse, self.fine, self.outside)
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

    @property
    def may_be_nt(self) -> float:
        """rms that the model may err by in the magnitude [nT]: as is usual, or as much as is taken where that is more.

        What is taken may be less than is usual only because nothing shows more.
        """
        return max(self.usual_nt, self.rms_nt)

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


def _knots_on_the_way(scene: Scene, place_km: NDArray[np.float64]) -> NDArray[np.intp]:
    """The same of places (n, 3) near the ground: as many as the way from one to the next takes to be short beside what
    the crust changes over."""
    count = min(_FEWEST_KNOTS, len(scene))
    while True:
        times = np.linspace(scene.time_s[0], scene.time_s[-1], count)
        at: NDArray[np.intp] = np.unique(np.clip(np.searchsorted(scene.time_s, times), 0, len(scene) - 1))
        moved = np.linalg.norm(np.diff(place_km[at], axis=0), axis=1)
        if count >= min(_MOST_KNOTS, len(scene)) or bool((moved < _STEP * reach_km(place_km[at[1:]])).all()):
            return at
        count = min(2 * count, _MOST_KNOTS, len(scene))


def _alignment(scene: Scene, at: NDArray[np.intp]) -> Array:
    """h_i . h_j (k, k), Earth-fixed; ones where the reference has no direction."""
    if scene.reference_eci_nt is None:
        return np.ones((len(at), len(at)))
    field = geomagnetic.ecef_from_eci(scene.time_ns[at], np.asarray(scene.reference_eci_nt[at], dtype=np.float64))
    unit = field / np.maximum(np.linalg.norm(field, axis=1, keepdims=True), 1e-9)
    return np.asarray(unit @ unit.T)
