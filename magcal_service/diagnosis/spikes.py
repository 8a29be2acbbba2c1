"""Single samples far outside their neighbourhood, but for those that recorded commands explain.

A coil or a load that is on for a few samples stands out of them as spikes do, the more so where the craft turns in that
time.  So what stands out is held against the recorded commands: fields along the body's axes that follow them, or their
row before, fitted to what stands out least (by absolute values, as weighted least squares), each row judged by a fit in
which it has no part.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from magcal_service.model import Array, calibrate
from magcal_service.physics.scene.scene import Scene
from magcal_service.residuals import MEDIAN_TO_SIGMA

_SPIKE: Final = 8.0
"""Robust sigmas by which a single sample stands out of its neighbourhood and of the whole: noise does once in 10^15.

Choice: lower, and steep but real courses of a disturbance lose samples; a spike below it is diluted by the fit.
"""

_AROUND: Final = 4
"""Rows on either side that are a row's neighbourhood."""

_COMMANDS: Final = ("magnetic moment", "current", "fraction", "dimensionless", "counts", "power")
"""Kinds of channels that switch a field on and off, those of coils first."""

_MOST_COMMANDS: Final = 12
"""Columns of channels that are looked at; choice: four sets of coils.  More would explain any few rows."""

_ROUNDS: Final = 8
"""Of weighting anew; choice: the coefficients are known to a hundredth then, where a third of the rows is off."""

_MUCH: Final = 0.25
"""Of a command's whole range, a change from one row to the next that is an edge."""

_EXPLAINS: Final = 0.5
"""Of the rows that stand out while a command is on, what it has to explain to be what makes them; choice: most."""

_ALONE: Final = 0.5
"""Of a row's own weight in a fit, from which on the fit says nothing of it."""

_ABSORBED: Final = 1e-9
"""Of the largest, the least part of the columns that is no rounding."""


def spikes(scene: Scene, x: Array) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Single samples (n,) far outside their neighbourhood that no recorded command explains; and of what else stands
    out, those (n,) at an edge of a command, where it is known to a sample only.

    Parameters
    ----------
    scene: of all rows.
    x: nine errors (9,).
    """
    w = calibrate(x, scene.field_nt)
    length = np.linalg.norm(w, axis=1)
    residual = length - scene.magnitude_nt
    off = _off(residual)
    limit = _SPIKE * MEDIAN_TO_SIGMA * float(np.median(off))
    spread = np.abs(residual - np.median(residual))
    found = (off > limit) & (spread > _SPIKE * MEDIAN_TO_SIGMA * float(np.median(spread)))
    commands = _commands(scene)
    if not found.any() or not commands.shape[1]:
        return found, np.zeros(len(scene), dtype=bool)
    explained, left = _explained(commands, w, residual - float(np.median(residual)))
    still, least = found & (_off(left) > limit), _MUCH * np.ptp(commands, axis=0)
    on = found & (np.abs(commands) > least).any(axis=1)
    if np.count_nonzero(found & ~still) < _EXPLAINS * np.count_nonzero(on):  # those that agree are no more its own
        return found, np.zeros(len(scene), dtype=bool)
    found = still
    edges = found & _at_change(commands, least) & _at_change(explained[:, None], limit)
    return found & ~edges, edges


def _off(residual: Array) -> Array:
    """How far each row is from the median of its neighbourhood (n,) [nT]."""
    padded = np.pad(residual, _AROUND, mode="reflect")
    around = np.median(np.lib.stride_tricks.sliding_window_view(padded, 2 * _AROUND + 1), axis=1)
    return np.abs(residual - around)


def _commands(scene: Scene) -> Array:
    """Recorded commands (n, k) from where they rest, and the same one row later."""
    columns = [
        column - np.median(column)
        for kind in _COMMANDS
        for channel in scene.of_quantity(kind)
        for column in channel.values.T
        if float(np.std(column)) > 0.0
    ][:_MOST_COMMANDS]
    later = [np.concatenate([column[:1], column[:-1]]) for column in columns]
    return np.stack([*columns, *later], axis=1) if columns else np.zeros((len(scene), 0))


def _at_change(courses: Array, least: Array | float) -> NDArray[np.bool_]:
    """Rows (n,) between which and the one before or after a course (n, k) changes by more than ``least``."""
    changes = (np.abs(np.diff(courses, axis=0)) > least).any(axis=1)
    return np.asarray(np.append(changes, False) | np.append(False, changes))


def _explained(commands: Array, w: Array, residual: Array) -> tuple[Array, Array]:
    """What commands (n, k) explain of each row of a residual (n,), and what they leave in a fit that it has no part in.

    Parameters
    ----------
    w: calibrated vectors (n, 3) [nT].  A field F makes them longer by its part along w - F / 2, to the third order.

    Of a row that hardly any other tells the columns of, nothing is explained.
    """
    middle, explained, left = w, residual, residual
    for _ in range(2):
        unit = middle / np.maximum(np.linalg.norm(middle, axis=1), 1.0)[:, None]
        columns = (commands[:, :, None] * unit[:, None, :]).reshape(len(w), -1)
        coefficients, explained, left = _fitted(columns, residual)
        middle = w - 0.5 * (commands @ coefficients.reshape(-1, 3))
    return explained, left


def _fitted(columns: Array, residual: Array) -> tuple[Array, Array, Array]:
    """Coefficients (k,) of columns (n, k), and as of ``_explained``."""
    size = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    columns = columns / size
    floor = max(MEDIAN_TO_SIGMA * float(np.median(np.abs(residual))), 1e-300)
    weights = np.ones(len(residual))
    for _ in range(_ROUNDS):
        values, vectors = np.linalg.eigh(columns.T @ (weights[:, None] * columns))
        kept = values > _ABSORBED * values[-1]
        basis = vectors[:, kept] / np.sqrt(values[kept])
        apart = columns @ basis
        leverage = weights * (apart**2).sum(axis=1)
        amounts = apart.T @ (weights * residual)
        left = residual - apart @ amounts
        weights = 1.0 / np.maximum(np.abs(left), floor)
    alone = leverage > _ALONE
    others = left / np.where(alone, 1.0, 1.0 - leverage)
    return basis @ amounts / size, np.where(alone, 0.0, residual - others), np.where(alone, residual, others)
