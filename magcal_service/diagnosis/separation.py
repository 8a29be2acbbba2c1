"""What would tell a name from its rivals: the same model and its rival on recordings that nobody has made yet.

If one of two models is the truth, a recording is expected to give it 0.5 sum((signal left) / sigma)^2 nats over the
other, signal left being what a fit of the other, with the nine errors and all other terms, leaves of it.  Both
directions are worked out, the smaller counts, and the blocks' dispersion divides it as it does evidence.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from magcal_service.diagnosis.aimed import Aimed
from magcal_service.diagnosis.diagnose import Diagnosis
from magcal_service.diagnosis.explain import CLASS_NATS
from magcal_service.diagnosis.imagined import Turn, continued, spun, steady, tilted
from magcal_service.diagnosis.problem import Fit, Problem, Term, disturbances, evaluate, free_numbers
from magcal_service.diagnosis.screen import Candidate
from magcal_service.model import Array, measure
from magcal_service.physics.effects.coloured_noise import Whitener
from magcal_service.physics.interface import Effect, Finding, Hypothesis
from magcal_service.physics.scene.scene import Scene

_MOST_RIVALS: Final = 2  # of a class that measurements are worked out against, the most probable first
_MOST_COURSES: Final = 12  # of a driver that nobody has recorded, spread over those that were searched
_SLOW_SPIN_RAD_S: Final = 2.0 * math.pi / 60.0  # one turn a minute, for a craft that does not spin
_UNTURNED: Final = ("temperature", "magnetic moment")
"""Channels that go on as they were when the craft turns; others, such as a panel's current, would change with it."""


@dataclass(frozen=True, slots=True)
class Separation:
    """A measurement, and how far it is expected to tell two names apart.

    Parameters
    ----------
    do: what to do, as a request.
    against: the rival.
    nats: expected evidence for the one that is true over the other, whichever it is.
    """

    do: str
    against: str
    nats: float

    @property
    def sigma(self) -> float:
        """The same as standard deviations."""
        return math.sqrt(2.0 * self.nats)


@dataclass(frozen=True, slots=True, eq=False)
class _Manoeuvre:
    """How a recording goes on: in words, how the craft turns, and the effect that is switched off."""

    do: str
    turn: Turn
    off: str = ""


def separations(diagnosis: Diagnosis, index: int, members: Sequence[str]) -> tuple[Separation, ...]:
    """Measurements that would tell a term from its class, the best first; none where it stands alone.

    Parameters
    ----------
    diagnosis: finished.
    index: of the term.
    members: names of its class, its own included.

    What cannot be worked out for a form, or tells nothing that the recording does not tell already, is left out; so is
    what leaves both as they are, where they act exactly alike.
    """
    fit = diagnosis.fit
    own = fit.terms[index]
    others = [term for number, term in enumerate(fit.terms) if number != index]
    rivals = [c for c in diagnosis.explained.rivals[index] if c.hypothesis.effect in set(members) - {_name(own)}]
    found: list[Separation] = []
    for rival in rivals[:_MOST_RIVALS]:
        is_exact = rival.hypothesis.effect in own.hypothesis.as_well
        found += _against(diagnosis, _Pair(diagnosis, own, _term(rival), others, index), is_exact)
    return tuple(sorted(found, key=lambda one: -one.nats))


def switched_off(effect: Effect, finding: Finding) -> tuple[Separation, ...]:
    """What switching off an effect that is no term of a fit would tell of it and each of its rivals."""
    if not effect.switched or finding.off_nats <= CLASS_NATS:
        return ()
    return tuple(Separation(_without(effect), rival, finding.off_nats) for rival, _ in finding.rivals)


def _against(diagnosis: Diagnosis, pair: _Pair, is_exact: bool) -> list[Separation]:
    """The best manoeuvre of each kind, and the records of drivers, against one rival.

    Where that acts exactly alike, however the craft turns and however long, only what switches one of them off counts.
    """
    now = pair.expected(_Manoeuvre("", steady(pair.scene)), recorded_only=True)
    if now is None:
        return []
    found = []
    for kind in _manoeuvres(diagnosis, pair):
        if is_exact and not any(manoeuvre.off for manoeuvre in kind):
            continue
        nats = [(pair.expected(manoeuvre), manoeuvre.do) for manoeuvre in kind]
        known = [(value, do) for value, do in nats if value is not None]
        if known:
            value, do = max(known)
            found.append(Separation(do, pair.rival_name, value))
    found += pair.records()
    return [one for one in found if one.nats > max(CLASS_NATS, now + 1.0)]


