"""Noise with a memory: 1/f, a driver that averages, or another level than stated."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from magcal_service.model import Array
from magcal_service.physics.acting import ActsOn, Watched
from magcal_service.physics.interface import Effect, Finding, value_of
from magcal_service.physics.scene.scene import Scene
from magcal_service.physics.scene.view import View

ORDER: Final = 8
"""Order of the autoregression; what lasts longer is ``long_memory``'s. Choice: each costs half of ln n nats."""

_FREE: Final = 16
"""Newest samples that have a coefficient each where a residual is whitened.

A driver that averages four has a memory that ends at once: of its rest after 4, 8 and 16 the largest correlation is
0.29, 0.22 and 0.15.
"""

_LEAST_NATS: Final = 15.0
"""Evidence from which on the noise is coloured: odds of 3 million, since every recording is tested."""

_LEAST_CORRELATION: Final = 0.05
"""Correlation below which a memory is neglected: variances are off by 10 % at most, (1 + rho) / (1 - rho)."""

_SIGNIFICANT_SIGMAS: Final = 5.0
"""Sampling errors that a correlation has to have besides: by chance once in 2 million."""

_FADING: Final = 0.3
"""Share of its covariance at one sample that noise has lost after ten; choice: what keeps more is slow physics.

A first-order memory of 25 samples (rho 0.96) loses 0.3; half of that suffices where the noise is stated.
"""

_NEAR: Final = (1, 2)
"""Lags [samples] at which a memory is taken to be whole."""

_FAR: Final = (9, 10, 11, 12)
"""Lags [samples], ten on average, at which one that begins to fade within ten samples has faded; four err by half."""

_FADES_SIGMAS: Final = 3.0
"""Sampling errors by which a memory has to be seen to fade: what does not show that it fades may be slow physics."""

_TURNED_AWAY: Final = 48  # samples within which a craft that tumbles or spins has turned away; a choice
_AWAY: Final = -0.3  # cosine of the turn, from which on it has
_FEWEST_AWAY: Final = 100  # pairs of samples: fewer show a tenth only by three of its sigma

_ALONG_SIGMAS: Final = 6.0
"""Sigmas of white noise by which they have to go along: of 48 lags, of a memory that doubles them."""

_OWN: Final = 0.85
"""Share of the stated noise's square that may change from one sample to the next if the noise has a memory.

White noise of the stated level has 1. Choice: white noise 8 % below what is stated passes for one with a memory.
"""

_OF_LEVEL: Final = (0.8, 1.05)
"""Times the stated noise's square, what all that is left is where it is the noise: nothing slow on top of it, but what
the sampling of a few thousand samples makes of it."""

_MODEL_S: Final = 5.0
"""Sample period from which on a field model's errors fade within ten samples, as a noise does [s]: those of degree 14
and more change over 500 km and less, which an orbit passes in a minute."""

_MODEL_NT: Final = 45.0
"""What a field model errs by at the most but for one in twenty, 1 sigma [nT]: twice the usual 22."""

_AT_ONCE: Final = 2
"""Columns filtered at a time: those of 20 000 rows and their sums stay in a core's own cache of 1 MB, and filtering
takes half of the time that it takes with eight."""


