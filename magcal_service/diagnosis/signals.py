"""Causes in no catalogue that follow one recorded channel: what a name has to beat before it is believed.

A catalogue is never complete.  A gain that follows a battery's voltage looks like one that follows a temperature
charged by the same light, and fits down to the noise, so nothing that is left would tell.  What a name by one channel,
or by none, can be held against without knowing physics is every recorded channel itself: its value, its change, what
follows it slowly, its square and its size, as a field fixed in the body and as a gain.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from magcal_service.diagnosis.blocks import gain_over
from magcal_service.diagnosis.explain import Explained, Search
from magcal_service.diagnosis.linear import Gain, Workspace
from magcal_service.diagnosis.problem import Fit, Term
from magcal_service.diagnosis.rivals import RECORDED_NATS
from magcal_service.diagnosis.screen import ACCEPTED_NATS, Candidate
from magcal_service.model import Array
from magcal_service.physics.columns import Columns, along_axes, common_gain, gains
from magcal_service.physics.interface import UNLISTED, Block, Hypothesis
from magcal_service.physics.scene.scene import Scene, is_sun_vector
from magcal_service.physics.scene.smooth import smooth_course
from magcal_service.physics.scene.sunlight import first_order

_SLOWLY: Final = (60.0, 300.0, 1500.0)
"""Time constants [s] of what follows a channel slowly: a part, a board, a structure."""

_ALIKE: Final = 0.9995
"""Correlation from which on two signals of one channel are one."""

_MOST_TRANSFORMED: Final = 8
"""Channels that more than their values are tried of, those first that hold most in the place of a name: of hundreds,
the others have nothing to do with the residual."""

_LEAST_SWING: Final = 1e-3  # of the channel's largest value, as for currents

_NO_DRIVER: Final = ("time", "length", "speed", "field")
"""Kinds of channels that drive nothing: clocks, places, and what other sensors measure of the same field."""

_LIGHT: Final = "light"

_SLOW: Final = "slow"
_FIELD: Final = "field"
_GAIN: Final = "gain"

_NO_GAIN: Final = Gain(0.0, 0.0, 0.0, np.zeros(0))


@dataclass(frozen=True, slots=True, eq=False)
class Signal:
    """Something made of one channel.

    Parameters
    ----------
    driver: ``channel:NAME``, or the inferred light.
    made: how, in a word; empty for the values themselves.
    course: (n,) or (n, s), in its unit.
    """

    driver: str
    made: str
    course: Array


def said(hypothesis: Hypothesis) -> str:
    """A signal in words: how it acts, and what it is made of."""
    kind, _, name = hypothesis.driver.partition(":")
    acts_as, _, made = hypothesis.variant.partition(" ")
    driver = f"the recorded {name}" if kind == "channel" else f"the {name}"
    follows = f"{driver} by a lag of {made.removeprefix(_SLOW).strip()}" if made.startswith(_SLOW) else driver
    if made and not made.startswith(_SLOW):
        follows = f"the {made} of {driver}"
    return f"a {acts_as} that follows {follows}"


@dataclass(frozen=True, slots=True, eq=False)
class _Place:
    """The place of one term: the residual without it, and its own columns at their best there.

    Parameters
    ----------
    term: the hypothesis that is fitted there; None for what is left beside all terms.
    space: the residual without it.
    left: (m,) what it leaves of that, white [nT].
    nats: evidence for it, after the cost of its search.
    """

    term: Hypothesis | None
    space: Workspace
    left: Array
    nats: float
    sigma_nt: float

    @staticmethod
    def of(search: Search, explained: Explained, index: int, floor_nt: float) -> _Place:
        fit = explained.fit
        term = fit.terms[index]
        space, sigma = search.workspace(fit, index), max(fit.white_rms_nt, floor_nt)
        rows = search.rows_of(term.hypothesis, term.theta, fit)
        assert rows is not None
        left = space.residual - space.projected(rows @ space.gain(rows, sigma).amplitudes)
        return _Place(term.hypothesis, space, left, explained.own_nats(index), sigma)

    def is_own(self, signal: Signal, acts_as: str) -> bool:
        """Whether a signal is only the term's own driver, a little later or smoother, or acts as that does with no lag
        that the term has found."""
        if self.term is None:
            return False
        if not signal.made and signal.driver == self.term.driver:
            is_field = all(block.unit.startswith("nT") for block in self.term.blocks)
            return acts_as == (_FIELD if is_field else _GAIN)
        inferred = self.term.is_inferred and signal.driver.startswith("inferred")
        return signal.made.startswith(_SLOW) and (inferred or signal.driver == self.term.driver)


def against_signals(search: Search, explained: Explained, floor_nt: float) -> Explained:
    """The same with the best signal of a channel among the rivals of each term.

    Parameters
    ----------
    search: as it has explained.
    explained: effects and their rivals.
    floor_nt: least noise that evidence is counted in [nT].
    """
    fit = explained.fit
    if not fit.terms:
        return explained
    places = [_Place.of(search, explained, index, floor_nt) for index in range(len(fit.terms))]
    tried = _tried(search, fit, places)
    if not tried:
        return explained
    odds = RECORDED_NATS + math.log(len(tried))
    best = [max((each[index] for each in tried), key=lambda c: c.nats) for index in range(len(places))]
    return replace(
        explained,
        rivals=tuple(
            _with(search, fit, place, ranked, replace(rival, nats=rival.nats - odds))
            for place, ranked, rival in zip(places, explained.rivals, best, strict=True)
        ),
    )


@dataclass(frozen=True, slots=True, eq=False)
class Followed:
    """A signal of a channel that what is left follows.

    Parameters
    ----------
    hypothesis: how it acts.
    gain: what it holds.
    cost: of choosing it among all of them, and what a record without physics has to hold [nats].
    """

    hypothesis: Hypothesis
    gain: Gain
    cost: float

    @property
    def nats(self) -> float:
        """Evidence for it after its cost."""
        return self.gain.nats - self.cost

    @property
    def squares(self) -> float:
        """Its drop in squares [nT^2]."""
        return self.gain.squares

    @property
    def term(self) -> Term:
        """As if it were an effect."""
        return Term(self.hypothesis, np.zeros(0), self.gain.amplitudes)

    @property
    def says(self) -> str:
        """How it acts and what it is made of, in words."""
        return said(self.hypothesis)


def strongest_signal(search: Search, fit: Fit, floor_nt: float) -> Followed | None:
    """The signal of a channel that holds most of what a fit leaves; None without one that is clear.

    Parameters
    ----------
    search: as it has explained.
    fit: nine errors and effects.
    floor_nt: least noise that evidence is counted in [nT].
    """
    space = search.workspace(fit)
    tried = _tried(search, fit, [_Place(None, space, space.residual, 0.0, max(fit.white_rms_nt, floor_nt))])
    best = max((each[0] for each in tried), key=lambda one: one.nats, default=None)
    if best is None:
        return None
    found = Followed(best.hypothesis, best.gain, RECORDED_NATS + math.log(len(tried)))
    return found if found.nats >= ACCEPTED_NATS else None


def _tried(search: Search, fit: Fit, places: list[_Place]) -> list[list[Candidate]]:
    """Every signal at its best in each place: all channels by their values, the nearest of them by what is made."""
    scene, values = fit.problem.scene, _values(fit.problem.scene)
    tried = [_at_best(search, fit, places, signal) for signal in values]
    most = np.argsort([-max(one.nats for one in each) for each in tried])[:_MOST_TRANSFORMED]
    for signal in [values[index] for index in most.tolist()]:
        tried += [_at_best(search, fit, places, made) for made in _transformed(scene, signal)]
    return tried


def _with(
    search: Search, fit: Fit, place: _Place, ranked: tuple[Candidate, ...], rival: Candidate
) -> tuple[Candidate, ...]:
    """Rivals with one more, as far from the term's own evidence as the blocks bear out."""
    rows = search.white(_rows(fit, rival.hypothesis))
    left = place.space.residual - place.space.projected(rows @ rival.gain.amplitudes)
    blocks = fit.problem.blocks(search.white(fit.residual))
    dispersion = gain_over(left, place.left, blocks, place.sigma_nt**2).dispersion
    nats = place.nats + (rival.nats - place.nats) / dispersion
    return tuple(sorted((*ranked, replace(rival, nats=nats)), key=lambda c: -c.nats))


