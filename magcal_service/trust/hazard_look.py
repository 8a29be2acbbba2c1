"""One look at the running sums of the hazards: which is seen, and how far those that are not may put a vector off."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from magcal_service.config.settings import TrustConfig
from magcal_service.model import BIAS, D_SCALE, STATE_SIZE, Array, field_jacobian
from magcal_service.trust import hazard_sums as sums
from magcal_service.trust import hazards
from magcal_service.trust.hazards import Hazard
from magcal_service.trust.protection import Level, alarm_gain, smallest_seen, worst
from magcal_service.wire.kinds import MAX_RESULT_FIELD_NT

CHUNK: Final = 64
"""Ticks that are added to the sums at a time."""

LOOK_CHUNKS: Final = 5
"""Chunks between two looks, once the first have passed: 320 ticks."""

FALSE_PER_YEAR: Final = 0.02
"""False alarms expected in a year of ticks, at most: the sum over all tests."""

_TESTS: Final = 200
"""Tests in one look at most: four for each of 40 blocks, 24 of what follows orbit or spin, the others."""

ALARM_NATS: Final = math.log(31_557_600.0 / (CHUNK * LOOK_CHUNKS) * _TESTS / FALSE_PER_YEAR)
"""Significance from which a hazard is seen: -ln of a false alarm's probability in one test."""

_PHASES: Final = np.pi * np.arange(8) / 8.0
"""At which what follows orbit or spin is tried, half a turn; what lies between them differs by 2 % in effect."""

_MIXED: Final = np.stack([np.vstack([math.cos(a) * np.eye(3), math.sin(a) * np.eye(3)]) for a in _PHASES.tolist()])
"""Amplitudes of cos and sin (8, 6, 3) of a vector at each phase."""

_SWING: Final = 2.0 / math.pi
"""Amplitude of the first harmonic of what swings by one: that of a square wave, the largest."""

_ORBIT_RADIUS_KM: Final = 6978.0
"""Of a low orbit: there the field falls with the third power of the radius."""

_MEMORY_SIGMA: Final = 4.0
"""A correlation from sample to sample counts from so many of its sigmas on."""

_NULL: Final = 1e-10  # directions of the nine errors with less than this share of the information are not fitted
_LEAST_SEEN: Final = 1e-7  # of a column's square has to be left, else it is rounding of what the nine errors absorb


@dataclass(frozen=True, slots=True)
class Accumulated:
    """What has been summed up since the filter's start.

    Parameters
    ----------
    total: sums of products of all columns (33, 33).
    used: samples in them.
    sizes, blocks: chunks in each block of time, and its sums (10, 10) of the nine errors and the residual.
    steps: response of the filter to steps at the beginning of each block, each (9, 6).
    response: of the filter to unit amplitudes of the columns 9 to 31 (9, 23).
    newest: time [s], B and |H| [nT] of the samples whose vectors are asked about, each (5,).
    memory: sums of the residual's products with the next one, and of its squares.
    spin_rad_s: the spin's rate, 0 where there is none.
    """

    total: Array
    used: int
    sizes: Sequence[int]
    blocks: Sequence[Array]
    steps: Sequence[Array]
    response: Array
    newest: Array
    memory: Sequence[float]
    spin_rad_s: float


@dataclass(frozen=True, slots=True)
class Look:
    """What a look has found.

    Parameters
    ----------
    level: the protection level.
    seen: the hazard with the largest evidence beyond the alarm; None where there is none.
    evidence: the largest of all, in units of the alarm's.
    levels: of each hazard by itself, at each time or in each form (h,) [nT]: of steps at the beginning of each block of
        time but the first, gains by axis; one that has just occurred, and cannot have been seen, is in none.
    ages: of those blocks [ticks].
    """

    level: Level
    seen: Hazard | None
    evidence: float
    levels: Mapping[Hazard, Array]
    ages: Array


@dataclass(frozen=True, slots=True)
class _Group:
    """One hazard at h times, or in h forms.

    Parameters
    ----------
    hazard: which.
    squares, products: of its columns, without what the nine errors take of them (h, k, k), and theirs with the
        residual (h, k).
    largest: longest vector of amplitudes that is possible (h,).
    errors: of the estimate by unit amplitudes, at each of m samples or at all alike (h, m or 1, 9, k).
    """

    hazard: Hazard
    squares: Array
    products: Array
    largest: Array
    errors: Array


def look(data: Accumulated, settings: TrustConfig) -> Look | None:
    """Test every hazard, and work out what would not have been seen; None where the sums are empty."""
    rest = _without_nine(data.total)
    samples, square = data.used - STATE_SIZE, float(rest[-1, -1])
    if samples <= 0 or square <= 0.0:
        return None
    raised = _raised(data)
    jacobian = field_jacobian(data.newest[:, 1:4]) * sums.UNIT
    level = Level(settings.disturbance_nt, Hazard.BIAS_STEP)  # a step that has just occurred
    levels: dict[Hazard, Array] = {}
    seen, evidence = None, 0.0
    for group in _groups(data, rest, settings.disturbance_nt):
        columns = group.squares.shape[-1]
        gain = float(sums.gains(group.squares, group.products, square, samples).max()) / raised
        if gain / alarm_gain(ALARM_NATS, columns) > evidence:
            evidence = gain / alarm_gain(ALARM_NATS, columns)
            seen = group.hazard if evidence > 1.0 else None
        noncentrality = raised * smallest_seen(ALARM_NATS, columns, samples)
        visible = group.squares * (samples / square)
        levels[group.hazard] = worst(visible, noncentrality, group.largest, jacobian @ group.errors)
        off_nt = float(levels[group.hazard].max())
        if not off_nt <= level.nt:
            level = Level(min(off_nt, MAX_RESULT_FIELD_NT), group.hazard)
    return Look(level, seen, evidence, levels, _ages(data))


