"""Noise that is not alike on the three axes of a sensor, as of the vertical one of a chip, and what it does.

Of a magnitude only the noise along the field is seen.  The vectors that columns are made of are freed of the rest of
it by a step along the field where noise is alike on all axes.  Where it is not, what lies across the field goes along
with what lies along it, and such a step leaves vectors whose error is correlated with the residual: products of the
field's components then hold a part of the noise itself (errors in variables).  The step has to go along the covariance
times the field's direction, and what is left of the noise is then correlated with nothing that is seen.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from magcal_service.model import STATE_SIZE, Array, d_matrix
from magcal_service.physics.scene.scene import Scene

_USUAL: Final = 0.25
"""How far a share is from one on the average: chips state up to 1.5 times the noise on the axis across their face."""

_ORDERS: Final = (4, 6)
"""Differences of samples that follow one another, in which a field that turns by less than a third of a radian from one
to the next leaves less than its noise; both have to tell the same of it."""

_AGREE: Final = 0.15  # of a variance, up to which two estimates are of the same noise

_AS_STATED: Final = 1.2  # times the stated noise, up to which a residual is noise: as for a recording's own doubt of it

_FEWEST: Final = 300  # samples that variances are told from; of fewer a third is not known

_FAR: Final = 5.0  # times the noise: what is farther out is none

_REMEMBERS: Final = 1.94
"""Samples over those that tell as much by themselves, of squares that share two of their three samples: 1 and twice the
squares of their correlations, 2/3 and 1/6."""

_LEAST_SHARE: Final = 0.1  # of the usual variance: no axis of a sensor has less

_OF_A_MEDIAN: Final = 0.4549  # the median of a chi-square of one degree, over its mean


def step_to_clean(x: Array, unit: Array, shares: Array | None) -> Array:
    """(n, 3) the way to vectors free of what is seen of their noise, for one nT more along the field.

    Parameters
    ----------
    x: nine errors first (9 + k,).
    unit: (n, 3) directions of the calibrated field.
    shares: (3,) each axis' variance over their mean, in the sensor; None: alike.
    """
    whole = np.eye(3) + d_matrix(x[:STATE_SIZE])
    step = unit @ (whole @ (whole.T if shares is None else shares[:, None] * whole.T))
    return np.asarray(step / np.einsum("ni,ni->n", step, unit)[:, None])


def shares_of(scene: Scene, x: Array, unit: Array, residual: Array, stated_nt: float | None) -> Array | None:
    """(3,) each axis' variance of noise over their mean, in the sensor; None where nothing tells them.

    By the samples' own differences where the craft turns little from one to the next.  Else by how the noise along the
    field depends on its direction, where there is no more than was stated: what physics leaves in the residual of a
    craft that turns fast depends on that direction, too.  Each counts as far as it is known beside what is usual.

    Parameters
    ----------
    scene: the samples.
    x, unit: as of ``step_to_clean``.
    residual: (n,) of magnitudes [nT].
    stated_nt: noise per axis as stated [nT], or None.
    """
    along = (unit @ (np.eye(3) + d_matrix(x[:STATE_SIZE]))) ** 2
    parts, squares = _bends(scene, along, residual)
    if len(squares) < _FEWEST:
        return None
    usual = float(np.mean(squares)) / float(np.mean(parts.sum(axis=1)))
    if stated_nt is not None and usual > (_AS_STATED * stated_nt) ** 2:
        return None  # a load that switches from sample to sample is no noise
    of_samples = _of_samples(scene)
    if of_samples is not None:
        variances, sigma = of_samples
        if abs(float(np.mean(parts @ variances)) / float(np.mean(squares)) - 1.0) < _AGREE:
            return _likeliest(variances, np.diag((sigma * variances) ** 2))
    return None if stated_nt is None else _of_residual(parts, squares)


def _bends(scene: Scene, along: Array, residual: Array) -> tuple[Array, Array]:
    """Squares (k,) of what a sample differs by from the mean of its neighbours [nT^2], in which nothing slow is, and
    what of each axis' variance is in them (k, 3)."""
    middle = np.arange(1, len(residual) - 1)
    middle = middle[~np.isin(middle, scene.pauses) & ~np.isin(middle + 1, scene.pauses)]
    before, after = middle - 1, middle + 1
    squares = (residual[middle] - 0.5 * (residual[before] + residual[after])) ** 2
    kept = squares < _FAR**2 * np.median(squares) / _OF_A_MEDIAN if len(squares) else squares > 0.0
    parts = along[middle] + 0.25 * (along[before] + along[after])
    return parts[kept], squares[kept]


def _of_samples(scene: Scene) -> tuple[Array, float] | None:
    """Variance (3,) of each axis' noise by its differences, and their relative sigma; None where the field's own
    course is in them."""
    parts = [part for part in np.split(scene.field_nt, scene.pauses) if len(part) > 2 * max(_ORDERS)]
    count = sum(len(part) for part in parts)
    if count < _FEWEST:
        return None
    found = []
    for order in _ORDERS:
        squares = np.concatenate([np.diff(part, order, axis=0) for part in parts]) ** 2
        limit = _FAR**2 * np.median(squares, axis=0) / _OF_A_MEDIAN
        kept = squares <= np.where(limit > 0.0, limit, np.inf)
        found.append((squares * kept).sum(axis=0) / np.maximum(kept.sum(axis=0), 1) / math.comb(2 * order, order))
    few, many = found
    if not np.all(many > 0.0) or np.any(np.abs(few / many - 1.0) > _AGREE):
        return None
    order = max(_ORDERS)
    remembers = math.comb(4 * order, 2 * order) / math.comb(2 * order, order) ** 2
    return many, math.sqrt(2.0 * remembers / count)


def _of_residual(parts: Array, squares: Array) -> Array:
    """Shares (3,) by least squares of squares (k,) on what of each axis is in them (k, 3)."""
    mean = float(np.mean(squares))
    usual = mean / float(np.mean(parts.sum(axis=1)))
    precision = 1.0 / (2.0 * mean**2 * _REMEMBERS)  # squares of a normal number scatter by sqrt(2) of their mean
    prior = np.eye(3) / (_USUAL * usual) ** 2
    found = np.linalg.solve(
        precision * parts.T @ parts + prior, precision * parts.T @ squares + usual * prior.sum(axis=1)
    )
    found = np.maximum(found, _LEAST_SHARE * usual)
    return np.asarray(found / found.mean())


def _likeliest(variances: Array, covariance: Array) -> Array:
    """Shares (3,) of variances (3,) known to a covariance, beside what is usual."""
    mean = float(variances.mean())
    prior = (_USUAL * mean) ** 2 * np.eye(3)
    found = mean + prior @ np.linalg.solve(prior + covariance, variances - mean)
    return np.asarray(found / found.mean())
