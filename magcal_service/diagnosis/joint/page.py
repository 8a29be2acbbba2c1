"""A joint diagnosis as one page: what is common, each recording predicted from the others, and the recordings."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import numpy as np

from magcal_service.diagnosis.belief import posterior
from magcal_service.diagnosis.joint.compare import Estimate, Kept, Predicted, Shared
from magcal_service.diagnosis.joint.diagnose import Alone, JointDiagnosis
from magcal_service.diagnosis.joint.levels import Levels, levels_of_each
from magcal_service.diagnosis.joint.light import light_lines
from magcal_service.diagnosis.joint.result import left_share
from magcal_service.diagnosis.joint.words import (
    ONE_ALONE,
    agreement,
    commonness,
    effect_of,
    name_in_words,
    noise_of_one,
    record_next,
    samples_lines,
    says,
    sentence,
    separated_by,
)
from magcal_service.diagnosis.report.frame import Origin, rendered
from magcal_service.diagnosis.rows import account_of
from magcal_service.diagnosis.words import driver_in_words, percent
from magcal_service.model import BIAS
from magcal_service.physics.apply.advice import advice, in_order
from magcal_service.physics.held import held_in_words
from magcal_service.physics.saying import measured

_NOT_SEEN: Final = 1e-3
"""Of its own sigma, the size of a number below which a recording says nothing of it; choice."""

_TEMPLATE: Final = Path(__file__).with_name("page.html")


def report(diagnosis: JointDiagnosis, origin: Origin) -> str:
    """The page as HTML.  Raises ``ExtraMissingError`` without jinja2 or matplotlib."""
    return rendered(
        _TEMPLATE,
        origin,
        diagnosis=diagnosis,
        sentence=sentence(diagnosis),
        advice=in_order(advice(diagnosis.reasons, diagnosis.concerned)),
        one_alone=ONE_ALONE,
        names=[one.name for one in diagnosis.recordings],
        effects=[_effect(diagnosis, index) for index in range(len(diagnosis.fit.terms))],
        samples=samples_lines(diagnosis),
        light=light_lines(diagnosis.recordings, diagnosis.explained),
        predicted=[_predicted(one) for one in diagnosis.compared.predicted if diagnosis.compared.shared],
        recordings=[
            _recording(one, levels) for one, levels in zip(diagnosis.recordings, levels_of_each(diagnosis), strict=True)
        ],
    )


def _effect(diagnosis: JointDiagnosis, index: int) -> dict[str, Any]:
    effect, believed = effect_of(diagnosis, index), posterior(diagnosis.explained, index)
    return {
        "name": effect.name,
        "title": effect.title,
        "says": says(diagnosis, index),
        "commonness": commonness(diagnosis, index),
        "name_is": name_in_words(diagnosis, index),
        "members": ", ".join(believed.members[1:]),
        "separated_by": separated_by(diagnosis, index),
        "record_next": record_next(diagnosis, index),
        "driver": driver_in_words(diagnosis.fit.terms[index].hypothesis.driver),
        "numbers": [_number(diagnosis, one) for one in diagnosis.compared.shared if one.index == index],
    }


def _number(diagnosis: JointDiagnosis, one: Shared) -> dict[str, Any]:
    return {
        "name": one.parameter,
        "unit": "" if one.unit == "1" else one.unit,
        "together": _in_words(one.together),
        "own": [_in_words(each.own) for each in one.each],
        "agrees": one.agrees,
        "agreement": agreement(diagnosis, one),
    }


def _in_words(one: Estimate) -> str:
    pairs = zip(one.value.tolist(), one.sigma.tolist(), strict=True)
    return ", ".join("not seen" if abs(v) < _NOT_SEEN * s else measured(v, s) for v, s in pairs)


def _predicted(one: Predicted) -> dict[str, Any]:
    worse = one.predicted_nt > one.without_nt
    kept = percent(max(one.kept, 0.0)) if one.shows else "shows too little"
    return {
        "name": one.name,
        "nine": f"{one.nine_nt:.0f} nT",
        "without": f"{one.without_nt:.0f} nT",
        "predicted": f"{one.predicted_nt:.0f} nT",
        "own": f"{one.own_nt:.0f} nT",
        "worse": worse,
        "kept": "worse than without them" if worse else kept,
        "effects": ["" if part is None else _share(part) for part in one.effects],
    }


def _share(part: Kept) -> str:
    """What is kept of one effect, in words."""
    if not part.is_seen:
        return "not seen"
    return "worse than without it" if part.share < 0.0 else percent(part.share)


def _recording(one: Alone, levels: Levels) -> dict[str, Any]:
    sigma = np.sqrt(np.maximum(np.diagonal(one.covariance), 0.0))[BIAS].tolist()
    bias = ", ".join(measured(value, s) for value, s in zip(one.fit.x[BIAS].tolist(), sigma, strict=True))
    bias += f", at {held_in_words(one.held_at)}" if one.held_at else ""
    share = left_share(one)
    return {
        "name": one.name,
        "rows": str(account_of(one.inspection, one.prepared)),
        "noise": noise_of_one(one),
        "before": f"{levels.held_out_nt[0]:.0f} nT",
        "after": f"{levels.held_out_nt[1]:.0f} nT",
        "bias": bias if one.has_coverage else f"{bias}: not fixed, the field pointed in too few directions",
        "left": percent(share) if share > 0.0 else "nothing in a shape that could be told",
    }
