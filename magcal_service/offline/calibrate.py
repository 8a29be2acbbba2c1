"""Offline use of the estimators on a whole recording, and how well the result explains it."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from magcal_service.base.errors import MISSING, Lacking, RecordingError
from magcal_service.config.settings import DEFAULT_METHOD, CraftConfig
from magcal_service.estimators import find_method
from magcal_service.estimators.interface import Method, StartGate
from magcal_service.estimators.parts.start import batch_start
from magcal_service.model import STATE_SIZE, Array, scalar_residual
from magcal_service.offline import short_log
from magcal_service.offline.given import Given, read_given
from magcal_service.offline.held import Over, held_of, over_of
from magcal_service.offline.nine_errors import NineErrors
from magcal_service.offline.prior import refuse_unfit
from magcal_service.offline.remedies import BY_ATTITUDE, remedy_of
from magcal_service.offline.replay import Replay, craft_of, replay
from magcal_service.offline.result_head import CALIBRATION, head
from magcal_service.offline.scale import scale_doubt
from magcal_service.physics.apply.advice import doubts_of
from magcal_service.physics.held import HeldAt
from magcal_service.recordings.inspect.account import Account
from magcal_service.recordings.inspect.finding import Finding
from magcal_service.recordings.inspect.inspection import Inspection, inspect
from magcal_service.recordings.reader import read_recording
from magcal_service.recordings.recording import Recording
from magcal_service.recordings.scene_of import recorded_attitude
from magcal_service.recordings.usable import refuse_hopeless
from magcal_service.residuals import rms, white_noise_level
from magcal_service.trust.reasons import Reason
from magcal_service.wire.messages import Verdict

_UNFINISHED: Final = (Reason.NOT_SETTLED, Reason.UNPROTECTED)
"""Reasons of an estimate that more samples would mend: named after those that they would not."""

_HELD_OUT_BLOCKS: Final = 10  # contiguous, every second one held out: ten minutes each of an orbit


@dataclass(frozen=True, slots=True)
class Residuals:
    """rms of |(I+D)B - b| - |H| over a recording [nT].

    Parameters
    ----------
    before: with x = 0.
    after: with the estimate; where ``physics.toml`` is compensated, on the samples as they were compensated.
    noise_floor: the sensor noise as stated, or the white-noise level of the residual after; ``is_stated``: which.
    held_out: on blocks that took no part in a batch fit to the others; None where no such fit could be made.
    published: where ``physics.toml`` is compensated, |B_cal| - |H| of the vectors as they were published since the
        start, with the estimate of each moment; else None, and where no start was made.
    """

    before: float
    after: float
    noise_floor: float
    held_out: float | None
    published: float | None = None
    is_stated: bool = False

    @property
    def noise(self) -> str:
        """The noise that the residual is held against, and whose it is; an estimate has rounding in it."""
        return f"{self.noise_floor:.1f} nT {'stated' if self.is_stated else 'estimated'}"


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Calibration(NineErrors):
    """The result of ``calibrate``.

    Parameters
    ----------
    x, covariance: state (9,) and its covariance (9, 9) in the order of ``model.STATE_NAMES`` [nT, -].
    trusted, verdict, reasons: as the service judged at the end, with what the whole recording adds.
    samples, ticks: rows that could be read, ticks used.
    rows: what became of the log's rows before the fit.
    counters: what happened to the samples, by kind.
    model_doubt: what the model seems to leave out, in words; empty where nothing was found.
    findings: what is wrong with the recording itself.
    source: of which magnetometer, where the recording says.
    craft: whose it is, where the recording says.
    protection_nt, protection_by: protection level of the last estimate and what sets it; None while unknown.
    whole_log: what to do about a log that was taken as one batch (``offline.short_log``); empty where it was not.
    of_one_place: whether one magnitude stands for the reference of all rows.
    has_attitude: whether the recording has an attitude, which this does not use.
    physics_doubts: what the ``physics.toml`` that is compensated says against acting on it, a line each.
    held_at: at which values of drivers the nine errors hold, where ``physics.toml`` has effects that follow some.
    over: the recorded temperature that the residual follows, over whose range they are constants.
    """

    method: str
    x: Array
    covariance: Array
    verdict: Verdict
    reasons: tuple[Reason, ...]
    samples: int
    ticks: int
    residuals: Residuals
    counters: dict[str, int]
    model_doubt: str
    rows: Account
    findings: tuple[Finding, ...] = ()
    protection_nt: float | None = None
    protection_by: str | None = None
    source: str = ""
    craft: str = ""
    whole_log: str = ""
    of_one_place: bool = False
    has_attitude: bool = False
    physics_doubts: tuple[str, ...] = ()
    held_at: tuple[HeldAt, ...] = ()
    over: Over | None = None

    @property
    def trusted(self) -> bool:
        """Whether the estimate may be used."""
        return self.verdict is Verdict.TRUSTED

    @property
    def scale_doubt(self) -> str:
        """What a factor that all axes share speaks for, in words; empty where it is that of a sensor, or not sure."""
        return "" if self.verdict is Verdict.NOT_STARTED else scale_doubt(self.x, self.covariance)

    @property
    def remedy(self) -> str:
        """What to do about the first reason, empty where there is none."""
        if not self.reasons:
            return self.whole_log
        found = remedy_of(self.reasons[0], of_one_place=self.of_one_place, has_attitude=self.has_attitude)
        return self.whole_log if self.whole_log and found is not BY_ATTITUDE else found

    def to_dict(self) -> dict[str, Any]:
        """What ``calibrate --json`` writes, as plain data."""
        return {
            **head(CALIBRATION),
            "source": self.source,
            "craft": self.craft,
            "method": self.method,
            "trusted": self.trusted,
            "verdict": self.verdict,
            "reasons": list(self.reasons),
            "remedy": self.remedy,
            "samples": self.samples,
            "ticks": self.ticks,
            "rows": self.rows.to_dict(),
            "bias_nt": self.bias_nt.tolist(),
            "D": self.D.tolist(),
            "sigma": {"bias_nt": self.sigma_bias_nt.tolist(), "D": self.sigma_D.tolist()},
            "covariance": self.covariance.tolist(),
            "errors_hold_at": [one.to_dict() for one in self.held_at],
            "errors_over": None if self.over is None else self.over.to_dict(),
            "protection_nt": self.protection_nt,
            "protection_by": self.protection_by,
            "residual_rms_nt": {
                "before": self.residuals.before,
                "after": self.residuals.after,
                "noise_floor": self.residuals.noise_floor,
                "held_out": self.residuals.held_out,
                **({} if self.residuals.published is None else {"published": self.residuals.published}),
            },
            "counters": self.counters,
            "model_doubt": self.model_doubt,
            "scale_doubt": self.scale_doubt,
            "physics_doubts": list(self.physics_doubts),
            "findings": [one.to_dict() for one in self.findings],
        }

    def as_json(self) -> str:
        """``to_dict`` as text, indented."""
        return json.dumps(self.to_dict(), indent=2, allow_nan=False) + "\n"

    def __repr__(self) -> str:
        reasons = f" ({', '.join(self.reasons)})" if self.reasons else ""
        head = f"Calibration by {self.method}: {self.verdict}{reasons}, {self.samples} samples"
        levels = self.residuals
        tail = f"  residual {levels.before:.1f} -> {levels.after:.1f} nT, noise {levels.noise}"
        return "\n".join([head, *([] if self.verdict is Verdict.NOT_STARTED else [self._table()]), tail])


def refuse_without_channel(recording: Recording, method: Method) -> None:
    """Raise ``RecordingError`` where a method needs a telemetry channel that the recording does not have."""
    quantities = {c.spec.quantity for c in recording.channels.values() if len(c.spec.columns) == 3}
    if method.needs and method.needs not in quantities:
        accepted = f"the method {method.name} needs a channel of three columns with a unit of {method.needs}; add it"
        raise RecordingError([Lacking(f"{recording.name}: channels", MISSING, accepted)])


def calibrate(
    recording: Recording | Path | str,
    method: str = DEFAULT_METHOD,
    config: CraftConfig | None = None,
    *,
    start_s: float | None = None,
    prior: Given | Path | None = None,
) -> Calibration:
    """Run a method over a recording and judge the result on the whole of it.

    Parameters
    ----------
    recording: a recording, or the descriptor or session to read one from.
    method: name of an estimator; of a given ``config`` its own.
    config: the craft's configuration; None: as the recording states it.
    start_s: in place of its ``filter.start_s`` [s].
    prior: an earlier result, or its file, that the filter goes on from; its sigmas count as they are.

    A recording that is no longer than ``start_s`` is taken as one batch (``offline.short_log``).

    Raises ``RecordingError`` where the recording is refused, ``ConfigError`` for an unknown method or a ``start_s``
    that no configuration may have, ``InputRefusedError`` for a ``prior`` that does not fit (``offline.prior``).
    """
    recording = recording if isinstance(recording, Recording) else read_recording(recording)
    inspection = inspect(recording)
    usable = inspection.usable
    refuse_hopeless(usable, inspection.lines())
    craft = craft_of(inspection.to_replay, method) if config is None else config
    craft = short_log.starting_at(craft, start_s)
    entry = find_method(craft.filter.method)
    refuse_without_channel(recording, entry)
    prior = read_given(prior) if isinstance(prior, Path) else prior
    short = None
    if prior is not None:
        refuse_unfit(prior, usable, craft)
    elif entry.estimates_matrix and entry.takes_wide_prior:
        short = short_log.for_whole(inspection.to_replay, craft)
    result = replay(recording, short or craft, inspection=inspection, prior=prior)
    return _calibration(recording, inspection, result, _judged(usable, result, as_one_batch=short is not None))


@dataclass(frozen=True, slots=True)
class _Judgement:
    """What the whole recording makes of a replay; ``whole`` where it was taken as one batch."""

    verdict: Verdict
    reasons: tuple[Reason, ...]
    residuals: Residuals
    whole: short_log.Whole | None

    @property
    def whole_log(self) -> str:
        """What can be said of a log that was taken as one batch; empty where it was not, or its fault is another."""
        whole = self.whole
        return whole.remedy if whole is not None and (whole.doubts or self.verdict is not Verdict.DOUBTFUL) else ""


def _judged(usable: Recording, result: Replay, *, as_one_batch: bool) -> _Judgement:
    """The verdict of a replay's last tick, with what only the whole recording shows."""
    craft = result.pipeline.config
    residuals = residuals_of(usable, result, craft)
    reasons = list(result.reasons)
    reasons += [reason for reason in _whole_recording(residuals, craft) if reason not in reasons]
    whole = None
    if as_one_batch:
        state = result.pipeline.estimator.estimate()
        whole = short_log.judged(usable, craft, state, has_started=result.verdict is not Verdict.NOT_STARTED)
        reasons = [*whole.doubts, *(reason for reason in reasons if reason not in whole.doubts)]
        reasons.sort(key=_UNFINISHED.__contains__)
    verdict = result.verdict
    doubted = Reason.STRUCTURED_RESIDUAL in reasons or bool(whole and whole.doubts)
    if verdict in (Verdict.TRUSTED, Verdict.CONVERGING) and doubted:
        verdict = Verdict.DOUBTFUL
    return _Judgement(verdict, tuple(reasons), residuals, whole)


