"""Hypotheses that act on several recordings: which of their numbers are common, and which each recording has itself."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from magcal_service.diagnosis.joint.scene import offsets_s, under
from magcal_service.diagnosis.problem import Problem, Term
from magcal_service.diagnosis.screen import hypotheses_of
from magcal_service.model import Array
from magcal_service.physics.interface import Block, Columns, Effect, Hypothesis
from magcal_service.physics.saying import labels_of
from magcal_service.physics.scene.scene import Scene

START: Final = "start_"
"""Begins the name of a start state, which every recording has itself."""

EACH_ITS_OWN: Final = "each its own"
"""Added to the variant of a form whose amplitudes differ from recording to recording."""

_OF_ONE_RECORDING: Final = ("middle_s", "span_s")
"""Constants of a course in time: they have no meaning in another recording."""

_LARGEST: Final = ("full_sun", "full_scale_nt", "largest_am2", "scale_nt")
"""Constants that scale a signal to its largest value."""

_NUMBERED: Final = ("face", "column")
"""Constants that list what is used: in several recordings, what is used in any."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class JointColumns(Columns):
    """Columns of several recordings.

    Parameters
    ----------
    parts: of each recording, None where the effect does not act on it.
    index: of each recording, the number among all amplitudes of each of its own.
    counts: samples of each recording.
    size: number of amplitudes.
    """

    parts: tuple[Columns | None, ...]
    index: tuple[NDArray[np.intp], ...]
    counts: tuple[int, ...]
    size: int

    def field(self, amplitudes: Array) -> Array:
        """The body field (n, 3) of amplitudes (k,) [nT], all recordings one after another."""
        return np.concatenate(
            [
                np.zeros((count, 3)) if part is None else part.field(amplitudes[index])
                for part, index, count in zip(self.parts, self.index, self.counts, strict=True)
            ]
        )

    def growth(self, amplitudes: Array) -> Array:
        """Growth of the magnitude (n,) of amplitudes (k,) [nT], all recordings one after another."""
        return np.concatenate(
            [
                np.zeros(count) if part is None else np.zeros(count) + part.growth(amplitudes[index])
                for part, index, count in zip(self.parts, self.index, self.counts, strict=True)
            ]
        )

    def sizes(self) -> Array:
        """rms of what one unit of each amplitude adds (k,) [nT per unit], over the recordings that it acts on."""
        squares, samples = np.zeros(self.size), np.zeros(self.size)
        for part, index, count in zip(self.parts, self.index, self.counts, strict=True):
            if part is not None:
                squares[index] += part.sizes() ** 2 * count
                samples[index] += count
        found: Array = np.sqrt(squares / np.maximum(samples, 1.0))
        return found


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class JointHypothesis(Hypothesis):
    """A hypothesis on several recordings.

    Parameters
    ----------
    base: label that the recordings' own hypotheses have.
    parts: of each recording, None where the effect does not act on it.
    index: of each recording, the number among all amplitudes of each of its own.
    own: names of the blocks that every recording has itself, with a first axis over those on which it acts.
    solo: the recording that it is a form of, where it is one of a single recording; else empty.
    names: of the recordings.
    counts, offsets: samples of each recording, and what is added to its time on the common clock [s].
    """

    base: str
    parts: tuple[Hypothesis | None, ...]
    index: tuple[NDArray[np.intp], ...]
    own: frozenset[str]
    solo: str
    names: tuple[str, ...]
    counts: tuple[int, ...]
    offsets: tuple[float, ...]

    @property
    def common(self) -> tuple[Block, ...]:
        """Blocks that all recordings share."""
        return () if self.solo else tuple(block for block in self.blocks if block.name not in self.own)

    def acts_on(self, name: str) -> bool:
        """Whether the effect acts on a recording."""
        return self.parts[self.names.index(name)] is not None

    def theta_of(self, number: int, theta: Array) -> Array:
        """The nonlinear numbers (m,) on the clock of one recording."""
        found = np.array(theta)
        for index, nonlinear in enumerate(self.nonlinear):
            if nonlinear.role == "instant":
                found[index] -= self.offsets[number]
        return found

    def term_of(self, number: int, term: Term) -> Term | None:
        """A term of this hypothesis as one recording has it."""
        part = self.parts[number]
        if part is None:
            return None
        return Term(part, self.theta_of(number, term.theta), term.amplitudes[self.index[number]])


