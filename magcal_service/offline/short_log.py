"""Logs that end before a live start would be made, such as a sensor turned by hand for a minute: one batch of all.

Live, the filter starts from a batch of the first ``start_s`` with a covariance that is inflated for what is still to
come.  Where nothing is to come, the batch is made at the log's end and its covariance stands as it is, but for two
things that one batch can tell: a residual larger than the noise that was stated, and neighbours in time that agree with
each other (a sensor turned beside iron), so that there are fewer independent samples than rows.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from magcal_service.base.errors import ConfigError, Fault
from magcal_service.config.settings import CraftConfig
from magcal_service.estimators.interface import StartGate, StateEstimate
from magcal_service.estimators.parts.start import batch_solution, gated
from magcal_service.model import STATE_SIZE, Array, scalar_residual
from magcal_service.offline.no_solution import no_solution, stopped
from magcal_service.recordings.recording import Recording
from magcal_service.residuals import rms
from magcal_service.trust.reasons import REMEDIES, Reason

_LAST_S: Final = 2.0
"""The batch is tried when so much of the log is left [s]: its last tick or two go through the filter."""

_FEWEST_INDEPENDENT: Final = 30.0
"""Independent samples below which the level of a residual, after nine fitted numbers, is not known to 15 %."""

_NOISE_SHARE: Final = 0.05
"""Residual over |H| beyond which the covariance is no longer consistent ([noise](methods.md#noise))."""

_AGREE: Final = 1.3
"""Sum of correlations beyond which neighbours agree: white noise of 600 samples reaches 1.2 once in forty logs."""

_BANDS: Final = (6, 12, 24)
"""Lowest frequencies over which power is averaged [bins]: of a minute those below 0.1, 0.2 and 0.4 Hz, hand turns."""


_TOGETHER: Final = (
    "neighbours in it agree, so it is no noise: the sensor was carried about, or something magnetic is near; turn it "
    "on one spot, far from iron and cables, in all directions"
)


@dataclass(frozen=True, slots=True)
class Whole:
    """What is said of a log that was taken as one batch.

    Parameters
    ----------
    factor: on the covariance of white noise [-].
    doubts: why its numbers must not be used.
    remedy: what to do about the first reason that it is not trusted.
    """

    factor: float
    doubts: tuple[Reason, ...]
    remedy: str


def for_whole(recording: Recording, craft: CraftConfig) -> CraftConfig | None:
    """The configuration that takes a recording as one batch; None where it is longer than ``filter.start_s``."""
    steps_s = 1e-9 * np.diff(np.unique(recording.time_ns)).astype(np.float64)
    seconds = float(steps_s[steps_s <= craft.ticks.gap_s].sum())
    if seconds > craft.filter.start_s:
        return None
    start_s = max(seconds - _LAST_S, 1.0)
    return replace(craft, filter=replace(craft.filter, start_s=start_s, start_inflation=1.0))


def starting_at(craft: CraftConfig, start_s: float | None) -> CraftConfig:
    """The craft with another ``filter.start_s`` [s]; raises ``ConfigError`` where a configuration could not have it."""
    if start_s is None:
        return craft
    if not 10.0 <= start_s <= 86_400.0:
        raise ConfigError([Fault("--start-s", start_s, "10 to 86400 s is accepted, as for filter.start_s")])
    latest_s = max(start_s, craft.filter.start_max_s)
    return replace(craft, filter=replace(craft.filter, start_s=start_s, start_max_s=latest_s))


def judged(recording: Recording, craft: CraftConfig, estimate: StateEstimate, *, has_started: bool) -> Whole:
    """How sure one batch of a whole recording is, or the reason why there is none.

    Parameters
    ----------
    recording: its usable rows.
    craft: the configuration that it was taken with.
    estimate: the last one.
    has_started: whether the batch was accepted.
    """
    usable = recording.sorted_unique()
    field, magnitude = usable.field_body_nt, usable.reference.magnitude_nt
    if not has_started:
        return Whole(1.0, (), _why_none(field, magnitude, craft))
    residual = scalar_residual(estimate.x, field, magnitude)
    level, share = rms(residual), rms(residual) / float(magnitude.mean())
    factor, independent = spread(residual, craft.sensor.noise_nt)
    if share > _NOISE_SHARE:
        is_white = len(residual) <= _AGREE * independent
        remedy = (
            f"the residual is {level:.0f} nT, {100 * share:.1f} % of the field; at most {100 * _NOISE_SHARE:g} % is "
            f"accepted: {REMEDIES[Reason.NOISE_TOO_HIGH] if is_white else _TOGETHER}"
        )
        return Whole(factor, (Reason.NOISE_TOO_HIGH,), remedy)
    if independent < _FEWEST_INDEPENDENT:
        remedy = (
            f"neighbours in the residual agree, so that of {len(residual)} samples {independent:.0f} are independent; "
            f"at least {_FEWEST_INDEPENDENT:g} are needed: turn the sensor on one spot, far from iron and cables, in "
            "all directions"
        )
        return Whole(factor, (Reason.STRUCTURED_RESIDUAL,), remedy)
    remedy = (
        f"the log is over before anything could be checked against it: {independent:.0f} independent samples, taken as "
        f"one batch, give the sigmas; trusted needs {craft.trust.min_ticks} s and a field that changes"
    )
    return Whole(factor, (), remedy)


def _why_none(field_nt: Array, magnitude_nt: Array, craft: CraftConfig) -> str:
    """Why one batch was not accepted: the value, what is accepted, the next step; empty where it would be."""
    noise_nt = craft.sensor.noise_nt
    found = batch_solution(field_nt, magnitude_nt, (), noise_nt, craft.filter)
    if isinstance(found, StartGate):
        return str(no_solution(found, field_nt, magnitude_nt))
    gate = gated(found, field_nt, magnitude_nt, noise_nt, thinned=1)
    return str(stopped(gate, found, field_nt, magnitude_nt, noise_nt)) if isinstance(gate, StartGate) else ""


def spread(residual_nt: Array, noise_nt: float | None) -> tuple[float, float]:
    """By how much the covariance of a batch is larger than white noise makes it, and the independent samples [-].

    Parameters
    ----------
    residual_nt: what the batch leaves, in order of time (n,) [nT].
    noise_nt: that its covariance assumes, where it was stated [nT]; None: it assumes the residual's own level.

    The variance of a mean of neighbours that agree is 1 + 2 (sum of their correlations) times that of white noise; the
    sum ends at the first correlation that chance would give.  Where it shows that they agree, it ends too early by the
    tail that chance hides, and the power at the lowest frequencies over that of all counts instead, the largest of some
    bands.  Nine numbers fitted to few independent samples n leave too small a residual, put right by n / (n - 9).
    """
    count = len(residual_nt)
    spectrum = np.abs(np.fft.rfft(residual_nt - residual_nt.mean(), 2 * count)) ** 2
    correlation = np.fft.irfft(spectrum)[: count // 2]
    correlation = correlation / max(float(correlation[0]), 1e-300)
    chance = np.flatnonzero(correlation < 2.0 / count**0.5)
    together = 1.0 + 2.0 * float(correlation[1 : int(chance[0]) if chance.size else count].sum())
    if together > _AGREE:
        power = spectrum[2::2] / max(float(spectrum[2::2].mean()), 1e-300)  # without the bins between, of the padding
        together = max(together, *(float(power[:band].mean()) for band in _BANDS))
    independent = count / together
    factor = together * independent / max(independent - STATE_SIZE, 1.0)
    if noise_nt is not None:
        factor *= max(1.0, (rms(residual_nt) / noise_nt) ** 2)
    return factor, independent
