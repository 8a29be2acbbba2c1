"""Axes of the magnetometer: swapped, mirrored, flipped against a gyro's or an attitude's, or from an instant on."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import Final

import numpy as np

from magcal_service.base.units import CHANNEL_UNITS
from magcal_service.recordings.inspect.finding import Code, Seen
from magcal_service.recordings.inspect.gyro_unit import is_gyro
from magcal_service.recordings.inspect.log import Log
from magcal_service.recordings.scene_of import recorded_attitude
from magcal_service.recordings.table import FloatArray
from magcal_service.samples.axes_watch import AxesWatch
from magcal_service.samples.signed_axes import any_of

_FEWEST: Final = 200  # differences: 24 hypotheses are compared, and each is free in three numbers
_LONGEST_TURN: Final = 0.35
"""Radians between rows: beyond, a difference is no derivative."""

_EXPLAINS: Final = 0.3  # of the change may be left: scale errors of a fifth, and noise
_BETTER: Final = 3.0  # choice: times less is left than as declared, far beyond what scale errors do
_MOST: Final = 3000  # rows: more only take time


def axes_by_gyro(log: Log) -> Iterator[Seen]:
    """In the body the field turns against the craft: dB/dt = -w x (B - b), in the axes that both really have."""
    gyro = next((c for c in log.recording.channels.values() if is_gyro(c)), None)
    if gyro is None or len(log) < _FEWEST:
        return
    rate = CHANNEL_UNITS[gyro.spec.unit].to_base(gyro.values[log.rows])
    step_s = np.diff(log.time_s)
    middle, mean = 0.5 * (rate[1:] + rate[:-1]), 0.5 * (log.field_nt[1:] + log.field_nt[:-1])
    turn = np.linalg.norm(middle, axis=1) * step_s
    good = (step_s > 0.0) & (step_s < 3.0 * log.step_s) & np.isfinite(turn) & (turn < _LONGEST_TURN)
    good = np.flatnonzero(good)[:_MOST]
    if len(good) < _FEWEST or float(np.median(turn[good])) < 1e-3:
        return
    change = np.diff(log.field_nt, axis=0)[good]
    angle = middle[good] * step_s[good, None]
    left = {signs: _left(change, angle, mean[good], signs) for signs in _turns()}
    straight, best = _SAME, min(left, key=lambda signs: left[signs])
    whole = float(np.sqrt(np.mean(change**2)))
    if best == straight or left[best] > _EXPLAINS * whole or left[straight] < _BETTER * left[best]:
        return
    says = (
        f"the field turns against the channel {gyro.spec.name} only if its x, y, z are the magnetometer's "
        f"{_named(best)}: {left[best] / whole:.2g} of the change is left then, as declared {left[straight] / whole:.2g}"
    )
    remedy = f"check the axes: order and signs of magnetometer.columns and of channels.{gyro.spec.name}"
    yield Seen(Code.AXES, False, log.rows, says, remedy)


_Signs = tuple[tuple[int, int], ...]
_SAME: Final[_Signs] = ((0, 1), (1, 1), (2, 1))  # each axis is itself


def _turns() -> Iterator[_Signs]:
    """Which axis, with which sign, each of three axes is: the 24 that differ by more than the sign of all three."""
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1, -1), repeat=2):
            yield tuple(zip(order, (1, *signs), strict=True))


def _matrix(signs: _Signs) -> FloatArray:
    matrix = np.zeros((3, 3))
    for row, (axis, sign) in enumerate(signs):
        matrix[row, axis] = sign
    return matrix


def _left(change: FloatArray, angle: FloatArray, mean: FloatArray, signs: _Signs) -> float:
    """rms that -w x (B - b) leaves of the change [nT], with the best b, in axes so turned."""
    matrix = _matrix(signs)
    off = change @ matrix.T + np.cross(angle, mean @ matrix.T)
    x, y, z = angle.T
    zero = np.zeros(len(angle))
    columns = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3)  # w x b
    solution = np.linalg.lstsq(columns, off.reshape(-1), rcond=None)[0]
    return float(np.sqrt(np.mean((off.reshape(-1) - columns @ solution) ** 2)))


def _named(signs: _Signs) -> str:
    return ", ".join(f"{'-' if sign < 0 else ''}{'xyz'[axis]}" for axis, sign in signs)


_ORDERED: Final = 0.6
"""Of the largest entry of a row of the fitted matrix over the row's length: an axis, not a mixture."""


