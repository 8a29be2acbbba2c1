"""Hypotheses that act on several recordings: which of their numbers are common, and which each recording has itself."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from magcal_service.diagnosis.problem import Term
from magcal_service.model import Array
from magcal_service.physics.columns import Columns
from magcal_service.physics.interface import Block, Hypothesis, Proposals, loose
from magcal_service.physics.saying import labels_of
from magcal_service.physics.segments import Segments, Sums

OF_CHANGES: Final = frozenset({"instant", "edge"})
"""Roles of times of a change, which happens in one recording: it has them on its own clock, the problem on the
common one."""

_OF_TIME: Final = OF_CHANGES | {"loose"}

OF_THE_FORM: Final = (
    "effect",
    "driver",
    "constants",
    "is_free",
    "by_samples",
    "is_whole",
    "in_place",
    "at_once",
    "needs_vectors",
)
"""What a hypothesis has by its form, alike in all recordings; all else is put together of the recordings' own."""

EACH_ITS_OWN: Final = "each its own"
"""Added to the variant of a form whose amplitudes differ from recording to recording."""


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
    timed: indices of the nonlinear numbers that are times, whatever their role has become.
    """

    base: str
    parts: tuple[Hypothesis | None, ...]
    index: tuple[NDArray[np.intp], ...]
    own: frozenset[str]
    solo: str
    names: tuple[str, ...]
    counts: tuple[int, ...]
    offsets: tuple[float, ...]
    timed: tuple[int, ...]

    @property
    def common(self) -> tuple[Block, ...]:
        """Blocks that all recordings share."""
        return () if self.solo else tuple(block for block in self.blocks if block.name not in self.own)

    @property
    def is_each_its_own(self) -> bool:
        """Whether every amplitude differs from recording to recording."""
        return self.variant.endswith(EACH_ITS_OWN)

    def acts_on(self, name: str) -> bool:
        """Whether the effect acts on a recording."""
        return self.parts[self.names.index(name)] is not None

    def meets(self, other: JointHypothesis) -> bool:
        """Whether both act on one of the recordings."""
        return any(self.acts_on(name) and other.acts_on(name) for name in self.names)

    def theta_of(self, number: int, theta: Array) -> Array:
        """The nonlinear numbers (m,) on the clock of one recording."""
        found = np.array(theta)
        found[list(self.timed)] -= self.offsets[number]
        return found

    def loosened(self) -> JointHypothesis:
        """As ``Hypothesis.loosened``, in every recording."""
        parts = tuple(None if part is None else part.loosened() for part in self.parts)
        return replace(self, nonlinear=loose(self.nonlinear), parts=parts)

    def holding(self, *held: int) -> JointHypothesis:
        """As ``Hypothesis.holding``, in every recording."""
        found = Hypothesis.holding(self, *held)
        assert isinstance(found, JointHypothesis)
        return replace(found, parts=tuple(None if part is None else part.holding(*held) for part in self.parts))

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
    acting = [number for number, part in enumerate(parts) if part is not None]
    own = frozenset(block.name for block in label.blocks if said == EACH_ITS_OWN or block.is_start)
    blocks, index = _laid_out(label.blocks, own if len(parts) > 1 else frozenset(), acting, names)
    shift = offsets[acting[0]]
    nonlinear = tuple(
        replace(number, grid=number.grid + shift) if number.role in _OF_TIME else number for number in label.nonlinear
    )
    size, given, samples = sum(block.size for block in blocks), tuple(parts), tuple(counts)

    def columns(theta: Array) -> Columns:
        made = [None if part is None else part.columns(found.theta_of(k, theta)) for k, part in enumerate(given)]
        return JointColumns(parts=tuple(made), index=index, counts=samples, size=size)

    found = JointHypothesis(
        **{name: getattr(label, name) for name in OF_THE_FORM},
        **_together(parts, counts),
        columns=columns,
        blocks=blocks,
        variant=", ".join(filter(None, (label.variant, said))),
        nonlinear=nonlinear,
        proposals=_proposals(label, acting, samples, shift),
        refines=_also(label.refines, label.effect, said),
        samples_in=_samples_in(given, lambda k, theta: found.theta_of(k, theta)),
        moves_s=_moves_s(given, index, samples),
        base=label.label,
        parts=given,
        index=index,
        own=own,
        solo=solo,
        names=tuple(names),
        counts=samples,
        offsets=tuple(offsets),
        timed=tuple(k for k, number in enumerate(label.nonlinear) if number.role in _OF_TIME),
    )
    return found


def _together(parts: Sequence[Hypothesis | None], counts: Sequence[int]) -> dict[str, Any]:
    """What the recordings' own hypotheses say each by itself, as it holds of all: a doubt in one of them is one of all.

    Parameters
    ----------
    parts: of each recording, None where the effect does not act on it; ``counts``: its samples.
    """
    acting = [part for part in parts if part is not None]
    least = sum(n * part.least_nt**2 for part, n in zip(parts, counts, strict=True) if part is not None)
    said = dict.fromkeys(part.imitated_by for part in acting if part.imitated_by)
    return {
        "odds": max(part.odds for part in acting),
        "largest_nt": max(part.largest_nt for part in acting),
        "least_nt": math.sqrt(least / sum(counts)),  # as the residual's rms, over the samples of all
        "inexact": max(part.inexact for part in acting),
        "imitated_by": " or ".join(said),
        "if_none": acting[0].if_none,  # of one label and its constants, so of the same amplitudes
        **{
            name: tuple(dict.fromkeys(other for part in acting for other in getattr(part, name)))
            for name in ("as_well", "if_completed", "if_along")
        },
    }


def _also(label: str, effect: str, said: str) -> str:
    """The label of a form of an effect with more added to its variant; empty where there is none."""
    form = label.removeprefix(effect)
    variant, _, driver = form[1:].rpartition("]") if form.startswith("[") else ("", "", form)
    return f"{effect}[{', '.join(filter(None, (variant, said)))}]{driver}" if label and said else label


def _samples_in(
    parts: Sequence[Hypothesis | None], theta_of: Callable[[int, Array], Array]
) -> Callable[[Array], int] | None:
    """How many samples of all recordings see a change come about; None where it is none."""
    each = [(k, part.samples_in) for k, part in enumerate(parts) if part is not None and part.samples_in is not None]
    return (lambda theta: sum(count(theta_of(k, theta)) for k, count in each)) if each else None


def _moves_s(
    parts: Sequence[Hypothesis | None], index: Sequence[NDArray[np.intp]], counts: Sequence[int]
) -> Callable[[Array], Array] | None:
    """How far amplitudes of all move the reference [s], one number a sample of all recordings; None: they do not."""
    moves = [None if part is None else part.moves_s for part in parts]
    if all(one is None for one in moves):
        return None

    def moves_s(amplitudes: Array) -> Array:
        rows = zip(moves, index, counts, strict=True)
        return np.concatenate([np.zeros(n) + (0.0 if one is None else one(amplitudes[at])) for one, at, n in rows])

    return moves_s


def _proposals(label: Hypothesis, acting: Sequence[int], counts: Sequence[int], shift: float) -> Proposals | None:
    """What the one recording on which a hypothesis acts proposes, on the common clock; None where it proposes nothing.

    ``shift`` is added to its time there [s].
    """
    propose = label.proposals
    if propose is None:
        return None
    (number,) = acting
    on_clock = np.array([shift * (one.role in _OF_TIME) for one in label.nonlinear])

    def proposals(sums: Sums, grids: Sequence[Array]) -> Array:
        def own_sums(made: Columns, rows: NDArray[np.intp]) -> Segments:
            width = len(made.sizes())
            every = tuple(made if k == number else None for k in range(len(counts)))
            places = tuple(np.arange(width if k == number else 0) for k in range(len(counts)))
            columns = JointColumns(parts=every, index=places, counts=tuple(counts), size=width)
            return sums(columns, rows + sum(counts[:number]))

        return np.asarray(propose(own_sums, grids) + on_clock)

    return proposals


def _laid_out(
    blocks: Sequence[Block], several: frozenset[str], acting: Sequence[int], names: Sequence[str]
) -> tuple[tuple[Block, ...], tuple[NDArray[np.intp], ...]]:
    """The blocks one after another, those named in ``several`` once for each acting recording.

    Returns them, and for each recording where its amplitudes are; nowhere for one on which nothing acts.
    """
    laid: list[Block] = []
    index: list[list[int]] = [[] for _ in names]
    at = 0
    for block in blocks:
        is_several = block.name in several
        for place, number in enumerate(acting):
            first = at + place * block.size if is_several else at
            index[number] += range(first, first + block.size)
        laid.append(_of_each(block, [names[number] for number in acting]) if is_several else block)
        at += laid[-1].size
    return tuple(laid), tuple(np.array(one, dtype=np.intp) for one in index)


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
