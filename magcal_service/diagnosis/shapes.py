"""Structure without a name: families of columns without any physics.

They answer one question, whether anything is left in a residual, and where: over time, at a frequency, along the field
in the body, with the spin's phase, with the Sun, with a channel.  What they alone explain is unknown.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Final

import numpy as np

from magcal_service.diagnosis.groups import Groups
from magcal_service.diagnosis.problem import Problem
from magcal_service.model import Array
from magcal_service.physics.columns import Columns, along_axes
from magcal_service.physics.drivers.between import smooth_field, smoothing
from magcal_service.physics.scene.scene import Scene

_BINS: Final = 10
"""Ranges of a channel; choice: a tenth of the samples each, and a course that a line or a step does not fit still
shows.
"""

_SHORTEST_S: Final = 240.0
"""Stretch of time in which a line may have an amplitude of its own [s]; choice: as the longest transient."""

_MOST_COURSES: Final = 48
"""Such stretches at the most: six columns each, so that a family stays under 300."""


@dataclass(frozen=True, slots=True, eq=False)
class Shape:
    """A family without a name.

    Parameters
    ----------
    name, says: of the family, and what it would mean.
    columns: its columns (m, k) as a function of the field's direction (n, 3).
    terms: names of its signals, where they have any.
    of_attitude: whether it is a function of where the craft points.
    groups: of rows, where each of its columns is zero outside of one.
    own: then the columns (n, a) of every group, as a function of the same.
    """

    name: str
    says: str
    columns: Callable[[Array], Array]
    terms: tuple[str, ...] = ()
    of_attitude: bool = False
    groups: Groups | None = None
    own: Callable[[Array], Array] = np.asarray


def shapes(problem: Problem, phase: Array | None, line_hz: float | None = None) -> Iterator[Shape]:
    """Every family that this recording has the means for; ``line_hz`` is a line to resolve further."""
    scene = problem.scene
    elapsed = scene.time_s - scene.time_s[0]
    share = elapsed / max(float(elapsed[-1]), 1.0)
    for count in (12, 40):
        says = "a body-fixed field that changes over time"
        yield _body(problem, f"slow {count}", says, partial(_cosines, share, count))
    if not problem.is_vector:
        for count in (24, 160):
            says = "the field's magnitude, in stretches of time"
            yield _grouped(f"time {count}", says, _in_windows(share, count), _ones)
    says = "a body-fixed field that follows the field itself"
    follows = body_shape(problem, "field", says, *_products(without_noise(scene)))
    yield replace(follows, of_attitude=True)
    if line_hz is not None:
        angle = 2.0 * np.pi * line_hz * scene.time_s
        count = int(np.clip(float(elapsed[-1]) / _SHORTEST_S, 4, _MOST_COURSES))
        says = f"a body-fixed oscillation near {line_hz:.4g} Hz that comes and goes"
        if problem.is_vector:
            yield _body(problem, "line", says, partial(_swinging, angle, _in_windows(share, count)))
        else:
            swing = np.stack([np.cos(angle), np.sin(angle)], axis=1)
            yield _grouped("line", says, _in_windows(share, count), along_axes(swing).along)
    if phase is not None:
        turn = np.stack([f(k * phase) for k in (1, 2, 3) for f in (np.cos, np.sin)], axis=1)
        spinning = body_shape(problem, "spin phase", "a body-fixed field that follows the spin's phase", turn)
        yield replace(spinning, of_attitude=True)
    if scene.sun_body is not None and scene.lit is not None:
        sun = np.concatenate([scene.sun_body, np.maximum(scene.sun_body, 0.0), np.ones((len(scene), 1))], axis=1)
        yield body_shape(problem, "sunlight", "a body-fixed field that follows the Sun", sun * scene.lit[:, None])
    if scene.position_ecef_km is not None and not problem.is_vector:
        places = _places(scene.position_ecef_km)
        if places is not None:
            yield _grouped("place", "the field's magnitude, by place on the Earth", places, _ones)
    for channel in scene.channels.values():
        for index, values in enumerate(channel.values.T):
            ranges = scene.once(f"ranges of {channel.name} {index}", partial(_quantiles, values))
            if ranges is not None:
                name = f"channel {channel.name}" + (f" {index + 1}" if channel.values.shape[1] > 1 else "")
                says = f"a body-fixed field that follows {channel.name}"
                yield in_groups(problem, name, says, ranges)


def products_of_two(problem: Problem) -> Columns:
    """The products of two components of the field, of unit rms, each on each axis."""
    signals, names = _products(without_noise(problem.scene))
    return along_axes(signals[:, [number for number, name in enumerate(names) if name.count(" ") == 1]])


def body_shape(problem: Problem, name: str, says: str, signals: Array, terms: tuple[str, ...] = ()) -> Shape:
    """A family of signals (n, s), each along each axis of the body."""
    return _body(problem, name, says, lambda: signals, terms)


def in_groups(problem: Problem, name: str, says: str, groups: Groups) -> Shape:
    """A family of a field fixed in the body in each of some groups of rows."""
    if problem.is_vector:
        return _body(problem, name, says, partial(groups.columns, _ones(problem.scene.time_s)))
    return _grouped(name, says, groups, np.asarray)


def _body(problem: Problem, name: str, says: str, make: Callable[[], Array], terms: tuple[str, ...] = ()) -> Shape:
    """As ``body_shape``; signals are made whenever columns are: those of all families are too many to hold."""

    def columns(unit: Array) -> Array:
        rows = problem.rows(along_axes(make()), unit)
        assert rows is not None
        return rows

    return Shape(name, says, columns, terms)


def _grouped(name: str, says: str, groups: Groups, own: Callable[[Array], Array]) -> Shape:
    """A family each of whose columns is one of ``own`` in one group's rows."""
    return Shape(name, says, lambda unit: groups.columns(own(unit)), groups=groups, own=own)


