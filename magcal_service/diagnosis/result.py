"""A diagnosis as the contract's entries: effects with probability, rivals, class, driver, parameters and where."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from magcal_service.diagnosis.belief import posterior
from magcal_service.diagnosis.diagnose import Diagnosis, Verdict
from magcal_service.diagnosis.leftover import fitted_terms, significant
from magcal_service.diagnosis.locate import Place, locate
from magcal_service.diagnosis.problem import Fit, Term, free_numbers
from magcal_service.diagnosis.screen import ACCEPTED_NATS, Candidate
from magcal_service.model import BIAS, STATE_SIZE, Array, d_matrix
from magcal_service.physics.acting import ActsOn
from magcal_service.physics.interface import Effect, Finding, Value, Values, value_of

_LEAST_PROBABILITY: Final = 1e-4
"""Probability below which a rival is not listed, but for the best: what has less changes no decision."""

_MOST_RIVALS: Final = 4
"""Rivals listed for an effect; choice: beyond the class itself they are for orientation."""


@dataclass(frozen=True, slots=True, eq=False)
class Entry:
    """One effect as it is reported.

    Parameters
    ----------
    effect, says, driver, variant: what, in a sentence, by what, in which form.
    probability: of this effect against its rivals.
    rivals: (effect, probability), most probable first.
    members: names that this recording cannot tell apart, the effect's own included.
    separated_by: the observation that would tell them apart, or what would confirm the effect.
    parameters: with sigma and unit.
    where: the contract's place: time_s, axis, frequency_hz, share_of_mismatch.
    nats: evidence over its absence.
    constants: what belongs to the form.
    seen_in_blocks: blocks of the recording that gain by it, of those that should; empty for what is no field.
    """

    effect: str
    says: str
    driver: str
    variant: str
    probability: float
    rivals: tuple[tuple[str, float], ...]
    members: tuple[str, ...]
    separated_by: str
    parameters: Values
    where: Mapping[str, Any]
    nats: float
    constants: Mapping[str, float]
    seen_in_blocks: tuple[int, ...] = ()

    def as_json(self) -> dict[str, Any]:
        """The contract's object."""
        return {
            "effect": self.effect,
            "says": self.says,
            "probability": round(self.probability, 6),
            "rivals": [{"effect": name, "probability": round(p, 6)} for name, p in self.rivals],
            "class": list(self.members),
            "separated_by": self.separated_by,
            "driver": self.driver,
            "variant": self.variant,
            "parameters": {
                name: {"value": _plain(v.value), "sigma": _plain(v.sigma), "unit": v.unit}
                for name, v in self.parameters.items()
            },
            "where": dict(self.where),
            "evidence_nats": round(self.nats, 2),
            "seen_in_blocks": list(self.seen_in_blocks),
        }


def _plain(values: Array) -> Any:
    """Numbers as JSON takes them; NaN as null."""
    if values.ndim == 0:
        return float(values) if math.isfinite(float(values)) else None
    return [_plain(np.asarray(part)) for part in values]


def entries(diagnosis: Diagnosis) -> tuple[Entry, ...]:
    """Effects in the residual by the share of the mismatch that they explain, then those in attitude and noise."""
    fields = [_of_term(diagnosis, index) for index in range(len(diagnosis.fit.terms))]
    acts_on = {effect.name: effect.acts_on for effect in diagnosis.effects}
    samples = [_of_finding(diagnosis, name) for name in diagnosis.findings if acts_on[name] is ActsOn.SAMPLES]
    others = [_of_finding(diagnosis, name) for name in diagnosis.findings if acts_on[name] is not ActsOn.SAMPLES]

    def by_share(entry: Entry) -> float:
        return -float(entry.where["share_of_mismatch"])

    # a craft that nutates has a rate that seems to change, too: attitude first, by name
    order = [name for kind in (ActsOn.ATTITUDE, ActsOn.NOISE) for name, acts in acts_on.items() if acts is kind]
    named = sorted([*fields, *samples], key=by_share) + sorted(others, key=lambda e: order.index(e.effect))
    if diagnosis.verdict is Verdict.UNKNOWN:
        return (_unknown(diagnosis), *named)
    return tuple(named)


def _effect(diagnosis: Diagnosis, name: str) -> Effect:
    return next(effect for effect in diagnosis.effects if effect.name == name)


