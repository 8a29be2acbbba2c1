"""Each recording against the others: whether they agree in what is common, and whether the others predict it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from magcal_service.diagnosis.blocks import Gain, gain_over
from magcal_service.diagnosis.doubts import STANDS_OUT
from magcal_service.diagnosis.joint.catalogue import Forms
from magcal_service.diagnosis.joint.forms import joint, like
from magcal_service.diagnosis.joint.problem import JointProblem
from magcal_service.diagnosis.joint.search import common_share, refitted
from magcal_service.diagnosis.problem import Fit, Problem, Term, free_numbers
from magcal_service.diagnosis.screen import ACCEPTED_NATS
from magcal_service.diagnosis.squares import held_out_nt2
from magcal_service.model import Array

SURE_DIFFERENCE: Final = 0.01
"""Probability below which a difference between a recording and the others is no chance."""


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """A number or a block of numbers (k,) as a fit has it, with its covariance (k, k)."""

    value: Array
    covariance: Array

    @property
    def sigma(self) -> Array:
        """1 sigma of each (k,)."""
        return np.asarray(np.sqrt(np.maximum(np.diagonal(self.covariance), 0.0)))


@dataclass(frozen=True, slots=True, eq=False)
class Against:
    """One recording's own estimate beside that of the others.

    Parameters
    ----------
    name: of the recording.
    own, others: from this recording alone, and from all others together; in the form that all have together.
    probability: of a difference at least so large by chance, were the number common.
    ratio: chi-square of the difference over its degrees of freedom, 1 on average by chance.
    """

    name: str
    own: Estimate
    others: Estimate
    probability: float
    ratio: float


@dataclass(frozen=True, slots=True, eq=False)
class Shared:
    """Whether the recordings agree in one number or block of an effect.

    Parameters
    ----------
    index: of the term.
    effect, parameter, unit, shape: what it is.
    together: from all recordings, its sigma widened by ``spread``.
    each: every recording against the others.
    """

    index: int
    effect: str
    parameter: str
    unit: str
    shape: tuple[int, ...]
    together: Estimate
    each: tuple[Against, ...]

    @property
    def probability(self) -> float:
        """Of the largest difference by chance, among as many as were looked at."""
        trials = 1 if len(self.each) == 2 else len(self.each)  # of two, each is the other's other
        return min(1.0, trials * min(one.probability for one in self.each))

    @property
    def spread(self) -> float:
        """Times its own sigma by which a number differs between recordings, at least 1.

        As measurements that disagree are averaged (Particle Data Group, Review of Particle Physics, section 5.2.2).
        """
        return spread_of(self.each)

    @property
    def agrees(self) -> bool:
        """Whether the recordings differ by no more than chance."""
        return self.probability >= SURE_DIFFERENCE


@dataclass(frozen=True, slots=True, eq=False)
class Kept:
    """What the others' numbers of one effect do for a recording, beside its own numbers of that effect alone.

    Parameters
    ----------
    share: of the gain by its own numbers, below 0 where the others' are worse than none; NaN where those gain nothing.
    nats: gain by its own numbers, as far as it stands out of the blocks' scatter.
    """

    share: float
    nats: float

    @property
    def is_seen(self) -> bool:
        """Whether the recording shows the effect at all, beside the others."""
        return self.nats > ACCEPTED_NATS


@dataclass(frozen=True, slots=True, eq=False)
class Predicted:
    """What the other recordings' numbers of the common effects do for one recording; all else is fitted to itself.

    Parameters
    ----------
    name: of the recording.
    nine_nt: held-out rms with the nine errors alone [nT].
    without_nt: with the effects that are not common besides, so without what is predicted; ``nine_nt`` where all are.
    predicted_nt, own_nt: with the others' numbers of the common ones added, and with its own numbers of them [nT].
    kept: share of the gain in squares over ``without_nt`` by its own numbers that the others' have; below 0 where those
        are worse than none.
    gain, own_gain: over ``without_nt``, in blocks that took no part, by the others' numbers and by its own.
    effects: the same for each effect beside the others; None where it has no common number.
    """

    name: str
    nine_nt: float
    without_nt: float
    predicted_nt: float
    own_nt: float
    kept: float
    gain: Gain
    own_gain: Gain
    effects: tuple[Kept | None, ...]

    @property
    def stands_out(self) -> bool:
        """Whether blocks gain by the prediction by more than their gains scatter."""
        return self.gain.tempered > 2.0 * STANDS_OUT**2

    @property
    def shows(self) -> bool:
        """Whether the effects are seen in this recording at all, by its own fit."""
        return self.own_gain.tempered > 2.0 * STANDS_OUT**2


@dataclass(frozen=True, slots=True, eq=False)
class Compared:
    """Every recording's own fit, and what the others say of it; of each term, the least that common numbers hold."""

    own: tuple[Fit, ...]
    shared: tuple[Shared, ...]
    predicted: tuple[Predicted, ...]
    least: tuple[float, ...]

    def is_common(self, index: int) -> bool:
        """Whether a term's numbers are the same in all recordings, as far as they show it.

        Either they differ by no more than chance, or the others' numbers do most of what the recordings' own would: no
        model is so exact that they would not differ, but what is common predicts.
        """
        return all(one.agrees for one in self.shared if one.index == index) or self.kept(index) >= self.least[index]

    def spread(self, index: int, parameter: str) -> float:
        """Times its own sigma by which a number of a term differs between recordings; 1 where it is each one's own."""
        return next((one.spread for one in self.shared if (one.index, one.parameter) == (index, parameter)), 1.0)

    def kept(self, index: int) -> float:
        """Share of what the recordings' own numbers of a term gain that the others' have, weighed by evidence.

        A recording may show what no other does (a face that is lit on that day alone); NaN where none shows it.
        """
        seen = [one for recording in self.predicted if (one := recording.effects[index]) is not None and one.is_seen]
        return float(np.average([one.share for one in seen], weights=[one.nats for one in seen])) if seen else math.nan


