"""What speaks against acting on a diagnosis: its fit, its numbers, what is left beside it, and names too uncertain."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np

from magcal_service.diagnosis.belief import posterior
from magcal_service.diagnosis.blocks import gain_over, steady_gain
from magcal_service.diagnosis.explain import Explained
from magcal_service.diagnosis.field_error import FieldError, Scale
from magcal_service.diagnosis.field_level import likelier_by
from magcal_service.diagnosis.problem import Fit
from magcal_service.diagnosis.rest import Rest
from magcal_service.diagnosis.sized import has_size
from magcal_service.diagnosis.which_driver import otherwise
from magcal_service.model import BIAS, D_ALL, STATE_SIZE, Array
from magcal_service.physics.interface import Finding
from magcal_service.residuals import MEDIAN_TO_SIGMA

SURE: Final = 0.95
"""Probability from which on a name is acted on: of those said so, one in twenty may be false."""

_FIELD_MODELS: Final = Scale(2.0, 3.0)
"""Times the usual errors of a field model, beyond which a recording is doubted: one model in twenty errs so much; of
what changes over shorter ways on a quiet night a third of that, on most others as much."""

_BEYOND_NATS: Final = 6.0
"""Nats by which larger errors have to be likelier to be seen, as of a family of shapes."""

STANDS_OUT: Final = 3.0
"""Standard errors over blocks by which the held-out gain has to stand out of its scatter."""

LITTLE_LEFT: Final = 0.05
"""Share of the mismatch without a name beside which names are still acted on: their numbers move by a few per cent."""

_MORE_THAN_LEFT: Final = 4.0
"""Times what is left without a name, what each name has to hold: of two true ones hardly anything is left."""

_MOST_BIAS_SIGMA_NT: Final = 1000.0  # a thirtieth of the field: the vector would be off by 2 deg
_MOST_D_SIGMA: Final = 0.05  # the same, by D
"""Sigma of the nine errors from which on the field did not point in enough directions; a choice."""

_MOST_NOISE: Final = 0.02
"""Share of the field that a sensor's noise may be, where it was not stated: 600 nT of the noisiest consumer parts are
1 to 2 %.  What changes from sample to sample by more is no noise, and names beside it only follow it."""

_NOISIER: Final = 1.2
"""Times the stated noise, what may be left at the most: the level of a hundred samples is known to 7 %."""

FEWEST_SAMPLES: Final = 300
"""Samples below which fifty blocks hold six each, and held-out blocks show nothing."""


def reasons(
    explained: Explained,
    unexplained: float,
    unknown: bool,
    stated: bool = True,
    rest: Rest | None = None,
    findings: Mapping[str, Finding] | None = None,
    reference_far_off: bool = False,
) -> tuple[str, ...]:
    """What speaks against acting on a result, by the names of ``advice.REASONS``.

    Parameters
    ----------
    explained: with effects, and what is left beside them.
    unexplained: share of the mismatch without a name; ``unknown``: whether that is the verdict.
    stated: whether the sensor's noise was stated, not estimated from the residual.
    rest: what lasts beside the names; None where the noise has a memory.
    findings: effects seen in samples, attitude or noise, by name.
    reference_far_off: whether whole vectors agree with a reference alone that is off by more than is believed.
    """
    fit, named, findings = explained.fit, bool(explained.fit.terms), findings or {}
    return listed(
        explained,
        rest,
        findings,
        poor_coverage=not has_coverage(fit.covariance[:STATE_SIZE, :STATE_SIZE]),
        unexplained_structure=unknown or (named and is_too_much(explained, unexplained)),
        **of_noise_and_reference(
            fit,
            named=named,
            stated=stated,
            own_noise_nt=max(
                (float(one.parameters["level_nt"].value) for one in findings.values() if "level_nt" in one.parameters),
                default=0.0,
            ),
            added_noise_nt=added_noise_nt(findings),
        ),
        reference_far_off=reference_far_off,
    )


def of_noise_and_reference(
    fit: Fit, *, named: bool, stated: bool, own_noise_nt: float = 0.0, added_noise_nt: float = 0.0
) -> dict[str, bool]:
    """Which doubts hold about the noise and the reference of one recording, by itself or among several.

    Parameters
    ----------
    fit: of the recording, with its effects.
    named: whether there are any; ``stated`` as of ``reasons``.
    own_noise_nt: level of noise with a memory that was found and said, 0 where it has none [nT]; it hangs together as
        the field model's errors do, which then have to show in how much is left.
    added_noise_nt: noise that was found on top of the stated one, as by a lattice of values [nT per axis].
    """
    reference_errs = is_beyond_model(fit) or errs_clearly(fit) or (not named and _adds_up_to_less(fit))
    return {
        "rough_residual": named and not stated and is_rough(fit),
        "noisier_than_stated": stated and not own_noise_nt and is_noisier(fit, added_noise_nt),
        "field_model_doubtful": reference_errs and (not own_noise_nt or _leaves_more_than_usual(fit, own_noise_nt)),
    }


def is_too_much(explained: Explained, unexplained: float) -> bool:
    """Whether too much is left without a name to act on the names: a share of the mismatch, or beside one of them."""
    return unexplained > LITTLE_LEFT or _hardly_more(explained)


def listed(
    explained: Explained,
    rest: Rest | None,
    findings: Mapping[str, Finding],
    *,
    poor_coverage: bool,
    unexplained_structure: bool,
    **beside: bool,
) -> tuple[str, ...]:
    """The reasons that hold, in order: what any fit says of itself, with those that its diagnosis found.

    Parameters
    ----------
    explained: with effects.
    rest: what lasts beside the names; None where the noise has a memory.
    findings: as of ``reasons``.
    poor_coverage, unexplained_structure: whether these hold.
    beside: further ones, by name.
    """
    fit = explained.fit
    found = {
        "not_converged": not fit.converged,
        "collapsed": fit.problem.is_collapsed(fit.x),
        "poor_coverage": poor_coverage,
        "unexplained_structure": unexplained_structure,
        "mismatch_lasts": bool(fit.terms) and rest is not None and rest.is_much,
        "not_enough_data": len(fit.problem.scene) < FEWEST_SAMPLES,
        **{reason: bool(names) for reason, names in concerned(explained, findings).items()},
        **beside,
    }
    return tuple(name for name, holds in found.items() if holds)


def concerned(explained: Explained, findings: Mapping[str, Finding]) -> dict[str, tuple[str, ...]]:
    """The effects that each reason is about, by the reason, for those that are about single ones."""
    names = [term.hypothesis.effect for term in explained.fit.terms]
    sure = [min(posterior(explained, index).own, 1.0 - otherwise(explained, index)) for index in range(len(names))]
    unsure = [name for name, least in zip(names, sure, strict=True) if least < SURE]
    unsure += [name for name, one in findings.items() if 1.0 - one.doubt < SURE]
    sized = [has_size(explained.fit, i) and not any(explained.courses[i : i + 1]) for i in range(len(names))]
    unsized = [name for name, is_sized in zip(names, sized, strict=True) if not is_sized]
    return {"name_uncertain": tuple(unsure), "size_uncertain": tuple(unsized)}


def added_noise_nt(findings: Mapping[str, Finding]) -> float:
    """Noise that a finding says comes on top of the sensor's own [nT per axis], 0 where none says so."""
    added = [one.parameters["added_noise_nt"].value for one in findings.values() if "added_noise_nt" in one.parameters]
    return max((float(np.max(one)) for one in added), default=0.0)