def _of_term(diagnosis: Diagnosis, index: int) -> Entry:
    fit, term = diagnosis.fit, diagnosis.fit.terms[index]
    effect = _effect(diagnosis, term.hypothesis.effect)
    parameters = parameters_of(fit, index, effect)
    believed = posterior(diagnosis.explained, index)
    rivals = [pair for pair in believed.rivals if pair[1] >= _LEAST_PROBABILITY or pair is believed.rivals[0]]
    return Entry(
        effect=effect.name,
        says=effect.sentence(parameters, term.hypothesis.driver),
        driver=term.hypothesis.driver,
        variant=term.hypothesis.variant,
        probability=believed.own,
        rivals=tuple(rivals[:_MOST_RIVALS]),
        members=believed.members,
        separated_by=effect.separated_by,
        parameters=parameters,
        where=_where_of_term(diagnosis, index),
        nats=diagnosis.explained.nats[index],
        constants=term.hypothesis.constants,
        seen_in_blocks=(diagnosis.explained.gains[index].seen, diagnosis.explained.gains[index].expected),
    )


def parameters_of(fit: Fit, index: int, effect: Effect) -> Values:
    """Amplitudes by block, nonlinear numbers, constants and what is derived, each with 1 sigma."""
    term = fit.terms[index]
    sigma = np.sqrt(np.maximum(np.diagonal(fit.covariance), 0.0))
    at = fit.problem.size + sum(t.hypothesis.size for t in fit.terms[:index])
    found: dict[str, Value] = {}
    used = 0
    for block in term.hypothesis.blocks:
        part = slice(at + used, at + used + block.size)
        values = term.amplitudes[used : used + block.size].reshape(block.shape)
        found[block.name] = value_of(values, sigma[part].reshape(block.shape), block.unit)
        used += block.size
    free = fit.linear_size + sum(len(free_numbers(t)) for t in fit.terms[:index])
    moving = free_numbers(term)
    for number, nonlinear in enumerate(term.hypothesis.nonlinear):
        if number in moving:
            error = float(sigma[free + moving.index(number)])
        elif nonlinear.role == "instant":
            error = _instant_sigma(fit, term)
        else:
            error = math.nan
        found[nonlinear.name] = value_of(float(term.theta[number]), error, nonlinear.unit)
    for name, constant in term.hypothesis.constants.items():
        found.setdefault(name, value_of(constant, math.nan, effect.units.get(name, "1")))
    return {**found, **effect.derived(found)}


def _instant_sigma(fit: Fit, term: Term) -> float:
    """1 sigma of a change time [s]: how far it may move, to either side, before that costs two noise variances.

    A change that shows in few directions cannot be told in time while the field points elsewhere.
    """
    rows = fit.problem.rows(term.hypothesis.columns(np.array([-np.inf])), fit.unit)
    assert rows is not None
    times, at_s = fit.problem.row_time_s, float(term.theta[0])
    spent = np.cumsum((rows @ term.amplitudes) ** 2)
    row = int(np.searchsorted(times, at_s))
    before = float(spent[row - 1]) if row else 0.0
    allowed = 2.0 * fit.rms_nt**2
    first, last = np.searchsorted(spent, [before - allowed, before + allowed])
    last = min(int(last), len(times) - 1)
    return max(0.34 * fit.problem.scene.period_s, at_s - float(times[first]), float(times[last]) - at_s)


def _mismatch(diagnosis: Diagnosis) -> float:
    """Sum of squares that simulation and recording differ by, beyond noise [nT^2]."""
    before, after = diagnosis.prepared.baseline.residual, diagnosis.fit.residual
    explained = max(float(before @ before) - float(after @ after), 1e-9)
    left = diagnosis.left[0].squares if diagnosis.left and significant(diagnosis.left[0]) else 0.0
    return explained + left


def _where_of_term(diagnosis: Diagnosis, index: int) -> dict[str, Any]:
    fit = diagnosis.fit
    plain = replace(diagnosis.search.problem, field_error=None)  # shares are of the residual as it is
    search = replace(diagnosis.search, problem=plain, whitening=np.zeros(0))
    term = fit.terms[index]
    rows = search.rows_of(term.hypothesis, term.theta, fit)
    assert rows is not None
    space = search.workspace(fit, index)
    gain = space.gain(rows, max(fit.white_rms_nt, 1e-3))
    signal = fit.problem.rows(term.hypothesis.columns(term.theta), fit.unit)
    assert signal is not None
    scene = fit.problem.scene
    return {
        "time_s": _span(fit, signal @ term.amplitudes),
        "axis": _direction(term, len(scene)),
        "frequency_hz": _lines(fit, signal @ term.amplitudes),
        "share_of_mismatch": round(min(1.0, gain.squares / _mismatch(diagnosis)), 4),
    }