def _groups(data: Accumulated, rest: Array, own_nt: float) -> Iterator[_Group]:
    """Hazards with what of them is seen; amplitudes in nT (gains: at 5e4 nT), in seconds, or relative."""
    reading_nt = max(float(np.linalg.norm(data.newest[:, 1:4], axis=1).max()), 1.0)  # a gain changes all of B
    relative_nt = own_nt / reading_nt * sums.FAR_NT
    course = sums.errors_of(sums.courses(data.newest[:, 0], data.spin_rad_s))

    def group(hazard: Hazard, columns: tuple[int, ...], largest: float, mixed: Array | None = None) -> _Group:
        at, mixed = np.array(columns) - STATE_SIZE, np.eye(len(columns))[None] if mixed is None else mixed
        squares = mixed.swapaxes(-1, -2) @ rest[np.ix_(at, at)] @ mixed
        errors = (data.response[:, at] - course[:, :, at])[None] @ mixed[:, None]
        return _Group(hazard, squares, rest[at, -1] @ mixed, np.full(len(mixed), largest), errors)

    yield group(Hazard.REFERENCE_LATE, (sums.LATE,), hazards.LATE_S)
    yield group(Hazard.REFERENCE_SCALED, (sums.SCALED,), hazards.SCALED)
    yield group(Hazard.REFERENCE_DISPLACED, (sums.SCALED,), 3.0 * hazards.DISPLACED_KM / _ORBIT_RADIUS_KM)
    yield group(Hazard.BIAS_DRIFT, sums.DRIFT, hazards.DRIFT_NT_PER_H * sums.DRIFT_S / 3600.0)
    yield group(Hazard.ORBIT_BIAS, sums.ORBIT_BIAS, _SWING * own_nt, _MIXED)
    yield group(Hazard.ORBIT_GAIN, sums.ORBIT_GAIN, _SWING * relative_nt, _MIXED)
    if data.spin_rad_s:
        yield group(Hazard.PANEL_CURRENT, sums.PANEL, _SWING * own_nt, _MIXED)
    if len(data.blocks) > 1:
        yield from _steps(data, own_nt, relative_nt)


def _steps(data: Accumulated, own_nt: float, relative_nt: float) -> Iterator[_Group]:
    """Steps of the bias, and of each axis' gain by itself, at the beginning of each block but the first."""
    seen, products = sums.steps_seen(np.array(data.blocks))
    response = np.array(data.steps[1:])
    old = _ages(data) >= hazards.STEP_SEEN_TICKS
    largest_nt = np.where(old, hazards.STEP_NT, own_nt)
    largest_gain_nt = np.where(old, hazards.GAIN_STEP * sums.FAR_NT, relative_nt)
    biases = response[:, :, BIAS] - np.eye(STATE_SIZE)[:, BIAS]
    gains = response[:, :, D_SCALE] - np.eye(STATE_SIZE)[:, D_SCALE]
    yield _Group(Hazard.BIAS_STEP, seen[:, BIAS, BIAS], products[:, BIAS], largest_nt, biases[:, None])
    yield _Group(
        Hazard.GAIN_STEP,
        np.diagonal(seen, axis1=1, axis2=2)[:, D_SCALE].reshape(-1, 1, 1),
        products[:, D_SCALE].reshape(-1, 1),
        np.repeat(largest_gain_nt, 3),
        gains.swapaxes(1, 2).reshape(-1, 1, STATE_SIZE, 1),
    )


def _ages(data: Accumulated) -> Array:
    """Of each block but the first [ticks]."""
    ages: Array = np.cumsum(data.sizes[::-1])[::-1][1:] * CHUNK
    return ages


def _raised(data: Accumulated) -> float:
    """By how much noise with a memory raises the gains of what is slow: (1 + r) / (1 - r), 1 for white noise."""
    products, squares = data.memory
    correlation = products / squares if squares > 0.0 else 0.0
    if correlation < _MEMORY_SIGMA / math.sqrt(data.used):
        return 1.0
    return (1.0 + correlation) / (1.0 - min(correlation, 0.99))


def _without_nine(total: Array) -> Array:
    """Sums of the columns from 9 on (24, 24) once the nine errors are fitted; what is absorbed becomes zero."""
    own, cross = total[:STATE_SIZE, :STATE_SIZE], total[:STATE_SIZE, STATE_SIZE:]
    scale = np.sqrt(np.maximum(np.diagonal(own), 1e-300))
    values, vectors = np.linalg.eigh(own / np.outer(scale, scale))
    good = values > _NULL * values[-1]
    half = (vectors[:, good] / np.sqrt(values[good]) / scale[:, None]).T @ cross
    rest: Array = total[STATE_SIZE:, STATE_SIZE:] - half.T @ half
    hidden = np.diagonal(rest) <= _LEAST_SEEN * np.diagonal(total)[STATE_SIZE:]
    hidden[-1] = False
    rest[hidden] = rest[:, hidden] = 0.0
    return rest
