"""A joint diagnosis as JSON, as a model, and in a dozen lines."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from magcal_service.diagnosis.belief import Posterior, posterior
from magcal_service.diagnosis.diagnose import Verdict
from magcal_service.diagnosis.doubts import SURE
from magcal_service.diagnosis.entry import plain
from magcal_service.diagnosis.handover import model_term, noise_of, spin_of
from magcal_service.diagnosis.joint.catalogue import started
from magcal_service.diagnosis.joint.compare import Estimate, Kept, Predicted, Shared, estimate
from magcal_service.diagnosis.joint.diagnose import Alone, JointDiagnosis
from magcal_service.diagnosis.joint.forms import OF_CHANGES, JointHypothesis, joint
from magcal_service.diagnosis.joint.levels import Levels, bias_moved_nt, levels_of_all, levels_of_each
from magcal_service.diagnosis.joint.light import light_lines
from magcal_service.diagnosis.parameters import parameters_of
from magcal_service.diagnosis.problem import Term, amplitude_columns
from magcal_service.diagnosis.rows import account_of
from magcal_service.diagnosis.summary import reason_lines, verdict_line
from magcal_service.diagnosis.words import (
    IN_DOUBT,
    advice,
    agreed,
    chance,
    explained_share,
    listed,
    nameless,
    percent,
    remaining,
)
from magcal_service.model import BIAS, STATE_SIZE, d_matrix
from magcal_service.offline.result_head import JOINT, head
from magcal_service.physics.apply.model_file import ModelTerm, PhysicsModel
from magcal_service.physics.interface import START, Effect, Value, Values
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
        "bias_nt": one.fit.x[BIAS].tolist(),
        "D": d_matrix(one.fit.x[:STATE_SIZE]).tolist(),
        "sigma": {"bias_nt": sigma[BIAS].tolist(), "D": d_matrix(sigma).tolist()},
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
        "rivals": [{"effect": name, "probability": round(p, 6)} for name, p in believed.rivals[:4]],
        "class": list(believed.members),
        "separated_by": effect_of(diagnosis, index).separated_by,
        "driver": form.driver,
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


def effect_of(diagnosis: JointDiagnosis, index: int) -> Effect:
    """The catalogue's entry of a term."""
    name = diagnosis.fit.terms[index].hypothesis.effect
    return next(effect for effect in diagnosis.effects if effect.name == name)


def parameters(diagnosis: JointDiagnosis, index: int) -> Values:
    """The numbers of a term with 1 sigma, without start states; an instant on the clock of its own recording.

    A number that differs between recordings is no better known than it differs.
    """
    term = diagnosis.fit.terms[index]
    form = joint(term)
    found = dict(parameters_of(diagnosis.fit, index, effect_of(diagnosis, index)))
    for number, nonlinear in enumerate(form.nonlinear):
        if nonlinear.role in OF_CHANGES:
            acting = next(k for k, name in enumerate(form.names) if form.acts_on(name))
            own = form.theta_of(acting, term.theta)[number]
            found[nonlinear.name] = replace(found[nonlinear.name], value=np.asarray(own))
    return {
        name: replace(value, sigma=diagnosis.compared.spread(index, name) * value.sigma)
        for name, value in found.items()
        if not name.startswith(START)
    }


