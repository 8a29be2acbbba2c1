"""What to do about a calibration of a recording that is not trusted: it is over, nobody can wait, reset or resume."""

from __future__ import annotations

from typing import Final

from magcal_service.trust.reasons import REMEDIES, Reason

_LONGER: Final = "record for longer, or go on from an earlier result by --prior"

_OF_A_RECORDING: Final = {
    Reason.COLLECTING: f"it ended before there were samples enough to start from: {_LONGER}",
    Reason.POOR_COVERAGE: "more directions of the field in the body are needed: record for more of the orbit, or turn "
    "the sensor about further axes",
    Reason.NO_SOLUTION: "no sound solution fits the samples, mostly for want of directions: check units, axes and the "
    "reference (magcal inspect); record for more of the orbit",
    Reason.NOT_SETTLED: f"it ended before enough samples could be held against the estimate: {_LONGER}",
    Reason.UNPROTECTED: "a disturbance too small to be seen yet may put vectors off by more than protection_nt: "
    f"{_LONGER}",
    Reason.COLLAPSED: "the solution shrinks an axis: check units and axes of sensor and reference",
    Reason.INCONSISTENT: "the residual is larger than noise and estimate allow: check magnetometer.noise_nt, the "
    "reference and its time tags; magcal diagnose says what physics is missing",
    Reason.STRUCTURED_RESIDUAL: "the residual is not white noise, so physics is missing: magcal diagnose says which",
    Reason.DRIFTING_RESIDUAL: "the residual wanders over minutes, so the errors change: magcal diagnose says by what",
    Reason.MODEL_DOUBTFUL: "the residual follows physics that is left out: fit it by magcal diagnose, and take "
    "its physics.toml in place of this result",
    Reason.MANY_REJECTED: "look for spikes, a wrong magnetometer.noise_nt, or a step in the errors (magcal inspect, "
    "magcal diagnose)",
    Reason.RESTARTED: "samples contradicted the estimate, it started anew, and the recording ended before that had "
    "settled: magcal diagnose says what changed",
    Reason.SATURATED: "the field exceeds the sensor's full scale (range_nt): choose a wider range, or find what "
    "magnetises it",
    Reason.FROZEN: "nothing was learned after the command freeze: give a part of the session without it",
    Reason.STALE: "the estimate had met no sample for more than an orbit at the end: give the part before",
    Reason.AXES_CHANGED: "the vector jumped as no turn explains and no outlier does, so vectors are in other axes than "
    "before: calibrate the parts before and after by themselves",
    Reason.SPIN_DISAGREES: "the field does not turn as [spin] says: check its axis and the sign and size of "
    "rate_rpm, and the signs and order of the sensor's axes",
    Reason.HEIGHT_DISAGREES: "the reference is that of another height: check the positions' unit, whether they "
    "are from the Earth's centre, their frame and their times",
    Reason.HELD_READINGS: "the sensor has new readings more seldom than rows come; repeats are not learned from: "
    "log each reading once",
    Reason.NOISE_MISSTATED: "the residual's noise is not magnetometer.noise_nt: set it to what was measured, or leave "
    "it out",
    Reason.CONSTANT_REFERENCE: "with a constant magnitude a collapsed solution fits as well: record in a changing "
    "field, or with an attitude, by which magcal diagnose compares whole vectors",
    Reason.COMPENSATION_STOPPED: "physics.toml made the residual worse, so it was not compensated any more: diagnose "
    "this recording",
    Reason.PHYSICS_DOUBTFUL: "physics.toml says that it should not be acted on, and why: diagnose again as it advises, "
    "or calibrate without the file",
}
"""In place of what the daemon advises while a craft flies; the other reasons' remedies are the same."""

_OF_ONE_PLACE: Final = (
    "it ended before enough samples could be held against the estimate, and at one place a longer one is not trusted "
    "either (constant_reference): take the numbers with their 3 sigma, or go on from an earlier result by --prior"
)
"""In place of those that say to record for longer, where the reference is one magnitude for all rows."""

BY_ATTITUDE: Final = (
    "a field of one magnitude shows no more to calibrate, which takes no attitude, and the recording has one: magcal "
    "diagnose compares whole vectors by it; give its diagnosis.json to apply or export in place of this result"
)
"""The same, where an attitude was recorded: what the magnitudes cannot tell apart, vectors do."""


def remedy_of(reason: Reason, *, of_one_place: bool = False, has_attitude: bool = False) -> str:
    """What to do about a reason.

    Parameters
    ----------
    of_one_place: whether the reference is one magnitude for all rows.
    has_attitude: whether the recording has an attitude.
    """
    if has_attitude and (reason is Reason.CONSTANT_REFERENCE or (of_one_place and reason is Reason.NOT_SETTLED)):
        return BY_ATTITUDE
    if of_one_place and reason is Reason.NOT_SETTLED:
        return _OF_ONE_PLACE
    return _OF_A_RECORDING.get(reason, REMEDIES[reason])