@dataclass(frozen=True, slots=True, eq=False)
class Apart:
    """A joint fit that is taken apart.

    Parameters
    ----------
    catalogue: the forms.
    fit: of all recordings.
    singles, names: the recordings' problems and names.
    floor: of each recording's noise, the least that evidence is counted in.
    """

    catalogue: Forms
    fit: Fit
    singles: Sequence[Problem]
    names: Sequence[str]
    floor: float

    def compared(self) -> Compared:
        """Each recording fitted alone, all others fitted without it, and it predicted from those."""
        every = range(len(self.names))
        own = [self._refitted([number], anywhere=True) for number in every]
        others = [self._refitted([k for k in every if k != number]) for number in every]
        shared = _shared(self.fit, own, others, self.names)
        predicted = [self._predicted(number, own[number], others[number]) for number in every]
        least = tuple(common_share(term.hypothesis) for term in self.fit.terms)
        return Compared(tuple(own), tuple(shared), tuple(predicted), least)

    def _refitted(
        self,
        numbers: Sequence[int],
        terms: Sequence[Term] | None = None,
        held: Sequence[Term] = (),
        *,
        anywhere: bool = False,
    ) -> Fit:
        """The fit again on some of the recordings, all of its terms or these; ``anywhere``: as of ``refitted``."""
        assert isinstance(self.fit.problem, JointProblem)
        x = np.split(self.fit.x, np.cumsum([single.size for single in self.singles])[:-1])
        return refitted(
            self.catalogue,
            [self.singles[number] for number in numbers],
            [self.names[number] for number in numbers],
            np.concatenate([x[number] for number in numbers]),
            self.fit.terms if terms is None else terms,
            held,
            self.fit.problem.dispersion,
            [self.fit.problem.relative[number] for number in numbers if self.fit.problem.relative],
            anywhere=anywhere,
        )

    def _predicted(self, number: int, own: Fit, others: Fit) -> Predicted:
        held = [term for term in others.terms if joint(term).common]
        apart = [term for term in self.fit.terms if not joint(term).common and joint(term).acts_on(self.names[number])]
        without = self._refitted([number], apart)
        nine = self._refitted([number], ()) if apart else without
        guess = self._refitted([number], None, held)
        squares = [held_out_nt2(one) for one in (without, guess, own)]
        sigma2 = max(own.white_rms_nt / own.noise_gain, self.floor * self.singles[number].noise_nt) ** 2
        blocks = own.problem.blocks(own.white_residual)

        def gain(before: Fit, after: Fit) -> Gain:
            return gain_over(before.sensor_held_out, after.sensor_held_out, blocks, sigma2)

        effects: list[Kept | None] = []
        for term in self.fit.terms:
            if not joint(term).common or not joint(term).acts_on(self.names[number]):
                effects.append(None)
                continue
            rest = [other for other in held if joint(other).base != joint(term).base]
            bare = self._refitted([number], [other for other in self.fit.terms if other is not term], rest)
            free = own if not rest else self._refitted([number], None, rest)
            most, kept = (held_out_nt2(bare) - held_out_nt2(one) for one in (free, guess))
            nats = gain(bare, free).tempered
            effects.append(Kept(kept / most, nats) if most > 0.0 else Kept(math.nan, 0.0))
        return Predicted(
            self.names[number],
            nine.held_out_rms_nt,
            without.held_out_rms_nt,
            guess.held_out_rms_nt,
            own.held_out_rms_nt,
            (squares[0] - squares[1]) / max(squares[0] - squares[2], 1e-12),
            gain(without, guess),
            gain(without, own),
            tuple(effects),
        )