def _manoeuvres(diagnosis: Diagnosis, pair: _Pair) -> Iterator[list[_Manoeuvre]]:
    """Kinds of continuations; of each kind the best is told."""
    scene = pair.scene
    yield [_Manoeuvre("record as long again as it was", steady(scene))]
    if pair.may_turn:
        axes = dict(zip("xyz", np.eye(3), strict=True))
        quarter = 0.5 * math.pi
        yield [
            _Manoeuvre(f"turn the craft by 90 deg about its {name} axis and record as long again",
                       tilted(scene, axis, quarter))
            for name, axis in axes.items()
        ]  # fmt: skip
        spin = diagnosis.spin
        if spin is not None and abs(spin.rate_rad_s) > 0.5 * _SLOW_SPIN_RAD_S:
            faster = spun(scene, np.asarray(spin.axis_body), spin.rate_rad_s)
            yield [_Manoeuvre("spin the craft twice as fast and record as long again", faster)]
        else:
            yield [
                _Manoeuvre(f"turn the craft about its {name} axis, once a minute, and record as long again",
                           spun(scene, axis, _SLOW_SPIN_RAD_S))
                for name, axis in axes.items()
            ]  # fmt: skip
    for effect in pair.effects:
        if effect.switched:
            yield [_Manoeuvre(_without(effect), steady(scene), effect.name)]


def _without(effect: Effect) -> str:
    return f"switch off {effect.switched} and record as long again"


