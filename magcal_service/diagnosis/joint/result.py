"""A joint diagnosis as JSON, as a model, and in a dozen lines."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np

from magcal_service.diagnosis.belief import posterior, unlisted
from magcal_service.diagnosis.entry import listed_rivals, plain
from magcal_service.diagnosis.first import why_first
from magcal_service.diagnosis.handover import model_term, spin_of
from magcal_service.diagnosis.joint.catalogue import started
from magcal_service.diagnosis.joint.compare import Estimate, Kept, Predicted, Shared, estimate
from magcal_service.diagnosis.joint.diagnose import Alone, JointDiagnosis
from magcal_service.diagnosis.joint.forms import joint
from magcal_service.diagnosis.joint.levels import Levels, bias_moved_nt, levels_of_all, levels_of_each
from magcal_service.diagnosis.joint.words import (
    ONE_ALONE,
    drivers,
    parameters,
    record_next,
    says,
    sentence,
    separated_by,
)
from magcal_service.diagnosis.problem import Term
from magcal_service.diagnosis.rows import account_of
from magcal_service.diagnosis.term_columns import amplitude_columns
from magcal_service.model import BIAS, STATE_SIZE, d_matrix
from magcal_service.offline.result_head import JOINT, head
from magcal_service.physics.apply.advice import advice
from magcal_service.physics.apply.model_file import ModelTerm, PhysicsModel
from magcal_service.physics.interface import Value
from magcal_service.wire.messages import Clock


def as_json(diagnosis: JointDiagnosis) -> str:
    """The ``diagnosis.json`` of several recordings."""
    content: dict[str, Any] = {
        **head(JOINT),
        "verdict": str(diagnosis.verdict),
        "sentence": sentence(diagnosis),
        "assumed": diagnosis.assumed,
        "fit": levels_of_all(diagnosis).to_dict(),
        "recordings": _recordings(diagnosis),
        "effects": [_effect(diagnosis, index) for index in range(len(diagnosis.fit.terms))],
        "own_numbers": ONE_ALONE,
        "shared": [_shared(one) for one in diagnosis.compared.shared],
        "predicted_from_the_others": [_predicted(diagnosis, one) for one in diagnosis.compared.predicted],
        "unexplained_share": round(diagnosis.unexplained, 4),
        "left_share": round(diagnosis.left_share, 4),
        "seconds": round(diagnosis.seconds, 2),
        "converged": diagnosis.fit.converged,
        "trusted": diagnosis.trusted,
        "reasons": list(diagnosis.reasons),
        "advice": advice(diagnosis.reasons, diagnosis.concerned),
    }
    return json.dumps(content, indent=2, allow_nan=False) + "\n"


def _recordings(diagnosis: JointDiagnosis) -> list[dict[str, Any]]:
    predicted = {one.name: one.predicted_nt for one in diagnosis.compared.predicted}
    each = zip(diagnosis.recordings, levels_of_each(diagnosis), bias_moved_nt(diagnosis), strict=True)
    return [
        {**_recording(one, levels, moved), "predicted_from_others_rms_nt": predicted.get(one.name)}
        for one, levels, moved in each
    ]


def _recording(one: Alone, levels: Levels, moved_nt: float) -> dict[str, Any]:
    sigma = np.sqrt(np.maximum(np.diagonal(one.covariance), 0.0))
    left = one.left[0] if one.unexplained > 0.0 else None
    return {
        "name": one.name,
        "file": one.prepared.recording.name,
        "rows": account_of(one.inspection, one.prepared).to_dict(),
        **levels.to_dict(),
        "noise_with_memory_nt": one.memory_nt,
        "bias_nt": one.fit.x[BIAS].tolist(),
        "D": d_matrix(one.fit.x[:STATE_SIZE]).tolist(),
        "sigma": {"bias_nt": sigma[BIAS].tolist(), "D": d_matrix(sigma).tolist()},
        "errors_hold_at": [held.to_dict() for held in one.held_at],
        "bias_before_nt": one.baseline.x[BIAS].tolist(),
        "bias_moved_nt": moved_nt,
        "has_coverage": one.has_coverage,
        "light_seen": [seen.to_dict() for seen in one.light],
        "left": None if left is None else {"shape": left.shape.says, "share": round(left_share(one), 4)},
        "seen_in_samples": sorted(one.prepared.findings),
        "findings": [finding.to_dict() for finding in one.inspection.findings],
    }


def left_share(one: Alone) -> float:
    """Share of a recording's mismatch without a name."""
    return one.unexplained / max(one.unexplained + one.explained, 1e-12)


def _effect(diagnosis: JointDiagnosis, index: int) -> dict[str, Any]:
    term, believed = diagnosis.fit.terms[index], posterior(diagnosis.explained, index)
    form, gain = joint(term), diagnosis.explained.gains[index]
    return {
        "effect": form.effect,
        "says": says(diagnosis, index),
        "common": bool(form.common),
        "shared": bool(form.common),
        "probability": round(believed.own, 6),
        "rivals": [
            {"effect": name, "probability": round(p, 6)} for name, p in listed_rivals(believed.rivals, believed.members)
        ],
        "class": list(believed.members),
        "as_well": list(form.exactly_alike),
        "why_first": why_first(diagnosis.explained, index),
        "separated_by": separated_by(diagnosis, index),
        "record_next": record_next(diagnosis, index),
        "driver": form.driver,
        "drivers": [{"driver": name, "probability": round(p, 6)} for name, p in drivers(diagnosis, index)],
        "unlisted": unlisted(diagnosis.explained, index),
        "variant": form.variant,
        "parameters": {name: _value(value) for name, value in parameters(diagnosis, index).items()},
        "constants": dict(form.constants),
        "own": {name: _own(diagnosis, index, name) for name in sorted(form.own)},
        "recordings": (acting := [name for name in form.names if form.acts_on(name)]),
        "where": {"recordings": acting, "share_of_mismatch": round(_share(diagnosis, index), 4)},
        "evidence_nats": round(diagnosis.explained.nats[index], 2),
        "seen_in_blocks": [gain.seen, gain.expected],
    }


