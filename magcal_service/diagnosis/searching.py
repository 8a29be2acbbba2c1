"""The search of a diagnosis, under the noise that the recording needs.

In the form of residual that says most; with the field model's errors as large as they have to be; and on a residual
whitened by the memory of its noise where it has one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from magcal_service.diagnosis.belief import are_rather_unlisted, with_left
from magcal_service.diagnosis.blocks import correlation_samples
from magcal_service.diagnosis.collapse import is_collapsed
from magcal_service.diagnosis.doubts import is_beyond_model
from magcal_service.diagnosis.explain import Explained, Search
from magcal_service.diagnosis.field_error import SCALES, FieldError, Scale
from magcal_service.diagnosis.field_level import at_scale, likeliest, needed_scale
from magcal_service.diagnosis.leftover import Structure, significant, structures, with_courses
from magcal_service.diagnosis.lines import is_red
from magcal_service.diagnosis.nameless import standing
from magcal_service.diagnosis.prepare import Form, Prepared, prepare
from magcal_service.diagnosis.problem import Fit, Problem
from magcal_service.diagnosis.records import from_records
from magcal_service.diagnosis.reference_off import is_too_far_off
from magcal_service.diagnosis.rest import Rest
from magcal_service.diagnosis.rivals import is_recorded
from magcal_service.diagnosis.screen import ACCEPTED_NATS, hypotheses_of
from magcal_service.diagnosis.signals import strongest_signal
from magcal_service.diagnosis.solution import solve
from magcal_service.diagnosis.stages import Progress, untold
from magcal_service.model import Array
from magcal_service.physics.effects.coloured_noise import autoregression, is_noise, long_memory
from magcal_service.physics.interface import Effect
from magcal_service.recordings.recording import Recording

_LONGEST_MEMORY: Final = 20.0
"""Samples over which noise may remember itself: a correlation of 0.9 from one to the next.  What lasts longer is
structure, until physics and shapes without a name have had their turn."""

_MOST_LASTS: Final = 0.5
"""Share of what lasts from sample to sample, from which on names leave the most of it: they hardly explain what is
there, and change its looks."""

_MUCH_WORSE: Final = 1.2
"""Times what magnitudes are left with, or the noise, from which on whole vectors are doubted: a sound attitude leaves
the same to a few per cent."""

FLOOR: Final = 0.3
"""Of the noise stated, the least that evidence is counted in: more is noise, however well a fit follows it."""

LOWER: Final = 0.3
"""Of that, where the noise is whitened by its memory: what is left of it then may be so much less."""


@dataclass(frozen=True, slots=True, eq=False)
class End:
    """What a search ends with.

    Parameters
    ----------
    search: the last one.
    explained: with the effects that stand.
    left: structures that are left, best first.
    floor_nt: least noise that evidence was counted in [nT].
    whitening: autoregressive coefficients (p,) of the noise, empty where it is white.
    rest: what lasts beside the effects; None where the noise has a memory.
    """

    search: Search
    explained: Explained
    left: list[Structure]
    floor_nt: float
    whitening: Array
    rest: Rest | None = None

    def with_left(self, baseline: Fit) -> End:
        """The same, with what is left beside the effects of a fit whose nine errors alone are ``baseline``."""
        rest = None if len(self.whitening) else Rest.of(baseline, self.explained.fit)
        left_nt2 = self.left[0].squares if self.left and significant(self.left[0]) else 0.0
        return replace(self, rest=rest, explained=with_left(self.explained, left_nt2, rest, self.floor_nt))


def without_names(end: End, prepared: Prepared) -> End:
    """The same, or what is left under the errors of the field model that suit the nine errors best, where no name has
    stood: those that it was searched under suited the names.  Errors beyond what field models have suit anything."""
    error = end.search.problem.field_error
    if error is None or end.explained.fit.terms or len(end.whitening) or not significant(end.left[0]):
        return end
    scale = prepared.alone or likeliest(end.search.problem, error, end.explained.fit.x)[0]
    if scale.is_within(error.scale):
        return end
    problem = at_scale(end.search.problem, error, scale)
    search = replace(end.search, problem=problem, close=set(end.search.close))
    fit = search.refreshed(solve(problem, end.explained.fit.x))
    if is_beyond_model(fit):
        return end
    return _nameless(end, prepared, search, fit)


def without_unlikely(end: End, prepared: Prepared) -> End:
    """The same, or without any name where a cause in no catalogue is likelier than every one of them, and is seen then:
    what it is most like is told without names that take up parts of it.

    Parameters
    ----------
    end: with what is left beside its names.
    prepared: as it was searched.
    """
    if not are_rather_unlisted(end.explained):
        return end
    search = replace(end.search, close=set(end.search.close))
    fit = search.refreshed(solve(search.problem, prepared.baseline.x))
    found = _nameless(end, prepared, search, fit)
    return found if significant(found.left[0]) else end


def _nameless(end: End, prepared: Prepared, search: Search, fit: Fit) -> End:
    """An end without names: what is left beside the nine errors of a fit that a search stands at."""
    phase = None if prepared.spin is None else prepared.spin.phase_rad
    explained, left = _standing(search, prepared.baseline, Explained(fit), phase, end.floor_nt)
    return replace(end, search=search, explained=explained, left=left).with_left(prepared.baseline)


def in_form(
    recording: Recording, effects: tuple[Effect, ...], progress: Progress = untold
) -> tuple[Prepared, Search, Explained, tuple[Form, ...]]:
    """A search in the form of residual that says most, and the forms that the attitude does not bear out.

    Whole vectors show what the attitude errs by, magnitudes nothing of that.  So where vectors are left with more than
    noise, magnitudes are searched too, and stand where they are left with clearly less; or where the reference would be
    off by more than it ever is, as beside an attitude in other axes than the reference's.
    """
    prepared, search, explained = _searched(prepare(recording, effects), effects, progress)
    is_far_off = is_too_far_off(explained.fit)
    left_nt = math.inf if is_far_off else _left_nt(explained.fit)
    if prepared.form is Form.SCALAR or left_nt < _MUCH_WORSE * prepared.problem.noise_nt:
        return prepared, search, explained, ()
    others = _searched(prepare(recording, effects, (Form.SCALAR,)), effects, progress)
    scalar = others[2].fit
    if is_collapsed(scalar.x) or left_nt < _MUCH_WORSE * _left_nt(scalar):
        return prepared, search, explained, ()
    agree = is_far_off and _left_nt(explained.fit) < _MUCH_WORSE * _left_nt(scalar)
    return replace(others[0], has_reference_far_off=agree), *others[1:], (prepared.form,)


def _left_nt(fit: Fit) -> float:
    """rms on held-out blocks, rows weighted as the noise is [nT]; of vectors that along the field, if it is more.

    Along the field an attitude's own noise does not show; what it errs by slowly draws the nine errors away there.
    """
    whole = float(np.sqrt(np.mean(fit.held_out_white**2)))
    if not fit.problem.is_vector:
        return whole
    along = np.einsum("ni,ni->n", fit.unit, fit.held_out_white.reshape(-1, 3))
    return max(whole, float(np.sqrt(np.mean(along**2))))


def _searched(
    prepared: Prepared, effects: tuple[Effect, ...], progress: Progress
) -> tuple[Prepared, Search, Explained]:
    """A search under the field-model errors that the recording needs, and what it was prepared as for it."""
    spin_hz = None if prepared.spin is None else abs(prepared.spin.rate_rad_s) / (2.0 * np.pi)
    usual, taken = prepared.problem.field_error, min(SCALES)
    prepared = _settled(prepared, prepared.problem) if usual is None else _at_scale(prepared, usual, taken)
    alone: tuple[Scale, float] | None = None
    while True:
        search = Search(prepared.problem, hypotheses_of(effects, prepared.problem), effects, spin_hz=spin_hz)
        floor = FLOOR * prepared.problem.noise_nt
        explained = from_records(search, search.run(prepared.baseline, floor, progress), floor, progress)
        if usual is None:
            return prepared, search, explained
        alone = alone or likeliest(prepared.problem, usual, prepared.baseline.x)
        prepared = replace(prepared, alone=alone[0])
        scale, names_hold = needed_scale(usual, alone, explained.fit)
        if not scale.is_within(taken) and (followed := strongest_signal(search, explained.fit, floor)) is not None:
            beside, holds = needed_scale(usual, alone, explained.fit, followed)
            scale = beside if holds else scale
        if scale.is_within(taken):
            return prepared, search, explained
        taken = scale.at_least(taken)
        prepared = _at_scale(prepared, usual, taken)
        if names_hold or not explained.fit.terms:  # wider noise brings no new names
            floor = FLOOR * prepared.problem.noise_nt
            return prepared, search, search.again(prepared.problem, explained.fit, floor)


def _drivers(explained: Explained) -> set[str]:
    """Recorded channels that drive the terms of a fit."""
    return {term.hypothesis.driver for term in explained.fit.terms if is_recorded(term.hypothesis)}


def _at_scale(prepared: Prepared, usual: FieldError, scale: Scale) -> Prepared:
    return _settled(prepared, at_scale(prepared.problem, usual, scale))


def _settled(prepared: Prepared, problem: Problem) -> Prepared:
    """Under a problem's noise, with the vectors that its nine errors calibrate: other vectors' columns hold noise."""
    baseline = Search(problem, []).refreshed(solve(problem, prepared.baseline.x))
    return replace(prepared, problem=baseline.problem, baseline=baseline)


def with_memory(prepared: Prepared, search: Search, explained: Explained, progress: Progress) -> End:
    """What stands, on a residual whitened by the memory of its noise where it has one.

    The memory is that beside the names; where those leave the most of what lasts, and that is none, beside the nine
    errors alone.  It is not whitened where a recorded driver would go with it, or where it follows a channel in spite
    of it: what the blocks bear out of a record is no noise.
    """
    problem, baseline = prepared.problem, prepared.baseline
    floor = FLOOR * problem.noise_nt
    phase = None if prepared.spin is None else prepared.spin.phase_rad
    lower = LOWER * floor
    quiet = quieted(prepared, search, problem, explained.fit, lower)
    if quiet is None and explained.fit.terms and Rest.of(baseline, explained.fit).share > _MOST_LASTS:
        quiet = quieted(prepared, search, problem, baseline, lower)
    if quiet is None:
        return End(search, *_standing(search, baseline, explained, phase, floor), floor, np.zeros(0))
    again = quiet.run(quiet.recorded_first(explained.fit, baseline, lower), lower, progress)
    again = from_records(quiet, again, lower, progress)
    again, again_left = _standing(quiet, baseline, again, phase, lower)
    if _drivers(explained):
        explained, left = _standing(search, baseline, explained, phase, floor)
        if not _drivers(explained) <= _drivers(again):
            return End(search, explained, left, floor, np.zeros(0))
    return End(quiet, again, again_left, lower, quiet.whitening)


def quieted(prepared: Prepared, search: Search, problem: Problem, fit: Fit, floor_nt: float) -> Search | None:
    """A search over a problem whose noise is whitened by the memory that it has beside a fit; None where that is white,
    or follows a channel in spite of it."""
    coefficients = memory_of(prepared, search.problem, fit)
    if not len(coefficients):
        return None
    quiet = search.with_noise(problem, coefficients)
    return None if strongest_signal(quiet, fit, floor_nt) is not None else quiet


def memory_of(prepared: Prepared, problem: Problem, fit: Fit) -> Array:
    """Autoregressive coefficients (p,) of the noise, empty where it is white.

    What hangs together has to be the noise itself, and its spectrum has to be red: an oscillation, or something slow
    on top of white noise, is none.
    """
    if problem.is_vector:
        return np.zeros(0)
    scene = problem.scene
    _, nats = autoregression(fit.residual, scene.pauses, scene.unit)
    if nats < ACCEPTED_NATS or not is_red(scene, fit.residual, fit.unit):
        return np.zeros(0)
    if correlation_samples(problem.white(fit.residual)) > _LONGEST_MEMORY:
        return np.zeros(0)
    if not is_noise(replace(prepared.view, scene=scene, residual_nt=fit.residual)):
        return np.zeros(0)
    return long_memory(fit.residual, scene.unit)


def _standing(
    search: Search, baseline: Fit, explained: Explained, phase: Array | None, floor: float
) -> tuple[Explained, list[Structure]]:
    """What stands beside the structure that is left, and that structure."""
    left = structures(search, explained.fit, phase, floor)
    if explained.fit.terms:
        stands = standing(search, baseline, explained, phase, floor, is_left=significant(left[0]))
        if stands.fit is not explained.fit:
            left = structures(search, stands.fit, phase, floor)
        explained = stands
    return explained, with_courses(search, explained.fit, left, floor)
