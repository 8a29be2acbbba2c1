"""Permeable parts have hysteresis: they follow the field that acts late, and by the way it came."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Final

import numpy as np

from magcal_service.model import Array
from magcal_service.physics.acting import ActsOn
from magcal_service.physics.columns import Columns, along_axes
from magcal_service.physics.drivers.between import is_coarse, smooth_field, smoothing, with_turning_points
from magcal_service.physics.interface import Block, Effect, Hypothesis, Nonlinear
from magcal_service.physics.saying import AXES
from magcal_service.physics.scene.recent import Recent
from magcal_service.physics.scene.scene import Scene
from magcal_service.physics.scene.sunlight import carried
from magcal_service.physics.segments import Segments, Sums

_WIDTHS: Final = np.array([0.05, 0.15, 0.3, 0.5, 0.8])
_FORGETS: Final = np.array([0.02, 0.06, 0.15, 0.4, 1.0])
"""Shares of the largest field: of 50 uT 0.8 to 40 A/m, about the coercive fields of mu-metal and of annealed iron
(Bozorth 1951)."""

_RODS, _STRIP, _GRADUAL = "rods along the axes", "one strip", "gradual"

_TILTS: Final = np.linspace(-90.0, 270.0, 13)
_TURNS: Final = np.linspace(-360.0, 360.0, 25)
"""Directions of a strip [deg]: steps of 30 to begin with, further than once around so that none is at an end."""

_DIRECTIONS: Final = [
    (math.degrees(math.acos(1.0 - (number + 0.5) / 20.0)), (137.508 * number) % 360.0) for number in range(20)
]
"""Tilts and turns [deg] of 20 directions on half of the sphere, by the golden angle: about 30 degrees apart."""

_WIDTHS_TRIED: Final = 2  # at which rods along the axes fit best; choice: a strip's is near to theirs
_STRIPS_TRIED: Final = 4  # best of the directions at those widths, from which the optimum is sought

_BETWEEN: Final = "turns_between"  # constant: 1 where turning points between the samples are followed
_SMOOTHED: Final = "smoothed_over"  # constant: samples before and after that the field is smoothed over

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
    edges = values - half_width, values + half_width
    spare, span = (np.empty_like(values), np.empty_like(values)), 1
    while span < len(values):  # maps x -> min(max(x, low), high) of 1, 2, 4 ... samples one after another
        low, high = edges
        if np.array_equal(low[span:], high[span:]):  # what was before no longer matters
            break
        for edge, found in zip(edges, spare, strict=True):
            found[:span], later = edge[:span], found[span:]
            np.minimum(np.maximum(edge[:-span], low[span:], out=later), high[span:], out=later)
        edges, spare, span = spare, edges, 2 * span
    return np.asarray(np.clip(before, *edges))


def _stepped(values: Array, state: float, half_width: float) -> Array:
    """One axis (n,), sample by sample."""
    found = []
    for value in values.tolist():
        state = min(max(state, value - half_width), value + half_width)
        found.append(state)
    return np.array(found)


def gradual(values: Array, length: float, start: Array | float = 0.0) -> Array:
    """What gives way little by little (n, k): dz = dh - |dh| z / length, along each course h (n, k).

    It is that part of the field that is held back, at most ``length``, and forgets over as much.  Exact for a course
    that goes one way from one value to the next.  Source: Coleman & Hodgdon 1987, with a linear anhysteretic curve;
    the model of Bouc 1967 and Wen 1976 with exponent 1; Dahl 1968.
    """
    steps = np.diff(values, axis=0)
    kept = np.exp(-np.abs(steps) / length)
    answer = np.empty_like(values)
    answer[0] = start
    if len(steps):
        answer[1:] = carried(kept, np.sign(steps) * length * (1.0 - kept), answer[0])
    return answer


@dataclass(eq=False)
class _Rods:
    """What rods along the axes add at a share of 1: minus the field that they do not follow yet.

    Parameters
    ----------
    scale_nt: the largest field, that widths are shares of.
    half_window: samples that a whole recording's field is smoothed over; a stream's is taken as it comes.
    is_between: whether turning points between the samples are followed.
    is_gradual: give way little by little, else all at once.
    """

    scene: Scene
    scale_nt: float
    half_window: int = 0
    is_between: bool = False
    is_gradual: bool = False
    _known: Recent[float, Array] = field(default_factory=lambda: Recent(_MOST_KNOWN), init=False)

    @cached_property
    def course(self) -> Array:
        """(n, 3) field along each rod, or (2 n - 1, 3) with what lies between the samples."""
        vectors = smooth_field(self.scene, self.half_window) if self.scene.memory is None else self.scene.calibrated_nt
        if self.is_between and len(vectors) > 1:
            return with_turning_points(self.scene, vectors)
        return vectors

    def lagging(self, share: float) -> Array:
        """(n, 3) [nT], for a half width as a share of the largest field."""
        return self._known.once(share, lambda: self._lagging(share))

    def _lagging(self, share: float) -> Array:
        return self._answer(self.course, share)

    def _answer(self, course: Array, share: float) -> Array:
        """What rods add (n, k) at a share of 1 that meet each column of a course."""
        every = 2 if self.is_between and len(self.scene) > 1 else 1
        begin, width = self.scene.begin("answer", 0.0), share * self.scale_nt
        state = (gradual if self.is_gradual else play)(course, width, begin)[::every]
        self.scene.keep("answer", state)
        return -state if self.is_gradual else np.asarray(state - course[::every])

    def own(self, theta: Array) -> Columns:
        """Each along its own axis."""
        return Columns(axes=self.lagging(float(theta[0]))[None])

    def everywhere(self, theta: Array) -> Columns:
        """Each along every axis."""
        return along_axes(self.lagging(float(theta[0])))

    def strip(self, theta: Array) -> Columns:
        """One of any direction, along every axis."""
        share, tilt_deg, turn_deg = (float(number) for number in theta)
        return along_axes(self._answer(self.course @ _direction(tilt_deg, turn_deg)[:, None], share)[:, 0])

    def strips(self, sums: Sums, shares: Array) -> Array:
        """Numbers (q, 3) of the best strips of the widths (w,) at which rods fit best: of a grid of directions, and of
        the one that such rods have in common."""
        whole = np.zeros(1, dtype=np.intp)
        rods = [sums(self.everywhere(np.array([share])), whole) for share in shares.tolist()]
        wide = np.argsort([float(held.drops[0]) for held in rods])[: -_WIDTHS_TRIED - 1 : -1]
        tried = [
            np.array([shares[at], *each]) for at in wide for each in (*_DIRECTIONS, self._common(rods[at], shares[at]))
        ]
        drops = [float(sums(self.strip(theta), whole).drops[0]) for theta in tried]
        return np.array(tried)[np.argsort(drops)[: -_STRIPS_TRIED - 1 : -1]]

    def _common(self, held: Segments, share: float) -> tuple[float, float]:
        """Tilt and turn [deg] of the strip that is most like the rods that fit best at a half width."""
        normal = held.normal[0] - held.inside[0].T @ held.inside[0]
        rms = np.sqrt(np.mean((self.lagging(share)[:, :, None] * self.scene.unit[:, None, :]) ** 2, axis=0))
        matrix = np.linalg.lstsq(normal, held.right[0], rcond=1e-9)[0].reshape(3, 3) / np.maximum(rms, 1e-9)
        x, y, z = np.linalg.svd(matrix)[0][:, 0].tolist()
        return math.degrees(math.acos(min(max(z, -1.0), 1.0))), math.degrees(math.atan2(y, x))


def _direction(tilt_deg: float, turn_deg: float) -> Array:
    """(3,) unit vector so far off z, and turned so far about it from x."""
    tilt, turn = math.radians(tilt_deg), math.radians(turn_deg)
    return np.array([math.sin(tilt) * math.cos(turn), math.sin(tilt) * math.sin(turn), math.cos(tilt)])


def _hypotheses(scene: Scene) -> Iterator[Hypothesis]:
    scale = scene.constant("scale_nt", float(np.percentile(np.abs(scene.calibrated_nt), 99)))
    between = scene.constant(_BETWEEN, 0.0 if scene.is_given else float(is_coarse(scene)))
    smoothed = scene.constant(_SMOOTHED, 0.0 if scene.is_given else float(smoothing(scene)))
    added = {name: value for name, value in ((_BETWEEN, between), (_SMOOTHED, smoothed)) if value}
    width, forgets = (Nonlinear("half_width", "1", grid, spans=True) for grid in (_WIDTHS, _FORGETS))
    each = Block("share", "1")
    matrix = Block("share_matrix", "1", (3, 3), labels=(("rod along x", "rod along y", "rod along z"), AXES))
    sharp = _Rods(scene, scale)
    yield _form("", sharp.own, each, width, {"scale_nt": scale})
    yield _form(_RODS, sharp.everywhere, matrix, width, {"scale_nt": scale})
    yield _strip(_STRIP, _RODS, sharp, width, {"scale_nt": scale})
    if between and scene.rate_body is None:
        return
    constants = {"scale_nt": scale, **added}
    soft = _Rods(scene, scale, int(smoothed), bool(between), is_gradual=True)
    yield _form(_GRADUAL, soft.own, each, forgets, constants)
    yield _form(f"{_GRADUAL}, {_RODS}", soft.everywhere, matrix, forgets, constants)
    yield _strip(f"{_GRADUAL}, {_STRIP}", f"{_GRADUAL}, {_RODS}", soft, forgets, constants)


def _form(
    variant: str,
    columns: Callable[[Array], Columns],
    block: Block,
    width: Nonlinear,
    constants: Mapping[str, float],
) -> Hypothesis:
    return Hypothesis("hysteresis", "none", columns, (block,), variant, (width,), constants, is_free=True)


def _strip(variant: str, rods: str, parts: _Rods, width: Nonlinear, constants: Mapping[str, float]) -> Hypothesis:
    """One strip of any direction, tried where rods along the axes come near the best."""
    form = _form(variant, parts.strip, Block("strip", "1"), width, constants)
    tilt, turn = Nonlinear("tilt_deg", "deg", _TILTS), Nonlinear("turn_deg", "deg", _TURNS)
    return replace(
        form,
        nonlinear=(width, tilt, turn),
        proposals=lambda sums, grids: parts.strips(sums, grids[0]),
        refines=replace(form, variant=rods).label,
        as_well=("cubic_response",),  # what bends along a slanted direction without a memory, of which there is no form
    )


EFFECT = Effect(
    name="hysteresis",
    acts_on=ActsOn.FIELD,
    title="permeable parts remember the field",
    equation=(
        "d_i = share_i (P_r[B_i] - B_i), P_r the play operator of half width r; gradual: d_i = -share_i z_i, "
        "dz_i = dB_i - |dB_i| z_i / r; rods and strips along every axis"
    ),
    units={
        "share": "1",
        "share_matrix": "1",
        "strip": "1",
        "half_width": "1",
        "tilt_deg": "deg",
        "turn_deg": "deg",
        "scale_nt": "nT",
    },
    prior=(10.0, 2000.0),
    valid=(
        "one width stands for a part's spread of them: of four play operators the gradual form leaves a twentieth of "
        "what is seen; sampled several times a turn, or at a known rate; live, noise is not smoothed first"
    ),
    confused_with=("cubic_response", "response_lag", "axis_skew"),
    separated_by="the two branches: the same field approached from both sides",
    source=(
        "Visintin 1994 (play operator); Coleman & Hodgdon 1987, Bouc 1967, Wen 1976 (gradual); Jiles & Atherton 1986; "
        "0.1-5 % for soft magnetic parts"
    ),
    says=(
        "Permeable parts hold back {share.percent} of the field's turns on {share.place}, within "
        "{half_width.percent} of the largest field.",
        "Permeable rods hold back {share_matrix.percent} of the field's turns ({share_matrix.place}), within "
        "{half_width.percent} of the largest field.",
        "A permeable strip, {tilt_deg.size} off axis z and turned {turn_deg.signed} about it from x, holds back "
        "{strip.percent} of the field's turns along it ({strip.place}), within {half_width.percent} of the largest "
        "field.",
    ),
    hypotheses=lambda scene: tuple(_hypotheses(scene)),
)
