"""Nine errors that are known before a recording: the filter goes on from them instead of from a start of its own."""

from __future__ import annotations

from typing import Final

import numpy as np

from magcal_service.base.errors import MISSING, Fault, InputRefusedError, Lacking
from magcal_service.config.settings import CraftConfig
from magcal_service.estimators import find_method, methods
from magcal_service.estimators.interface import GoesOn
from magcal_service.estimators.parts.start_gates import handover_sigma, vector_sigma
from magcal_service.offline.given import Given
from magcal_service.recordings.recording import Recording
from magcal_service.trust.reasons import Reason

_ONLY_UNFINISHED: Final = {Reason.NOT_SETTLED, Reason.UNPROTECTED, Reason.CONSTANT_REFERENCE}
"""Reasons that say a result is not finished; every other says that it may be wrong."""


def refuse_unfit(given: Given, recording: Recording, craft: CraftConfig) -> None:
    """Raise ``InputRefusedError`` where a result cannot be what a filter goes on from.

    Parameters
    ----------
    given: the earlier result.
    recording: usable rows of the one that is to come.
    craft: with the method that is to go on.

    A method without ``takes_prior``; a result that may be wrong; one without a noise level where none is stated; and
    one that leaves vectors less sure than a start of the filter's own has to make them.
    """
    given.refuse_other_craft(recording)
    faults = []
    if not find_method(craft.filter.method).takes_prior:
        able = ", ".join(method.name for method in methods() if method.takes_prior)
        faults.append(Fault("--prior with the method", craft.filter.method, f"{able} are accepted; leave --prior out"))
    if not given.trusted and not set(given.reasons) <= set(_ONLY_UNFINISHED):
        accepted = "a result that is trusted, or only not settled or not protected yet, is accepted"
        faults.append(Fault(f"{given.name}: reasons", ", ".join(given.reasons) or "none given", accepted))
    noise_nt = noise_of(given, craft)
    if noise_nt is None:
        faults.append(Lacking(f"{given.name}: noise_floor", MISSING, "state magnetometer.noise_nt in the descriptor"))
    else:
        sigma = vector_sigma(given.covariance, recording.field_body_nt)
        limit = handover_sigma(noise_nt, float(np.nanmean(recording.reference.magnitude_nt)))
        if sigma > limit:
            accepted = f"at most {limit:.0f} nT is accepted; calibrate without --prior"
            faults.append(Fault(f"{given.name}: 1 sigma of a calibrated vector here", f"{sigma:.0f} nT", accepted))
    if faults:
        raise InputRefusedError(faults)


def noise_of(given: Given, craft: CraftConfig) -> float | None:
    """The sensor's noise, as stated for the craft, else as the result has it [nT]."""
    return craft.sensor.noise_nt if craft.sensor.noise_nt is not None else given.noise_nt


def go_on(estimator: object, given: Given, craft: CraftConfig) -> None:
    """Let an estimator go on from a result that ``refuse_unfit`` has let pass."""
    noise_nt = noise_of(given, craft)
    if isinstance(estimator, GoesOn) and noise_nt is not None:
        estimator.begin_with(given.x, given.covariance, noise_nt)