def plain_shape(name: str, says: str, rows: Array) -> Shape:
    """A family of columns along the field (n, k)."""
    return Shape(name, says, lambda _: rows)


def _cosines(share: Array, count: int) -> Array:
    """(n, count) smooth courses over the recording."""
    return np.asarray(np.cos(np.pi * share[:, None] * np.arange(1, count + 1)))


def _swinging(angle: Array, windows: Groups) -> Array:
    """(n, 2 g) an oscillation in each window, as cosine and sine."""
    courses = windows.columns(_ones(angle))
    return np.concatenate([courses * part[:, None] for part in (np.cos(angle), np.sin(angle))], axis=1)


def _in_windows(share: Array, count: int) -> Groups:
    """Even windows of the recording, as far as they are used."""
    number = np.minimum((share * count).astype(np.intp), count - 1)
    return Groups.of(number, np.unique(number))


def _ones(rows: Array) -> Array:
    """(n, 1) for so many rows."""
    return np.ones((len(rows), 1))


def without_noise(scene: Scene) -> Array:
    """The field's course (n, 3), as measured, without noise as far as the craft turns slowly [nT].

    Where that is a curve, as on a craft that keeps its attitude, products that vanish on it follow what noise leads off
    it; and if the axes' noises differ, that goes along with the residual's.
    """
    return smooth_field(scene, smoothing(scene), scene.clean_field_nt)


def _products(field_nt: Array) -> tuple[Array, tuple[str, ...]]:
    """Second- and third-degree products of the field's components, each of unit rms, with their names."""
    scaled = field_nt / max(float(np.sqrt(np.mean(field_nt**2))), 1.0)
    found, names = [], []
    for i in range(3):
        for j in range(i, 3):
            found.append(scaled[:, i] * scaled[:, j])
            names.append("B" + "xyz"[i] + " B" + "xyz"[j])
            for k in range(j, 3):
                found.append(scaled[:, i] * scaled[:, j] * scaled[:, k])
                names.append(f"{names[-1 - (k - j)]} B{'xyz'[k]}")
    signals = np.stack(found, axis=1)
    return signals - signals.mean(axis=0), tuple(names)


def _quantiles(values: Array) -> Groups | None:
    """Nine of ten ranges that hold equally many samples, as far as they are used; None for a constant channel."""
    edges = np.unique(np.quantile(values, np.linspace(0.0, 1.0, _BINS + 1)[1:-1]))
    number = np.searchsorted(edges, values, side="right")
    used = np.unique(number)
    return None if len(used) < 2 else Groups.of(number, used[:-1])


def _places(position_ecef_km: Array) -> Groups | None:
    """The squares of about 15 degrees that were visited; None of fewer than two."""
    x, y, z = position_ecef_km.T
    latitude = np.degrees(np.arctan2(z, np.hypot(x, y)))
    longitude = np.degrees(np.arctan2(y, x))
    number = (np.floor(latitude / 15.0) * 100.0 + np.floor(longitude / 15.0)).astype(np.int16)
    used, counts = np.unique(number, return_counts=True)
    kept = used[counts >= 20][:200]
    return Groups.of(number, kept) if len(kept) > 1 else None
