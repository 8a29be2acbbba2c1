"""How far a diagnosis is believed: each name's probability among its rivals, and what speaks against acting on it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from magcal_service.diagnosis.blocks import gain_over
from magcal_service.diagnosis.explain import CLASS_NATS, Explained
from magcal_service.diagnosis.passes import foretells
from magcal_service.diagnosis.problem import Fit, Term
from magcal_service.diagnosis.rest import Rest
from magcal_service.diagnosis.rivals import is_recorded
from magcal_service.diagnosis.signals import UNLISTED, said
from magcal_service.diagnosis.sized import has_size, numbers_of
from magcal_service.model import BIAS, D_ALL, STATE_SIZE, Array
from magcal_service.physics.interface import Hypothesis
from magcal_service.recordings.inspect.motion import kepler_rad_s
from magcal_service.residuals import MEDIAN_TO_SIGMA

SURE: Final = 0.95
"""Probability from which on a name is acted on: of those said so, one in twenty may be false."""

_MOST_UNLISTED: Final = 0.999
"""Probability that a name leaves to what is in no catalogue, at the most: it was seen, after all."""

_LEAST_UNLISTED: Final = (0.01, 0.03)
"""Probability that a name leaves to what is in no catalogue, at the least: by a recorded driver, and by none or one
that is inferred.  However well a name fits, causes that nobody thought of fit as well now and then; of concealed cases'
names that nothing spoke against, 1 and 3 of a hundred were false."""

_FEW_LEVELS: Final = 2
"""Jumps, each by a vector of its own, that are believed as one is: what swells and fades is met by more, too."""

_ONE_WAVE: Final = 0.5
"""Probability that a duty, with a line beside it at a multiple of its rate or along it, leaves to another wave."""

_ALONG: Final = 0.9
"""Cosine from which on two fields lie along one another: of directions at random one in ten does."""

_FEWEST_SWITCHED: Final = 4
"""Instants from which on two pairs show whether they come again after an orbit."""

_EACH_ORBIT: Final = 0.03
"""Share of an orbit to which what is switched comes again after one: an eclipse to less, a command only by chance."""

_INEXACT: Final = 0.03
"""Of a name's evidence, what the form it was fitted in may leave for others to take: no course, direction or lag of
a cause is known to better than a tenth of it, whose square is 1 %.  What follows a record is held against that."""

_OF_A_COURSE: Final = 0.005
"""Of a name's evidence, what a course that is inferred loses by not being the true one: up to a tenth of it squared,
half of that as a rule.  A rival behind by some times as much may be the cause: of six within 3 % one was."""

_OF_A_FORM: Final = 0.3
"""Probability that a name within that leaves to a larger one's other form; choice: enough for it not to be acted on."""

_NOT_FORETOLD: Final = 0.5
"""Probability that a name leaves to others where it does not foretell passes that took no part: anything that differs
from pass to pass is fitted as well by as many numbers."""

_OF_A_MEMORY: Final = 0.5
"""Probability that what acts by how the samples follow one another leaves to noise with a memory, where that is there
too: to a craft that turns little they are the same."""

_FIELD_MODEL: Final = 2.0
"""Times the usual errors of a field model, beyond which a recording is doubted: one model in twenty errs so much."""

_MOST_NATS: Final = 700.0
"""Largest exponent that a double takes."""

STANDS_OUT: Final = 3.0
"""Standard errors over blocks by which the held-out gain has to stand out of its scatter."""

LITTLE_LEFT: Final = 0.1
"""Share of the mismatch without a name beside which names are still acted on: their numbers move by a few per cent."""

_MORE_THAN_LEFT: Final = 4.0
"""Times what is left without a name, what each name has to hold: of two true ones hardly anything is left."""

_MOST_BIAS_SIGMA_NT: Final = 1000.0  # a thirtieth of the field: the vector would be off by 2 deg
_MOST_D_SIGMA: Final = 0.05  # the same, by D
"""Sigma of the nine errors from which on the field did not point in enough directions; a choice."""

