"""How far a name is believed: its probability among its rivals, and the class that a recording cannot tell apart."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from magcal_service.diagnosis.explain import CLASS_NATS, Explained
from magcal_service.diagnosis.passes import foretells
from magcal_service.diagnosis.problem import Fit, Term
from magcal_service.diagnosis.rest import Rest
from magcal_service.diagnosis.rivals import is_recorded
from magcal_service.diagnosis.screen import Candidate
from magcal_service.diagnosis.signals import said
from magcal_service.diagnosis.sized import may_as_well_be, numbers_of
from magcal_service.model import Array
from magcal_service.physics.interface import UNLISTED, Hypothesis
from magcal_service.physics.scene.scene import Scene
from magcal_service.recordings.inspect.motion import kepler_rad_s

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

OF_A_RECORD: Final = 0.01
"""Of a name's evidence, what a recorded driver loses by its own noise and lag, held against one by no record; choice: a
tenth of a course, squared.  A relaxing drift was 3 % before a thermometer that had recorded what caused it, and a field
of the Sun's direction 1 % before recorded panels."""

_OF_A_RAMP: Final = 0.02
"""Of the evidence for a change over a while, what its two free ends take up of the field model's errors over short ways
beside a jump: of two true jumps among such errors they had 2 and 5 % more."""

_OF_A_FORM: Final = 0.3
"""Probability that a name within that leaves to a larger one's other form; choice: enough for it not to be acted on."""

_NOT_FORETOLD: Final = 0.5
"""Probability that a name leaves to others where it does not foretell passes that took no part: anything that differs
from pass to pass is fitted as well by as many numbers."""

_OF_A_MEMORY: Final = 0.5
"""Probability that what acts by how the samples follow one another leaves to noise with a memory, where that is there
too: to a craft that turns little they are the same."""

_SLOW_ODDS: Final = 0.5
"""Odds of a change over minutes against a sudden one, before it is looked at: of jumps that were not seen to be
sudden two of six were currents that fell as a battery filled."""

_HARDLY: Final = 0.05
"""Probability of a name, below which it is none beside a cause in no catalogue, though that has a form: a name at 2 %
was all that was said."""

_RATHER: Final = 1.05
"""Times a name's class that a cause in no catalogue is likelier, from which on there is no name; choice: an even chance
is none."""

_SLOW: Final = "a drift over minutes by a cause in no catalogue"

MOST_NATS: Final = 700.0
"""Largest exponent that a double takes."""


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

    How often a cause is met counts for how probable it is, and not for what a recording can tell apart.  What acts as
    well exactly so is as probable, as the name or as a rival of it.
    """
    mine = explained.fit.terms[index].hypothesis
    name = mine.effect
    ranked, own = explained.rivals[index], explained.own_nats(index)
    ahead = [(c.nats - own) / _inexact_by(explained, index, c) for c in ranked]
    weights = {
        c.hypothesis.effect: math.exp(float(np.clip(one, -MOST_NATS, MOST_NATS)))
        for c, one in zip(ranked, ahead, strict=True)
    }
    weights[name] = 1.0
    as_well = may_as_well_be(explained.fit, index)
    weights |= dict.fromkeys(as_well, 1.0)
    for rival in (c.hypothesis for c in ranked if c.hypothesis.effect != name):
        weights |= {other: max(weights.get(other, 0.0), weights[rival.effect]) for other in rival.as_well}
    weights[UNLISTED] = weights.get(UNLISTED, 0.0) + _slow_odds(explained, index)
    held = max(explained.gains[index].nats, 0.0)
    lasting, shaped = _part(explained.lasting_nats, held), _part(explained.shaped_nats, held)
    unlisted = min(max(lasting, shaped**2, _least_unlisted(explained, index)), _MOST_UNLISTED)
    total = sum(weights.values()) / (1.0 - unlisted)
    weights[UNLISTED] += unlisted * total
    rivals = sorted(((n, w / total) for n, w in weights.items() if n != name), key=lambda pair: -pair[1])
    apart = [one + max(c.hypothesis.odds - mine.odds, 0.0) for c, one in zip(ranked, ahead, strict=True)]
    near = [c.hypothesis for c, one in zip(ranked, apart, strict=True) if one > -CLASS_NATS]
    effects = [effect for hypothesis in near for effect in (hypothesis.effect, *hypothesis.as_well)]
    effects += [*as_well, *([UNLISTED] if _may_be_slow(explained, index) else [])]
    return Posterior(weights[name] / total, tuple(rivals), tuple(dict.fromkeys((name, *effects))))


def _slow_odds(explained: Explained, index: int) -> float:
    """Odds of a change over minutes against a term's jump; 0 where it is none."""
    return 0.0 if explained.slower is None else _SLOW_ODDS * explained.slower.likelihoods[index]


