"""Permeable parts have hysteresis: play operators of the field that acts."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np

from magcal_service.model import Array
from magcal_service.physics.acting import ActsOn
from magcal_service.physics.columns import Columns, along_axes
from magcal_service.physics.interface import Block, Effect, Hypothesis, Nonlinear
from magcal_service.physics.saying import AXES
from magcal_service.physics.scene.recent import Recent
from magcal_service.physics.scene.scene import Scene

_WIDTHS: Final = np.array([0.05, 0.15, 0.3, 0.5, 0.8])

_MOST_KNOWN: Final = 16  # answers kept for what is tried again: two forms, on a grid and about its best

_MANY: Final = 64
"""Samples from which on all of them at once, in log2(n) passes, are faster than one after another."""


def play(values: Array, half_width: float, start: Array | float = 0.0) -> Array:
    """The play operator (n, 3) of each axis: it follows the input once the slack of +-half_width is used up.

    ``start`` is its state before the first sample.

    Source: Visintin 1994, Differential Models of Hysteresis, chapter III.
    """
    before = np.broadcast_to(start, values.shape[1:])
    if len(values) < _MANY:
        return np.stack([_stepped(*each, half_width) for each in zip(values.T, before.tolist(), strict=True)], axis=1)
    low, high = values - half_width, values + half_width
    span = 1
    while span < len(values):  # maps x -> min(max(x, low), high) of 1, 2, 4 ... samples one after another
        lower, upper = low[span:], high[span:]
        if np.array_equal(lower, upper):  # what was before no longer matters
            break
        found = [np.minimum(np.maximum(edge[:-span], lower), upper) for edge in (low, high)]
        low[span:], high[span:] = found
        span *= 2
    return np.asarray(np.clip(before, low, high))


def _stepped(values: Array, state: float, half_width: float) -> Array:
    """One axis (n,), sample by sample."""
    found = []
    for value in values.tolist():
        state = min(max(state, value - half_width), value + half_width)
        found.append(state)
    return np.array(found)


def _hypotheses(scene: Scene) -> Iterator[Hypothesis]:
    field = scene.calibrated_nt
    scale = scene.constant("scale_nt", float(np.percentile(np.abs(field), 99)))
    known = Recent[float, Array](_MOST_KNOWN)

    def lag(share: float) -> Array:
        answer = play(field, share * scale, scene.begin("answer", 0.0))
        scene.keep("answer", answer)
        return np.asarray(answer - field)

    def lagging(share: float) -> Array:
        return known.once(share, lambda: lag(share))

    def own(theta: Array) -> Columns:
        return Columns(axes=lagging(float(theta[0]))[None])

    def rods(theta: Array) -> Columns:
        return along_axes(lagging(float(theta[0])))

    width = Nonlinear("half_width", "1", _WIDTHS)
    constants = {"scale_nt": scale}
    yield Hypothesis("hysteresis", "none", own, (Block("share", "1"),), "", (width,), constants, is_free=True)
    block = Block("share_matrix", "1", (3, 3), labels=(("rod along x", "rod along y", "rod along z"), AXES))
    yield Hypothesis("hysteresis", "none", rods, (block,), "rods along the axes", (width,), constants, is_free=True)


EFFECT = Effect(
    name="hysteresis",
    acts_on=ActsOn.FIELD,
    title="permeable parts remember the field",
    equation="d_i = share_i (P_r[B_i] - B_i), P_r the play operator of half width r",
    units={"share": "1", "share_matrix": "1", "half_width": "1", "scale_nt": "nT"},
    prior=(10.0, 2000.0),
    valid="one play operator stands for the part's spread of them; sampled several times a turn",
    confused_with=("cubic_response", "response_lag", "axis_skew"),
    separated_by="the two branches: the same field approached from both sides",
    source="Visintin 1994 (play operator); Jiles & Atherton 1986; 0.1-5 % for soft magnetic parts",
    says=(
        "Permeable parts hold back {share.percent} of the field's turns on {share.place}, within "
        "{half_width.percent} of the largest field.",
        "Permeable rods hold back {share_matrix.percent} of the field's turns ({share_matrix.place}), within "
        "{half_width.percent} of the largest field.",
    ),
    hypotheses=lambda scene: tuple(_hypotheses(scene)),
)