class _Pair:
    """A term and its rival beside the other terms, on the recording and its continuations."""

    def __init__(self, diagnosis: Diagnosis, own: Term, rival: Term, others: Sequence[Term], index: int) -> None:
        self._search, self._fit = diagnosis.search, diagnosis.fit
        self._known = {effect.name: effect for effect in diagnosis.effects}
        self._terms, self._others = (own, rival), tuple(others)
        self._scene = self._fit.problem.scene
        white = self._white(self._fit.residual, self._scene)
        self._sigma2 = max(float(np.mean(white**2)), 1e-12)
        self._of_reference: dict[int, Term | None] = {}
        self._dispersion = diagnosis.explained.gains[index].dispersion

    @property
    def scene(self) -> Scene:
        """The recording."""
        return self._scene

    @property
    def rival_name(self) -> str:
        """The rival's name."""
        return _name(self._terms[1])

    @property
    def effects(self) -> list[Effect]:
        """The two effects, as far as the catalogue has them."""
        return [self._known[_name(term)] for term in self._terms if _name(term) in self._known]

    @property
    def may_turn(self) -> bool:
        """Whether the drivers of all terms are known when the craft turns."""
        channels = [t.hypothesis.driver.partition(":")[2] for t in (*self._terms, *self._others)
                    if t.hypothesis.driver.startswith("channel:")]  # fmt: skip
        parts = [name for channel in channels for name in channel.split("+")]
        return all(name in self._scene.channels and self._scene.channels[name].quantity in _UNTURNED for name in parts)

    def expected(self, manoeuvre: _Manoeuvre, recorded_only: bool = False) -> float | None:
        """Nats expected of the recording and its continuation; None where a form cannot be had there."""
        scene = continued(self._scene, manoeuvre.turn, self._fit.x)
        terms = [self._on(term, scene) for term in (*self._terms, *self._others)]
        bound = [term for term in terms if term is not None]
        if len(bound) < len(terms):
            return None
        found = []
        for truth, wrong in ((0, 1), (1, 0)):
            fit = self._fitted(scene, manoeuvre.turn, [*bound[2:], bound[wrong]])
            signal = _signal(fit, bound[truth])
            columns = np.array(fit.columns)
            rows = len(signal) // 2
            if manoeuvre.off == _name(bound[truth]):
                signal[rows:] = 0.0
            if manoeuvre.off == _name(bound[wrong]):
                columns[np.ix_(range(rows, len(columns)), _last(fit))] = 0.0
            halves = [self._white(np.column_stack([signal, columns])[part], fit.problem.scene, number)
                      for number, part in enumerate((slice(None, rows), slice(rows, None)))]  # fmt: skip
            white = halves[0] if recorded_only else np.concatenate(halves)
            found.append(self._left(white[:, 0], white[:, 1:], fit.tie))
        return min(found)

    def records(self) -> list[Separation]:
        """For each of the two whose driver nobody recorded: how far its record would rule it out, were it wrong."""
        found = []
        for truth, wrong in ((0, 1), (1, 0)):
            kind, _, driver = self._terms[wrong].hypothesis.driver.partition(":")
            if kind != "inferred":
                continue
            problem = self._fit.problem
            fit = self._exact(self._scene, problem.room_from_body, self._others, problem.aimed)
            signal = self._white(_signal(self._fit, self._terms[truth]), self._scene)
            plain = self._white(fit.columns, self._scene)
            nats = []
            for hypothesis, theta in self._courses(self._terms[wrong]):
                columns = hypothesis.columns(theta)
                rows = self._fit.problem.rows(columns, self._fit.unit)
                if rows is not None:
                    tie = np.concatenate([fit.tie, (columns.sizes() / self._fit.problem.largest(hypothesis)) ** 2])
                    both = np.concatenate([plain, self._white(rows, self._scene)], axis=1)
                    nats.append(self._left(signal, both, tie))
            if nats:
                name = _name(self._terms[wrong])
                words = f"record what drives {name} ({driver.replace('_', ' ')}), which shows whether it is that"
                found.append(Separation(words, self.rival_name, float(np.median(nats))))
        return found

    def _courses(self, term: Term) -> list[tuple[Hypothesis, Array]]:
        """Courses that a driver nobody recorded may have: every form of the effect over the numbers searched."""
        found = []
        for hypothesis in self._search.hypotheses:
            if hypothesis.effect == _name(term) and hypothesis.driver == term.hypothesis.driver:
                grids = [number.grid for number in hypothesis.nonlinear]
                if all(len(grid) for grid in grids):
                    axes = np.meshgrid(*grids, indexing="ij") if grids else []
                    tried = np.stack([axis.ravel() for axis in axes], axis=1) if grids else np.zeros((1, 0))
                    found += [(hypothesis, theta) for theta in tried]
        step = max(1, -(-len(found) // _MOST_COURSES))
        return found[::step]

    def _on(self, term: Term, scene: Scene) -> Term | None:
        """A term with the columns that it has on another scene; an error of the reference is the same on all."""
        effect = self._known.get(_name(term))
        if effect is None:
            return None
        if not effect.acts_on.is_reference:
            return self._formed(effect, term, scene)
        if id(term) not in self._of_reference:
            self._of_reference[id(term)] = self._formed(effect, term, scene)
        return self._of_reference[id(term)]

    @staticmethod
    def _formed(effect: Effect, term: Term, scene: Scene) -> Term | None:
        own = term.hypothesis
        for form in effect.hypotheses(replace(scene, given=own.constants)):
            if (form.driver, form.variant, form.size) == (own.driver, own.variant, own.size):
                return replace(term, hypothesis=form)
        return None

    def _fitted(self, scene: Scene, turn: Turn, terms: Sequence[Term]) -> Fit:
        """Nine errors and terms at their values, on samples that agree with them."""
        room = self._fit.problem.room_from_body
        if room is not None:
            room = np.concatenate([room, room @ np.transpose(turn.rotation, (0, 2, 1))])
        aimed = self._fit.problem.aimed
        if aimed is not None:
            aimed = aimed.continued(turn.rotation)
        return self._exact(scene, room, terms, aimed)

    def _exact(self, scene: Scene, room: Array | None, terms: Sequence[Term], aimed: Aimed | None) -> Fit:
        body, _ = disturbances(terms, scene)
        exact = replace(scene, field_nt=measure(self._fit.x[:9], scene.calibrated_nt + body))
        problem: Problem = replace(self._fit.problem, scene=exact, room_from_body=room, field_error=None, aimed=aimed)
        return evaluate(problem, self._fit.x, terms)

    def _white(self, rows: Array, scene: Scene, half: int = 0) -> Array:
        """Rows (m,) or (m, k) of one half through the whitening of the recording's noise."""
        rows = self._search.problem.white(rows)
        if not len(self._search.whitening):
            return rows
        count = len(self._scene)
        unit = scene.unit[half * count : (half + 1) * count]
        return Whitener(self._search.whitening, unit).white(rows.reshape(len(rows), -1)).reshape(rows.shape)

    def _left(self, signal: Array, columns: Array, tie: Array) -> float:
        """Nats that are left of a signal (m,) after a fit of columns (m, p) with inverse prior variances (p,)."""
        scale = np.linalg.norm(columns, axis=0)
        scale = np.where(scale > 0.0, scale, 1.0)
        scaled = columns / scale
        normal = scaled.T @ scaled + np.diag(self._sigma2 * tie / scale**2)
        right = scaled.T @ signal
        left = float(signal @ signal) - float(right @ np.linalg.lstsq(normal, right, rcond=1e-12)[0])
        return max(left, 0.0) / (2.0 * self._sigma2 * self._dispersion)


def _name(term: Term) -> str:
    return term.hypothesis.effect


def _term(candidate: Candidate) -> Term:
    return Term(candidate.hypothesis, candidate.theta, candidate.gain.amplitudes)


def _signal(fit: Fit, term: Term) -> Array:
    """A term's part in the residual (m,) [nT]."""
    rows = fit.problem.rows(term.hypothesis.columns(term.theta), fit.unit)
    assert rows is not None, "a term that says nothing in this form was fitted"
    return rows @ term.amplitudes


def _last(fit: Fit) -> list[int]:
    """Numbers of the columns of a fit's last term: amplitudes and nonlinear numbers."""
    term, count = fit.terms[-1], fit.columns.shape[1]
    moving = len(free_numbers(term))
    return [*range(fit.linear_size - term.hypothesis.size, fit.linear_size), *range(count - moving, count)]
