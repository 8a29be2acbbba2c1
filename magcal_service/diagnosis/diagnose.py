"""The pipeline: prepare -> explain -> what is left -> attitude and noise -> verdict.  Each takes the one before."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Final

import numpy as np

from magcal_service.diagnosis.doubts import STANDS_OUT, added_noise_nt, concerned, reasons
from magcal_service.diagnosis.empirical.modelled import Modelled, modelled
from magcal_service.diagnosis.expansion import clean_vectors, where_moved
from magcal_service.diagnosis.explain import Explained, Search
from magcal_service.diagnosis.leftover import Structure, significant, unexplained_share
from magcal_service.diagnosis.misled import Misled
from magcal_service.diagnosis.noise import sensor_noise_nt
from magcal_service.diagnosis.prepare import FEWEST_ROWS, Form, Prepared
from magcal_service.diagnosis.problem import Fit, Term, disturbances, evaluate
from magcal_service.diagnosis.rest import Rest
from magcal_service.diagnosis.rows import made_where
from magcal_service.diagnosis.searching import End, in_form, with_memory, without_names, without_unlikely
from magcal_service.diagnosis.solution import solve
from magcal_service.diagnosis.stages import LEFT, MODELLING, SIMULATING, TURNING, Progress, untold
from magcal_service.model import STATE_SIZE, Array
from magcal_service.physics.acting import ActsOn
from magcal_service.physics.catalogue import catalogue, held_at
from magcal_service.physics.effects import coloured_noise, nutation, spin_rate
from magcal_service.physics.held import HeldAt
from magcal_service.physics.interface import UNLISTED, Effect, Finding
from magcal_service.physics.scene.steady_spin import SpinSolution, Turn, solve_spin
from magcal_service.recordings.inspect.inspection import Inspection, inspect
from magcal_service.recordings.recording import Recording
from magcal_service.trust.reasons import Reason

COLOURED_NOISE, NUTATION, SPIN_RATE = (module.EFFECT.name for module in (coloured_noise, nutation, spin_rate))

UNKNOWN_SHARE: Final = 0.2
"""Of the mismatch: as long as less is left unexplained, the named effects are the explanation."""


_OF_A_PATTERN: Final = 0.5
"""What noise with a memory leaves to a guessed pattern beside it, for what that is not exact in has one, too."""


class Verdict(StrEnum):
    """What a diagnosis comes to."""

    NONE = "none"
    NAMED = "named"
    UNKNOWN = "unknown"


@dataclass(frozen=True, slots=True, eq=False)
class Diagnosis:
    """Everything that was found.

    Parameters
    ----------
    inspection: what is wrong with the recording itself.
    prepared: recording, problem and the nine errors alone.
    explained: with effects.
    findings: effects seen in samples, attitude or noise, by name.
    left: structures that are left, best first.
    unexplained: share of the mismatch that no effect explains, 0 where nothing significant is left.
    verdict, trusted, reasons: what it comes to, and what speaks against believing it.
    spin: the turn of the craft after the fit.
    simulation_x: nine errors (9,) of the simulation; of none, as calibrated on the first half of the recording.
    simulation_residual_nt: the residual under them [nT].
    whitening: autoregressive coefficients of the noise, empty where it is white.
    seconds: what it took.
    refused: forms of the residual that the attitude did not bear out.
    rest: what lasts beside the names; None where the noise has a memory, which lasts by itself.
    modelled: what has no name as curves over drivers; None where nothing is left, or no curve helps.
    has_simulation: whether a simulation was given.
    """

    inspection: Inspection
    prepared: Prepared
    explained: Explained
    search: Search
    findings: Mapping[str, Finding]
    left: tuple[Structure, ...]
    unexplained: float
    verdict: Verdict
    reasons: tuple[str, ...]
    spin: SpinSolution | None
    simulation_x: Array
    simulation_residual_nt: Array
    whitening: Array
    effects: tuple[Effect, ...]
    seconds: float
    refused: tuple[Form, ...] = ()
    rest: Rest | None = None
    modelled: Modelled | None = None
    has_simulation: bool = False

    @property
    def memory_nt(self) -> float | None:
        """rms of the noise with its memory [nT], where that is more than ``noise_nt``; None where it is white, or the
        memory may be that of what has no name."""
        has_one = len(self.whitening) > 0 and self.verdict is not Verdict.UNKNOWN
        return self.fit.rms_nt if has_one and self.fit.rms_nt > self.noise_nt else None

    @property
    def left_share(self) -> float:
        """Of the mismatch, what is left beside the names: in a shape, or lasting without one."""
        return max(self.unexplained, 0.0 if self.rest is None else self.rest.share)

    @property
    def may_last(self) -> float:
        """Of the mismatch, what cannot be excluded to last beside the names."""
        return 0.0 if self.rest is None else self.rest.unsafe_share

    @property
    def added_noise_nt(self) -> float:
        """Noise that was found on top of the sensor's own, as by rounding [nT per axis]."""
        return added_noise_nt(self.findings)

    @property
    def misled(self) -> Misled:
        """How far off a calibration without the effects puts vectors."""
        return Misled.of(self.prepared.baseline, self.fit)

    @property
    def concerned(self) -> Mapping[str, tuple[str, ...]]:
        """The effects that a reason is about, by the reason."""
        return concerned(self.explained, self.findings)

    @property
    def made_where(self) -> list[str]:
        """What is only guessed, or was not used, of where the recording was made."""
        return made_where(self.prepared)

    @property
    def usable(self) -> Modelled | None:
        """Curves without a name that may be used elsewhere."""
        return self.modelled if self.modelled is not None and self.modelled.is_usable else None

    @property
    def handed_over(self) -> Fit:
        """The fit whose numbers are in ``physics.toml``: with what has no name, where that is in it."""
        return self.fit if self.usable is None else self.usable.fit

    @property
    def noise_nt(self) -> float:
        """The sensor's noise beside all that was found, 1 sigma per axis [nT]."""
        return sensor_noise_nt(self.handed_over, self.prepared.view.stated_noise_nt)

    @property
    def trusted(self) -> bool:
        """Whether the result may be acted on."""
        return not self.reasons

    @property
    def fit(self) -> Fit:
        """Nine errors and effects."""
        return self.explained.fit

    @property
    def held_at(self) -> tuple[HeldAt, ...]:
        """At which temperature the nine errors hold, where an effect follows one."""
        return held_at(term.hypothesis for term in self.fit.terms)