def axes_by_attitude(log: Log) -> Iterator[Seen]:
    """The reference, turned into the body by the recorded attitude, is the measured field but for nine errors."""
    reference = log.recording.reference
    known = recorded_attitude(log.recording)
    if known is None or reference.vector_nt is None or reference.frame is None or known[0] != reference.frame.value:
        return
    turned, rows = known[1][log.rows], reference.vector_nt[log.rows]
    good = np.flatnonzero(np.isfinite(rows).all(axis=1) & np.isfinite(turned).all(axis=(1, 2)))
    good = good[:: -(-max(len(good), 1) // _MOST)]
    if len(good) < _FEWEST:
        return
    field, turned, rows = log.field_nt[good], turned[good], rows[good]
    declared, matrix = _fitted(field, np.einsum("nij,nj->ni", turned, rows))
    back, _ = _fitted(field, np.einsum("nji,nj->ni", turned, rows))
    if declared > _EXPLAINS and back * _BETTER < declared:
        says = (
            f"the attitude turns the reference into the field only backwards: {back:.2g} is left, else {declared:.2g}"
        )
        remedy = "check the attitude: exchange from and to"
    elif declared < _EXPLAINS and not _is_straight(matrix):
        says = f"turned by the attitude, the reference's x, y, z are most like {_largest(matrix)} of the magnetometer: "
        says += f"{declared:.2g} of the field's change is left so"
        remedy = "check the axes: order and signs of magnetometer.columns, and what body the attitude leads to"
    else:
        return
    yield Seen(Code.AXES, False, log.rows, says, remedy)


def axes_changed(log: Log) -> Iterator[Seen]:
    """The vector jumps at an instant as its own continuity allows only if axes were swapped or flipped there.

    The service watches for the same in flight; what it doubts a calibration for is no physics of a diagnosis.
    """
    watch, order = AxesWatch(), np.argsort(log.time_s, kind="stable")
    changes, from_s, until_s = list[int](), np.inf, np.inf
    for time_s, (x, y, z) in zip(log.time_s[order].tolist(), log.field_nt[order].tolist(), strict=True):
        watch.push(time_s, (x, y, z))
        if watch.changes and not changes:
            changes, from_s = list(watch.changes), watch.since_s
        elif changes and watch.changes != changes:
            until_s = watch.since_s
            break
    if changes:
        rows = log.rows[(from_s <= log.time_s) & (log.time_s < until_s)]
        says = f"against the rows before, for {len(rows)} rows axes look as if {any_of(changes)}: "
        says += "the vector jumps, and goes on as it did"
        yield Seen(Code.AXES_CHANGED, False, rows, says, "diagnose these rows and the others each by themselves")


def _fitted(field: FloatArray, body: FloatArray) -> tuple[float, FloatArray]:
    """Share of the field's scatter that M H + b leaves, with the best M (3, 3) and b, and this M."""
    columns = np.column_stack([body, np.ones(len(body))])
    solution = np.linalg.lstsq(columns, field, rcond=None)[0]
    left = field - columns @ solution
    whole = field - field.mean(axis=0)
    return float(np.sqrt(np.sum(left**2) / max(np.sum(whole**2), 1e-12))), np.asarray(solution[:3].T, np.float64)


def _is_straight(matrix: FloatArray) -> bool:
    """Whether each axis is mostly itself, with its own sign; a matrix that is a mixture says nothing."""
    largest = np.abs(matrix).max(axis=1)
    mixed = np.any(largest < _ORDERED * np.linalg.norm(matrix, axis=1))
    return bool(mixed or np.all(np.diagonal(matrix) >= largest))


def _largest(matrix: FloatArray) -> str:
    """The axes (rows of M) that the attitude's x, y, z are found in."""
    found = []
    for column in matrix.T:
        row = int(np.argmax(np.abs(column)))
        found.append(f"{'-' if column[row] < 0 else ''}{'xyz'[row]}")
    return ", ".join(found)