def _span(fit: Fit, signal: Array) -> list[float]:
    """Where nearly all of a signal lies [s]."""
    weight = np.cumsum(signal**2)
    if weight[-1] <= 0.0:
        return [0.0, float(fit.problem.row_time_s[-1])]
    inside = np.searchsorted(weight / weight[-1], [0.001, 0.999])
    times = fit.problem.row_time_s
    first, last = (float(times[min(int(i), len(times) - 1)]) for i in inside)
    return [round(0.0 if first < 0.02 * times[-1] else first, 1), round(last, 1)]


def _direction(term: Term, count: int) -> list[float] | None:
    """Main direction of a body field (3,); None for a reference's error."""
    field = term.hypothesis.columns(term.theta).field(term.amplitudes)
    if not field.any():
        return None
    centred = field - field.mean(axis=0)
    source = centred if float((centred**2).sum()) > 1e-6 * float((field**2).sum()) else field
    _, vectors = np.linalg.eigh(source.T @ source)
    axis = vectors[:, 2]
    return [round(float(v), 4) for v in axis * np.sign(axis[np.argmax(np.abs(axis))])]


def _lines(fit: Fit, signal: Array) -> list[float]:
    """The one or two strongest frequencies of a signal [Hz]."""
    scene = fit.problem.scene
    if fit.problem.is_vector or len(signal) < 16:
        return []
    slot = np.rint(scene.time_s / scene.period_s).astype(np.intp)
    grid = np.zeros(int(slot[-1]) + 1)
    grid[slot] = signal - signal.mean()
    power = np.abs(np.fft.rfft(grid)) ** 2
    frequency = np.fft.rfftfreq(len(grid), scene.period_s)
    order = np.argsort(power[1:])[::-1][:2] + 1
    kept = [i for i in order.tolist() if power[i] > 0.25 * power[order[0]]]
    return [float(f"{frequency[i]:.4g}") for i in kept]


def _of_finding(diagnosis: Diagnosis, name: str) -> Entry:
    finding: Finding = diagnosis.findings[name]
    effect = _effect(diagnosis, name)
    end = float(diagnosis.prepared.problem.scene.time_s[-1])
    axis = finding.parameters.get("axis")
    frequency = finding.parameters.get("frequency_hz")
    odds = math.exp(-min(finding.nats, 50.0))
    return Entry(
        effect=name,
        says=effect.sentence(finding.parameters, "none"),
        driver="none",
        variant="",
        probability=1.0 - odds,
        rivals=(),
        members=(name,),
        separated_by=effect.separated_by,
        parameters=finding.parameters,
        where={
            "time_s": list(finding.time_s or (0.0, end)),
            "axis": None if axis is None else _plain(axis.value),
            "frequency_hz": [] if frequency is None else [float(frequency.value)],
            "share_of_mismatch": round(finding.share, 4),
        },
        nats=finding.nats,
        constants={},
    )


def _unknown(diagnosis: Diagnosis) -> Entry:
    """What is left and has no name: where it sits, what it follows, its shape, and the nearest of the catalogue."""
    structure = diagnosis.left[0]
    places = [place for place in locate(diagnosis.search, diagnosis.fit, diagnosis.left) if place.share > 0.0]
    terms = fitted_terms(structure, diagnosis.search, diagnosis.fit)
    nearest = _nearest(diagnosis)
    shape = "; ".join(f"{name}: {size:.1f} nT" for name, size in terms)
    says = f"Something that is in no catalogue is left, most like {structure.shape.says}."
    if diagnosis.inspection.open:
        asked = ", ".join(one.code for one in diagnosis.inspection.open)
        says = f"Recording and reference disagree; no physics is named before the recording is answered for: {asked}."
    if nearest is not None:
        says += f" Nearest is {nearest[0]}, which explains {100.0 * nearest[1]:.0f} % of it."
    where: dict[str, Any] = {
        "time_s": _span(diagnosis.fit, structure.signal),
        "axis": None,
        "frequency_hz": _lines(diagnosis.fit, structure.signal),
        "share_of_mismatch": round(diagnosis.unexplained, 4),
        "correlates_with": [place.as_json() for place in places[:6]],
        "fitted_shape": shape or structure.shape.name,
        "nearest": None if nearest is None else {"effect": nearest[0], "explains": round(nearest[1], 4)},
    }
    return Entry(
        effect="unknown",
        says=says,
        driver="none",
        variant=structure.shape.name,
        probability=1.0 - math.exp(-min(structure.nats, 50.0)),
        rivals=() if nearest is None else ((nearest[0], 0.0),),
        members=("unknown",),
        separated_by="record more telemetry beside the magnetometer, and switch one suspect at a time",
        parameters={},
        where=where,
        nats=structure.nats,
        constants={},
    )


