"""Why an estimate is not trusted, and what to do about it."""

from __future__ import annotations

from enum import StrEnum
from typing import Final

from magcal_service.estimators.interface import StartGate


class Reason(StrEnum):
    """Why an estimate is not (yet) trusted; the code travels in messages, ``REMEDIES`` says what to do."""

    COLLECTING = "collecting"
    POOR_COVERAGE = "poor_coverage"
    NO_SOLUTION = "no_solution"
    NOT_SETTLED = "not_settled"
    UNPROTECTED = "unprotected"
    COLLAPSED = "collapsed"
    INCONSISTENT = "inconsistent"
    STRUCTURED_RESIDUAL = "structured_residual"
    DRIFTING_RESIDUAL = "drifting_residual"
    MODEL_DOUBTFUL = "model_doubtful"
    LOCAL_DISTURBANCE = "local_disturbance"
    MANY_REJECTED = "many_rejected"
    RESTARTED = "restarted"
    SPIN_ALIASING = "spin_aliasing"
    SPIN_CONTRADICTED = "spin_contradicted"
    NOISE_TOO_HIGH = "noise_too_high"
    CONSTANT_REFERENCE = "constant_reference"
    NO_REFERENCE = "no_reference"
    STUCK = "stuck"
    AXIS_STUCK = "axis_stuck"
    DRIVER_MISSING = "driver_missing"
    COMPENSATION_STOPPED = "compensation_stopped"
    SATURATED = "saturated"
    FROZEN = "frozen"
    STALE = "stale"
    RECORDING_DOUBTFUL = "recording_doubtful"
    AXES_CHANGED = "axes_changed"
    SPIN_DISAGREES = "spin_disagrees"
    RATE_DISAGREES = "rate_disagrees"
    REFERENCE_HELD = "reference_held"
    HELD_READINGS = "held_readings"
    NOISE_MISSTATED = "noise_misstated"
    HEIGHT_DISAGREES = "height_disagrees"
    PHYSICS_DOUBTFUL = "physics_doubtful"


REMEDIES: Final = {
    Reason.COLLECTING: "keep the samples and the reference coming",
    Reason.POOR_COVERAGE: "more directions of the field in the body are needed: wait for more of the orbit, or change "
    "the spin axis against the orbit's plane",
    Reason.NO_SOLUTION: "no sound solution fits the samples so far, mostly for want of directions; if that lasts for "
    "an orbit, check units, axes and the reference",
    Reason.NOT_SETTLED: "wait",
    Reason.UNPROTECTED: "a disturbance too small to be seen yet may put vectors off by more than protection_nt: "
    "wait for more of the orbit",
    Reason.COLLAPSED: "the solution shrinks an axis: check units and axes of sensor and reference, then reset",
    Reason.INCONSISTENT: "the residual is larger than noise and estimate allow: check noise_nt, the reference and its "
    "time tags; diagnose a recording",
    Reason.STRUCTURED_RESIDUAL: "the residual is not white noise, so physics is missing: diagnose a recording",
    Reason.DRIFTING_RESIDUAL: "the residual wanders over minutes, so the errors change: diagnose a recording; set "
    "process_noise where no cause is found",
    Reason.MODEL_DOUBTFUL: "the residual follows physics that is left out, the status says which: diagnose a "
    "recording ([record] makes them), and name its physics.toml as physics under [[craft]]",
    Reason.LOCAL_DISTURBANCE: "the craft's other magnetometers do not see this disturbance, so its cause is near this "
    "sensor: use another one, and look for what is magnetic beside it",
    Reason.MANY_REJECTED: "look for spikes, a wrong noise_nt, or a step in the errors",
    Reason.RESTARTED: "the samples contradicted the estimate and it started anew: wait until it has settled",
    Reason.SPIN_ALIASING: "the sample period is close to a multiple of half the spin period: change one of them",
    Reason.SPIN_CONTRADICTED: "the spin windows contradict the scalar measurement and are no longer used: check "
    "spin.axis and spin.rate_rpm, and whether the errors drift",
    Reason.NOISE_TOO_HIGH: "at this noise the covariance is no longer consistent: average the sensor faster, or take "
    "the sigmas as lower bounds",
    Reason.CONSTANT_REFERENCE: "with a constant magnitude a collapsed solution fits as well: move through a changing "
    "field; by a recorded attitude magcal diagnose compares whole vectors",
    Reason.NO_REFERENCE: "samples arrive without a reference at their time: check the reference's source and clock, of "
    "positions that they are UTC and in km (not metres) from the Earth's centre",
    Reason.AXIS_STUCK: "one axis repeats one value while the others move: power-cycle the sensor",
    Reason.SATURATED: "the field exceeds the sensor's full scale (range_nt): find what magnetises it",
    Reason.FROZEN: "nothing is learned since the command freeze: resume",
    Reason.STALE: "the estimate has met no sample for more than an orbit: resume, or look after sensor and reference",
    Reason.RECORDING_DOUBTFUL: "the recording itself is in doubt: answer in its descriptor what was found on it "
    "(magcal inspect shows it)",
    Reason.AXES_CHANGED: "the vector jumped as no turn explains and no outlier does, so vectors are in other axes than "
    "before: check the sensor's driver and what restarted, correct the axes, then reset",
    Reason.SPIN_DISAGREES: "the field does not turn as [craft.spin] says: check its axis and the sign and size of "
    "rate_rpm, and the signs and order of the sensor's axes",
    Reason.RATE_DISAGREES: "gyro and magnetometer turn differently: check signs, order and units of both sensors' axes",
    Reason.REFERENCE_HELD: "the reference repeats while time goes on: check that its source gets new positions, and "
    "its rate",
    Reason.HEIGHT_DISAGREES: "the reference is that of another height: check the positions' unit, whether they "
    "are from the Earth's centre, their frame and their times, then reset",
    Reason.HELD_READINGS: "the sensor has new readings more seldom than samples come; repeats are not learned from: "
    "send each reading once",
    Reason.NOISE_MISSTATED: "the residual's noise is not sensor.noise_nt: set it to what was measured, or leave it out",
    Reason.STUCK: "the sensor repeats one vector: power-cycle it or check its bus",
    Reason.COMPENSATION_STOPPED: "physics.toml made the residual worse, so it is not compensated any more: diagnose a "
    "recording of today and load its physics.toml",
    Reason.PHYSICS_DOUBTFUL: "physics.toml says that it should not be acted on, the log says why: diagnose again as it "
    "advises, or take the file out",
    Reason.DRIVER_MISSING: "what drives an effect of physics.toml is missing or stale, or beyond the range of its "
    "curve, so it is not compensated: bring channel, position or reference back, correct a channel's name, or take "
    "the effect out of the file",
}

_REASON_OF_GATE: Final = {
    StartGate.POOR_COVERAGE: Reason.POOR_COVERAGE,
    StartGate.NOT_POSITIVE: Reason.NO_SOLUTION,
    StartGate.COLLAPSED: Reason.NO_SOLUTION,
    StartGate.NO_CONVERGENCE: Reason.NO_SOLUTION,
    StartGate.BAD_FIT: Reason.INCONSISTENT,
}
"""What each start gate (``estimators.parts.start_gates``) means for the verdict."""


def reason_of(gate: StartGate) -> Reason:
    """The verdict's reason for a start that was stopped by this gate."""
    return _REASON_OF_GATE[gate]