def diagnose(
    recording: Recording,
    simulation_x: Array | None = None,
    effects: tuple[Effect, ...] | None = None,
    progress: Progress = untold,
    inspection: Inspection | None = None,
) -> Diagnosis:
    """Compare a recording with its simulation and find what was left out.

    Rows that are certainly none are left out before; while something has to be answered about the recording itself,
    no physics is named.

    Parameters
    ----------
    recording: any recording.
    simulation_x: nine errors (9,) of the simulation to compare with; None: the forward model as calibrated on the
        first half of the recording.
    effects: the catalogue; a test may pass its own.
    progress: is called with which of ``stages.STEPS`` begins.
    inspection: what was found on the recording, where that is known already.
    """
    began = time.monotonic()
    inspection = inspect(recording) if inspection is None else inspection
    effects = () if inspection.open else catalogue() if effects is None else effects
    rows = inspection.to_diagnose
    progress(SIMULATING)
    first = _on_rows(rows, inspection, effects, simulation_x, progress)
    comes_and_goes = _comes_and_goes(first)
    if not comes_and_goes:
        return replace(first, seconds=time.monotonic() - began)
    between = np.ones(len(rows), dtype=bool)
    for one in comes_and_goes.values():
        if one.spoiled is not None:
            between &= ~np.isin(rows.time_ns, first.prepared.recording.time_ns[one.spoiled])
    if np.count_nonzero(between) < FEWEST_ROWS:
        return replace(first, seconds=time.monotonic() - began)
    again = _on_rows(rows.select(between), inspection, effects, simulation_x, progress, comes_and_goes)
    if again.verdict is Verdict.UNKNOWN:
        return replace(first, seconds=time.monotonic() - began)
    left_out = {**again.prepared.left_out, "in_pulses": len(rows) - int(between.sum())}
    return replace(
        again,
        prepared=replace(again.prepared, left_out=left_out),
        seconds=time.monotonic() - began,
    )


def _comes_and_goes(diagnosis: Diagnosis) -> dict[str, Finding]:
    """Effects of the field that show by when they act, beside the names, where the recording is in no doubt."""
    prepared, fit = diagnosis.prepared, diagnosis.fit
    if diagnosis.inspection.open or prepared.problem.is_vector:
        return {}
    view = replace(prepared.view, scene=fit.problem.scene, residual_nt=fit.residual)
    found = {}
    for effect in diagnosis.effects:
        finding = effect.find(view) if effect.find is not None and effect.acts_on is ActsOn.FIELD else None
        if finding is not None:
            found[effect.name] = finding
    return found


