"""Cramer-Rao bounds: the smallest standard deviation any unbiased estimator of the nine errors can have.

With isotropic noise s and noise-free vectors m = A H and B = (I + D)^-1 (m + b), every sample adds a Fisher information
F_k = R_k'R_k / s^2.  The rows R_k say what the sample shows of the state, by what is known beside it:

====================  ============================================================================================
``SCALAR``            |H| only, equations (2)-(4): R = u' J(B) with u = m / |m|, the radial component.
``SCALAR_SPIN``       also the spin pseudo-measurements, equations (6): the radial rows, and per spin window the mean
                      of the components across the spin axis, of tangential noise only.
``VECTOR_SPIN``       H, and a steady spin of unknown direction, phase and rate: R = J(B), less what these four (with
                      an unknown body axis: six) nuisance parameters can imitate.
``VECTOR_ATTITUDE``   H and the attitude A: R = J(B).
====================  ============================================================================================

Information adds, so the bound over time is the inverse of the cumulative sum.  What the bounds leave out: the
information that the size of the tangential noise carries (of order (s / |H|)^2, below 1e-3 to 5 % noise).

Source: Rao 1945, Cramer 1946 for the bound; Van Trees 1968, section 2.4, for nuisance parameters (Schur complement);
the measurement model is equations (1)-(6) of the method.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from magcal_service.estimators.interface import InformationSet
from magcal_service.estimators.parts.spin_window import (
    LEO_FIELD_RATE_RAD_S,
    across_axis,
    harmonic_leak_nt,
    harmonic_weights,
)
from magcal_service.model import STATE_SIZE, Array, field_jacobian, measure


@dataclass(frozen=True, slots=True)
class Flight:
    """A noise-free experiment.

    Parameters
    ----------
    times_s: sample times (n,) [s], rising.
    field_body_nt: true field A H (n, 3) [nT], body.
    x: true state (9,) [nT, -].
    noise_nt: white noise, 1 sigma per axis [nT].
    spin_axis: unit vector in the body (3,); needed by the two sets with spin.
    spin_rate_rad_s: rate about +axis [rad/s].
    window_s: length of a spin window (``SpinConfig.window_s``) [s]; needed by ``SCALAR_SPIN``.
    """

    times_s: Array
    field_body_nt: Array
    x: Array
    noise_nt: float
    spin_axis: Array | None = None
    spin_rate_rad_s: float = 0.0
    window_s: float = 0.0

    def jacobian(self) -> Array:
        """J(B) (n, 3, 9) at the noise-free measured vectors."""
        return field_jacobian(measure(self.x, self.field_body_nt))

    def spin(self) -> tuple[Array, float]:
        """Axis and rate; ValueError where the flight has none."""
        if self.spin_axis is None or self.spin_rate_rad_s == 0.0:
            raise ValueError(
                f"spin_rate_rad_s = {self.spin_rate_rad_s}: this information set needs a spin axis and rate"
            )
        return self.spin_axis, self.spin_rate_rad_s


def bound_sigma(flight: Flight, known: InformationSet, *, body_axis_known: bool = True) -> Array:
    """1 sigma of the nine states at the end of the flight (9,) [nT, -]; parameters as ``bound_over_time``."""
    sigma: Array = bound_over_time(flight, known, flight.times_s[-1:], body_axis_known=body_axis_known)[0]
    return sigma


def bound_over_time(flight: Flight, known: InformationSet, at_s: Array, *, body_axis_known: bool = True) -> Array:
    """1 sigma of the nine states from all samples up to each of the times ``at_s`` (k,): (k, 9) [nT, -].

    Parameters
    ----------
    flight: the experiment.
    known: the information set.
    at_s: times [s], rising; inf comes back where the samples so far don't determine a state.
    body_axis_known: for ``VECTOR_SPIN``, whether the spin axis in the body is given or to be estimated, too.

    Raises ValueError where the set needs a spin that the flight does not have.
    """
    counts = np.searchsorted(flight.times_s, at_s, side="right")
    information = cumulative_information(flight, known, counts.tolist(), body_axis_known=body_axis_known)
    return np.stack([_sigma(matrix) for matrix in information])


def cumulative_information(
    flight: Flight, known: InformationSet, counts: Sequence[int], *, body_axis_known: bool = True
) -> Array:
    """Fisher information (k, p, p) of the first ``counts`` samples; nuisance parameters stand after the nine states."""
    jacobian = flight.jacobian()
    if known is InformationSet.VECTOR_ATTITUDE:
        return _accumulate(jacobian / flight.noise_nt, counts)
    if known is InformationSet.VECTOR_SPIN:
        nuisance = _spin_rows(flight, body_axis_known)
        return _accumulate(np.concatenate([jacobian, nuisance], axis=2) / flight.noise_nt, counts)
    unit = flight.field_body_nt / np.linalg.norm(flight.field_body_nt, axis=1)[:, None]
    information = _accumulate(np.einsum("ni,nij->nj", unit, jacobian)[:, None] / flight.noise_nt, counts)
    if known is InformationSet.SCALAR_SPIN:
        information = information + _window_information(flight, jacobian, counts)
    return information


def _accumulate(rows: Array, counts: Sequence[int]) -> Array:
    """Sums of R'R over the first ``counts`` of rows (n, m, p): (k, p, p)."""
    edges = [0, *counts]
    parts = [rows[first:last].reshape(-1, rows.shape[2]) for first, last in pairwise(edges)]
    sums: Array = np.cumsum([part.T @ part for part in parts], axis=0)
    return sums