def _nearest(diagnosis: Diagnosis) -> tuple[str, float] | None:
    """The effect of the catalogue that would explain most of what is left, and how much of it."""
    fit, search = diagnosis.fit, diagnosis.search
    present = {term.hypothesis.effect for term in fit.terms}
    space = search.workspace(fit)
    ranked = search.screen(space, fit, max(fit.white_rms_nt, 1e-3), sorted(present))
    if not ranked or ranked[0].nats < ACCEPTED_NATS:
        return None
    best: Candidate = ranked[0]
    return best.hypothesis.effect, min(1.0, best.gain.squares / max(diagnosis.left[0].squares, 1e-9))


def moved_bias(diagnosis: Diagnosis) -> float:
    """How far the effects that were left out had pulled the bias of a static calibration [nT]."""
    return float(np.linalg.norm(diagnosis.fit.x[BIAS] - diagnosis.prepared.baseline.x[BIAS]))


def held_out_rms(diagnosis: Diagnosis) -> dict[str, float]:
    """rms of the residual on blocks that took no part: as simulated, nine errors fitted anew, with the effects [nT]."""
    simulated = diagnosis.simulation_residual_nt
    return {
        "simulation": float(np.sqrt(np.mean(simulated**2))),
        "recalibrated": diagnosis.prepared.baseline.held_out_rms_nt,
        "with_effects": diagnosis.fit.held_out_rms_nt,
    }


def as_json(diagnosis: Diagnosis, found: Sequence[Entry] | None = None) -> str:
    """The contract's ``diagnosis.json``."""
    found = entries(diagnosis) if found is None else found
    fit, problem = diagnosis.fit, diagnosis.prepared.problem
    sigma = np.sqrt(np.maximum(np.diagonal(fit.covariance)[:STATE_SIZE], 0.0))
    places: Sequence[Place] = locate(diagnosis.search, diagnosis.prepared.baseline)
    content: dict[str, Any] = {
        "verdict": str(diagnosis.verdict),
        "effects": [entry.as_json() for entry in found],
        "fit": {
            "noise_floor_nt": problem.noise_nt,
            "held_out_rms_nt": held_out_rms(diagnosis),
            "bias_nt": fit.x[BIAS].tolist(),
            "D": d_matrix(fit.x[:STATE_SIZE]).tolist(),
            "sigma": {"bias_nt": sigma[BIAS].tolist(), "D": d_matrix(sigma).tolist()},
            "bias_before_nt": diagnosis.prepared.baseline.x[BIAS].tolist(),
            "bias_moved_nt": moved_bias(diagnosis),
        },
        "located": [place.as_json() for place in places],
        "unexplained_share": round(diagnosis.unexplained, 4),
        "rows": dict(diagnosis.prepared.counts),
        "spin": _spin(diagnosis),
        "seconds": round(diagnosis.seconds, 2),
        "converged": fit.converged,
        "trusted": diagnosis.trusted,
        "reasons": list(diagnosis.reasons),
        "findings": [one.to_dict() for one in diagnosis.inspection.findings],
    }
    return json.dumps(content, indent=2, allow_nan=False) + "\n"


def _spin(diagnosis: Diagnosis) -> dict[str, Any] | None:
    spin = diagnosis.spin
    if spin is None:
        return None
    return {
        "axis_body": spin.axis_body.tolist(),
        "axis_eci": spin.axis_eci.tolist(),
        "rate_rpm": spin.rate_rpm,
    }
