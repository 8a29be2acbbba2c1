"""Noise with a memory: 1/f, a driver that averages, or another level than stated."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from magcal_service.model import Array
from magcal_service.physics.interface import Effect, Finding, value_of
from magcal_service.physics.view import View

ORDER: Final = 8
_LEAST_NATS: Final = 15.0
_LEAST_CORRELATION: Final = 0.05


def autoregression(residual: Array, pauses: NDArray[np.intp] | None = None) -> tuple[Array, float]:
    """Coefficients (p,) of an autoregressive model of a residual (n,), and the nats that it gains over white noise.

    Source: Yule-Walker equations, solved by least squares on the samples' own products.
    """
    count = len(residual)
    order = min(ORDER, max(1, count // 50))
    usable = np.ones(count, dtype=bool)
    usable[:order] = False
    for first in () if pauses is None else pauses.tolist():
        usable[first : first + order] = False
    rows = np.flatnonzero(usable)
    if len(rows) < 10 * order:
        return np.zeros(0), 0.0
    design = np.stack([residual[rows - lag] for lag in range(1, order + 1)], axis=1)
    target = residual[rows]
    coefficients = np.linalg.lstsq(design, target, rcond=1e-10)[0]
    left = target - design @ coefficients
    gain = 0.5 * len(rows) * math.log(float(target @ target) / max(float(left @ left), 1e-300))
    return coefficients, gain - 0.5 * order * math.log(count)


def long_memory(residual: Array) -> Array:
    """Coefficients (p,) of an autoregressive model with a memory of up to 2048 samples, few of them free.

    The newest four samples have one each; means over the newest 8, 32, 128, 512 and 2048 share theirs: 1/f noise.
    Source: Corsi 2009, a heterogeneous autoregressive model, J. Financial Econometrics 7, 174-196.
    """
    spans = [1, 2, 3, 4, *(span for span in (8, 32, 128, 512, 2048) if span < len(residual) // 8)]
    longest = spans[-1]
    sums = np.concatenate([[0.0], np.cumsum(residual)])
    rows = np.arange(longest, len(residual))
    design = [residual[rows - lag] for lag in spans[:4]]
    design += [(sums[rows] - sums[rows - span]) / span for span in spans[4:]]
    weights = np.linalg.lstsq(np.stack(design, axis=1), residual[rows], rcond=1e-10)[0]
    coefficients = np.zeros(longest)
    coefficients[:4] = weights[:4]
    for span, weight in zip(spans[4:], weights[4:].tolist(), strict=True):
        coefficients[:span] += weight / span
    return coefficients


def body_correlation(view: View) -> float:
    """Correlation at one sample of noise that is fixed in the body, from e_i e_(i+1) = C u_i . u_(i+1)."""
    unit, e = view.scene.unit, view.residual_nt
    turned = np.einsum("ni,ni->n", unit[1:], unit[:-1])
    zero = float(np.mean(e**2))
    return float(np.clip((e[1:] * e[:-1]) @ turned / max(float(turned @ turned) * zero, 1e-300), -0.999, 0.999))


def _find(view: View) -> Finding | None:
    coefficients, nats = autoregression(view.residual_nt, view.scene.pauses)
    if not len(coefficients):
        return None
    correlation = body_correlation(view)
    level = float(np.sqrt(np.mean(view.residual_nt**2)))
    stated = view.stated_noise_nt
    other = stated is not None and abs(level / stated - 1.0) > max(0.03, 6.0 / math.sqrt(2.0 * len(view.residual_nt)))
    coloured = nats > _LEAST_NATS and max(abs(correlation), float(np.abs(coefficients).max())) > _LEAST_CORRELATION
    if not coloured and not (other and stated is not None and level > stated):
        return None
    sigma = 2.0 / math.sqrt(len(view.residual_nt))
    parameters = {
        "correlation": value_of(correlation, sigma, "1"),
        "level_nt": value_of(level, level / math.sqrt(2.0 * len(view.residual_nt)), "nT"),
    }
    if stated is not None:
        parameters["stated_nt"] = value_of(stated, 0.0, "nT")
    white = 1.0 if not coloured else 1.0 - math.exp(-2.0 * nats / len(view.residual_nt))
    return Finding(parameters, max(nats, _LEAST_NATS), white)


EFFECT = Effect(
    name="coloured_noise",
    title="the noise has a memory, or another level than stated",
    equation="eps_k = sum_j a_j eps_(k-j) + white; correlation at one sample rho",
    units={"correlation": "1", "level_nt": "nT", "stated_nt": "nT"},
    prior=(1.0, 2000.0),
    valid="stationary over the recording; slower structure than a few samples is looked for as physics first",
    confused_with=("bias_drift", "response_lag", "quantisation"),
    separated_by="a stretch in a shielded room: noise keeps its colour there, physics does not",
    source="Box & Jenkins 1970 (autoregressive models); drivers that average give 0.3-0.9 at one sample",
    says=("The noise has a correlation of {correlation} at one sample and a level of {level_nt} nT.",),
    find=_find,
    absorbed="a filter that takes the noise as white is too sure, by (1 + rho) / (1 - rho) in variance",
)