def joined(
    label: Hypothesis,
    parts: Sequence[Hypothesis | None],
    names: Sequence[str],
    counts: Sequence[int],
    offsets: Sequence[float],
    said: str = "",
    solo: str = "",
) -> JointHypothesis:
    """One hypothesis of those that the recordings have themselves.

    Parameters
    ----------
    label: any of them, for what they have in common.
    parts: of each recording, None where the effect does not act on it.
    names, counts, offsets: name of each recording, its samples, and what is added to its time on the common clock [s].
    solo: the recording that it is a form of, where it is one of a single recording.
    said: added to the variant; ``EACH_ITS_OWN`` makes every amplitude, not only start states, the recording's own.
    """
    is_own = said == EACH_ITS_OWN
    acting = [number for number, part in enumerate(parts) if part is not None]
    blocks: list[Block] = []
    own: set[str] = set()
    index: list[list[int]] = [[] for _ in parts]
    at = 0
    for block in label.blocks:
        several = (is_own or block.name.startswith(START)) and len(parts) > 1
        for place, number in enumerate(acting):
            first = at + place * block.size if several else at
            index[number] += range(first, first + block.size)
        blocks.append(_of_each(block, [names[number] for number in acting]) if several else block)
        own |= {block.name} if is_own or block.name.startswith(START) else set()
        at += blocks[-1].size
    numbers = tuple(np.array(one, dtype=np.intp) for one in index)
    shift = offsets[acting[0]]
    nonlinear = tuple(
        replace(number, grid=number.grid + shift) if number.role == "instant" else number for number in label.nonlinear
    )
    size, given, samples = at, tuple(parts), tuple(counts)

    def columns(theta: Array) -> Columns:
        made = [None if part is None else part.columns(found.theta_of(k, theta)) for k, part in enumerate(given)]
        return JointColumns(parts=tuple(made), index=numbers, counts=samples, size=size)

    found = JointHypothesis(
        effect=label.effect,
        driver=label.driver,
        columns=columns,
        blocks=tuple(blocks),
        variant=", ".join(filter(None, (label.variant, said))),
        nonlinear=nonlinear,
        constants=label.constants,
        odds=label.odds,
        largest_nt=max(part.largest_nt for part in parts if part is not None),
        is_free=label.is_free,
        is_whole=label.is_whole,
        base=label.label,
        parts=given,
        index=numbers,
        own=frozenset(own),
        solo=solo,
        names=tuple(names),
        counts=samples,
        offsets=tuple(offsets),
    )
    return found


def _of_each(block: Block, names: Sequence[str]) -> Block:
    """A block that each of the recordings has itself."""
    labels = (tuple(names), *labels_of(block.shape, block.labels))
    return replace(block, shape=(len(names), *block.shape), labels=labels)


def joint(term: Term) -> JointHypothesis:
    """The hypothesis of a term of several recordings."""
    assert isinstance(term.hypothesis, JointHypothesis)
    return term.hypothesis


def like(form: JointHypothesis, among: Sequence[JointHypothesis]) -> JointHypothesis | None:
    """The same form on other recordings; of one recording alone, all numbers are common."""
    alike = [other for other in among if other.base == form.base and other.solo == form.solo]
    return next((other for other in alike if other.label == form.label or len(other.names) == 1), None)