_MOST_NOISE: Final = 0.02
"""Share of the field that a sensor's noise may be, where it was not stated: 600 nT of the noisiest consumer parts are
1 to 2 %.  What changes from sample to sample by more is no noise, and names beside it only follow it."""

_NOISIER: Final = 1.2
"""Times the stated noise, what may be left at the most: the level of a hundred samples is known to 7 %."""

FEWEST_SAMPLES: Final = 300
"""Samples below which fifty blocks hold six each, and held-out blocks show nothing."""


@dataclass(frozen=True, slots=True)
class Posterior:
    """Names in one place.

    Parameters
    ----------
    own: probability of the name that was fitted.
    rivals: other names with theirs, most probable first.
    members: names that this recording cannot tell apart, the fitted one first.
    """

    own: float
    rivals: tuple[tuple[str, float], ...]
    members: tuple[str, ...]


def posterior(explained: Explained, index: int) -> Posterior:
    """Of a term against its rivals, with evidence that the blocks' scatter has tempered, and causes in no catalogue.

    What is left without a name beside a term may be the rest of a cause that made the term too.  What lasts in no shape
    of its own has that probability by its share of the two; what has one is rather another cause, unless it is as large
    as the name, so by that share's square.
    """
    name = explained.fit.terms[index].hypothesis.effect
    ranked, own = explained.rivals[index], explained.own_nats(index)
    ahead = [(c.nats - own) / _inexact_by(explained, index, c.hypothesis) for c in ranked]
    weights = {
        c.hypothesis.effect: math.exp(float(np.clip(one, -_MOST_NATS, _MOST_NATS)))
        for c, one in zip(ranked, ahead, strict=True)
    }
    weights[name] = 1.0
    held = max(explained.gains[index].nats, 0.0)
    lasting, shaped = _part(explained.lasting_nats, held), _part(explained.shaped_nats, held)
    unlisted = min(max(lasting, shaped**2, _least_unlisted(explained, index)), _MOST_UNLISTED)
    total = sum(weights.values()) / (1.0 - unlisted)
    weights[UNLISTED] = weights.get(UNLISTED, 0.0) + unlisted * total
    rivals = sorted(((n, w / total) for n, w in weights.items() if n != name), key=lambda pair: -pair[1])
    effects = [c.hypothesis.effect for c, one in zip(ranked, ahead, strict=True) if one > -CLASS_NATS]
    return Posterior(weights[name] / total, tuple(rivals), (name, *(one for one in effects if one != name)))


def _inexact_by(explained: Explained, index: int, rival: Hypothesis) -> float:
    """What a rival's evidence beside a term's own is divided by: its driver is inferred, and not exactly true.

    A rival by the same driver errs along with it.
    """
    mine = explained.fit.terms[index].hypothesis
    if not mine.is_inferred or rival.driver == mine.driver:
        return 1.0
    return 1.0 + _OF_A_COURSE * max(explained.own_nats(index), 0.0)


def _least_unlisted(explained: Explained, index: int) -> float:
    """Least probability that a name leaves to causes in no catalogue, by its form and what stands beside it."""
    fit = explained.fit
    hypothesis = fit.terms[index].hypothesis
    levels = max((block.shape[0] for block in hypothesis.blocks if len(block.shape) > 1), default=1)
    jumps = levels if any(number.role == "instant" for number in hypothesis.nonlinear) else 1
    least = _LEAST_UNLISTED[not is_recorded(hypothesis)] * max(jumps - _FEW_LEVELS + 1, 1)
    if _is_within_another(explained, index) or _share_an_orbit(fit, index):
        least = max(least, _OF_A_FORM)
    if hypothesis.blocks and all(block.is_start for block in hypothesis.blocks):
        least = max(least, _OF_A_FORM)  # what settles, and follows no record, is as well any drift that relaxes
    if not foretells(fit, index):
        least = max(least, _NOT_FORETOLD)
    if explained.has_memory and hypothesis.by_samples:
        least = max(least, _OF_A_MEMORY)
    is_part = index in _of_one_wave(fit) or _is_each_orbit(fit, index) or _is_along_inferred(fit, index)
    return max(least, _ONE_WAVE) if is_part else least