def _calibration(recording: Recording, inspection: Inspection, result: Replay, judgement: _Judgement) -> Calibration:
    pipeline, whole = result.pipeline, judgement.whole
    state = pipeline.estimator.estimate()
    magnitude_nt = recording.reference.magnitude_nt
    return Calibration(
        method=pipeline.estimator.name,
        x=state.x,
        covariance=state.covariance if whole is None else whole.factor * state.covariance,
        verdict=judgement.verdict,
        reasons=judgement.reasons,
        samples=len(recording),
        ticks=pipeline.ticks.counters["ticks"],
        residuals=judgement.residuals,
        counters=dict(pipeline.ticks.counters + pipeline.counters),
        model_doubt=result.model_doubt,
        rows=inspection.account,
        findings=inspection.findings,
        protection_nt=pipeline.trust.protection_nt,
        protection_by=pipeline.trust.protection_by,
        source=recording.source,
        craft=recording.of_craft or "",
        whole_log=judgement.whole_log,
        of_one_place=bool(np.nanmin(magnitude_nt) == np.nanmax(magnitude_nt)),
        has_attitude=recorded_attitude(recording) is not None,
        physics_doubts=() if pipeline.compensation is None else tuple(doubts_of(pipeline.compensation.model.doubts)),
        held_at=held_of(pipeline),
        over=None if inspection.open else over_of(recording, pipeline),
    )