def _at_best(search: Search, fit: Fit, places: list[_Place], signal: Signal) -> list[Candidate]:
    """A signal at its best in each place: as a field, as one gain, or as three."""
    found = [Candidate(_nothing(signal), np.zeros(0), _NO_GAIN, -math.inf) for _ in places]
    for hypothesis in _hypotheses(fit.problem.scene, signal):
        rows = _rows(fit, hypothesis)
        whole = search.problem.white_products(rows) if search.is_symmetric else None
        columns = rows if whole is not None else search.white(rows)
        for index, place in enumerate(places):
            if place.is_own(signal, hypothesis.variant.partition(" ")[0]):
                continue
            space = place.space
            of = space.products(columns) if whole is None else space.products_before(rows, search.problem, whole)
            gain = of.gain(place.sigma_nt)
            if gain.nats > found[index].nats:
                found[index] = Candidate(hypothesis, np.zeros(0), gain, gain.nats)
    return found


def _nothing(signal: Signal) -> Hypothesis:
    return Hypothesis(UNLISTED, signal.driver, lambda _: Columns(), ())


def _rows(fit: Fit, hypothesis: Hypothesis) -> Array:
    rows = fit.problem.rows(hypothesis.columns(np.zeros(0)), fit.unit)
    assert rows is not None, "fields of the body are seen in every form"
    return rows


