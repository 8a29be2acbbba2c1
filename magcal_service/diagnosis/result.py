"""A diagnosis as the contract's entries: effects with probability, rivals, class, driver, parameters and where."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from magcal_service.diagnosis.belief import posterior, unlisted
from magcal_service.diagnosis.cycle import CYCLE
from magcal_service.diagnosis.diagnose import Diagnosis, Verdict
from magcal_service.diagnosis.entry import Entry, listed_rivals, plain
from magcal_service.diagnosis.first import why_first
from magcal_service.diagnosis.leftover import fitted_terms
from magcal_service.diagnosis.locate import locate
from magcal_service.diagnosis.nearest import Nearest
from magcal_service.diagnosis.parameters import of_each_axis, parameters_of
from magcal_service.diagnosis.searching import FLOOR
from magcal_service.diagnosis.separation import separations, switched_off
from magcal_service.diagnosis.signals import strongest_signal
from magcal_service.diagnosis.wander import TWO_LEVELS
from magcal_service.diagnosis.where import lines, span, where_of_term
from magcal_service.diagnosis.which_driver import drivers_of
from magcal_service.diagnosis.words import percent
from magcal_service.model import BIAS
from magcal_service.physics.acting import ActsOn
from magcal_service.physics.interface import UNLISTED, Effect, Finding


def entries(diagnosis: Diagnosis) -> tuple[Entry, ...]:
    """Effects in the residual by the share of the mismatch that they explain, then those in attitude and noise.

    What has no name stands among them by its share, where it is the verdict.
    """
    fields = [_of_term(diagnosis, index) for index in range(len(diagnosis.fit.terms))]
    acts_on = {effect.name: effect.acts_on for effect in diagnosis.effects}
    beside = (ActsOn.ATTITUDE, ActsOn.NOISE)
    samples = [_of_finding(diagnosis, name) for name in diagnosis.findings if acts_on[name] not in beside]
    others = [_of_finding(diagnosis, name) for name in diagnosis.findings if acts_on[name] in beside]

    def by_share(entry: Entry) -> float:
        return -float(entry.where["share_of_mismatch"])

    # a craft that nutates has a rate that seems to change, too: attitude first, by name
    order = [name for kind in beside for name, acts in acts_on.items() if acts is kind]
    unknown = [_unknown(diagnosis)] if diagnosis.verdict is Verdict.UNKNOWN else []
    by_size = sorted([*unknown, *fields, *samples], key=by_share)
    return (*by_size, *sorted(others, key=lambda e: order.index(e.effect)))


def _effect(diagnosis: Diagnosis, name: str) -> Effect:
    return next(effect for effect in diagnosis.effects if effect.name == name)


def _of_term(diagnosis: Diagnosis, index: int) -> Entry:
    fit, term = diagnosis.fit, diagnosis.fit.terms[index]
    effect = _effect(diagnosis, term.hypothesis.effect)
    parameters = {**parameters_of(fit, index, effect), **of_each_axis(fit, index, effect)}
    believed = posterior(diagnosis.explained, index)
    where = where_of_term(diagnosis, index)
    driver = term.hypothesis.driver
    drivers = () if driver == "none" else drivers_of(diagnosis.explained, index)
    return Entry(
        effect=effect.name,
        says=effect.sentence(parameters, driver, [other for other, _ in drivers if other != driver]),
        driver=driver,
        variant=term.hypothesis.variant,
        probability=believed.own,
        rivals=listed_rivals(believed.rivals, believed.members),
        members=believed.members,
        separated_by=effect.separation(diagnosis.prepared.problem.scene.quantities),
        parameters=parameters,
        where=where,
        nats=diagnosis.explained.nats[index],
        constants=term.hypothesis.constants,
        seen_in_blocks=(diagnosis.explained.gains[index].seen, diagnosis.explained.gains[index].expected),
        measure=separations(diagnosis, index, believed.members),
        drivers=drivers,
        unlisted=unlisted(diagnosis.explained, index),
        as_well=term.hypothesis.exactly_alike,
        why_first=why_first(diagnosis.explained, index),
        record_next=effect.next_record(parameters, driver),
        # of several in one residual; these need not add up to what all of them explain
        extent=f"{percent(float(where['share_of_mismatch']))} of the mismatch comes back in a fit without it",
    )


def _of_finding(diagnosis: Diagnosis, name: str) -> Entry:
    finding: Finding = diagnosis.findings[name]
    effect = _effect(diagnosis, name)
    end = float(diagnosis.prepared.problem.scene.time_s[-1])
    axis = finding.parameters.get("axis")
    frequency = finding.parameters.get("frequency_hz")
    odds = math.exp(-min(finding.nats, 50.0))
    return Entry(
        effect=name,
        says=effect.sentence(finding.parameters, finding.driver),
        driver=finding.driver,
        variant="",
        probability=1.0 - max(odds, finding.doubt),
        rivals=listed_rivals(finding.rivals, (name,)),
        members=(name,),
        separated_by=effect.separation(diagnosis.prepared.problem.scene.quantities),
        parameters=finding.parameters,
        where={
            "time_s": list(finding.time_s or (0.0, end)),
            "axis": None if axis is None else plain(axis.value),
            "frequency_hz": [] if frequency is None else [float(frequency.value)],
            "share_of_mismatch": round(finding.share, 4),
        },
        nats=finding.nats,
        constants={},
        measure=switched_off(effect, finding),
        extent=_extent(effect, finding),
    )


def _extent(effect: Effect, finding: Finding) -> str:
    """How much a finding has a part in: of the samples that it spoils, which are in no fit, no share of a residual."""
    if finding.spoiled is not None:
        return f"{percent(float(finding.spoiled.mean()))} of the samples, which no fit uses"
    if effect.acts_on is ActsOn.NOISE:
        return "a part of the noise, and of no mismatch"
    of = "what the turn differs by" if effect.acts_on is ActsOn.ATTITUDE else "the residual's variance"
    return f"{percent(finding.share)} of {of}"


def _unknown(diagnosis: Diagnosis) -> Entry:
    """What is left and has no name: where it sits, what it follows, its shape, and the nearest of the catalogue."""
    structure = diagnosis.left[0]
    places = [place for place in locate(diagnosis.search, diagnosis.fit, diagnosis.left) if place.share > 0.0]
    terms = fitted_terms(structure, diagnosis.search, diagnosis.fit)
    nearest = None if diagnosis.inspection.open else Nearest.of(diagnosis)
    shape = "; ".join(f"{name}: {size:.1f} nT" for name, size in terms)
    separated_by = "record more telemetry beside the magnetometer, and switch one suspect at a time"
    says = f"Something without a name is left, most like {structure.shape.says}."
    alike = _unrecorded(diagnosis)
    if alike:
        separated_by = "record what every load draws and every coil is commanded, and switch one suspect at a time"
        says += f" It may be {' or '.join(alike)}, driven by what is not recorded."
    if diagnosis.inspection.open:
        asked = ", ".join(one.code for one in diagnosis.inspection.open)
        separated_by = "correct the descriptor, or accept what was found under [inspect]"
        says = f"Recording and reference disagree; no physics is named before the recording is answered for: {asked}."
    if nearest is not None:
        says += f" {nearest}"
    follows = strongest_signal(diagnosis.search, diagnosis.fit, FLOOR * diagnosis.prepared.problem.noise_nt)
    held = 0.0 if follows is None else min(1.0, follows.squares / max(structure.squares, 1e-9))
    if (
        follows is not None
        and follows.says != structure.shape.says
        and held >= (0.0 if nearest is None else nearest.share)
    ):
        says += f" Of one channel's signals {follows.says} does most: {100.0 * held:.0f} %."
    where: dict[str, Any] = {
        "time_s": span(diagnosis.fit, structure.signal),
        "axis": None,
        "frequency_hz": lines(diagnosis.fit, structure.signal),
        "share_of_mismatch": round(diagnosis.unexplained, 4),
        "rms_nt": round(float(np.sqrt(np.mean(structure.signal**2))), 2),
        "correlates_with": [place.as_json() for place in places[:6]],
        "fitted_shape": shape or structure.shape.name,
        "nearest": None if nearest is None else nearest.to_dict(),
    }
    return Entry(
        effect=UNLISTED,
        says=says,
        driver="none",
        variant=structure.shape.name,
        probability=1.0 - math.exp(-min(structure.nats, 50.0)),
        rivals=(),
        members=(UNLISTED, *alike),
        separated_by=separated_by,
        parameters={},
        where=where,
        nats=structure.nats,
        constants={},
        extent=f"{percent(diagnosis.unexplained)} of the mismatch",
    )


def _unrecorded(diagnosis: Diagnosis) -> tuple[str, ...]:
    """The effects that what is left may be without its driver, where it goes between two levels or repeats, and what
    repeats in any shape where there are several of it; else none."""
    shape = diagnosis.left[0].shape.name
    if diagnosis.inspection.open or shape not in (CYCLE, TWO_LEVELS):
        return ()
    named = {term.hypothesis.effect for term in diagnosis.fit.terms}
    may_be = (one for one in diagnosis.effects if one.two_levels or (shape == CYCLE and one.is_line))
    return tuple(effect.name for effect in may_be if effect.name not in named)


def moved_bias(diagnosis: Diagnosis) -> tuple[float, float]:
    """How far the effects that were left out had pulled the bias of a static calibration, with 1 sigma [nT]."""
    moved = diagnosis.fit.x[BIAS] - diagnosis.prepared.baseline.x[BIAS]
    size = float(np.linalg.norm(moved))
    towards = moved / max(size, 1e-300)
    return size, math.sqrt(max(float(towards @ diagnosis.fit.covariance[BIAS, BIAS] @ towards), 0.0))


def held_out_rms(diagnosis: Diagnosis) -> dict[str, float]:
    """rms of the residual on blocks that took no part: as simulated, nine errors fitted anew, with the effects [nT]."""
    simulated = diagnosis.simulation_residual_nt
    return {
        "simulation": float(np.sqrt(np.mean(simulated**2))),
        "recalibrated": diagnosis.prepared.baseline.held_out_rms_nt,
        "with_effects": diagnosis.fit.held_out_rms_nt,
    }