def autoregression(
    residual: Array, pauses: NDArray[np.intp] | None = None, unit: Array | None = None
) -> tuple[Array, float]:
    """Coefficients (p,) of an autoregressive model of a residual (n,), and the nats that it gains over white noise.

    With the field's directions ``unit`` (n, 3) in the body the noise is one that is fixed in the body and seen along
    them: what was seen a lag before counts by the cosine of the turn since, e_k = sum_l a_l (u_k . u_(k-l)) e_(k-l).

    Source: Yule-Walker equations, solved by least squares on the samples' products.
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
    along, body = _in_body(residual, unit)
    design = np.stack([_dot(along[rows], body[rows - lag]) for lag in range(1, order + 1)], axis=1)
    target = residual[rows]
    coefficients = np.linalg.lstsq(design, target, rcond=1e-10)[0]
    left = target - design @ coefficients
    gain = 0.5 * len(rows) * math.log(float(target @ target) / max(float(left @ left), 1e-300))
    return coefficients, gain - 0.5 * order * math.log(count)


def _in_body(residual: Array, unit: Array | None) -> tuple[Array, Array]:
    """Directions (n, d), and the residual put along them (n, d)."""
    along = np.ones((len(residual), 1)) if unit is None else unit
    return along, along * residual[:, None]


def _dot(first: Array, second: Array) -> Array:
    return np.asarray(np.einsum("nd,nd->n", first, second))


def long_memory(residual: Array, unit: Array | None = None) -> Array:
    """Coefficients (p,) of an autoregressive model with a memory of up to 2048 samples, few of them free.

    The newest 16 samples have one each; means over the newest 32, 128, 512 and 2048 share theirs: 1/f noise.
    ``unit`` as in ``autoregression``.
    Source: Corsi 2009, a heterogeneous autoregressive model, J. Financial Econometrics 7, 174-196.
    """
    means = [span for span in (32, 128, 512, 2048) if span < len(residual) // 8]
    longest = max([_FREE, *means])
    along, body = _in_body(residual, unit)
    sums = np.concatenate([np.zeros((1, along.shape[1])), np.cumsum(body, axis=0)])
    rows = np.arange(longest, len(residual))
    design = [_dot(along[rows], body[rows - lag]) for lag in range(1, _FREE + 1)]
    design += [_dot(along[rows], sums[rows] - sums[rows - span]) / span for span in means]
    weights = np.linalg.lstsq(np.stack(design, axis=1), residual[rows], rcond=1e-10)[0]
    coefficients = np.zeros(longest)
    coefficients[:_FREE] = weights[:_FREE]
    for span, weight in zip(means, weights[_FREE:].tolist(), strict=True):
        coefficients[:span] += weight / span
    return coefficients


class Whitener:
    """What an autoregressive model of noise fixed in the body predicts, subtracted.

    Each of the newest samples counts by a coefficient of its own and by the cosine of the turn since, which are worked
    out once.  Before them coefficients are level for long: what they predict is a sum of means, one for every lag after
    which they change, so running sums do it.

    Parameters
    ----------
    coefficients: (p,) of the model.
    unit: (n, 3) directions as in ``autoregression``.
    """

    def __init__(self, coefficients: Array, unit: Array) -> None:
        count = len(unit)
        newest = min(_FREE, len(coefficients))
        level = coefficients[newest] if newest < len(coefficients) else 0.0
        lags = range(1, min(newest, count - 1) + 1)
        self._newest = [(lag, (coefficients[lag - 1] - level) * _dot(unit[lag:], unit[:-lag])) for lag in lags]
        levels = np.concatenate([np.full(newest, level), coefficients[newest:]])
        falls = levels - np.append(levels[1:], 0.0)
        self._falls = [(lag, falls[lag - 1]) for lag in (np.flatnonzero(falls) + 1).tolist() if lag < count]
        self._level = float(level)
        self._directions = np.ascontiguousarray(unit.T)

    def white(self, rows: Array) -> Array:
        """Rows (n, k) in which the noise is white, each column in one piece."""
        columns = np.ascontiguousarray(rows.T, dtype=np.float64)
        result = np.array(columns)
        spare, sums, body = (np.zeros((min(_AT_ONCE, len(columns)), len(rows))) for _ in range(3))
        for first in range(0, len(columns), _AT_ONCE):
            some, left = columns[first : first + _AT_ONCE], result[first : first + _AT_ONCE]
            part = slice(0, len(some))
            self._subtract(some, left, spare[part], sums[part], body[part])
        return result.T

    def _subtract(self, columns: Array, left: Array, spare: Array, sums: Array, body: Array) -> None:
        """From ``left`` (k, n) what columns (k, n) predict; the others (k, n) are room for it, ``sums`` begin at 0."""
        for lag, weights in self._newest:
            left[:, lag:] -= np.multiply(weights, columns[:, :-lag], out=spare[:, lag:])
        for direction in self._directions if self._falls else ():
            np.multiply(columns, direction, out=spare)
            np.cumsum(spare[:, :-1], axis=1, out=sums[:, 1:])  # of the samples before each
            np.multiply(self._level, sums, out=body)
            for lag, fall in self._falls:
                body[:, lag:] -= np.multiply(fall, sums[:, :-lag], out=spare[:, lag:])
            left -= np.multiply(body, direction, out=body)


def is_noise(view: View) -> bool:
    """Whether a correlated residual is the noise itself, rather than something slow on top of it.

    The covariance of a noise fixed in the body at a lag l is C_l = sum e_k e_(k+l) c / sum c^2, c the cosine of the
    turn between.  What changes from one sample to the next, C_0 - C_1, is the noise's square if that is white, and
    less if it has a memory, unless all of it is as large as stated; and a memory begins to fade within ten samples.
    """
    unit, e = view.scene.unit, view.residual_nt
    if _is_of_reference(view):
        return False
    zero, one = (covariance(unit, e, lag) for lag in (0, 1))
    turned = _dot(unit[1:], unit[:-1])
    sampling = 1.0 / math.sqrt(max(float(turned @ turned), 1.0))
    least = max(_LEAST_CORRELATION, _SIGNIFICANT_SIGMAS * sampling)
    if one < least * zero:
        return one < -3.0 * least * zero
    stated = view.stated_noise_nt
    if stated is None:
        return _fades(view, _FADING, sampling * zero)
    has_room = zero - one < _OWN * stated**2 or _OF_LEVEL[0] < zero / stated**2 < _OF_LEVEL[1]
    return has_room and _fades(view, 0.5 * _FADING, sampling * zero)


def _is_of_reference(view: View) -> bool:
    """Whether samples go along with one another though the body has turned away between them: as of a reference, whose
    errors are magnitudes and do not turn.

    Noise fixed in the body is seen with the other sign there, or has faded.  What a field model errs by was taken for a
    memory that fades within ten samples, for a craft had turned by a half meanwhile.
    """
    unit, e = view.scene.unit, view.residual_nt
    level = max(float(np.mean(e**2)), 1e-300)
    for lag in range(1, min(_TURNED_AWAY, len(e) // 4)):
        away = _dot(unit[:-lag], unit[lag:]) < _AWAY
        count = int(np.count_nonzero(away))
        if count < _FEWEST_AWAY:
            continue
        along = float(np.mean((e[:-lag] * e[lag:])[away])) / level
        if along * math.sqrt(count) > _ALONG_SIGMAS:
            return True
    return False


def _fades(view: View, share: float, sampling: float) -> bool:
    """Whether a memory is seen to lose a share of its covariance within ten samples.

    ``sampling`` [nT^2] is the error of a covariance at one lag where most of the noise is white.
    """
    near, far = (
        float(np.mean([covariance(view.scene.unit, view.residual_nt, lag) for lag in lags])) for lags in (_NEAR, _FAR)
    )
    error = sampling * math.hypot((1.0 - share) / math.sqrt(len(_NEAR)), 1.0 / math.sqrt(len(_FAR)))
    return (1.0 - share) * near - far > _FADES_SIGMAS * error


def covariance(unit: Array, residual: Array, lag: int) -> float:
    """Covariance [nT^2] at a lag of noise fixed in the body, seen along directions ``unit`` (n, 3)."""
    count = len(residual) - lag
    cosine = _dot(unit[:count], unit[lag:])
    return float((residual[:count] * residual[lag:]) @ cosine / max(float(cosine @ cosine), 1e-300))


def body_correlation(view: View) -> float:
    """Correlation at one sample of noise that is fixed in the body."""
    unit, e = view.scene.unit, view.residual_nt
    return float(np.clip(covariance(unit, e, 1) / max(covariance(unit, e, 0), 1e-300), -0.999, 0.999))


def _independent(residual: Array) -> float:
    """As many independent samples would tell the level of a residual (n,) as well: n / (1 + 2 sum r_l^2).

    r_l is its correlation at a lag of l samples, up to the first that does not stand out.
    Source: Bartlett 1946, J. Royal Statistical Society B 8, 27-41, variance of a mean square.
    """
    count, total = len(residual), 1.0
    square = max(float(residual @ residual), 1e-300)
    for lag in range(1, count // 2):
        correlation = float(residual[:-lag] @ residual[lag:]) / square
        if abs(correlation) < 2.0 / math.sqrt(count):
            break
        total += 2.0 * correlation**2
    return count / total


def _find(view: View) -> Finding | None:
    coefficients, nats = autoregression(view.residual_nt, view.scene.pauses, view.scene.unit)
    if not len(coefficients):
        return None
    correlation = body_correlation(view)
    level = float(np.sqrt(np.mean(view.residual_nt**2)))
    stated = view.stated_noise_nt
    other = stated is not None and abs(level / stated - 1.0) > max(0.03, 6.0 / math.sqrt(2.0 * len(view.residual_nt)))
    coloured = nats > _LEAST_NATS and max(abs(correlation), float(np.abs(coefficients).max())) > _LEAST_CORRELATION
    if not coloured and not (other and stated is not None and level > stated):
        return None
    lasting = level**2 - (stated or 0.0) ** 2 if other else correlation * level**2
    if _is_field_models(view.scene) and 0.0 < lasting < _MODEL_NT**2:
        return None
    sigma = 2.0 / math.sqrt(len(view.residual_nt))
    parameters = {
        "correlation": value_of(correlation, sigma, "1"),
        "level_nt": value_of(level, level / math.sqrt(2.0 * _independent(view.residual_nt)), "nT"),
    }
    if stated is not None:
        parameters["stated_nt"] = value_of(stated, 0.0, "nT")
    return Finding(parameters, max(nats, _LEAST_NATS), share=0.0)  # noise explains no mismatch


def _is_field_models(scene: Scene) -> bool:
    """Whether what lasts for some samples may be the errors of a field model along an orbit."""
    return scene.in_orbit and scene.period_s >= _MODEL_S


EFFECT = Effect(
    name="coloured_noise",
    acts_on=ActsOn.NOISE,
    watched=((Watched.MEMORY, ""),),
    title="the noise has a memory, or another level than stated",
    equation="eps_k = sum_j a_j eps_(k-j) + white; correlation at one sample rho",
    units={"correlation": "1", "level_nt": "nT", "stated_nt": "nT"},
    prior=(1.0, 2000.0),
    valid="stationary over the recording; slower structure than a few samples is looked for as physics first",
    confused_with=("bias_drift", "response_lag", "quantisation"),
    separated_by="a stretch in a shielded room: noise keeps its colour there, physics does not",
    source="Box & Jenkins 1970 (autoregressive models); drivers that average give 0.3-0.9 at one sample",
    says=("The noise has a correlation of {correlation.signed} at one sample and a level of {level_nt.size}.",),
    find=_find,
    absorbed="a filter that takes the noise as white is too sure, by (1 + rho) / (1 - rho) in variance",
)