def _on_rows(
    rows: Recording,
    inspection: Inspection,
    effects: tuple[Effect, ...],
    simulation_x: Array | None,
    progress: Progress,
    beside: Mapping[str, Finding] | None = None,
) -> Diagnosis:
    """The diagnosis of some rows of an inspected recording; ``beside``: what was found on the others."""
    began = time.monotonic()
    prepared, search, explained, refused = in_form(rows, effects, progress)
    progress(LEFT)
    end = with_memory(prepared, search, explained, progress).with_left(prepared.baseline)
    end = without_names(without_unlikely(end, prepared), prepared)
    progress(TURNING)
    findings, spin = _other_findings(prepared, end, effects)
    findings |= beside or {}
    unexplained = unexplained_share(prepared.baseline, end.explained.fit, end.left)
    verdict = verdict_of(end.explained, findings, unexplained)
    if verdict is Verdict.UNKNOWN:
        findings.pop(COLOURED_NOISE, None)  # the memory may be that of what has no name
    stated = prepared.view.stated_noise_nt is not None
    far_off = prepared.has_reference_far_off
    against = reasons(end.explained, unexplained, verdict is Verdict.UNKNOWN, stated, end.rest, findings, far_off)
    simulated = _simulation(prepared, simulation_x)
    return Diagnosis(
        inspection=inspection,
        prepared=prepared,
        explained=end.explained,
        search=end.search,
        findings=findings,
        left=tuple(end.left),
        unexplained=unexplained,
        verdict=verdict,
        reasons=_doubts(inspection) + against,
        spin=spin,
        simulation_x=simulated[0],
        simulation_residual_nt=simulated[1],
        whitening=end.whitening,
        effects=effects,
        seconds=time.monotonic() - began,
        refused=refused,
        rest=end.rest,
        modelled=_modelled(end, against, inspection, spin, progress),
        has_simulation=simulation_x is not None,
    )


def _modelled(
    end: End, against: tuple[str, ...], inspection: Inspection, spin: SpinSolution | None, progress: Progress
) -> Modelled | None:
    """Curves over drivers where too much has no name; while the recording itself is in doubt nothing is modelled."""
    if inspection.open or not {"unexplained_structure", "mismatch_lasts"} & set(against):
        return None
    progress(MODELLING)
    return modelled(end.search, end.explained.fit, end.floor_nt, with_sun=spin is not None)


def _other_findings(
    prepared: Prepared, end: End, effects: tuple[Effect, ...]
) -> tuple[dict[str, Finding], SpinSolution | None]:
    """Effects in attitude and noise, with the field's effects subtracted, and the reference where they have moved it;
    those in the samples are there already."""
    findings, fit, coloured = dict(prepared.findings), end.explained.fit, len(end.whitening) > 0
    view, scene = prepared.view, prepared.problem.scene
    spin = prepared.spin
    if spin is not None and fit.terms:
        scene = where_moved(scene, clean_vectors(fit).moved_s)
        length = np.linalg.norm(fit.calibrated_nt, axis=1)
        clean = fit.calibrated_nt * (scene.magnitude_nt / np.maximum(length, 1.0))[:, None]
        spin = solve_spin(replace(scene, calibrated_nt=clean), view.nominal_axis, view.nominal_rate_rad_s) or spin
        scene = replace(scene, calibrated_nt=clean)
    if not prepared.problem.is_vector:
        view = replace(view, scene=scene, residual_nt=fit.residual, spin=spin)
        # how a craft turns is only doubted where somebody said how it does
        wanted = (*([ActsOn.ATTITUDE] if view.nominal_axis is not None else []), *([ActsOn.NOISE] if coloured else []))
        for effect in effects:
            if effect.find is None or effect.acts_on not in wanted:
                continue
            finding = effect.find(view)
            if finding is not None and effect.name == NUTATION and view.turn is not None:
                finding = _beside_disturbances(finding, prepared, fit, end.left, view.turn)
            if finding is not None:
                findings[effect.name] = finding
    if COLOURED_NOISE in findings:
        findings[COLOURED_NOISE] = _beside_a_pattern(findings[COLOURED_NOISE], fit.terms)
    if NUTATION in findings and SPIN_RATE in findings and _is_coning(findings):
        del findings[SPIN_RATE]
    return findings, spin