def _is_within_another(explained: Explained, index: int) -> bool:
    """Whether a name that follows no record holds no more than the form of a larger one may be inexact by."""
    largest = max(gain.nats for gain in explained.gains)
    return not is_recorded(explained.fit.terms[index].hypothesis) and explained.gains[index].nats < _INEXACT * largest


def _share_an_orbit(fit: Fit, index: int) -> bool:
    """Whether a name and another one follow no record, in less than an orbit: two of any kind together are met by a
    third cause, as a drift and a hysteresis were by a warmth that nobody recorded."""
    unrecorded = [number for number, term in enumerate(fit.terms) if not is_recorded(term.hypothesis)]
    orbit_s, scene = _orbit_s(fit), fit.problem.scene
    return index in unrecorded and len(unrecorded) > 1 and float(np.ptp(scene.time_s)) < orbit_s


def _orbit_s(fit: Fit) -> float:
    """Time that an orbit takes [s]; 0 where there is none."""
    place = fit.problem.scene.position_ecef_km
    if place is None or not fit.problem.scene.in_orbit:
        return 0.0
    return 2.0 * math.pi / kepler_rad_s(float(np.linalg.norm(place, axis=1).mean()))


def _is_along_inferred(fit: Fit, index: int) -> bool:
    """Whether jumps lie along a field whose driver is inferred: a load of the same current, which nobody recorded."""
    if not any(number == index for number, _ in numbers_of(fit, "instant")):
        return False
    others = (t for t in fit.terms if t.hypothesis.is_inferred and any(b.unit == "nT" for b in t.hypothesis.blocks))
    return any(_are_along(fit.terms[index], other) for other in others)


def _are_along(one: Term, other: Term) -> bool:
    """Whether any fields of two terms lie along one another."""
    return float(np.abs(_directions(one) @ _directions(other).T).max(initial=0.0)) > _ALONG


def _directions(term: Term) -> Array:
    """(k, 3) unit vectors of a term's fields; none where its amplitudes are no vectors."""
    if len(term.amplitudes) % 3:
        return np.zeros((0, 3))
    vectors = term.amplitudes.reshape(-1, 3)
    length = np.linalg.norm(vectors, axis=1)
    return np.asarray(vectors[length > 0.0] / length[length > 0.0, None])


def _is_each_orbit(fit: Fit, index: int) -> bool:
    """Whether a term's instants come again an orbit later, every second one: something follows the orbit, as light."""
    instants, orbit_s = np.sort([at for number, at in numbers_of(fit, "instant") if number == index]), _orbit_s(fit)
    if orbit_s == 0.0 or len(instants) < _FEWEST_SWITCHED:
        return False
    return bool(np.all(np.abs((instants[2:] - instants[:-2]) / orbit_s - 1.0) < _EACH_ORBIT))


def _of_one_wave(fit: Fit) -> set[int]:
    """Numbers of the terms that are parts of one wave: a duty, and lines at multiples of its rate or along it."""
    time_s = fit.problem.scene.time_s
    resolution_hz = 1.0 / max(float(time_s[-1] - time_s[0]), 1e-9)
    cycles = [(index, value) for index, value in numbers_of(fit, "period") if value > 0.0]
    found: set[int] = set()
    for cycle, period_s in cycles:
        for line, frequency_hz in numbers_of(fit, "frequency"):
            order = round(frequency_hz * period_s)
            is_multiple = order >= 1 and abs(frequency_hz - order / period_s) < resolution_hz
            if is_multiple or _are_along(fit.terms[cycle], fit.terms[line]):
                found |= {cycle, line}
    return found