def transferred(term: Term, form: JointHypothesis) -> Term:
    """A term on some of its recordings, whose form there is ``form``."""
    amplitudes = np.zeros(form.size)
    source = joint(term)
    for name, index in zip(form.names, form.index, strict=True):
        if len(index):
            amplitudes[index] = term.amplitudes[source.index[source.names.index(name)]]
    acting = next(number for number, index in enumerate(form.index) if len(index))
    theta = source.theta_of(source.names.index(form.names[acting]), term.theta)
    return Term(form, theta + (theta - form.theta_of(acting, theta)), amplitudes)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class FrozenColumns(Columns):
    """Columns of which some amplitudes are known: what those add is part of the field, and they are no unknowns.

    Parameters
    ----------
    base: all columns.
    known: amplitudes (k,) of all, zero where free.
    free: numbers of the free ones.
    """

    base: Columns
    known: Array
    free: NDArray[np.intp]

    def along(self, unit: Array) -> Array:
        """As ``Columns.along``, of the free ones."""
        return self.base.along(unit)[:, self.free]

    def components(self) -> Array | None:
        """As ``Columns.components``, of the free ones."""
        rows = self.base.components()
        return None if rows is None else rows[:, self.free]

    def sizes(self) -> Array:
        """As ``Columns.sizes``, of the free ones."""
        return self.base.sizes()[self.free]

    def field(self, amplitudes: Array) -> Array:
        """The body field (n, 3) of free amplitudes (k,) and known ones [nT]."""
        return self.base.field(self._all(amplitudes))

    def growth(self, amplitudes: Array) -> Array | float:
        """Growth of the magnitude (n,) of free amplitudes (k,) and known ones [nT]."""
        return self.base.growth(self._all(amplitudes))

    def _all(self, amplitudes: Array) -> Array:
        every = np.array(self.known)
        every[self.free] = amplitudes
        return every


def frozen(form: JointHypothesis, known: Term) -> JointHypothesis:
    """A form on one recording whose common numbers, nonlinear ones included, are those of a term of others."""
    (part,) = form.parts
    assert part is not None
    given = values_by_block(known)
    amplitudes, free, at = np.zeros(form.size), list[int](), 0
    for block in form.blocks:
        if block.name in form.own:
            free += range(at, at + block.size)
        else:
            amplitudes[at : at + block.size] = given[block.name].ravel()
        at += block.size
    numbers = np.array(free, dtype=np.intp)
    own = tuple(block for block in form.blocks if block.name in form.own)

    def columns(_: Array) -> Columns:
        return FrozenColumns(base=part.columns(known.theta), known=amplitudes, free=numbers)

    held = replace(part, columns=columns, blocks=own, nonlinear=())
    return joined(held, [held], form.names, form.counts, form.offsets)


def frozen_term(term: Term, known: Term) -> Term:
    """A term on one recording with the common numbers of ``known``."""
    form = frozen(joint(term), known)
    own = values_by_block(term)
    values = [own[block.name].ravel() for block in form.blocks]
    return Term(form, np.zeros(0), np.concatenate([*values, np.zeros(0)]))


def values_by_block(term: Term) -> dict[str, Array]:
    """Amplitudes of a term by the names of its blocks, in their shapes."""
    found, at = {}, 0
    for block in term.hypothesis.blocks:
        found[block.name] = term.amplitudes[at : at + block.size].reshape(block.shape)
        at += block.size
    return found


