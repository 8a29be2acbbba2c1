"""The Sun as the telemetry shows it: where light and shadow come at other times than the stated date has them.

What follows light without a record of it is inferred from the Earth's shadow, and that from the date.  A recorder
whose date is off by weeks, or a simulation with a Sun of its own, has its shadow elsewhere on the orbit; a disturbance
by light then fits nothing, or something that it is not.  A current or a temperature tells: the Sun is moved along the
ecliptic until its shadow explains the channel, and is believed there only where the channel leaves no doubt.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from magcal_service.model import Array, field_jacobian
from magcal_service.physics.effects.sun_disturbance import harmonics
from magcal_service.physics.scene import sunlight
from magcal_service.physics.scene.scene import Scene

_BINS: Final = 600
"""Means that a channel is reduced to: 30 s of a recording of five hours, where the shadow's edge moves 0.1 deg a s."""

_STEP_DEG: Final = 2.0
"""Steps of the Sun along the ecliptic; the shadow's edges move by as much, half a minute of an orbit."""

_FINE_DEG: Final = 0.25
"""Steps of the Sun around the best of those: 4 s of an orbit, less than a bin."""

_RESPONSES_S: Final = (
    (0.0, 0.0),
    (150.0, 0.0),
    (400.0, 0.0),
    (800.0, 0.0),
    (1500.0, 0.0),
    (4000.0, 0.0),
    (400.0, 150.0),
    (1000.0, 400.0),
    (2500.0, 1000.0),
)
"""Time constants of what answers to light, and of a skin before it: a current, a panel, a board, the middle."""

_HERE_DEG: Final = 6.0
"""Sun this near is where the date has it: 24 s of an orbit, as a penumbra, a flattened Earth and a bin blur it."""

_ELSEWHERE_DEG: Final = 15.0
"""Least distance at which the Sun is believed to be elsewhere: two weeks of date, a minute of an orbit."""

_LAGGING_S: Final = 200.0
"""Time constant from which on a channel lags: a current is smoothed over a turn of the craft, a panel takes minutes."""

_LAGGING_ELSEWHERE_DEG: Final = 45.0
"""The same of what lags: heat that comes a long way is late by up to an eighth of an orbit more than two lags say."""

_BEARS_OUT: Final = 3.0
"""Most times more that may be left at the stated date by a channel that bears it out."""

_SMALL: Final = 1e-6
"""Of the largest, what is rounding among columns that light makes of the field."""

_CHANCE: Final = 35.0
"""Times the noise of a row, what light elsewhere has to explain more: odds of e^17 for a Sun that was looked for."""

_GREATER_PART: Final = 0.5
"""Of what a slow field or gain leaves beside light at the date, what light elsewhere has to explain: a step or a drift
goes a little better with one Sun than with another by chance."""

_STRETCHES: Final = 48
"""In which a field may differ: ten an orbit over five hours, as fast as heat comes and goes."""

_EXPLAINED: Final = 0.1
"""Most that may be left of a channel's variance by light alone: what follows angles or duty as well tells no date."""

_BETTER: Final = 5.0
"""Times less that is left elsewhere than at the stated date, or ..."""

_SHARPER: Final = 2.0
"""... than by two smooth waves an orbit: without the shadow's edges any phase would do."""

_LEAST_CHANGES: Final = 3
"""Edges of the shadow in the recording: two could be a step and a trend."""

_EDGE_SHARE: Final = 0.05
"""Standard deviation of light below which a Sun has no shadow on the orbit that a channel could follow."""


@dataclass(frozen=True, slots=True)
class SunSeen:
    """Where a channel shows the Sun: ``ahead_deg`` along the ecliptic from where the stated time has it."""

    channel: str
    ahead_deg: float

    def __str__(self) -> str:
        return (
            f"{abs(self.ahead_deg):.0f} deg {'ahead of' if self.ahead_deg > 0.0 else 'behind'} where the stated time "
            f"has it, by the light and shadow in channel {self.channel}: check date and clock"
        )


def sun_seen(scene: Scene, residual_nt: Array) -> SunSeen | None:
    """Where the telemetry shows the Sun; None where that is at the stated date, or where nothing tells.

    Parameters
    ----------
    scene: with vectors calibrated by nine errors, ``recordings.scene_of.cleaned``.
    residual_nt: (n,) scalar residual under them [nT]; the date stands unless light elsewhere is what it follows.
    """
    if not scene.in_orbit or scene.position_eci_km is None or scene.sun_eci is None or len(scene) < _BINS // 4:
        return None
    bins = _Bins.of(scene)
    angles = np.arange(0.0, 360.0, _STEP_DEG)
    answers = _answers(scene, bins, angles)
    near = np.array([abs(_half_turn(angle)) <= _HERE_DEG for angle in angles])
    found: list[tuple[bool, float, SunSeen]] = []
    for name, values in _courses(scene, bins):
        each = answers.left(values)
        left = each.min(axis=0)
        here, best = float(left[near].min()), int(left.argmin())
        if here <= _EXPLAINED and here <= _BEARS_OUT * left[best]:
            return None
        if left[best] > min(_EXPLAINED, here / _BETTER, bins.smooth_left(values) / _SHARPER):
            continue
        lags = _RESPONSES_S[int(each[:, best].argmin())][0] > _LAGGING_S
        seen = SunSeen(name, _finer(scene, bins, values, float(angles[best])))
        if abs(seen.ahead_deg) >= (_LAGGING_ELSEWHERE_DEG if lags else _ELSEWHERE_DEG):
            found.append((lags, float(left[best]), seen))
    if not found:
        return None
    sun = min(found, key=lambda one: one[:2])[2]
    return sun if _needed(scene, residual_nt, sun) else None