def says(diagnosis: JointDiagnosis, index: int) -> str:
    """What a term is, in a sentence with its numbers."""
    form = joint(diagnosis.fit.terms[index])
    sentence = effect_of(diagnosis, index).sentence(parameters(diagnosis, index), form.driver)
    if form.solo:
        return f"In {form.solo}: {sentence}"
    return sentence if form.common else f"In each recording its own, in the order of the recordings: {sentence}"


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
    latest = max(diagnosis.recordings, key=lambda one: one.prepared.problem.scene.origin_ns)
    scene = latest.prepared.problem.scene
    sigma = np.sqrt(np.maximum(np.diagonal(latest.covariance), 0.0))
    terms = [(k, term) for k, term in enumerate(diagnosis.fit.terms) if joint(term).common]
    return PhysicsModel(
        recording=latest.prepared.recording.name,
        origin_ns=scene.origin_ns,
        clock=Clock.UTC if scene.utc else Clock.ELAPSED,
        x=latest.fit.x[:STATE_SIZE],
        sigma=sigma[:STATE_SIZE],
        noise_nt=noise_of(latest.fit, latest.prepared.view.stated_noise_nt),
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


# In words


def sentence(diagnosis: JointDiagnosis) -> str:
    """The verdict in one plain sentence: what is common, and what each recording has itself."""
    if diagnosis.verdict is Verdict.NONE:
        levels = levels_of_all(diagnosis)
        noisier = "noisier_than_stated" in diagnosis.reasons
        return agreed(levels.held_out_nt[1], levels.noise_nt, _field_model_nt(diagnosis), "recordings", noisier=noisier)
    terms = list(enumerate(diagnosis.fit.terms))
    if diagnosis.verdict is Verdict.UNKNOWN:
        doubted = [one.name for one in diagnosis.recordings if one.inspection.open]
        if doubted:
            return f"{IN_DOUBT} It is {listed(doubted)}."
        titles = [effect_of(diagnosis, k).title for k, _ in terms]
        return nameless(diagnosis.unexplained, "", list(dict.fromkeys(titles)))
    common = [_title(diagnosis, k) for k, term in terms if joint(term).common]
    own = [_title(diagnosis, k) for k, term in terms if not joint(term).common and not joint(term).solo]
    alone = [f"in {joint(term).solo} alone: {_title(diagnosis, k)}" for k, term in terms if joint(term).solo]
    parts = [f"{len(diagnosis.recordings)} recordings have in common {listed(common)}"] if common else []
    parts += [f"each recording has numbers of its own for {listed(own)}"] if own else []
    text = "; ".join([*parts, *alone, explained_share(diagnosis.left_share)])
    return f"{text[0].upper()}{text[1:]}."


def _title(diagnosis: JointDiagnosis, index: int) -> str:
    """What a term is; where its name is not sure, the names between which it is open."""
    titles = {effect.name: effect.title for effect in diagnosis.effects}
    name, believed = diagnosis.fit.terms[index].hypothesis.effect, posterior(diagnosis.explained, index)
    alike = [other for other in believed.members if other != name] or [other for other, _ in believed.rivals]
    if believed.own >= SURE or not alike:
        return titles[name]
    return f"{titles[name]} (not told apart from {'; or '.join(titles.get(other, other) for other in alike)})"


def _field_model_nt(diagnosis: JointDiagnosis) -> float | None:
    """rms that the field model may err by [nT], the largest of the recordings; None where that counts in none."""
    errors = [one.baseline.problem.field_error for one in diagnosis.recordings]
    return max((error.rms_nt for error in errors if error is not None), default=None)


def summary(diagnosis: JointDiagnosis, files: Sequence[Path]) -> list[str]:
    """What was found, what is common, how well each recording is predicted, and where the files are."""
    against = advice(diagnosis.reasons, diagnosis.concerned)
    lines = [verdict_line(diagnosis.verdict, diagnosis.reasons), *reason_lines(against), f"  {sentence(diagnosis)}"]
    for index, term in enumerate(diagnosis.fit.terms):
        believed = posterior(diagnosis.explained, index)
        lines.append(f"  {term.hypothesis.effect}: {commonness(diagnosis, index)}; {_sure(believed)}")
        lines.append(f"    {says(diagnosis, index)}")
    lines += [f"  {line}" for line in shared_lines(diagnosis)]
    lines += [f"  {line}" for line in predicted_lines(diagnosis) if diagnosis.fit.terms]
    lines += [f"  {line}" for line in light_lines(diagnosis.recordings, diagnosis.explained)]
    lines += _level_lines(diagnosis)
    if diagnosis.verdict is not Verdict.UNKNOWN or sentence(diagnosis) == IN_DOUBT:  # else the sentence has said it
        lines.append(f"left: {remaining(diagnosis)}")
    lines += ["files: " + ", ".join(str(path) for path in files)] if files else []
    return lines


def _level_lines(diagnosis: JointDiagnosis) -> list[str]:
    """How much better each recording fits by the effects, and all of them."""
    names = [*(one.name for one in diagnosis.recordings), "all"]
    moved = [f"; bias moved by {nt:.1f} nT" if diagnosis.fit.terms else "" for nt in bias_moved_nt(diagnosis)]
    return [
        f"{name}: rms on rows held out of the fit {levels.held_out_nt[0]:.1f} nT recalibrated, "
        f"{levels.held_out_nt[1]:.1f} nT with effects; noise floor {levels.noise_nt:.1f} nT{more}"
        for name, levels, more in zip(
            names, [*levels_of_each(diagnosis), levels_of_all(diagnosis)], [*moved, ""], strict=True
        )
    ]


def _sure(believed: Posterior) -> str:
    others = f"; not told from {', '.join(believed.members[1:])}" if len(believed.members) > 1 else ""
    return f"probability {chance(believed.own)}{others}"


def commonness(diagnosis: JointDiagnosis, index: int) -> str:
    """Whether an effect is common to all recordings."""
    form: JointHypothesis = joint(diagnosis.fit.terms[index])
    if form.solo:
        return f"in {form.solo} alone"
    return "common to all" if form.common else "not common: each recording has numbers of its own"


def shared_lines(diagnosis: JointDiagnosis) -> list[str]:
    """One line for each number: whether the recordings agree in it."""
    return [f"{one.effect} {one.parameter}: {agreement(diagnosis, one)}" for one in diagnosis.compared.shared]


def agreement(diagnosis: JointDiagnosis, one: Shared) -> str:
    """Whether the recordings agree in a number, with the evidence."""
    by_chance = f"probability of the largest difference by chance {percent(one.probability)}"
    if one.agrees:
        return f"shared ({by_chance})"
    if not diagnosis.compared.is_common(one.index):
        return f"not shared ({by_chance})"
    return (
        f"shared, but the recordings differ by more than their sigma ({by_chance}); the others' numbers do "
        f"{percent(diagnosis.compared.kept(one.index))} of what the recordings' own would"
    )


def predicted_lines(diagnosis: JointDiagnosis) -> list[str]:
    """One line for each recording: what the others' numbers do for it."""
    return [f"{one.name}: {prediction(one)}" for one in diagnosis.compared.predicted]


def prediction(one: Predicted) -> str:
    """What the other recordings' numbers do for one, in words."""
    besides = "" if one.without_nt == one.nine_nt else f", {one.without_nt:.0f} with what is not common besides"
    levels = (
        f"{one.nine_nt:.0f} nT with nine errors{besides}, {one.predicted_nt:.0f} predicted, "
        f"{one.own_nt:.0f} by its own fit"
    )
    if one.predicted_nt > one.without_nt:
        return f"{levels}; the others' numbers make it worse"
    if not one.shows:
        return f"{levels}; it shows too little to be predicted"
    return f"{levels}; predicted from the others, {percent(max(one.kept, 0.0))} of its own fit's gain is kept"