def _part(left: float, held: float) -> float:
    """Share of what is left in what is left and held together; 0 where nothing is left."""
    return left / (left + held) if left > 0.0 else 0.0


def drivers_of(explained: Explained, index: int) -> tuple[tuple[str, float], ...]:
    """Drivers of a term that this recording cannot tell apart, with their probabilities, most probable first.

    Of each driver of the term's own effect its best form; those within ``CLASS_NATS`` of the best.
    """
    ranked = explained.drivers[index]
    weights = [math.exp(max(c.nats - ranked[0].nats, -_MOST_NATS)) for c in ranked]
    total = sum(weights)
    alike = [(c, w) for c, w in zip(ranked, weights, strict=True) if c.nats > ranked[0].nats - CLASS_NATS]
    return tuple((c.hypothesis.driver, w / total) for c, w in alike)


def unlisted(explained: Explained, index: int) -> str:
    """What follows a recorded channel, is no effect and does as well as a term, in words; empty where nothing does."""
    ranked, own = explained.rivals[index], explained.own_nats(index)
    near = (c for c in ranked if c.hypothesis.effect == UNLISTED and c.nats > own - CLASS_NATS)
    return next((said(c.hypothesis) for c in near), "")


def with_left(explained: Explained, left_nt2: float, rest: Rest | None, floor_nt: float) -> Explained:
    """The same with what is left without a name [nats], in a family of shapes and lasting between samples.

    Parameters
    ----------
    explained: with effects.
    left_nt2: sum of squares that a family of shapes still holds [nT^2], 0 where it may be noise.
    rest: what lasts beside the names; None where the noise has a memory.
    floor_nt: least noise that evidence is counted in [nT].
    """
    share = 0.0 if rest is None else min(rest.likely_share, _MOST_UNLISTED)
    held = sum(max(gain.nats, 0.0) for gain in explained.gains)  # through the noise's whitening, as shapes are
    return replace(
        explained,
        has_memory=rest is None,
        shaped_nats=left_nt2 / (2.0 * max(explained.fit.white_rms_nt, floor_nt) ** 2),
        lasting_nats=share / (1.0 - share) * held,
    )


def reasons(
    explained: Explained,
    unexplained: float,
    unknown: bool,
    stated: bool = True,
    rest: Rest | None = None,
    *,
    has_own_noise: bool = False,
    added_noise_nt: float = 0.0,
) -> tuple[str, ...]:
    """What speaks against acting on a result, by the names of ``words.REASONS``.

    Parameters
    ----------
    explained: with effects, and what is left beside them.
    unexplained: share of the mismatch without a name; ``unknown``: whether that is the verdict.
    stated: whether the sensor's noise was stated, not estimated from the residual.
    rest: what lasts beside the names; None where the noise has a memory.
    has_own_noise: whether a level of noise beside the stated one was found and said.
    added_noise_nt: noise that was found on top of the stated one, as by a lattice of values [nT per axis].
    """
    fit, named = explained.fit, bool(explained.fit.terms)
    return listed(
        explained,
        rest,
        poor_coverage=not has_coverage(fit.covariance[:STATE_SIZE, :STATE_SIZE]),
        unexplained_structure=unknown or (named and (unexplained > LITTLE_LEFT or _hardly_more(explained))),
        rough_residual=named and not stated and is_rough(fit),
        noisier_than_stated=stated and not has_own_noise and is_noisier(fit, added_noise_nt),
        field_model_doubtful=is_beyond_model(fit),
    )