def _may_be_slow(explained: Explained, index: int) -> bool:
    """Whether a jump is not told apart from a change over minutes."""
    return _slow_odds(explained, index) > math.exp(-CLASS_NATS)


def are_rather_unlisted(explained: Explained) -> bool:
    """Whether of every name a cause in no catalogue is clearly likelier than the name and its class together."""
    each = [posterior(explained, index) for index in range(len(explained.fit.terms))]
    return bool(each) and all(_is_rather_unlisted(one) for one in each)


def _is_rather_unlisted(believed: Posterior) -> bool:
    if (
        UNLISTED in believed.members and believed.own > _HARDLY
    ):  # what it is has a form, which is not told from the name
        return False
    rivals = dict(believed.rivals)
    listed = believed.own + sum(rivals.get(name, 0.0) for name in believed.members if name != UNLISTED)
    return rivals.get(UNLISTED, 0.0) > _RATHER * listed


def _inexact_by(explained: Explained, index: int, beside: Candidate) -> float:
    """What a rival's evidence beside a term's own is divided by: its driver is inferred, and not exactly true, or one
    of the two is a record of it, which is not either; or a change's ends are free to follow what a field model errs by.

    A rival by the same driver errs along with it, and a name by a record that is ahead of others is so in spite of it.
    """
    fit, rival = explained.fit, beside.hypothesis
    mine = fit.terms[index].hypothesis
    errs = any(part.field_error is not None for part, _ in fit.problem.acting(fit.terms[index]))
    if rival.effect == mine.at_once and errs:
        return 1.0 + _OF_A_RAMP * max(explained.own_nats(index), 0.0)
    if rival.driver == mine.driver:
        return 1.0
    is_behind = is_recorded(mine) and not is_recorded(rival) and beside.nats > explained.own_nats(index)
    by_record = OF_A_RECORD if is_behind or (_is_name_of_record(rival) and not is_recorded(mine)) else 0.0
    by_course = _OF_A_COURSE if mine.is_inferred else 0.0
    return 1.0 + max(by_record, by_course) * max(explained.own_nats(index), 0.0)


def _is_name_of_record(rival: Hypothesis) -> bool:
    """Whether it is an effect that follows a record, no signal that any channel may have."""
    return is_recorded(rival) and rival.effect != UNLISTED


def _least_unlisted(explained: Explained, index: int) -> float:
    """Least probability that a name leaves to causes in no catalogue, by its form and what stands beside it."""
    fit = explained.fit
    hypothesis = fit.terms[index].hypothesis
    levels = max((block.shape[0] for block in hypothesis.blocks if len(block.shape) > 1), default=1)
    jumps = levels if any(number.role == "instant" for number in hypothesis.nonlinear) else 1
    least = _LEAST_UNLISTED[not is_recorded(hypothesis)] * max(jumps - _FEW_LEVELS + 1, 1)
    if _is_within_another(explained, index) or _share_an_orbit(fit, index) or _are_inferred_along(fit, index):
        least = max(least, _OF_A_FORM)
    if hypothesis.blocks and all(block.is_start for block in hypothesis.blocks):
        least = max(least, _OF_A_FORM)  # what settles, and follows no record, is as well any drift that relaxes
    if not foretells(fit, index):
        least = max(least, _NOT_FORETOLD)
    of_memory = not is_recorded(hypothesis) and any(term.hypothesis.by_samples for term in fit.terms)
    if explained.has_memory and of_memory:  # what stands beside such a form stands with it
        least = max(least, _OF_A_MEMORY)
    is_part = index in _of_one_wave(fit) or _is_each_orbit(fit, index) or _is_along_inferred(fit, index)
    return max(least, _ONE_WAVE) if is_part else least