def _needed(scene: Scene, residual_nt: Array, sun: SunSeen) -> bool:
    """Whether a residual (n,) follows light there, as it follows neither light at the date nor the channel itself.

    A channel looks like the light of another Sun for many reasons: a payload on for part of each orbit, heat late by
    more than two lags, a panel's angle.  None of those moves what light does to the magnetometer.
    """
    unit, field_nt = scene.unit, scene.clean_field_nt
    nine = np.linalg.qr(np.einsum("ni,nij->nj", unit, field_jacobian(field_nt)))[0]
    residual = _without(residual_nt[:, None], nine)[:, 0]
    columns = np.concatenate([unit, unit * field_nt], axis=1)

    def explained(answers: Iterable[Array]) -> float:
        return max(_squares(_without(_following(columns, one), nine), residual) for one in answers)

    def by_light(ahead_deg: float) -> float:
        under = replace(scene, sun_ahead_deg=ahead_deg)
        aimed = _aimed(under)
        by_direction = 0.0 if aimed is None else _squares(_without(aimed, nine), residual)
        return max(explained(_lit_answers(under)), by_direction)

    instead = max(by_light(0.0), explained(scene.channels[sun.channel].values.T[:, :, None]))
    gain = by_light(sun.ahead_deg) - instead
    slow, noise = _slow(columns, residual)
    return gain > max(_CHANCE * noise, _GREATER_PART * (slow - instead))


def _aimed(scene: Scene) -> Array | None:
    """(n, 24) what a field by the Sun's direction in the body may add, first and second degree; None without one."""
    if scene.sun_body is None or scene.lit is None:
        return None
    sun = scene.sun_body * scene.lit[:, None]
    signals = np.concatenate([sun, harmonics(sun)], axis=1)
    return np.asarray((signals[:, :, None] * scene.unit[:, None, :]).reshape(len(scene), -1))


def _following(columns: Array, courses: Array) -> Array:
    """Columns (n, k) times each of some courses (n, m) less its mean: (n, k m)."""
    return np.concatenate([columns * (one - one.mean())[:, None] for one in courses.T], axis=1)


def _lit_answers(scene: Scene) -> Iterator[Array]:
    """What answers to a scene's light, and the decays of its start (n, m), by its time constants."""
    assert scene.lit is not None
    for constants_s in _RESPONSES_S:
        courses = [scene.lit - scene.lit.mean()]
        for constant_s in (constant_s for constant_s in constants_s if constant_s > 0.0):
            courses[0] = sunlight.first_order(scene.time_s, courses[0], constant_s)
            courses.append(np.exp(-(scene.time_s - scene.time_s[0]) / constant_s))
        yield np.stack(courses, axis=1)


def _squares(columns: Array, residual: Array) -> float:
    """Squares of a residual (n,) that columns (n, k) take with them [nT^2]; what rounding made of them takes none."""
    basis, sizes, _ = np.linalg.svd(columns, full_matrices=False)
    return float(((basis[:, sizes > max(_SMALL * sizes[0], 1e-9)].T @ residual) ** 2).sum())