@dataclass(eq=False)
class Forms:
    """Every way the catalogue's effects may act on several recordings of one craft.

    A form is left out where a recording lacks what it needs (a channel, a place): what is common to all is asked.
    Left to each recording alone are tones and duties, whose phases are its own, and drivers whose pattern is guessed.
    Changes at an instant are forms of one recording each.

    Parameters
    ----------
    effects: the catalogue.
    constants: for each form, by its label, the constants that all recordings share.
    """

    effects: tuple[Effect, ...]
    constants: Mapping[str, Mapping[str, float]]
    _warmed: dict[Any, dict[Any, Any]] = field(default_factory=dict, repr=False)

    @classmethod
    def of(cls, effects: Sequence[Effect], parts: Sequence[Problem]) -> Forms:
        """The forms of these recordings, with the constants that suit them all."""
        found: dict[str, list[tuple[int, Mapping[str, float]]]] = {}
        for part in parts:
            for hypothesis in hypotheses_of(effects, part):
                found.setdefault(hypothesis.label, []).append((len(part.scene), hypothesis.constants))
        return cls(tuple(effects), {label: _common(each) for label, each in found.items()})

    def on(
        self, parts: Sequence[Problem], names: Sequence[str], only: Sequence[JointHypothesis] | None = None
    ) -> list[JointHypothesis]:
        """The forms on some of the recordings; ``only``: of those that are like these."""
        bases = None if only is None else {form.base for form in only}
        counts, offsets = [len(part.scene) for part in parts], offsets_s([part.scene for part in parts])
        found = []
        for effect in self.effects:
            if only is not None and all(form.effect != effect.name for form in only):
                continue
            each = [self._of_part(effect, part, name, bases) for part, name in zip(parts, names, strict=True)]
            for label in dict.fromkeys(label for one in each for label in one):
                found += _forms([one.get(label) for one in each], names, counts, offsets)
        return found if only is None else [form for form in found if any(like(one, [form]) for one in only)]

    def _of_part(self, effect: Effect, part: Problem, name: str, bases: set[str] | None) -> dict[str, Hypothesis]:
        """One recording's hypotheses by label, under the constants that all share."""
        plain = {form.label: form for form in hypotheses_of([effect], part)}
        by_constants: dict[tuple[tuple[str, float], ...], list[str]] = {}
        found = {}
        for label, constants in self.constants.items():
            if _effect_of(label) != effect.name or not (bases is None or label in bases):
                continue
            if label in plain and not constants:
                found[label] = plain[label]
            else:
                by_constants.setdefault(tuple(sorted(constants.items())), []).append(label)
        for key, labels in by_constants.items():
            warmed = self._warmed.setdefault((name, key), {})
            given = replace(part, scene=under(part.scene, started(part.scene, dict(key)), warmed))
            forms = {form.label: form for form in hypotheses_of([effect], given)}
            found |= {label: forms[label] for label in labels if label in forms}
        return found


def _forms(
    parts: Sequence[Hypothesis | None], names: Sequence[str], counts: Sequence[int], offsets: Sequence[float]
) -> list[JointHypothesis]:
    """What the recordings' own hypotheses of one label become together; nothing where one of them lacks it."""
    first = next(part for part in parts if part is not None)
    roles = {number.role for number in first.nonlinear}
    if roles & {"frequency", "period"} or first.proposals is not None:
        return []
    if "instant" in roles:
        alone = [[part if k == number else None for k in range(len(parts))] for number, part in enumerate(parts)]
        return [
            joined(part, one, names, counts, offsets, f"in {name}", solo=name)
            for part, one, name in zip(parts, alone, names, strict=True)
            if part is not None
        ]
    if any(part is None for part in parts) or len({_shape(part) for part in parts if part is not None}) > 1:
        return []
    together = [joined(first, parts, names, counts, offsets)]
    return together if len(parts) == 1 else [*together, joined(first, parts, names, counts, offsets, EACH_ITS_OWN)]


def started(scene: Scene, constants: Mapping[str, float]) -> Mapping[str, float]:
    """Constants with those of a recording's start: what light heats first begins in the light of the first sample."""
    if "mean_light" not in constants or scene.lit is None:
        return constants
    return {**constants, "skin_start": float(scene.lit[0]) - constants["mean_light"]}


def _effect_of(label: str) -> str:
    return label.partition(" by ")[0].partition("[")[0]


def _shape(form: Hypothesis) -> tuple[tuple[str, tuple[int, ...]], ...]:
    return tuple((block.name, block.shape) for block in form.blocks)


def _common(each: Sequence[tuple[int, Mapping[str, float]]]) -> Mapping[str, float]:
    """The constants of one form that suit all recordings, from (samples, constants) of those that have it."""
    found: dict[str, float] = {}
    for kind in _NUMBERED:
        used = {
            v for _, one in each for k, v in one.items() if k.startswith(f"{kind}_") and k[len(kind) + 1 :].isdigit()
        }
        found |= {f"{kind}_{index}": value for index, value in enumerate(sorted(used))}
    for name in dict.fromkeys(name for _, one in each for name in one):
        if name in found or name in _OF_ONE_RECORDING or _is_numbered(name):
            continue
        values = [(samples, one[name]) for samples, one in each if name in one]
        if name in _LARGEST:
            found[name] = max(value for _, value in values)
        else:
            found[name] = sum(samples * value for samples, value in values) / sum(samples for samples, _ in values)
    return found


def _is_numbered(name: str) -> bool:
    kind, _, number = name.rpartition("_")
    return kind in _NUMBERED and number.isdigit()
