"""A recording's vectors by nine errors that are given, as the daemon would publish them with that estimate."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from magcal_service.base.progress import each_of
from magcal_service.config.settings import PhysicsConfig
from magcal_service.daemon.outbox import calibrated_vector
from magcal_service.estimators.interface import Phase, StateEstimate
from magcal_service.model import Array
from magcal_service.offline.compensated import EffectAccount, Tally
from magcal_service.offline.given import Given
from magcal_service.offline.replay import craft_of, replay
from magcal_service.physics.apply.compensation import Compensation
from magcal_service.physics.apply.model_file import text_of
from magcal_service.recordings.inspect.inspection import Inspection
from magcal_service.recordings.messages import messages
from magcal_service.recordings.recording import Recording
from magcal_service.recordings.table import IntArray
from magcal_service.residuals import MEDIAN_TO_SIGMA, white_noise_level
from magcal_service.trust.vector_gate import strays
from magcal_service.trust.verdict import Trust
from magcal_service.wire.messages import (
    CalibratedVector,
    Clock,
    MagnetometerSample,
    PositionSample,
    ReferenceSample,
    TelemetrySample,
    Verdict,
)

_NOISE_RATIO: Final = math.sqrt(1.5**2 - 1.0)
"""Beside the noise, in its units: a residual of 1.5 times the noise, as ``[craft.trust] residual_ratio`` has it."""


@dataclass(frozen=True, slots=True)
class Applied:
    """The vectors of a recording.

    Parameters
    ----------
    vectors: one of each usable row, in its order.
    strayed: those that are not as long as the field was: doubtful, whatever the result.
    accounts: what was done with each effect of a ``physics.toml``; none where no effect was subtracted from any.
    partly: how many vectors an effect was not subtracted from, whatever kept it: doubtful as well.
    remark: what kept the model from being used as it is, empty where nothing did.
    references: time [ns] and length [nT] of each reference, as the effects that act on it leave it, in the order of
        the recording.
    stopped: why no effect was subtracted from any, empty where that was not so; it is in ``remark`` too.
    """

    vectors: tuple[CalibratedVector, ...]
    strayed: int
    accounts: tuple[EffectAccount, ...]
    partly: int
    remark: str = ""
    references: tuple[tuple[int, float], ...] = ()
    stopped: str = ""

    @property
    def trusted(self) -> int:
        """How many vectors may be used."""
        return sum(one.verdict is Verdict.TRUSTED for one in self.vectors)

    def reference_at(self, time_ns: IntArray) -> Array:
        """Length of the reference at given times (n,), interpolated between those there are [nT]; NaN without any."""
        if not self.references:
            return np.full(len(time_ns), np.nan)
        times, lengths = (np.array(column) for column in zip(*sorted(self.references), strict=True))
        found: Array = np.interp(time_ns - times[0], times - times[0], lengths)
        return found


def apply(given: Given, inspection: Inspection) -> Applied:
    """Calibrate every usable row of a recording.

    Parameters
    ----------
    given: the nine errors, and the effects that are subtracted where they are of a ``physics.toml``.
    inspection: of the recording.

    Equation (5), w = (I + D) B - b, with the covariance of noise and estimate; disturbances are subtracted from B
    first, by the same code as in the daemon.  A temperature at the start of another day is estimated from the whole
    recording, as a replay does.
    """
    recording = inspection.to_replay
    compensation, remark = (None, "") if given.model is None else _compensation(given, recording, inspection)
    state = StateEstimate(
        x=given.x,
        covariance=given.covariance,
        noise_nt=_noise(given, recording),
        phase=Phase.RUNNING,
        samples=0,
        rejected=0,
        restarts=0,
        waiting_for=None,
        spin_given_up=False,
    )
    applied = _applied(recording, given, state, compensation, remark)
    return _judged(applied, inspection, given, state.noise_nt)


def residual_rms(given: Given, inspection: Inspection, applied: Applied) -> tuple[float, float]:
    """How far |B| as measured, and |w| as applied, are off the field over the usable rows: rms [nT]; NaN without any.

    Where effects act on the reference, |w| is compared with the field as they leave it.
    """
    usable = inspection.usable.sorted_unique()
    stated = usable.reference.magnitude_nt
    after_nt, field_nt = given.apply(usable.field_body_nt), stated
    if given.model is not None:
        found = {one.time_ns: one.field_body_nt for one in applied.vectors}
        absent = (math.nan,) * 3
        after_nt = np.array([found.get(time_ns, absent) for time_ns in usable.time_ns.tolist()]).reshape(-1, 3)
        field_nt = np.where(np.isnan(stated), np.nan, applied.reference_at(usable.time_ns))
    return _rms_off(usable.field_body_nt, stated), _rms_off(after_nt, field_nt)


def _rms_off(vectors_nt: Array, field_nt: Array) -> float:
    off = np.linalg.norm(vectors_nt, axis=1) - field_nt
    off = off[np.isfinite(off)]
    return float(np.sqrt(np.mean(np.square(off)))) if off.size else math.nan


def _judged(applied: Applied, inspection: Inspection, given: Given, noise_nt: float) -> Applied:
    """All doubtful where the vectors are off the field by more than noise and protection level explain.

    Judged by the median, for a spike is doubted by itself.  A bias that is off by p moves the length of a vector that
    turns everywhere by up to p, evenly: p / 2 by the median.  Noise that is told somewhat too low is allowed for as a
    calibration does (``[craft.trust] residual_ratio``).
    """
    usable = inspection.usable
    length = dict(zip(usable.time_ns.tolist(), usable.reference.magnitude_nt.tolist(), strict=True))
    off = [
        float(np.linalg.norm(one.field_body_nt)) - magnitude
        for one in applied.vectors
        if math.isfinite(magnitude := length.get(one.time_ns, math.nan))
    ]
    if not off:
        return applied
    spread = MEDIAN_TO_SIGMA * float(np.median(np.abs(off)))
    level = math.sqrt(max(0.0, spread**2 - noise_nt**2))
    allowed = max(_NOISE_RATIO * noise_nt, 0.5 * MEDIAN_TO_SIGMA * (given.protection_nt or 0.0))
    if level <= allowed:
        return applied
    remark = (
        f"{given.name} does not fit this recording: beside {noise_nt:.1f} nT of noise the vectors are {level:.1f} nT "
        f"off the field where {allowed:.1f} nT are allowed for noise and protection level"
    )
    vectors = tuple(replace(one, verdict=Verdict.DOUBTFUL) for one in applied.vectors)
    return replace(applied, vectors=vectors, remark="; ".join(filter(None, (applied.remark, remark))))


def _noise(given: Given, recording: Recording) -> float:
    """White noise, 1 sigma per axis [nT]: as the recording states it, else the result, else as the residual shows.

    What the result names as added to the sensor's own counts beside what is stated, as far as the residual shows it:
    it may be stated with it.
    """
    stated = recording.descriptor.magnetometer.noise_nt
    added = 0.0 if given.model is None else given.model.added_noise_nt
    if stated is not None and added > 0.0:
        return max(stated, min(math.hypot(stated, added), _floor(given, recording)))
    if stated is not None:
        return stated
    return _floor(given, recording) if given.noise_nt is None else given.noise_nt


def _floor(given: Given, recording: Recording) -> float:
    usable = recording.sorted_unique()
    residual = np.linalg.norm(given.apply(usable.field_body_nt), axis=1) - usable.reference.magnitude_nt
    return white_noise_level(usable.time_ns, residual)


def _compensation(given: Given, recording: Recording, inspection: Inspection) -> tuple[Compensation | None, str]:
    """What subtracts the effects, with its start where that has to be found; a remark where it can not."""
    assert given.model is not None
    compensation = Compensation(given.model)
    first = next((one for one in messages(recording) if isinstance(one, MagnetometerSample)), None)
    if first is None or not compensation.begins_elsewhere(first):
        return compensation, ""
    craft = replace(craft_of(recording), physics=PhysicsConfig(Path(given.name), text_of(given.model)))
    pipeline = replay(recording, craft, inspection=inspection).pipeline
    if pipeline.compensation is None or not pipeline.compensates:
        why = pipeline.stopped or "no temperature at the start could be found"
        return None, f"its effects are not subtracted: {why}"
    compensation.free_start()
    compensation.take_start(pipeline.compensation)
    return compensation, ""


def _applied(
    recording: Recording, given: Given, state: StateEstimate, compensation: Compensation | None, remark: str
) -> Applied:
    vectors, tally, partly, strayed = list[CalibratedVector](), Tally(), 0, 0
    newest: tuple[int, float, Clock] | None = None
    references: list[tuple[int, float]] = []
    trust = Trust(given.verdict, (), "", given.protection_nt, given.protection_by)
    for sample, reference in each_of(_samples(recording, compensation), len(recording), "applying", "rows"):
        newest = reference or newest
        if reference is not None:
            references.append(reference[:2])
        corrected, unknown = sample, None
        if compensation is not None:
            corrected, unknown = compensation.correct(sample), compensation.start_variance
            tally.corrected(compensation.missing, compensation.causes)
            partly += bool(compensation.missing)
        vector = calibrated_vector(corrected, state, given.covariance, trust, unknown)
        doubt = bool(remark) or (compensation is not None and bool(compensation.missing))
        if newest is not None and newest[2] is vector.clock:
            stray = strays(vector, newest[1], abs(vector.time_ns - newest[0]) * 1e-9)
            strayed += stray
            doubt |= stray
        vectors.append(replace(vector, verdict=Verdict.DOUBTFUL) if doubt else vector)
    model = None if compensation is None else compensation.model
    accounts = () if model is None else tally.accounts(model, recording.driving, "")
    return Applied(tuple(vectors), strayed, accounts, partly, remark, tuple(references), stopped=remark)


def _samples(
    recording: Recording, compensation: Compensation | None
) -> Iterator[tuple[MagnetometerSample, tuple[int, float, Clock] | None]]:
    """Each sample of the recording's own magnetometer, and the newest reference before it where there was a new one."""
    newest: tuple[int, float, Clock] | None = None
    for message in messages(recording):
        match message:
            case MagnetometerSample() if recording.source in ("", message.source):
                yield message, newest
                newest = None
            case ReferenceSample():
                if compensation is not None:
                    message = compensation.reference(message)
                length = message.magnitude_nt
                if message.field_nt is not None:
                    length = float(np.linalg.norm(message.field_nt))
                newest = (message.time_ns, float(length or 0.0), message.clock)
            case PositionSample() if compensation is not None:
                compensation.position(message)
            case TelemetrySample() if compensation is not None:
                compensation.telemetry(message)