def _slow(columns: Array, residual: Array) -> tuple[float, float]:
    """Squares of a residual (n,) that a slowly changing field or gain takes with it, and the noise of a row [nT^2].

    ``columns`` (n, k) of the field and gain, fitted anew in each of many stretches, less what that takes of noise.
    """
    count = max(min(_STRETCHES, len(residual) // (8 * columns.shape[1])), 1)
    taken = sum(
        _squares(some, left)
        for some, left in zip(np.array_split(columns, count), np.array_split(residual, count), strict=True)
    )
    numbers = count * columns.shape[1]
    noise = max(float(residual @ residual) - taken, 0.0) / (len(residual) - numbers)
    return taken - numbers * noise, noise


def _finer(scene: Scene, bins: _Bins, values: Array, angle: float) -> float:
    """The angle [deg] that leaves least of a course, between the neighbours of the best one."""
    angles = np.arange(angle - _STEP_DEG, angle + _STEP_DEG + 0.5 * _FINE_DEG, _FINE_DEG)
    left = _answers(scene, bins, angles).left(values).min(axis=0)
    return _half_turn(round(float(angles[left.argmin()]), 2))


def _half_turn(angle: float) -> float:
    """The same angle within half a turn of 0 [deg]."""
    return (angle + 180.0) % 360.0 - 180.0


@dataclass(frozen=True, slots=True, eq=False)
class _Bins:
    """Stretches of a recording over which channels are averaged: row of each sample's bin, middle rows, their times."""

    of_row: NDArray[np.intp]
    middle: NDArray[np.intp]
    time_s: Array
    waves: Array

    @classmethod
    def of(cls, scene: Scene) -> _Bins:
        span_s = max(float(scene.time_s[-1] - scene.time_s[0]), 1e-9)
        number = np.minimum(((scene.time_s - scene.time_s[0]) / span_s * _BINS).astype(np.intp), _BINS - 1)
        _, first, of_row, counts = np.unique(number, return_index=True, return_inverse=True, return_counts=True)
        middle = first + counts // 2
        time_s = np.bincount(of_row, scene.time_s) / counts
        assert scene.position_eci_km is not None
        return cls(of_row, middle, time_s, _waves(scene.position_eci_km[middle]))

    def means(self, values: Array) -> Array:
        """Values (n,) averaged in each bin."""
        return np.asarray(np.bincount(self.of_row, values) / np.bincount(self.of_row))

    def smooth_left(self, values: Array) -> float:
        """Share of a course's variance that two waves an orbit leave."""
        return float(
            _share_left(_without(self.waves, _trend(self.time_s)), _without(values[:, None], _trend(self.time_s)))
        )


@dataclass(frozen=True, slots=True, eq=False)
class _Answers:
    """Responses to light under each Sun, with the trends that a channel may have beside them taken out.

    ``groups``: for each pair of time constants the trends (q, k) and the responses (q, a), of unit length or 0.
    """

    groups: list[tuple[Array, Array]]

    def left(self, values: Array) -> Array:
        """(r, a) share of a course's variance (q,) that is left by each response under each Sun."""
        shares = []
        for trend, responses in self.groups:
            course = _without(values[:, None], trend)[:, 0]
            explained = (responses.T @ course) ** 2 / max(float(course @ course), 1e-300)
            shares.append(1.0 - explained)
        return np.stack(shares)


def _answers(scene: Scene, bins: _Bins, angles: Array) -> _Answers:
    assert scene.position_eci_km is not None
    place, utc_s = scene.position_eci_km[bins.middle], scene.time_ns[bins.middle] * 1e-9
    lit = np.stack([sunlight.sunlit(place, sunlight.sun_eci(utc_s, math.radians(angle))) for angle in angles], axis=1)
    edges = np.count_nonzero(np.diff((lit > 0.5).astype(np.int8), axis=0), axis=0)
    usable = (edges >= _LEAST_CHANGES) & (lit.std(axis=0) > _EDGE_SHARE)
    groups = []
    for tau_s, skin_s in _RESPONSES_S:
        answer, trend = lit, _trend(bins.time_s)
        for constant_s in (skin_s, tau_s):
            if constant_s > 0.0:
                answer = sunlight.first_order(bins.time_s, answer, constant_s, answer.mean(axis=0))
                decay = np.exp(-(bins.time_s - bins.time_s[0]) / constant_s)
                trend = np.concatenate([trend, decay[:, None]], axis=1)
        basis = np.linalg.qr(trend)[0]
        responses = _without(answer, basis)
        length = np.linalg.norm(responses, axis=0)
        told = usable & (length > 1e-3 * np.linalg.norm(answer, axis=0))
        groups.append((basis, np.where(told, responses / np.maximum(length, 1e-300), 0.0)))
    return _Answers(groups)


def _courses(scene: Scene, bins: _Bins) -> Iterator[tuple[str, Array]]:
    """Channels, a column each, averaged; angles, rates and directions turn with the craft and tell no light."""
    for channel in scene.channels.values():
        if channel.quantity in ("angular rate", "angle", "magnetic field"):
            continue
        for column in channel.values.T:
            if float(np.std(column)) > 0.0:
                yield channel.name, bins.means(column)


def _trend(time_s: Array) -> Array:
    """(q, 2) orthonormal: a level and a line."""
    return np.asarray(np.linalg.qr(np.stack([np.ones(len(time_s)), time_s - time_s.mean()], axis=1))[0])


def _waves(place_km: Array) -> Array:
    """(q, 4) one and two waves an orbit, by the angle of a place (q, 3) along it."""
    pole = np.cross(place_km[:-1], place_km[1:]).sum(axis=0)
    first = place_km[0] / np.linalg.norm(place_km[0])
    across = np.cross(pole / max(float(np.linalg.norm(pole)), 1e-300), first)
    angle = np.arctan2(place_km @ across, place_km @ first)
    return np.stack([np.cos(angle), np.sin(angle), np.cos(2.0 * angle), np.sin(2.0 * angle)], axis=1)


def _without(values: Array, basis: Array) -> Array:
    """Values (q, k) with orthonormal columns (q, m) taken out."""
    return np.asarray(values - basis @ (basis.T @ values))


def _share_left(columns: Array, course: Array) -> float:
    """Share of a course (q, 1) that columns (q, k) leave."""
    basis = np.linalg.qr(columns)[0]
    left = _without(course, basis)
    return float((left**2).sum() / max(float((course**2).sum()), 1e-300))