def _whole_recording(residuals: Residuals, craft: CraftConfig) -> Sequence[Reason]:
    """What the whole recording shows and a running window may not."""
    limit = craft.trust.residual_ratio * residuals.noise_floor
    worst = max(residuals.after, residuals.held_out or 0.0)
    return (Reason.STRUCTURED_RESIDUAL,) if worst > limit else ()


def residuals_of(recording: Recording, result: Replay, craft: CraftConfig) -> Residuals:
    """Residual levels of a recording before and after a replay of it.

    With ``physics.toml`` what was really done to each sample counts, which no formula over the recording tells.
    """
    usable = recording.sorted_unique()
    times_ns = usable.time_ns
    field: Array = usable.field_body_nt
    magnitude: Array = usable.reference.magnitude_nt
    before = scalar_residual(np.zeros(STATE_SIZE), field, magnitude)
    published = None
    if result.published is not None:
        times_ns, field, magnitude = result.published.used(as_measured=not result.pipeline.compensates)
        vectors = result.published.since_start()
        published = rms(vectors) if vectors.size else None
    after = scalar_residual(result.x, field, magnitude)
    noise = craft.sensor.noise_nt
    return Residuals(
        before=rms(before),
        after=rms(after),
        noise_floor=noise if noise is not None else white_noise_level(times_ns, after),
        held_out=_held_out(field, magnitude, craft),
        published=published,
        is_stated=noise is not None,
    )


def _held_out(field: Array, magnitude: Array, craft: CraftConfig) -> float | None:
    """rms [nT] on every second of ten contiguous blocks, with a batch fitted to the others."""
    block = np.arange(len(field)) * _HELD_OUT_BLOCKS // len(field)
    fit = block % 2 == 0
    solution = batch_start(field[fit], magnitude[fit], (), craft.sensor.noise_nt, craft.filter)
    if isinstance(solution, StartGate):
        return None
    return rms(scalar_residual(solution.x, field[~fit], magnitude[~fit]))
