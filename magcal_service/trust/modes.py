"""What is published when something is missing or wrong: one row for each degraded mode.

This table is the promise; ``tests/daemon/test_pipeline_modes.py`` runs each row through a pipeline and checks
it, or names the test that does, and ``docs/degraded-modes.md`` is written from it
(``python -m magcal_service.trust.modes``).  In no mode is a vector overstated: it is withheld, or its covariance is the
prior's or grows, or its verdict says ``doubtful``, or its protection level is published.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Final

from magcal_service.trust.reasons import Reason
from magcal_service.wire.messages import Verdict


class Mode(StrEnum):
    """Ways in which a daemon can have less than it needs."""

    NO_REFERENCE = "no_reference"
    NO_POSITION = "no_position"
    NO_MAGNETOMETER = "no_magnetometer"
    SATURATED_AXIS = "saturated_axis"
    STUCK_SENSOR = "stuck_sensor"
    STUCK_AXIS = "stuck_axis"
    DEAD_AXIS = "dead_axis"
    REFERENCE_JUMPS = "reference_jumps"
    REFERENCE_WRONG = "reference_wrong"
    TIME_STEPS = "time_steps"
    OUTLIERS = "outliers"
    UNKNOWN_CRAFT = "unknown_craft"
    OVERLOAD = "overload"
    COMMANDS_LIMITED = "commands_limited"
    SOURCE_REFUSED = "source_refused"
    LOCAL_DISTURBANCE = "local_disturbance"
    UNPROTECTED = "unprotected"
    ESTIMATOR_FAILED = "estimator_failed"
    FROZEN = "frozen"
    STALE = "stale"
    MODEL_DOUBTFUL = "model_doubtful"
    AXES_CHANGED = "axes_changed"
    SPIN_CHANGED = "spin_changed"
    GYRO_DISAGREES = "gyro_disagrees"
    POSITIONS_WRONG = "positions_wrong"
    REFERENCE_HELD = "reference_held"
    HELD_READINGS = "held_readings"
    DRIVER_MISSING = "driver_missing"
    COMPENSATION_STOPPED = "compensation_stopped"


@dataclass(frozen=True, slots=True)
class Row:
    """What holds in one mode, for a craft that was trusted before.

    Parameters
    ----------
    when: what is seen.
    vectors: what becomes of the samples' vectors.
    covariance: what their covariance and that of the estimate say.
    verdict: the verdict while it lasts.
    reason: the reason in it; None where there is none.
    counter: what counts it.
    after: what happens when it is over.
    """

    when: str
    vectors: str
    covariance: str
    verdict: Verdict
    reason: Reason | None
    counter: str
    after: str


MODES: Final = {
    Mode.NO_REFERENCE: Row(
        "samples come, no reference covers them",
        "each sample's, by the last estimate",
        "the last one, grown by the process noise since",
        Verdict.DOUBTFUL,
        Reason.NO_REFERENCE,
        "ticks_skipped",
        "the next tick with a reference; for the first 60 s the reason is given and the verdict stays",
    ),
    Mode.NO_POSITION: Row(
        "the reference is IGRF's by reference.model, and no position comes, or none on UTC and within the model",
        "each sample's, by the last estimate",
        "the last one, grown by the process noise since",
        Verdict.DOUBTFUL,
        Reason.NO_REFERENCE,
        "ticks_skipped",
        "the next tick with a position; references that are sent are counted as reference_not_used and do not help",
    ),
    Mode.NO_MAGNETOMETER: Row(
        "no sample comes",
        "none: nothing is extrapolated",
        "at the first sample afterwards grown by the process noise since",
        Verdict.TRUSTED,
        None,
        "troubles",
        "at the first sample; spin windows restart after gap_s; after 320 s the protection level is unknown until 64 "
        "ticks have been looked at, and after 6000 s the mode is stale",
    ),
    Mode.SATURATED_AXIS: Row(
        "a component reaches sensor.range_nt",
        "none for the samples that reach it",
        "unchanged: the samples are not used",
        Verdict.DOUBTFUL,
        Reason.SATURATED,
        "saturated",
        "60 accepted samples in a row",
    ),
    Mode.STUCK_SENSOR: Row(
        "the same vector for sensor.stuck_samples samples",
        "none from then on",
        "unchanged: the samples are not used",
        Verdict.DOUBTFUL,
        Reason.STUCK,
        "stuck",
        "the first other vector",
    ),
    Mode.STUCK_AXIS: Row(
        "one component keeps its value where noise would have changed it, or the field has (sensor.axis_stuck_s)",
        "none from then on; sensor.stuck_samples before that, where the noise is given",
        "unchanged: the samples are stopped by the gate or not used",
        Verdict.DOUBTFUL,
        Reason.AXIS_STUCK,
        "axis_stuck",
        "the first other value",
    ),
    Mode.DEAD_AXIS: Row(
        "one component is 0 from a time on",
        "as with a stuck axis",
        "as with a stuck axis",
        Verdict.DOUBTFUL,
        Reason.AXIS_STUCK,
        "axis_stuck",
        "the first other value",
    ),
    Mode.REFERENCE_JUMPS: Row(
        "the reference's time jumps forth and back",
        "each sample's, by the last estimate",
        "the last one; samples at an unconfirmed time get no reference and are not used",
        Verdict.TRUSTED,
        None,
        "reference_jump",
        "three references in a row that agree",
    ),
    Mode.REFERENCE_WRONG: Row(
        "the reference's field changes at some time by more than the gate",
        "each sample's, by the last estimate",
        "the last one: the gate stops the samples; a filter that restarts keeps it until its start is accepted",
        Verdict.DOUBTFUL,
        Reason.MANY_REJECTED,
        "rejected",
        "the old field within half a minute; after that a new start, which says restarted",
    ),
    Mode.TIME_STEPS: Row(
        "the samples' clock steps back or far ahead",
        "none for the first two samples, which are rejected; then each sample's",
        "unchanged: a gap lies before, nothing is carried over",
        Verdict.TRUSTED,
        None,
        "clock_step",
        "the third sample of the new time",
    ),
    Mode.OUTLIERS: Row(
        "one sample in ten is corrupted, and passes every check of the wire",
        "each sample's, the corrupted ones' as well: they cannot be detected before the filter has updated",
        "the estimate's: the gate stops them",
        Verdict.TRUSTED,
        None,
        "rejected",
        "nothing: outliers are independent",
    ),
    Mode.UNKNOWN_CRAFT: Row(
        "messages of a craft that is not configured",
        "none",
        "of the others: untouched",
        Verdict.TRUSTED,
        None,
        "unknown_craft",
        "nothing: they are counted, at the link where it knows the craft",
    ),
    Mode.OVERLOAD: Row(
        "more messages than the daemon can take",
        "those of the messages that were taken; the oldest of the fullest source are dropped, craft are served in turn",
        "the estimate's: a lost sample is a gap",
        Verdict.TRUSTED,
        None,
        "overflow",
        "nothing: it continues with what is received; event overloaded and a trouble, until 10 s without a loss",
    ),
    Mode.COMMANDS_LIMITED: Row(
        "more commands than commands.burst and commands.rate_per_min allow a craft",
        "as before: the commands beyond are refused, and as many refusals answered as commands are taken",
        "as before",
        Verdict.TRUSTED,
        None,
        "commands_limited",
        "the time that the answer names",
    ),
    Mode.SOURCE_REFUSED: Row(
        "samples of a further magnetometer, beyond max_sources or one that the method cannot serve",
        "none for its samples; those of the others as before",
        "of the others: untouched",
        Verdict.TRUSTED,
        None,
        "sources_refused",
        "nothing: status and log name the source and why",
    ),
    Mode.LOCAL_DISTURBANCE: Row(
        "one of several magnetometers sees a disturbance that another one would see and does not",
        "each sample's of that one, by its last estimate; those of the others as before",
        "the estimate's: the disturbance is not in it",
        Verdict.DOUBTFUL,
        Reason.LOCAL_DISTURBANCE,
        "",
        "30 ticks in which its residual agrees with the reference",
    ),
    Mode.UNPROTECTED: Row(
        "what could not have been seen yet may put a vector off by more than trust.protection_nt",
        "each sample's, with that level as protection_nt",
        "the estimate's: the level stands beside it",
        Verdict.CONVERGING,
        Reason.UNPROTECTED,
        "",
        "the next look at which the level is within the limit",
    ),
    Mode.ESTIMATOR_FAILED: Row(
        "the estimator's arithmetic fails, or its result is not finite or beyond what a message can carry",
        "each sample's, uncalibrated",
        "the prior's",
        Verdict.NOT_STARTED,
        Reason.COLLECTING,
        "estimator_failed",
        "a new start",
    ),
    Mode.FROZEN: Row(
        "command freeze",
        "each sample's, by the estimate of that time",
        "that of the last update, grown by the process noise since",
        Verdict.TRUSTED,
        Reason.FROZEN,
        "ticks_frozen",
        "command resume; what lies before counts as before a gap; after 320 s there is no protection level, and no "
        "trust where one is asked for, until 64 ticks have been looked at",
    ),
    Mode.STALE: Row(
        "nothing was learned for more than 6000 s of samples' time: frozen, without reference or without samples",
        "each sample's, by the last estimate",
        "that of the last update, grown by the process noise since",
        Verdict.DOUBTFUL,
        Reason.STALE,
        "",
        "the first tick that is learned from",
    ),
    Mode.MODEL_DOUBTFUL: Row(
        "the residual follows physics that the nine errors do not model: a temperature, a current, a coil, a step, ...",
        "each sample's, by the last estimate",
        "the estimate's: the missing physics is not in it",
        Verdict.DOUBTFUL,
        Reason.MODEL_DOUBTFUL,
        "",
        "a whole window of the watch in which nothing is found, or a physics.toml that holds it",
    ),
    Mode.AXES_CHANGED: Row(
        "the vector jumps as no turn explains and the jump stays: axes were swapped or flipped",
        "each sample's, by the last estimate: they are in other axes than before",
        "the estimate's: |B| does not show the change",
        Verdict.DOUBTFUL,
        Reason.AXES_CHANGED,
        "",
        "axes that change back, or are corrected and command reset",
    ),
    Mode.SPIN_CHANGED: Row(
        "the field turns about another axis than craft.spin says, in the other sense or at another rate",
        "each sample's, by the last estimate",
        "the estimate's: wrong windows are not in it; once they contradict it they are left out (spin_contradicted)",
        Verdict.DOUBTFUL,
        Reason.SPIN_DISAGREES,
        "",
        "the turn of before, or a new craft.spin",
    ),
    Mode.GYRO_DISAGREES: Row(
        "a gyro's rates do not explain the vector's turn; with axes swapped or flipped they would",
        "each sample's, by the last estimate",
        "the estimate's: |B| does not show it",
        Verdict.DOUBTFUL,
        Reason.RATE_DISAGREES,
        "",
        "rates that agree",
    ),
    Mode.POSITIONS_WRONG: Row(
        "the reference is IGRF's by reference.model, and positions do not fall as an orbit at their height does",
        "each sample's, by the last estimate",
        "the estimate's: a wrong reference is not in it",
        Verdict.DOUBTFUL,
        Reason.HEIGHT_DISAGREES,
        "",
        "three minutes of right positions; the estimate still holds the wrong ones, until command reset",
    ),
    Mode.REFERENCE_HELD: Row(
        "the reference repeats one value though at its usual pace it would have changed by 1 %",
        "each sample's, by the last estimate",
        "the estimate's: a wrong reference is not in it",
        Verdict.DOUBTFUL,
        Reason.REFERENCE_HELD,
        "",
        "the next other value",
    ),
    Mode.HELD_READINGS: Row(
        "the sensor repeats each reading several times",
        "each sample's; those of repeats, which are old, as doubtful",
        "the estimate's: repeats are not learned from",
        Verdict.TRUSTED,
        Reason.HELD_READINGS,
        "held",
        "readings that are new each time; the status says the factor until then",
    ),
    Mode.DRIVER_MISSING: Row(
        "what drives an effect of physics.toml does not come, is stale, or is beyond the range of its curve",
        "each sample's, without that compensation",
        "the estimate's: what is not compensated is not in it",
        Verdict.DOUBTFUL,
        Reason.DRIVER_MISSING,
        "uncompensated.*",
        "the driver's next value",
    ),
    Mode.COMPENSATION_STOPPED: Row(
        "physics.toml has made the residual worse than without",
        "each sample's, as of a craft without the file",
        "that of a craft without the file",
        Verdict.TRUSTED,
        Reason.COMPENSATION_STOPPED,
        "compensation_stopped",
        "command load_physics",
    ),
}


def markdown() -> str:
    """The page ``docs/degraded-modes.md``."""
    lines = [
        "# Degraded modes",
        "",
        "What is published when something is missing or wrong, for a craft that was trusted before. The table is that",
        "of [`modes.py`](../magcal_service/trust/modes.py), and `tests/daemon/test_pipeline_modes.py` runs each row",
        "through a pipeline, or names the test that plays it. In no mode is a vector overstated: it is withheld, or",
        "its covariance is the prior's or grows, or its verdict says `doubtful`, or its protection level is published.",
        "",
        "| mode | when | vectors | covariance | verdict | reason | counted as | over with |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for mode, row in MODES.items():
        reason = "-" if row.reason is None else f"`{row.reason}`"
        counter = f"`{row.counter}`" if row.counter else "-"
        cells = (mode, row.when, row.vectors, row.covariance, f"`{row.verdict}`", reason, counter, row.after)
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    print(markdown(), end="")