def has_coverage(covariance: Array) -> bool:
    """Whether the field pointed in enough directions to fix nine errors of a covariance (9, 9)."""
    sigma = np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
    return float(sigma[BIAS].max()) <= _MOST_BIAS_SIGMA_NT and float(sigma[D_ALL].max()) <= _MOST_D_SIGMA


def _hardly_more(explained: Explained) -> bool:
    """Whether one of the names holds hardly more than what is left without one: it may be a part of that instead."""
    return any(gain.nats < _MORE_THAN_LEFT * explained.shaped_nats for gain in explained.gains)


def is_rough(fit: Fit) -> bool:
    """Whether what changes from sample to sample is more of the field than any sensor's noise."""
    return fit.problem.noise_nt > _MOST_NOISE * float(np.mean(fit.problem.scene.magnitude_nt))


def is_noisier(fit: Fit, added_nt: float = 0.0) -> bool:
    """Whether more is left than the noise and the field model's errors, by rms and by the median alike.

    Outliers raise the one, and a few large waves hardly the other.  The noise is the sensor's, per axis, and so are
    ``added_nt`` on top [nT]; calibration multiplies them by I + D along the field.
    """
    left = fit.held_out_white
    noise_nt = max(fit.noise_gain, 1.0) * float(np.hypot(fit.problem.noise_nt, added_nt))
    robust = MEDIAN_TO_SIGMA * float(np.median(np.abs(left - np.median(left))))
    return min(float(np.sqrt(np.mean(left**2))), robust) > _NOISIER * noise_nt


