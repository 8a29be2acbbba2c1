"""A day of SUCHAI-3 replayed with the physics of its other days, and the best that could come of that: bench_together.

What a craft publishes since its start is held against |H|; beside it stands the rms of the best nine constants for the
day, alone and with the file's effects and the best start temperature: what no filter can do better on average.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from magcal_service.config.settings import PhysicsConfig
from magcal_service.diagnosis.joint.catalogue import Forms
from magcal_service.diagnosis.joint.diagnose import JointDiagnosis
from magcal_service.diagnosis.joint.problem import JointProblem
from magcal_service.diagnosis.joint.result import model_of
from magcal_service.diagnosis.joint.search import refitted
from magcal_service.diagnosis.prepare import Form, prepare
from magcal_service.estimators.parts.magnitude_fit import magnitude_fit
from magcal_service.model import STATE_SIZE, Array, d_matrix
from magcal_service.offline.replay import craft_of, replay
from magcal_service.physics.apply.forward import bind
from magcal_service.physics.apply.live_terms import WARMTH
from magcal_service.physics.apply.model_file import PhysicsModel, text_of
from magcal_service.physics.catalogue import catalogue
from magcal_service.recordings.inspect.inspection import inspect
from magcal_service.recordings.recording import Recording
from magcal_service.residuals import rms
from magcal_service.wire.messages import CalibratedVector, Message, Verdict

START_SIGMA = 0.5  # of a start temperature, in units of the swing between light and shadow, as live


def live(recording: Recording, model: PhysicsModel) -> dict[str, Any]:
    """Published residuals with a model and without, and the best of both that nine constants could give [nT]."""
    alone, with_it = best(recording, model)
    without, before = published(recording, None)
    within, after = published(recording, model)
    return {
        "effects": [term.effect for term in model.terms],
        "doubts": model.doubts,
        "without_nt": without,
        "vectors_without": before,
        "with_nt": within,
        "vectors_with": after,
        "times_better": without / within,
        "best_without_nt": alone,
        "best_with_nt": with_it,
        "best_times_better": alone / with_it,
    }


def published(recording: Recording, model: PhysicsModel | None) -> tuple[float, int]:
    """rms of |B_cal| - |H| [nT] over the vectors that a replay publishes since its start, and their number."""
    inspection = inspect(recording)
    craft = craft_of(inspection.to_replay)
    if model is not None:
        craft = replace(craft, physics=PhysicsConfig(Path("physics.toml"), text_of(model)))
    vectors: list[CalibratedVector] = []

    def keep(message: Message) -> None:
        if isinstance(message, CalibratedVector) and message.verdict is not Verdict.NOT_STARTED:
            vectors.append(message)

    replay(recording, craft, sink=keep, inspection=inspection)
    used = inspection.to_replay.sorted_unique()
    rows = np.searchsorted(used.time_ns, [one.time_ns for one in vectors])
    lengths = np.linalg.norm([one.field_body_nt for one in vectors], axis=1)
    return rms(lengths - used.reference.magnitude_nt[rows]), len(vectors)


def best(recording: Recording, model: PhysicsModel) -> tuple[float, float]:
    """rms of the residual that the best nine constants leave on all rows [nT]: alone, and with a model's effects."""
    prepared = prepare(inspect(recording).to_diagnose, catalogue(), (Form.SCALAR,))
    scene = prepared.problem.scene
    alone = magnitude_fit(prepared.baseline.x[:STATE_SIZE], scene.field_nt, scene.magnitude_nt)
    added, starts = np.zeros((len(scene), 3)), list[Array]()
    for term in model.terms:
        given = term
        if term.driver == WARMTH:
            assert scene.lit is not None
            skin_start = float(scene.lit[0]) - term.constants["mean_light"]
            given = replace(term, constants={**term.constants, "skin_start": skin_start})
        bound = bind(given, scene)
        columns, amplitudes = bound.hypothesis.columns(bound.theta), np.array(bound.amplitudes)
        if term.driver == WARMTH:
            own = len(amplitudes) // 2
            starts.append(columns.field(np.concatenate([np.zeros(own), amplitudes[:own]])))
            amplitudes[own:] = 0.0
        added += columns.field(amplitudes)
    inverse = np.linalg.inv(np.eye(3) + d_matrix(model.x))
    fields = np.stack([one @ inverse.T for one in starts], axis=1) if starts else None
    fit = magnitude_fit(model.x, scene.field_nt - added @ inverse.T, scene.magnitude_nt, fields, START_SIGMA)
    return rms(alone.residual_nt), rms(fit.residual_nt)


def numbers_of_others(found: JointDiagnosis, left_out: int) -> PhysicsModel:
    """The effects that all recordings have in common, with the numbers that the others give without one of them."""
    problem = found.fit.problem
    assert isinstance(problem, JointProblem)
    others = [number for number in range(len(found.recordings)) if number != left_out]
    singles, names = [problem.singles[k] for k in others], [found.recordings[k].name for k in others]
    x = problem.unknowns_of(found.fit.x[: problem.size])
    relative = [problem.relative[k] for k in others] if problem.relative else []
    start = np.concatenate([x[k] for k in others])
    forms = Forms.of(found.effects, problem.singles)
    fit = refitted(forms, singles, names, start, found.fit.terms, (), problem.dispersion, relative)
    return model_of(replace(found, recordings=_alone(found, others, fit), explained=replace(found.explained, fit=fit)))


def _alone(found: JointDiagnosis, others: Sequence[int], fit: Any) -> tuple[Any, ...]:
    """The other recordings, each with its part of their fit."""
    recordings, first = [], 0
    for number, part in zip(others, fit.problem.fits(fit.x, fit.terms), strict=True):
        own = slice(first, first + STATE_SIZE)
        first += part.problem.size
        recordings.append(replace(found.recordings[number], fit=part, covariance=fit.covariance[own, own]))
    return tuple(recordings)
