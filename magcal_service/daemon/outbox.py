"""Messages that a craft publishes, as records of the wire: vectors, estimates, replies and status."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass
from typing import Final

import numpy as np

from magcal_service.config.rules import RESERVED_SOURCE
from magcal_service.estimators.interface import StateEstimate
from magcal_service.model import BIAS, D_ALL, STATE_SIZE, Array, vector_jacobian
from magcal_service.trust.verdict import Trust
from magcal_service.wire.fields import fitting, shown
from magcal_service.wire.kinds import MAX_COUNTERS, MAX_RESULT_FIELD_NT, MAX_SAMPLE_FIELD_NT
from magcal_service.wire.messages import (
    CalibratedVector,
    Clock,
    Command,
    CommandReply,
    Estimate,
    MagnetometerSample,
    Status,
)

SOURCE: Final = RESERVED_SOURCE
"""Who sends: the source of every message of the daemon, but for the estimates and statuses of further magnetometers."""

_UPPER: Final = np.flatnonzero(np.triu(np.ones((STATE_SIZE, STATE_SIZE))))  # a covariance travels as its upper triangle

_LONGEST_READ_NT: Final = math.sqrt(3.0) * MAX_SAMPLE_FIELD_NT
"""Longest vector that is calibrated: one that compensation has corrected is held to the limit by its components."""

_LARGEST_COVARIANCE: Final = 1e16
"""Of the nine errors [nT^2, nT, 1]: with the longest vector it makes less than the wire's 1e30 nT^2.

A sigma of 0.1 T, or of a factor of 10^8, is no estimate of a magnetometer.
"""


@dataclass(frozen=True, slots=True)
class Stamp:
    """Craft, source and number of a message, and the source time [ns] that it refers to."""

    craft: str
    sequence: int
    time_ns: int
    clock: Clock
    source: str = SOURCE


def calibrated_vector(
    sample: MagnetometerSample,
    state: StateEstimate,
    covariance: Array,
    trust: Trust,
    unknown: Array | None = None,
) -> CalibratedVector:
    """A sample's vector by equation (5), with the covariance of noise and estimate together.

    Parameters
    ----------
    sample: as it is to be calibrated [nT].
    state: the present estimate.
    covariance: its covariance (9, 9), grown by the random walk since the newest sample that it learned from.
    trust: how far it is to be trusted.
    unknown: covariance (3, 3) [nT^2] of what the sample was corrected for; None: it is known.
    """
    b1, b2, b3 = sample.field_body_nt
    jacobian = vector_jacobian(b1, b2, b3)
    of_vector = jacobian.dot(covariance).dot(jacobian.T)
    of_vector.ravel()[::4] += state.noise_nt**2  # on the diagonal
    if unknown is not None:
        of_vector = of_vector + unknown
    dx, dy, dz = jacobian.dot(state.x).tolist()  # w = B + J(B) x
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = of_vector.tolist()
    return CalibratedVector(
        craft=sample.craft,
        source=sample.source,
        sequence=sample.sequence,
        time_ns=sample.time_ns,
        clock=sample.clock,
        field_body_nt=(b1 + dx, b2 + dy, b3 + dz),
        covariance_nt2=(xx, xy, xz, yy, yz, zz),
        verdict=trust.verdict,
        protection_nt=trust.protection_nt,
        protection_by=trust.protection_by,
    )


def unsendable(state: StateEstimate) -> str:
    """Why results of an estimate might be beyond the limits of the wire, for some sample; empty where none can be."""
    bx, by, bz, d11, d22, d33, d12, d13, d23 = state.x.tolist()
    stretch = math.sqrt(d11 * d11 + d22 * d22 + d33 * d33 + 2.0 * (d12 * d12 + d13 * d13 + d23 * d23))
    longest_nt = (1.0 + stretch) * _LONGEST_READ_NT + math.sqrt(bx * bx + by * by + bz * bz)
    largest = math.sqrt(float(np.vdot(state.covariance, state.covariance)))  # at least the largest element's size
    if not largest <= 0.5 * _LARGEST_COVARIANCE:
        largest = float(np.abs(state.covariance).max())  # not a number where one is none
    if not math.isfinite(longest_nt + largest):
        return "it is not finite"
    if longest_nt > MAX_RESULT_FIELD_NT:
        return f"the nine errors {shown(state.x.tolist())} make vectors of more than {MAX_RESULT_FIELD_NT:g} nT"
    if largest > _LARGEST_COVARIANCE:
        return f"its covariance has an element of more than {_LARGEST_COVARIANCE:g}"
    if min(state.covariance.diagonal().tolist()) < 0.0:
        return "it has a variance below 0"
    return "" if state.noise_nt <= MAX_RESULT_FIELD_NT else f"its noise is {state.noise_nt:g} nT"


def estimate_message(
    stamp: Stamp, method: str, tick: int, state: StateEstimate, covariance: Array, trust: Trust, residual_rms_nt: float
) -> Estimate:
    """The nine errors (x, covariance (9, 9) [nT, -]) with verdict, reasons and remedy."""
    bx, by, bz = state.x[BIAS].tolist()
    d11, d22, d33, d12, d13, d23 = state.x[D_ALL].tolist()
    return Estimate(
        craft=stamp.craft,
        source=stamp.source,
        sequence=stamp.sequence,
        time_ns=stamp.time_ns,
        clock=stamp.clock,
        method=method,
        tick=tick,
        bias_nt=(bx, by, bz),
        D=(d11, d22, d33, d12, d13, d23),
        covariance=tuple(covariance.take(_UPPER).tolist()),
        verdict=trust.verdict,
        reasons=tuple(map(str, trust.reasons)),
        remedy=trust.remedy,
        residual_rms_nt=min(residual_rms_nt, MAX_RESULT_FIELD_NT),
        noise_nt=state.noise_nt,
        samples_used=state.samples,
        protection_nt=trust.protection_nt,
        protection_by=trust.protection_by,
    )


def command_reply(stamp: Stamp, command: Command, refusal: str, summary: str) -> CommandReply:
    """The answer to a command: why it was refused, or the craft's summary after it was carried out."""
    return CommandReply(
        craft=stamp.craft,
        source=stamp.source,
        sequence=stamp.sequence,
        time_ns=stamp.time_ns,
        clock=stamp.clock,
        name=command.name,
        command_source=command.source,
        command_sequence=command.sequence,
        accepted=not refusal,
        text=fitting(refusal or summary),
    )


def status_message(stamp: Stamp, uptime_s: float, trust: Trust, counters: Counter[str], summary: str) -> Status:
    """Health of a craft, with as many counters as a status may hold."""
    return Status(
        craft=stamp.craft,
        source=stamp.source,
        sequence=stamp.sequence,
        time_ns=stamp.time_ns,
        clock=stamp.clock,
        uptime_s=uptime_s,
        verdict=trust.verdict,
        counters=dict(capped(counters)),
        text=summary,
    )


def capped(counters: Counter[str]) -> Counter[str]:
    """As many counters as a status may hold; what is left out is counted."""
    if len(counters) <= MAX_COUNTERS:
        return counters
    kept = Counter(dict(list(counters.items())[: MAX_COUNTERS - 1]))
    kept["counters_left_out"] = len(counters) - len(kept)
    return kept