def _sigma(information: Array) -> Array:
    """Square roots of the first nine diagonal elements of the inverse; inf where it has none."""
    scale = np.sqrt(np.maximum(np.diagonal(information), np.finfo(float).tiny))
    values, vectors = np.linalg.eigh(information / np.outer(scale, scale))
    if values[0] < 1e-13:
        return np.full(STATE_SIZE, np.inf)
    sigma: Array = (np.sqrt(((vectors / values) * vectors).sum(axis=1)) / scale)[:STATE_SIZE]
    return sigma


def _spin_rows(flight: Flight, body_axis_known: bool) -> Array:
    """Derivatives of A H with respect to the spin's nuisance parameters (n, 3, 4 or 6), per rad and rad/s.

    A = exp(-[a w t]x) A_0.  A turn of A_0 by theta (body axes at t = 0: direction and phase) moves A H by
    (exp(-[a w t]x) theta) x A H, with a sign that does not matter; a change of the rate vector by dw moves it by
    (S(t) dw) x A H, with S the integral of exp(-[a w (t - s)]x) over s, (Rodrigues).
    """
    axis, rate = flight.spin()
    t = flight.times_s - flight.times_s.mean()  # the same parameters, referred to mid-flight: better conditioned
    along, cross = np.outer(axis, axis), _skew(axis)
    across = np.eye(3) - along
    cos, sin = np.cos(rate * t)[:, None, None], np.sin(rate * t)[:, None, None]
    turned = along + cos * across - sin * cross
    moved = along * t[:, None, None] + (sin * across - (1.0 - cos) * cross) / rate
    rate_part = moved if not body_axis_known else moved @ axis[:, None]
    angles = np.concatenate([turned, rate_part], axis=2)
    rows: Array = -_skew(flight.field_body_nt) @ angles
    return rows


def _skew(vector: Array) -> Array:
    """[v]x (..., 3, 3), so that [v]x y = v x y."""
    x, y, z = vector[..., 0], vector[..., 1], vector[..., 2]
    zero = np.zeros_like(x)
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1).reshape(*vector.shape, 3)


def _window_information(flight: Flight, jacobian: Array, counts: Sequence[int]) -> Array:
    """Information of the finished spin windows among the first ``counts`` samples (k, 9, 9).

    A window measures across'(sum of weights times w), of which the radial noise is in the scalar rows already: what is
    left is the tangential part, rows and noise both.
    """
    axis, rate = flight.spin()
    across = across_axis(axis)
    if not flight.window_s > 0.0:
        raise ValueError(f"window_s = {flight.window_s}: this information set needs the length of a spin window")
    number = np.floor((flight.times_s - flight.times_s[0]) / flight.window_s + 1e-9).astype(int)
    edges = np.append(np.flatnonzero(np.diff(number, prepend=-1)), len(number))
    magnitude = np.linalg.norm(flight.field_body_nt, axis=1)
    unit = flight.field_body_nt / magnitude[:, None]
    tangential = np.eye(3) - unit[:, :, None] * unit[:, None, :]
    information = np.zeros((len(counts), STATE_SIZE, STATE_SIZE))
    for first, last in pairwise(edges[:-1].tolist()):  # the last one is not known to be finished
        part = slice(first, last)
        weights = harmonic_weights(flight.times_s[part], rate) if last - first >= 6 else None
        if weights is None:
            continue
        rows = np.einsum("ci,k,kij,kjs->cs", across, weights, tangential[part], jacobian[part])
        noise = flight.noise_nt**2 * np.einsum("ci,k,kij,dj->cd", across, weights**2, tangential[part], across)
        leak_nt = harmonic_leak_nt(magnitude[part], LEO_FIELD_RATE_RAD_S / rate)
        gain = rows.T @ np.linalg.solve(noise + leak_nt**2 * np.eye(2), rows)
        information[np.array(counts) >= last] += gain
    return information
