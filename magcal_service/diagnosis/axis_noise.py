"""Noise that is not alike in all directions, as of the axis across the face of a chip, and what it does.

Of a magnitude only the noise along the field is seen.  The vectors that columns are made of are freed of the rest of
it by a step along the field where noise is alike in all directions.  Where it is not, what lies across the field goes
along with what lies along it, and such a step leaves vectors whose error is correlated with the residual: products of
the field's components then hold a part of the noise itself (errors in variables).  The step has to go along the
covariance times the field's direction, and what is left of the noise is then correlated with nothing that is seen.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from magcal_service.model import STATE_SIZE, Array, d_matrix
from magcal_service.physics.scene.scene import Scene
from magcal_service.residuals import MEDIAN_TO_SIGMA

_SEEN: Final = 30.0
"""Chi-square of five numbers that are no noise alike in all directions, from which on it is unlike: by chance in one
recording of 70 000."""

_ORDERS: Final = (4, 6)
"""Differences of samples that follow one another, in which a field that turns by less than a third of a radian from one
to the next leaves less than its noise; both have to tell the same of it."""

_AGREE: Final = 0.15  # of a variance, up to which two estimates are of the same noise

_AS_STATED: Final = 1.2  # times the stated noise, up to which it is noise: as for a recording's own doubt of it

_FEWEST: Final = 300  # samples that variances are told from; of fewer a third is not known

_FAR: Final = 5.0  # times the noise: what is farther out is none


def step_to_clean(unit: Array, covariance: Array | None) -> Array:
    """(n, 3) the way to vectors free of what is seen of their noise, for one nT more along the field.

    Parameters
    ----------
    unit: (n, 3) directions of the calibrated field.
    covariance: (3, 3) of the calibrated vectors' noise, in any unit; None: alike in all directions.
    """
    if covariance is None:
        return unit
    step = unit @ covariance
    return np.asarray(step / np.einsum("ni,ni->n", step, unit)[:, None])


def covariance_of(scene: Scene, x: Array, unit: Array, residual: Array, stated_nt: float | None) -> Array | None:
    """(3, 3) covariance of the calibrated vectors' noise over its mean variance; None where it may be alike in all
    directions, or where nothing tells.

    It is told by the samples' own differences, where the craft turns little from one to the next, and where the noise
    along the field is as much as they say.

    Parameters
    ----------
    scene: the samples.
    x: nine errors first (9 + k,); ``unit``: (n, 3) directions of the calibrated field.
    residual: (n,) of magnitudes [nT].
    stated_nt: noise per axis as stated [nT], or None.
    """
    found = _of_samples(scene, np.eye(3) + d_matrix(x[:STATE_SIZE]))
    if found is None:
        return None
    covariance, sigma = found
    mean = float(np.trace(covariance)) / 3.0
    if stated_nt is not None and mean > (_AS_STATED * stated_nt) ** 2:
        return None  # a load that switches from sample to sample is no noise
    along = float(np.mean(np.einsum("ni,ij,nj->n", unit, covariance, unit)))
    if abs(_bends(scene, residual) / along - 1.0) > _AGREE:
        return None
    unlike = covariance / mean - np.eye(3)
    # a variance is known to sigma, a covariance of two to sigma over sqrt(2): the sum counts both places of the latter
    return covariance / mean if float((unlike**2).sum()) > _SEEN * sigma**2 else None


def _bends(scene: Scene, residual: Array) -> float:
    """Variance [nT^2] of the noise in a residual (n,), by what samples differ from the mean of their neighbours."""
    middle = np.arange(1, len(residual) - 1)
    middle = middle[~np.isin(middle, scene.pauses) & ~np.isin(middle + 1, scene.pauses)]
    bends = residual[middle] - 0.5 * (residual[middle - 1] + residual[middle + 1])
    size = np.abs(bends)
    return float(np.mean(bends[size < _FAR * MEDIAN_TO_SIGMA * np.median(size)] ** 2)) / 1.5


def _of_samples(scene: Scene, whole: Array) -> tuple[Array, float] | None:
    """Covariance (3, 3) of samples' noise, calibrated by I + D (3, 3), by their differences [nT^2], and its relative
    sigma; None where the field's own course is in them."""
    parts = [part @ whole.T for part in np.split(scene.field_nt, scene.pauses) if len(part) > 2 * max(_ORDERS)]
    count = sum(len(part) for part in parts)
    if count < _FEWEST:
        return None
    found = []
    for order in _ORDERS:
        each = np.concatenate([np.diff(part, order, axis=0) for part in parts])
        size = (each**2).sum(axis=1)
        kept = each[size < _FAR**2 * max(float(np.median(size)), 1e-300)]
        found.append(kept.T @ kept / max(len(kept), 1) / math.comb(2 * order, order))
    few, many = (np.diagonal(one) for one in found)
    if not np.all(many > 0.0) or np.any(np.abs(few / many - 1.0) > _AGREE):
        return None
    order = max(_ORDERS)
    remembers = math.comb(4 * order, 2 * order) / math.comb(2 * order, order) ** 2
    return found[-1], math.sqrt(2.0 * remembers / count)