def listed(
    explained: Explained,
    rest: Rest | None,
    *,
    poor_coverage: bool,
    unexplained_structure: bool,
    rough_residual: bool,
    **beside: bool,
) -> tuple[str, ...]:
    """The reasons that hold, in order: what any fit says of itself, with those that its diagnosis found.

    Parameters
    ----------
    explained: with effects.
    rest: what lasts beside the names; None where the noise has a memory.
    poor_coverage, unexplained_structure, rough_residual: whether these hold.
    beside: further ones, by name.
    """
    fit = explained.fit
    found = {
        "not_converged": not fit.converged,
        "collapsed": fit.problem.is_collapsed(fit.x),
        "poor_coverage": poor_coverage,
        "unexplained_structure": unexplained_structure,
        "mismatch_lasts": bool(fit.terms) and rest is not None and rest.is_much,
        "not_enough_data": len(fit.problem.scene) < FEWEST_SAMPLES,
        **{reason: bool(names) for reason, names in concerned(explained).items()},
        "rough_residual": rough_residual,
        **beside,
    }
    return tuple(name for name, holds in found.items() if holds)


def concerned(explained: Explained) -> dict[str, tuple[str, ...]]:
    """The effects that each reason is about, by the reason, for those that are about single ones."""
    names = [term.hypothesis.effect for term in explained.fit.terms]
    unsure = [name for index, name in enumerate(names) if posterior(explained, index).own < SURE]
    sized = [has_size(explained.fit, i) and not any(explained.courses[i : i + 1]) for i in range(len(names))]
    unsized = [name for name, is_sized in zip(names, sized, strict=True) if not is_sized]
    return {"name_uncertain": tuple(unsure), "size_uncertain": tuple(unsized)}


def has_coverage(covariance: Array) -> bool:
    """Whether the field pointed in enough directions to fix nine errors of a covariance (9, 9)."""
    sigma = np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
    return float(sigma[BIAS].max()) <= _MOST_BIAS_SIGMA_NT and float(sigma[D_ALL].max()) <= _MOST_D_SIGMA


def _hardly_more(explained: Explained) -> bool:
    """Whether one of the names holds hardly more than what is left without one: it may be a part of that instead."""
    return any(gain.nats < _MORE_THAN_LEFT * explained.shaped_nats for gain in explained.gains)


def is_rough(fit: Fit) -> bool:
    """Whether what changes from sample to sample is more of the field than any sensor's noise."""
    return fit.problem.noise_nt > _MOST_NOISE * float(np.mean(fit.problem.scene.magnitude_nt))


def is_noisier(fit: Fit, added_nt: float = 0.0) -> bool:
    """Whether more is left than the noise and the field model's errors, by rms and by the median alike.

    Outliers raise the one, and a few large waves hardly the other.  The noise is the sensor's, per axis, and so are
    ``added_nt`` on top [nT]; calibration multiplies them by I + D along the field.
    """
    left = fit.held_out_white
    noise_nt = max(fit.noise_gain, 1.0) * float(np.hypot(fit.problem.noise_nt, added_nt))
    robust = MEDIAN_TO_SIGMA * float(np.median(np.abs(left - np.median(left))))
    return min(float(np.sqrt(np.mean(left**2))), robust) > _NOISIER * noise_nt


def is_beyond_model(fit: Fit) -> bool:
    """Whether the reference errs by more than field models do, and what is left shows it: nobody knows by what."""
    error = fit.problem.field_error
    if error is None or error.scale <= _FIELD_MODEL:
        return False
    usual_nt = error.rms_nt / error.scale
    return fit.held_out_rms_nt > _NOISIER * float(np.hypot(max(fit.noise_gain, 1.0) * error.noise_nt, usual_nt))


def stands_out(baseline: Fit, fit: Fit, floor_nt: float) -> bool:
    """Whether held-out blocks gain by the effects by more than their gains scatter."""
    number = fit.problem.blocks(fit.white_residual)
    sigma2 = max(fit.white_rms_nt / fit.noise_gain, floor_nt) ** 2
    gain = gain_over(baseline.sensor_held_out, fit.sensor_held_out, number, sigma2)
    return gain.tempered > 2.0 * STANDS_OUT**2  # nats beyond so many of their sigma, sqrt(2 nats dispersion)
