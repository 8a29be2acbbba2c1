"""One question: read, hide channels, diagnose, and keep what the tables are made of."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from magcal_service.recordings.reader import read_recording
from magcal_service.recordings.recording import Recording
from magcal_service.studies.real.plan import Question


@dataclass(frozen=True, slots=True)
class Named:
    """An effect as it was named: by what it is driven, and how probable it is."""

    effect: str
    driver: str
    probability: float


@dataclass(frozen=True, slots=True)
class SharedNumber:
    """A number that recordings have in common, or not: value with 1 sigma of the joint fit, and what speaks for it."""

    effect: str
    parameter: str
    value: tuple[float, ...]
    sigma: tuple[float, ...]
    unit: str
    agreement: str


@dataclass(frozen=True, slots=True)
class PredictedDay:
    """One recording predicted from the others: held-out rms [nT], and the share of its own fit's gain that is kept.

    ``kept`` is None where it shows too little to be predicted.
    """

    recording: str
    recalibrated_nt: float
    predicted_nt: float
    own_nt: float
    kept: float | None


@dataclass(frozen=True, slots=True)
class Answer:
    """What came of a question.

    Parameters
    ----------
    verdict, reasons: of the diagnosis; no reason: it is trusted.
    named: effects, the first one first.
    recalibrated_nt, with_effects_nt: rms on blocks that took no part, of all recordings [nT].
    processor_s: what reading and diagnosis took.
    shared, predicted: of several recordings together.
    """

    verdict: str
    reasons: tuple[str, ...]
    named: tuple[Named, ...]
    recalibrated_nt: float
    with_effects_nt: float
    processor_s: float
    shared: tuple[SharedNumber, ...] = ()
    predicted: tuple[PredictedDay, ...] = ()

    @property
    def trusted(self) -> bool:
        """Whether ``magcal diagnose`` ends with 0."""
        return not self.reasons


def answer(question: Question) -> Answer:
    """Diagnose; raises what reading refuses, and where no calibration is possible."""
    began = time.process_time()
    recordings = [_without(read_recording(path), question.hidden) for path in question.paths]
    found = _alone(recordings[0]) if len(recordings) == 1 else _together(recordings)
    return replace(found, processor_s=time.process_time() - began)


def _without(recording: Recording, hidden: Sequence[str]) -> Recording:
    kept = {name: channel for name, channel in recording.channels.items() if name not in hidden}
    return replace(recording, channels=kept)


def _alone(recording: Recording) -> Answer:
    from magcal_service.diagnosis.diagnose import diagnose
    from magcal_service.diagnosis.result import entries, held_out_rms
    from magcal_service.physics.interface import UNLISTED
    from magcal_service.recordings.inspect.inspection import inspect
    from magcal_service.recordings.usable import refuse_hopeless

    inspection = inspect(recording)
    refuse_hopeless(inspection.to_diagnose, inspection.lines())
    diagnosis = diagnose(recording, inspection=inspection)
    level = held_out_rms(diagnosis)
    named = (entry for entry in entries(diagnosis) if entry.effect != UNLISTED)
    return Answer(
        verdict=str(diagnosis.verdict),
        reasons=tuple(map(str, diagnosis.reasons)),
        named=tuple(Named(entry.effect, entry.driver, float(entry.probability)) for entry in named),
        recalibrated_nt=float(level["recalibrated"]),
        with_effects_nt=float(level["with_effects"]),
        processor_s=0.0,
    )


def _together(recordings: Sequence[Recording]) -> Answer:
    from magcal_service.diagnosis.belief import posterior
    from magcal_service.diagnosis.joint.diagnose import diagnose_together
    from magcal_service.diagnosis.joint.gather import gather

    gathered = gather(recordings)
    diagnosis = diagnose_together(gathered.inspections, gathered.names, assumed=gathered.assumed)
    before = np.concatenate([one.baseline.held_out_residual for one in diagnosis.recordings])
    hypotheses = [term.hypothesis for term in diagnosis.fit.terms]
    return Answer(
        verdict=str(diagnosis.verdict),
        reasons=tuple(map(str, diagnosis.reasons)),
        named=tuple(
            Named(form.effect, form.driver, float(posterior(diagnosis.explained, index).own))
            for index, form in enumerate(hypotheses)
        ),
        recalibrated_nt=float(np.sqrt(np.mean(before**2))),
        with_effects_nt=diagnosis.fit.held_out_rms_nt,
        processor_s=0.0,
        shared=tuple(_shared(diagnosis, one) for one in diagnosis.compared.shared),
        predicted=tuple(
            PredictedDay(
                one.name,
                float(one.nine_nt),
                float(one.predicted_nt),
                float(one.own_nt),
                float(one.kept) if one.shows else None,
            )
            for one in diagnosis.compared.predicted
        ),
    )


def _shared(diagnosis: Any, one: Any) -> SharedNumber:
    from magcal_service.diagnosis.joint.words import agreement

    return SharedNumber(
        one.effect,
        one.parameter,
        tuple(one.together.value.tolist()),
        tuple(one.together.sigma.tolist()),
        one.unit,
        agreement(diagnosis, one),
    )