def _share(diagnosis: JointDiagnosis, index: int) -> float:
    """Of what the effects explain together, an effect's part by its evidence."""
    nats = np.maximum(diagnosis.explained.nats, 0.0)
    return float((1.0 - diagnosis.unexplained) * nats[index] / max(float(nats.sum()), 1e-12))


def _own(diagnosis: JointDiagnosis, index: int, block: str) -> dict[str, Any]:
    """What each recording has itself."""
    term = diagnosis.fit.terms[index]
    form, one = joint(term), estimate(diagnosis.fit, index, block)
    shape = next(b.shape for b in form.blocks if b.name == block)
    acting = [name for name in form.names if form.acts_on(name)]
    values, sigmas = one.value.reshape(shape), one.sigma.reshape(shape)
    unit = next(b.unit for b in form.blocks if b.name == block)
    return {
        name: {"value": value.tolist(), "sigma": sigma.tolist(), "unit": unit}
        for name, value, sigma in zip(acting, values, sigmas, strict=True)
    }


def _value(value: Value) -> dict[str, Any]:
    return {"value": plain(value.value), "sigma": plain(value.sigma), "unit": value.unit}


def _shared(one: Shared) -> dict[str, Any]:
    return {
        "effect": one.effect,
        "parameter": one.parameter,
        "unit": one.unit,
        "together": _estimate(one.together, one.shape),
        "probability": float(f"{one.probability:.4g}"),
        "agrees": one.agrees,
        "recordings": [
            {
                "name": each.name,
                "own": _estimate(each.own, one.shape),
                "others": _estimate(each.others, one.shape),
                "probability": float(f"{each.probability:.4g}"),
            }
            for each in one.each
        ],
    }


def _estimate(one: Estimate, shape: tuple[int, ...]) -> dict[str, Any]:
    return {"value": one.value.reshape(shape).tolist(), "sigma": one.sigma.reshape(shape).tolist()}


def _predicted(diagnosis: JointDiagnosis, one: Predicted) -> dict[str, Any]:
    kept = zip(diagnosis.fit.terms, one.effects, strict=True)
    return {
        "name": one.name,
        "held_out_rms_nt": {
            "recalibrated": one.nine_nt,
            "without_common": one.without_nt,
            "predicted": one.predicted_nt,
            "own": one.own_nt,
        },
        "share_of_own_gain": round(one.kept, 4) if one.shows else None,
        "worse_than_nothing": one.predicted_nt > one.without_nt,
        "stands_out": one.stands_out,
        "gain_nats": round(one.gain.tempered, 2),
        "seen_in_blocks": [one.gain.seen, one.gain.expected],
        "effects": {term.hypothesis.effect: _kept(part) for term, part in kept if part is not None},
    }


def _kept(part: Kept) -> float | None:
    return round(part.share, 4) if part.is_seen else None


# The model


def model_of(diagnosis: JointDiagnosis) -> PhysicsModel:
    """The common physics, with nine errors, spin and start states of the latest recording, to begin from.

    What each recording has its own, and what acts in one of them alone, is no model of the next and is left out.
    """
    latest = diagnosis.recordings[diagnosis.latest]
    scene = latest.prepared.problem.scene
    sigma = np.sqrt(np.maximum(np.diagonal(latest.covariance), 0.0))
    terms = [(k, term) for k, term in enumerate(diagnosis.fit.terms) if joint(term).common]
    return PhysicsModel(
        recording=latest.prepared.recording.name,
        origin_ns=scene.origin_ns,
        clock=Clock.UTC if scene.utc else Clock.ELAPSED,
        x=latest.fit.x[:STATE_SIZE],
        sigma=sigma[:STATE_SIZE],
        noise_nt=latest.noise_nt,
        terms=tuple(_model_term(diagnosis, k, term, latest) for k, term in terms),
        notes=(),
        spin=spin_of(latest.prepared.spin),
        doubts=", ".join(diagnosis.reasons),
        craft=latest.prepared.recording.of_craft or "",
    )


def _model_term(diagnosis: JointDiagnosis, index: int, term: Term, latest: Alone) -> ModelTerm:
    form = joint(term)
    number = form.names.index(latest.name)
    own = form.term_of(number, term)
    assert own is not None
    found = model_term(own.hypothesis, own.theta, own.amplitudes)
    variance = np.diagonal(diagnosis.fit.covariance)
    at = amplitude_columns(diagnosis.fit, index).start
    spread = np.repeat(
        [diagnosis.compared.spread(index, block.name) for block in form.blocks], [block.size for block in form.blocks]
    )
    sigmas = spread * np.sqrt(np.maximum(variance[at : at + form.size], 0.0))
    sigma = model_term(own.hypothesis, own.theta, sigmas[form.index[number]]).amplitudes
    constants = started(latest.prepared.problem.scene, own.hypothesis.constants)
    return replace(found, sigma=sigma, constants=dict(constants))
