"""A form on one recording whose common numbers are known from the others: what is left free is the recording's own."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from magcal_service.diagnosis.joint.forms import JointHypothesis, joined, joint
from magcal_service.diagnosis.problem import Term
from magcal_service.model import Array
from magcal_service.physics.columns import Columns


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

    def moves_s(free: Array) -> Array | float:
        assert part.moves_s is not None
        every = np.array(amplitudes)
        every[numbers] = free
        return part.moves_s(every)

    moved = None if part.moves_s is None else moves_s
    held = replace(part, columns=columns, blocks=own, nonlinear=(), samples_in=None, moves_s=moved)
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