def _is_within_another(explained: Explained, index: int) -> bool:
    """Whether a name that follows no record holds no more than the form of a larger one may be inexact by."""
    terms = explained.fit.terms
    own = explained.gains[index].nats
    left = (
        max(_INEXACT, term.hypothesis.inexact) * gain.nats
        for number, (term, gain) in enumerate(zip(terms, explained.gains, strict=True))
        if number != index
    )
    return not is_recorded(terms[index].hypothesis) and own < max(left, default=0.0)


def _share_an_orbit(fit: Fit, index: int) -> bool:
    """Whether a name and one beside it follow no record, and it is seen for less than an orbit in all: two of any kind
    together are met by a third cause, as a drift and a hysteresis were by a warmth that nobody recorded."""
    own, others = fit.terms[index], (term for number, term in enumerate(fit.terms) if number != index)
    scenes = [part.scene for part, _ in fit.problem.acting(own)]
    beside = (term for term in others if any(part.scene in scenes for part, _ in fit.problem.acting(term)))
    if is_recorded(own.hypothesis) or all(is_recorded(term.hypothesis) for term in beside):
        return False
    return sum(float(np.ptp(scene.time_s)) for scene in scenes) < max(map(_orbit_s, scenes))


def _orbit_s(scene: Scene) -> float:
    """Time that an orbit takes [s]; 0 where there is none."""
    place = scene.position_ecef_km
    if place is None or not scene.in_orbit:
        return 0.0
    return 2.0 * math.pi / kepler_rad_s(float(np.linalg.norm(place, axis=1).mean()))


def _are_inferred_along(fit: Fit, index: int) -> bool:
    """Whether a name and one beside it are inferred and change the field along one line: one cause of another
    course is a sum of the two, as what follows a warmth's change is of warmth and light."""
    own = fit.terms[index]
    others = [term for number, term in enumerate(fit.terms) if number != index and term.hypothesis.is_inferred]
    if not own.hypothesis.is_inferred or not others:
        return False
    line = _line(own)
    return bool(max(abs(float(line @ _line(other))) for other in others) > _ALONG)


def _line(term: Term) -> Array:
    """Unit vector (3,) along which a term's field changes; 0 where it does so in several directions."""
    field = term.hypothesis.columns(term.theta).field(term.amplitudes)
    values, vectors = np.linalg.eigh(np.cov(field.T))
    return np.asarray(vectors[:, 2] * (values[2] > _ALONG * values.sum()))


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
    instants = np.sort([at for number, at in numbers_of(fit, "instant") if number == index])
    orbit_s = max(_orbit_s(part.scene) for part, _ in fit.problem.acting(fit.terms[index]))
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


def unlisted(explained: Explained, index: int) -> str:
    """What is no effect and does as well as a term, in words: a signal of a channel, what acts exactly so, or a change
    that takes minutes; empty where nothing does."""
    ranked, own = explained.rivals[index], explained.own_nats(index)
    near = (c for c in ranked if c.hypothesis.effect == UNLISTED and c.nats > own - CLASS_NATS)
    alike = explained.fit.terms[index].hypothesis.imitated_by
    return next((said(c.hypothesis) for c in near), alike or (_SLOW if _may_be_slow(explained, index) else ""))


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
