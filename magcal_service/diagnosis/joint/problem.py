"""Several recordings as one problem: rows one after another, nine errors of each, amplitudes of all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from magcal_service.diagnosis.blocks import numbered
from magcal_service.diagnosis.joint.forms import JointColumns, joint
from magcal_service.diagnosis.joint.scene import JointScene, offsets_s
from magcal_service.diagnosis.problem import Fit, Problem, Term, amplitude_tie, evaluate, free_numbers
from magcal_service.model import Array
from magcal_service.physics.columns import Columns


@dataclass(frozen=True, eq=False)
class JointProblem(Problem):
    """As ``Problem``; rows count by the noise of their own recording.

    Parameters
    ----------
    scene: a ``JointScene``.
    noise_nt: noise in which white rows are given, 1 sigma per axis [nT].
    singles: each recording's own problem, whose scene is replaced by that in ``scene``.
    relative: of each recording, noise that is left in it over ``noise_nt`` of its own, up to a common factor: what it
        was before the effects may hold them, and nine errors multiply it.  Empty: the same in all.
    dispersion: how many times less evidence counts than independent samples would have it (``blocks``), and so how
        many times more the prior of the amplitudes does: what the samples hardly tell is not made certain by their
        number, and the next recording would have it wrong.
    """

    singles: tuple[Problem, ...] = ()
    dispersion: float = 1.0
    relative: tuple[float, ...] = ()

    @classmethod
    def of(cls, singles: Sequence[Problem], dispersion: float = 1.0, relative: Sequence[float] = ()) -> JointProblem:
        """The problems of the recordings together, white rows in the noise of the quietest."""
        return cls(
            scene=JointScene.of([single.scene for single in singles]),
            noise_nt=min(single.noise_nt for single in singles),
            largest_nt=singles[0].largest_nt,
            singles=tuple(singles),
            dispersion=dispersion,
            relative=tuple(relative) if len(singles) > 1 else (),
        )

    @cached_property
    def parts(self) -> tuple[Problem, ...]:
        """Each recording's own problem."""
        assert isinstance(self.scene, JointScene)
        pairs = zip(self.singles, self.scene.parts, strict=True)
        return tuple(single if single.scene is scene else replace(single, scene=scene) for single, scene in pairs)

    @property
    def is_vector(self) -> bool:
        """Whether rows of any recording are components."""
        return any(part.is_vector for part in self.singles)

    @property
    def size(self) -> int:
        """Unknowns of all recordings before any effect."""
        return sum(part.size for part in self.singles)

    @cached_property
    def fold(self) -> NDArray[np.intp]:
        """Fold number of each row; blocks end with their recording."""
        return np.concatenate([part.fold for part in self.parts])

    @cached_property
    def row_time_s(self) -> Array:
        """Time of each row on the common clock."""
        shifts = offsets_s([part.scene for part in self.parts])
        return np.concatenate([part.row_time_s + shift for part, shift in zip(self.parts, shifts, strict=True)])

    @cached_property
    def slices(self) -> tuple[slice, ...]:
        """Rows of each recording."""
        ends = np.cumsum([len(part.scene) * part.rows_per_sample for part in self.parts]).tolist()
        return tuple(slice(first, end) for first, end in zip([0, *ends[:-1]], ends, strict=True))

    @cached_property
    def sample_slices(self) -> tuple[slice, ...]:
        """Samples of each recording."""
        ends = np.cumsum([len(part.scene) for part in self.parts]).tolist()
        return tuple(slice(first, end) for first, end in zip([0, *ends[:-1]], ends, strict=True))

    def unknowns_of(self, x: Array) -> list[Array]:
        """Each recording's own unknowns among those of all (size,)."""
        return np.split(x, np.cumsum([part.size for part in self.singles])[:-1])

    def white(self, rows: Array) -> Array:
        """Rows (m,) or (m, k) in which the noise is white and of one size."""
        triples = zip(self.parts, self.slices, self.relative or (1.0,) * len(self.parts), strict=True)
        found = [part.white(rows[at]) * (self.noise_nt / (part.noise_nt * one)) for part, at, one in triples]
        return np.concatenate(found)

    def relative_to(self, residual: Array) -> tuple[float, ...]:
        """Noise that a residual (m,) has in each recording over that recording's own, by the mean of all rows."""
        pairs = list(zip(self.parts, self.slices, strict=True))
        each = np.array([float(np.sqrt(np.mean(part.white(residual[at]) ** 2))) / part.noise_nt for part, at in pairs])
        rows = [at.stop - at.start for _, at in pairs]
        return tuple((each / np.sqrt(np.average(each**2, weights=rows))).tolist())

    def is_collapsed(self, x: Array) -> bool:
        """Whether the nine errors of any recording are no sensor's."""
        return any(part.is_collapsed(own) for part, own in zip(self.singles, self.unknowns_of(x), strict=True))

    def noise_gains(self, x: Array, unit: Array) -> Array:
        """As ``Problem.noise_gains``, of the samples of all recordings."""
        parts = zip(self.singles, self.unknowns_of(x), self.sample_slices, strict=True)
        return np.concatenate([part.noise_gains(own, unit[at]) for part, own, at in parts])

    @property
    def passes(self) -> None:
        """None: that recordings foretell one another is asked of each."""
        return None

    def blocks(self, white_residual: Array) -> NDArray[np.intp]:
        """Block number (m,) of each row; blocks end with their recording."""
        found: list[NDArray[np.intp]] = []
        for part, at in zip(self.parts, self.slices, strict=True):
            first = int(found[-1][-1]) + 1 if found else 0
            found.append(first + numbered(white_residual[at], part.rows_per_sample))
        return np.concatenate(found)

    def rows(self, columns: Columns, unit: Array) -> Array | None:
        """Columns as rows of the residual (m, k), zero where the effect does not act."""
        assert isinstance(columns, JointColumns)
        found = np.zeros((self.slices[-1].stop, columns.size))
        any_rows = False
        for number, part in enumerate(self.parts):
            own = columns.parts[number]
            rows = None if own is None else part.rows(own, unit[self.sample_slices[number]])
            if rows is not None:
                found[self.slices[number], columns.index[number]] = rows
                any_rows = True
        return found if any_rows else None

    def evaluated(self, x: Array, terms: Sequence[Term], derivatives: bool, most_nt2: float = np.inf) -> Fit:
        """What ``evaluate`` gives: each recording's own, put together, and always with its derivatives if wanted."""
        fits = self.fits(x, terms, derivatives)
        residual = np.concatenate([fit.residual for fit in fits])
        calibrated = np.concatenate([fit.calibrated_nt for fit in fits])
        if not derivatives:
            none = np.zeros((len(residual), 0))
            return Fit(self, x, tuple(terms), residual, none, np.zeros((0, 3)), calibrated, np.zeros(0))
        unit = np.concatenate([fit.unit for fit in fits])
        linear = self.size + sum(term.hypothesis.size for term in terms)
        columns = np.zeros((len(residual), linear + sum(len(free_numbers(term)) for term in terms)))
        for number, fit in enumerate(fits):
            columns[self.slices[number], self._columns_of(number, terms)] = fit.columns
        ties = [fit.tie[: part.size] for fit, part in zip(fits, self.parts, strict=True)]
        ties += [self._tie_of(term) for term in terms]
        tie = np.concatenate([*ties, np.zeros(columns.shape[1] - linear)])
        return Fit(self, x, tuple(terms), residual, columns, unit, calibrated, tie)

    def _tie_of(self, term: Term) -> Array:
        """(k,) inverse prior variances of a term's amplitudes.

        What an amplitude adds is bounded by its rms in the recordings and by the number itself: one recording alone
        may see little of a face, and what another makes of a number known from there is not bounded by that little.
        """
        largest, found = self.largest(term.hypothesis), []
        for block in term.hypothesis.blocks:
            at_full_nt = largest if block.unit == "nT" else np.inf  # of a signal that is 1 at its fullest
            found.append(np.full(block.size, at_full_nt**-2.0))
        own = amplitude_tie(self, term, term.hypothesis.columns(term.theta))
        return np.asarray(self.dispersion * np.maximum(own, np.concatenate([*found, np.zeros(0)])))

    def fits(self, x: Array, terms: Sequence[Term], derivatives: bool = True) -> list[Fit]:
        """Each recording's own residual and derivatives at given unknowns of all."""
        return [
            evaluate(part, own, self.terms_of(number, terms), derivatives)
            for number, (part, own) in enumerate(zip(self.parts, self.unknowns_of(x), strict=True))
        ]

    def acting(self, term: Term) -> list[tuple[Problem, Term]]:
        """As ``Problem.acting``."""
        each = ((part, joint(term).term_of(number, term)) for number, part in enumerate(self.parts))
        return [(part, own) for part, own in each if own is not None]

    def terms_of(self, number: int, terms: Sequence[Term]) -> list[Term]:
        """The terms as one recording has them, without those that do not act on it."""
        found = [joint(term).term_of(number, term) for term in terms]
        return [term for term in found if term is not None]

    def _columns_of(self, number: int, terms: Sequence[Term]) -> NDArray[np.intp]:
        """Numbers among all columns of those of one recording: its unknowns, amplitudes, nonlinear numbers."""
        first = sum(part.size for part in self.parts[:number])
        found: list[Any] = [np.arange(first, first + self.parts[number].size)]
        at, free = self.size, self.size + sum(term.hypothesis.size for term in terms)
        moving: list[Any] = []
        for term in terms:
            form, numbers = joint(term), len(free_numbers(term))
            if form.parts[number] is not None:
                found.append(at + form.index[number])
                moving.append(np.arange(free, free + numbers))
            at, free = at + form.size, free + numbers
        return np.concatenate([*found, *moving]).astype(np.intp)