def _hypotheses(scene: Scene, signal: Signal) -> Iterator[Hypothesis]:
    """A signal as a field fixed in the body, as a gain of all axes, and as one of each."""
    course = _scaled(signal.course)
    yield _hypothesis(signal, _FIELD, lambda: along_axes(course), 3 * (1 if course.ndim == 1 else course.shape[1]))
    if course.ndim == 1:
        yield _hypothesis(signal, _GAIN, lambda: common_gain(scene.clean_field_nt, course), 1)
        yield _hypothesis(signal, _GAIN, lambda: gains(scene.clean_field_nt, course), 3)


def _hypothesis(signal: Signal, acts_as: str, make: Callable[[], Columns], size: int) -> Hypothesis:
    """Columns are made when they are asked for: those of hundreds of channels are too many to hold."""
    block = Block("amplitude", "nT" if acts_as == _FIELD else "1", (size,))
    return Hypothesis(UNLISTED, signal.driver, lambda _: make(), (block,), f"{acts_as} {signal.made}".strip())


def _values(scene: Scene) -> list[Signal]:
    """Every channel's columns as they are, and the light where there is shadow."""
    found = [
        Signal(f"channel:{channel.name}", "", column if channel.quantity != "angle" else _turn(column))
        for channel in scene.channels.values()
        if channel.quantity not in _NO_DRIVER and not is_sun_vector(channel)
        for number, column in enumerate(channel.values.T)
        if channel.swings[0][number] > _LEAST_SWING * channel.swings[1][number]
    ]
    if scene.lit is not None and scene.eclipses:
        found.append(Signal(f"inferred:{_LIGHT}", "", scene.lit))
    return found


def _transformed(scene: Scene, signal: Signal) -> Iterator[Signal]:
    """What is made of a channel's values: change, what follows them slowly, square, size, and what they add up to."""
    values = signal.course
    if values.ndim > 1:
        return
    made = {"change": scene.slope(smooth_course(values)), "square": values**2, "size": np.abs(values)}
    made["sum"] = _summed(scene.time_s, values)
    made |= {f"{_SLOW} {tau_s:g} s": first_order(scene.time_s, values, tau_s) for tau_s in _SLOWLY}
    known = [_scaled(values)]
    for name, course in made.items():
        scaled = _scaled(course)
        if max(abs(float(np.mean(scaled * one))) for one in known) < _ALIKE:
            known.append(scaled)
            yield Signal(signal.driver, name, course)


def _summed(time_s: Array, values: Array) -> Array:
    """What values (n,) add up to over time, such as the charge that a current leaves; the mean is a leak."""
    steps = np.diff(time_s, prepend=time_s[0])
    return np.asarray(np.cumsum((values - values.mean()) * steps))


def _turn(angle_rad: Array) -> Array:
    """(n, 2) what turns with an angle (n,)."""
    return np.stack([np.cos(angle_rad), np.sin(angle_rad)], axis=1)


def _scaled(course: Array) -> Array:
    """A course (n,) or (n, s) of zero mean and unit variance; zeros where it is constant."""
    centred = course - course.mean(axis=0)
    return np.asarray(centred / np.maximum(centred.std(axis=0), 1e-300))
