"""What a diagnosis comes to, as one frozen result for programs and notebooks."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, overload

import numpy as np

from magcal_service.base.errors import Fault, InputRefusedError
from magcal_service.diagnosis.content import as_json
from magcal_service.diagnosis.diagnose import Diagnosis
from magcal_service.diagnosis.diagnose import diagnose as run
from magcal_service.diagnosis.entry import Entry
from magcal_service.diagnosis.errors_spread import errors_covariance
from magcal_service.diagnosis.joint.diagnose import JointDiagnosis, diagnose_together
from magcal_service.diagnosis.joint.gather import gather
from magcal_service.diagnosis.joint.result import as_json as joint_json
from magcal_service.diagnosis.joint.words import summary as joint_summary
from magcal_service.diagnosis.result import entries, held_out_rms
from magcal_service.model import STATE_SIZE, Array
from magcal_service.offline.nine_errors import NineErrors
from magcal_service.recordings.inspect.inspection import inspect
from magcal_service.recordings.reader import read_recording
from magcal_service.recordings.recording import Recording
from magcal_service.recordings.usable import refuse_hopeless


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Answer(NineErrors):
    """What physics a recording shows beyond nine errors.

    Parameters
    ----------
    verdict: ``none``, ``named`` or ``unknown``.
    trusted, reasons: whether it may be acted on, and what speaks against it.
    effects: what was found, by the share of the mismatch that it explains.
    held_out_rms_nt: rms of the residual on blocks that took no part [nT]: ``simulation`` (of none: as calibrated on the
        first half), ``recalibrated`` (nine errors fitted anew), ``with_effects``.
    x, covariance: nine errors (9,) with the effects beside them, and their covariance (9, 9) [nT, -].
    content: what ``diagnosis.json`` holds.
    """

    verdict: str
    trusted: bool
    reasons: tuple[str, ...]
    effects: tuple[Entry, ...]
    held_out_rms_nt: dict[str, float]
    x: Array
    covariance: Array
    content: dict[str, Any]

    @classmethod
    def of(cls, diagnosis: Diagnosis) -> Answer:
        """The answer of a finished diagnosis."""
        found = entries(diagnosis)
        return cls(
            verdict=str(diagnosis.verdict),
            trusted=diagnosis.trusted,
            reasons=tuple(map(str, diagnosis.reasons)),
            effects=found,
            held_out_rms_nt=held_out_rms(diagnosis),
            x=np.asarray(diagnosis.fit.x[:STATE_SIZE]),
            covariance=errors_covariance(diagnosis.fit),
            content=json.loads(as_json(diagnosis, found)),
        )

    def to_dict(self) -> dict[str, Any]:
        """What ``magcal diagnose`` writes as ``diagnosis.json``."""
        return self.content

    def __repr__(self) -> str:
        doubt = "trusted" if self.trusted else f"do not act on this: {', '.join(self.reasons)}"
        levels = " -> ".join(f"{value:.0f}" for value in self.held_out_rms_nt.values())
        compared = self.content["compared_with"]
        head = f"Diagnosis: {self.verdict} ({doubt}); held out {levels} nT ({compared}, recalibrated, with effects)"
        return "\n".join(
            [head, f"  {self.content['sentence']}", *(f"  {entry.effect}: {entry.says}" for entry in self.effects)]
        )


@dataclass(frozen=True, slots=True, eq=False)
class OneOfSeveral(NineErrors):
    """The nine errors of one recording among several: x (9,) and covariance (9, 9) [nT, -]."""

    x: Array
    covariance: Array


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class JointAnswer:
    """What physics several recordings of one craft have in common.

    Parameters
    ----------
    verdict: ``none``, ``named`` or ``unknown``.
    trusted, reasons: whether it may be acted on, and what speaks against it.
    held_out_rms_nt: rms of the residual of all recordings on blocks that took no part [nT]: ``recalibrated`` (nine
        errors of each), ``with_effects``.
    recordings: nine errors of each, by its name.
    content: what ``diagnosis.json`` holds: ``sentence``, ``effects``, ``shared``, ``predicted_from_the_others``, ...
    lines: the summary, as the command prints it.
    """

    verdict: str
    trusted: bool
    reasons: tuple[str, ...]
    held_out_rms_nt: dict[str, float]
    recordings: dict[str, OneOfSeveral]
    content: dict[str, Any]
    lines: tuple[str, ...]

    @classmethod
    def of(cls, diagnosis: JointDiagnosis) -> JointAnswer:
        """The answer of a finished diagnosis."""
        content = json.loads(joint_json(diagnosis))
        return cls(
            verdict=str(diagnosis.verdict),
            trusted=diagnosis.trusted,
            reasons=diagnosis.reasons,
            held_out_rms_nt=content["fit"]["held_out_rms_nt"],
            recordings={one.name: OneOfSeveral(one.fit.x[:STATE_SIZE], one.covariance) for one in diagnosis.recordings},
            content=content,
            lines=tuple(joint_summary(diagnosis, ())),
        )

    def to_dict(self) -> dict[str, Any]:
        """What ``magcal diagnose`` writes as ``diagnosis.json``."""
        return self.content

    def __repr__(self) -> str:
        doubt = "trusted" if self.trusted else f"do not act on this: {', '.join(self.reasons)}"
        assumed = [f"taken for granted: {self.content['assumed']}"] if self.content["assumed"] else []
        return "\n".join([f"Diagnosis of {len(self.recordings)} recordings ({doubt})", *assumed, *self.lines])


@overload
def diagnose(recordings: Recording | Path | str, *, simulation: Array | None = None) -> Answer: ...


@overload
def diagnose(
    recordings: Sequence[Recording | Path | str], *, simulation: Array | None = None
) -> Answer | JointAnswer: ...


def diagnose(
    recordings: Recording | Path | str | Sequence[Recording | Path | str],
    *,
    simulation: Array | None = None,
) -> Answer | JointAnswer:
    """Compare a recording with its simulation and name what was left out; several, with what they have in common.

    Parameters
    ----------
    recordings: one recording, or the descriptor or session to read one from; or several of one craft, whose physics is
        taken to be common.
    simulation: nine errors (9,) of the simulation to compare one recording with; None: as calibrated on the first half.

    Raises ``InputRefusedError`` where a recording is refused, none is given, or several are not of one craft.
    """
    given = [recordings] if isinstance(recordings, Recording | Path | str) else list(recordings)
    if len(given) > 1:
        if simulation is not None:
            raise InputRefusedError([Fault("simulation", "given", "one recording is compared with a simulation")])
        gathered = gather(given)
        return JointAnswer.of(diagnose_together(gathered.inspections, gathered.names, assumed=gathered.assumed))
    if not given:
        raise InputRefusedError([Fault("number of recordings", 0, "one is accepted, or several of one craft")])
    recording = given[0] if isinstance(given[0], Recording) else read_recording(given[0])
    inspection = inspect(recording)
    refuse_hopeless(inspection.to_diagnose, inspection.lines())
    return Answer.of(run(recording, simulation, inspection=inspection))