def is_beyond_model(fit: Fit) -> bool:
    """Whether the reference errs by more than field models do, and what is left shows it, by its size or by how it
    hangs together: nobody knows by what."""
    error = fit.problem.field_error
    if error is None or error.scale.is_within(_FIELD_MODELS):
        return False
    return likelier_by(fit, _FIELD_MODELS) > _BEYOND_NATS or _leaves_more_than_usual(fit)


def errs_clearly(fit: Fit) -> bool:
    """Whether the reference errs by more than is usual, in degrees that no loud night changes, and that much is left:
    old coefficients, whose error no random field is like, move nine errors by more than their sigma."""
    error = fit.problem.field_error
    if error is None or error.scale.coarse <= 1.0:
        return False
    usual = Scale(1.0, error.scale.fine)
    return likelier_by(fit, usual) > _BEYOND_NATS and _leaves_more_than_usual(fit)


def _leaves_more_than_usual(fit: Fit, own_noise_nt: float = 0.0) -> bool:
    """Whether held-out rows are left with more than noise, its memory included, and a field model's usual errors."""
    error = fit.problem.field_error
    assert error is not None
    noise_nt = max(_noise_nt(fit, error), own_noise_nt)
    return fit.held_out_rms_nt > _NOISIER * float(np.hypot(noise_nt, error.usual_nt))


def _adds_up_to_less(fit: Fit) -> bool:
    """Whether noise and a field model's usual errors make less than the fit leaves on its own rows."""
    error = fit.problem.field_error
    return error is not None and fit.rms_nt > _NOISIER * float(np.hypot(_noise_nt(fit, error), error.may_be_nt))


def _noise_nt(fit: Fit, error: FieldError) -> float:
    """The sensor's noise along the field as calibrated, or of the sensor itself if that is more [nT]."""
    return max(fit.noise_gain, 1.0) * error.noise_nt


def stands_out(baseline: Fit, fit: Fit, floor_nt: float) -> bool:
    """Whether held-out blocks gain by the effects by more than their gains scatter, all of them or but for one."""
    number = fit.problem.blocks(fit.white_residual)
    sigma2 = max(fit.white_rms_nt / fit.noise_gain, floor_nt) ** 2
    left = baseline.sensor_held_out, fit.sensor_held_out
    gains = (gain_over(*left, number, sigma2), steady_gain(*left, number, sigma2))
    return max(one.tempered for one in gains) > 2.0 * STANDS_OUT**2  # nats beyond sigmas of sqrt(2 nats dispersion)