def _beside_a_pattern(noise: Finding, terms: Sequence[Term]) -> Finding:
    """Noise with a memory, which may as well be what a free form by a guessed driver leaves."""
    patterns = [term.hypothesis for term in terms if term.hypothesis.is_free and term.hypothesis.is_inferred]
    return replace(noise, rivals=((patterns[0].effect, _OF_A_PATTERN),)) if patterns else noise


def _is_coning(findings: Mapping[str, Finding]) -> bool:
    """Whether a steady rate differs from the stated one by no more than coning makes of it, or its sigma allows."""
    rate, angle = findings[SPIN_RATE].parameters, findings[NUTATION].parameters["angle_deg"].value
    if "nominal_rpm" not in rate:
        return False
    nominal, found = float(rate["nominal_rpm"].value), rate["rate_rpm"]
    made = 2.0 * (1.0 - np.cos(np.radians(float(angle)))) * abs(nominal)
    return bool(abs(float(found.value) - nominal) < made + STANDS_OUT * float(found.sigma))


def _beside_disturbances(
    nutation: Finding, prepared: Prepared, fit: Fit, left: Sequence[Structure], turn: Turn
) -> Finding | None:
    """A nutation, doubted by what disturbs the vectors anyway, of which the residual sees one part only; None where it
    is no larger.

    A body field turns the vector by its parts across it, which no scalar residual bounds: a field of the same rms in
    every direction as what the residual has along it is taken for granted, or that of the effects found, or the usual
    error of a field model.  Across it may be larger by chance, hence the doubt: the square of its share.
    """
    turned_nt = np.tan(np.radians(float(nutation.parameters["angle_deg"].value))) * np.mean(turn.across_nt)
    body, _ = disturbances(fit.terms, fit.problem.scene)
    excess_nt2 = max(prepared.baseline.rms_nt**2 - prepared.problem.noise_nt**2, 0.0)
    left_nt2 = max((one.squares / len(fit.residual) for one in left[:1] if significant(one)), default=0.0)
    error = fit.problem.field_error
    model_nt2 = 0.0 if error is None else error.usual_nt**2
    disturbed_nt2 = max(float((body**2).sum(axis=1).mean()), 3.0 * max(excess_nt2, left_nt2), model_nt2)
    share = disturbed_nt2 / max(float(turned_nt**2), 1e-300)
    return None if share > 1.0 else replace(nutation, rivals=((UNLISTED, share**2),))


def verdict_of(explained: Explained, findings: Mapping[str, Finding], unexplained: float) -> Verdict:
    """What it comes to: effects that were fitted, effects seen in the samples by name, and the share without a name."""
    if unexplained > UNKNOWN_SHARE:
        return Verdict.UNKNOWN
    named = explained.fit.terms or any(name != COLOURED_NOISE for name in findings)  # noise explains no mismatch
    return Verdict.NAMED if named else Verdict.NONE


def _doubts(inspection: Inspection) -> tuple[str, ...]:
    """What speaks against the recording itself."""
    return (str(Reason.RECORDING_DOUBTFUL),) if inspection.open else ()


def _simulation(prepared: Prepared, given: Array | None) -> tuple[Array, Array]:
    """Nine errors of the simulation and its residual: those given, or as calibrated on the first half."""
    problem = prepared.problem
    if given is not None:
        x = np.concatenate([given, prepared.baseline.x[STATE_SIZE:]])
        return given, evaluate(problem, x, (), derivatives=False).residual
    half = len(problem.scene) // 2
    scene = problem.scene
    first = replace(
        scene,
        time_s=scene.time_s[:half],
        field_nt=scene.field_nt[:half],
        calibrated_nt=scene.calibrated_nt[:half],
        clean_field_nt=scene.clean_field_nt[:half],
        undisturbed_nt=None,
        magnitude_nt=scene.magnitude_nt[:half],
        reference_eci_nt=None,
        position_ecef_km=None,
        channels={},
        body_from_eci=None,
    )
    room = None if problem.room_from_body is None else problem.room_from_body[:half]
    aimed = None if problem.aimed is None else problem.aimed.part(half)
    alone = replace(problem, scene=first, room_from_body=room, field_error=None, aimed=aimed)
    x = solve(alone, prepared.baseline.x).x
    return x[:STATE_SIZE], evaluate(problem, x, (), derivatives=False).residual