def _shared(fit: Fit, own: Sequence[Fit], others: Sequence[Fit], names: Sequence[str]) -> list[Shared]:
    found = []
    for index, term in enumerate(fit.terms):
        form = joint(term)
        wanted = [(block.name, block.unit, block.shape) for block in form.common]
        wanted += [(form.nonlinear[k].name, form.nonlinear[k].unit, ()) for k in free_numbers(term) if form.common]
        for name, unit, shape in wanted:
            each = [
                _against(
                    recording, estimate(one, place_of(term, one), name), estimate(rest, place_of(term, rest), name)
                )
                for recording, one, rest in zip(names, own, others, strict=True)
            ]
            alone = estimate(fit, index, name)
            together = replace(alone, covariance=spread_of(each) ** 2 * alone.covariance)
            found.append(Shared(index, form.effect, name, unit, shape, together, tuple(each)))
    return found


def place_of(term: Term, fit: Fit) -> int:
    """Number of the term of another fit that has the same form."""
    return next(k for k, other in enumerate(fit.terms) if like(joint(term), [joint(other)]) is not None)


def _against(name: str, own: Estimate, others: Estimate) -> Against:
    seen = (np.diagonal(own.covariance) > 0.0) & (np.diagonal(others.covariance) > 0.0)
    if not seen.any():
        return Against(name, own, others, 1.0, 0.0)
    difference = (own.value - others.value)[seen]
    covariance = (own.covariance + others.covariance)[np.ix_(seen, seen)]
    values, vectors = np.linalg.eigh(covariance)
    turned, values = vectors.T @ difference, np.maximum(values, 1e-12 * max(float(values[-1]), 1e-300))
    chi_square = float((turned**2 / values).sum())
    return Against(name, own, others, chi_square_tail(chi_square, len(difference)), chi_square / len(difference))


def spread_of(each: Sequence[Against]) -> float:
    """Times its own sigma by which a number differs between recordings, at least 1."""
    return math.sqrt(max(1.0, *(one.ratio for one in each)))


def estimate(fit: Fit, index: int, name: str) -> Estimate:
    """A block of amplitudes, or a nonlinear number, of a term of a fit."""
    at, free = fit.problem.size, fit.linear_size
    for term in fit.terms[:index]:
        at, free = at + term.hypothesis.size, free + len(free_numbers(term))
    term = fit.terms[index]
    used = 0
    for block in term.hypothesis.blocks:
        if block.name == name:
            part = slice(at + used, at + used + block.size)
            return Estimate(term.amplitudes[used : used + block.size], fit.covariance[part, part])
        used += block.size
    for place, number in enumerate(free_numbers(term)):
        if term.hypothesis.nonlinear[number].name == name:
            part = slice(free + place, free + place + 1)
            return Estimate(term.theta[[number]], fit.covariance[part, part])
    raise KeyError(name)


def chi_square_tail(value: float, degrees: int) -> float:
    """Probability that a chi-square with so many degrees of freedom is larger than ``value``."""
    half = 0.5 * value
    if half > 700.0:
        return 0.0
    tail, term, k = (math.erfc(math.sqrt(half)), 0.0, 0.5) if degrees % 2 else (0.0, 0.0, 0.0)
    while k < 0.5 * degrees - 0.25:
        term = math.exp(k * math.log(max(half, 1e-300)) - half - math.lgamma(k + 1.0))
        tail, k = tail + term, k + 1.0
    return min(tail, 1.0)
