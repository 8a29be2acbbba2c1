"""A reference that is minutes of the orbit off, against places and fields worked out anew."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from magcal_service.diagnosis.explain import Search
from magcal_service.diagnosis.problem import Problem
from magcal_service.diagnosis.screen import hypotheses_of
from magcal_service.diagnosis.solution import solve
from magcal_service.earth import geomagnetic
from magcal_service.model import Array
from magcal_service.physics.catalogue import effect_named
from magcal_service.physics.interface import Hypothesis
from magcal_service.physics.scene.scene import Scene
from tests.physics.scenes import COUNT, NOISE_NT, X, orbit_eci_km, scene

AHEAD_S, GROWTH_S_PER_H = 430.0, 4.0


@cache
def stale(with_earth: bool) -> Scene:
    """The clean craft, its reference and positions those of a place that it has passed 430 s and more ago.

    With the Earth: a clock that is late, so position and Earth are those of another time.
    """
    clean = scene(NOISE_NT)
    behind = AHEAD_S + GROWTH_S_PER_H * clean.time_s / 3600.0
    place = orbit_eci_km(clean.time_s - behind)
    at_ns = clean.time_ns - (np.rint(behind * 1e9).astype(np.int64) if with_earth else 0)
    ecef = geomagnetic.ecef_from_eci(at_ns, place)
    field_nt = geomagnetic.igrf_ecef_nt(clean.time_ns, ecef)
    magnitude = np.linalg.norm(field_nt, axis=1)
    return replace(
        clean, position_ecef_km=ecef, magnitude_nt=magnitude, reference_eci_nt=None, body_from_eci=None, channels={}
    )


FAR = ("by minutes", "far along")
"""The forms for a shift by minutes."""


def form(effect: str, of: Scene) -> Hypothesis:
    """The effect's form for a large shift."""
    return next(h for h in effect_named(effect).hypotheses(of) if h.variant in FAR)


CASES = [("position_offset", False), ("time_offset", True)]


@pytest.mark.parametrize(("effect", "with_earth"), CASES)
def test_the_right_shift_gives_the_field_of_the_right_place(effect: str, with_earth: bool) -> None:
    """|H| at the craft less |H| as computed, worked out at its true place, to 60 nT of more than 5 uT."""
    of = stale(with_earth)
    growth = form(effect, of).columns(np.array([AHEAD_S, GROWTH_S_PER_H])).growth(np.ones(1))
    true = np.linalg.norm(geomagnetic.igrf_eci_nt(of.time_ns, orbit_eci_km(of.time_s)), axis=1)
    inside = of.time_s < of.time_s[-1] - 600.0  # beyond the end the orbit is continued, not known
    off = np.asarray(growth - (true - of.magnitude_nt))[inside]
    assert float(np.abs(true - of.magnitude_nt).max()) > 5000.0
    assert float(np.abs(off).max()) < 60.0


@pytest.mark.parametrize(("effect", "with_earth"), CASES)
def test_a_shift_of_minutes_is_found_with_its_growth(effect: str, with_earth: bool) -> None:
    """430 s at the start and 4 s more with every hour, from a search that starts at whole minutes."""
    of = stale(with_earth)
    problem = Problem(of, NOISE_NT)
    effects = [effect_named("position_offset"), effect_named("time_offset")]
    search = Search(problem, hypotheses_of(effects, problem), effects)
    fit = search.run(solve(problem, X), 0.3 * NOISE_NT).fit
    term = fit.terms[0]
    assert (term.hypothesis.effect, term.hypothesis.is_whole) == (effect, True)
    assert term.theta[0] == pytest.approx(AHEAD_S, abs=8.0)
    assert float(term.amplitudes[0]) == pytest.approx(1.0, abs=0.03)


def test_beyond_its_ends_a_track_goes_on() -> None:
    """The shift at the last sample, where no place was recorded 430 s later, is that of the orbit: to 100 nT."""
    of = stale(False)
    growth: Array = np.asarray(
        form("position_offset", of).columns(np.array([AHEAD_S, GROWTH_S_PER_H])).growth(np.ones(1))
    )
    true = np.linalg.norm(geomagnetic.igrf_eci_nt(of.time_ns[-1:], orbit_eci_km(of.time_s[-1:])), axis=1)
    assert float(growth[-1]) == pytest.approx(float(true[0] - of.magnitude_nt[-1]), abs=100.0)


def test_a_recording_with_a_long_pause_has_no_form_for_it() -> None:
    """Across half an hour without a place the track is no straight line, and nothing is worked out along it."""
    of = stale(False)
    paused = replace(of, time_s=of.time_s + 1800.0 * (np.arange(COUNT) > 900))
    forms = [h for effect in ("time_offset", "position_offset") for h in effect_named(effect).hypotheses(paused)]
    assert forms
    assert not [h for h in forms if h.variant in FAR]


def test_a_short_recording_has_no_form_for_it() -> None:
    """Under half an orbit a shift along it has no shape of its own."""
    of = stale(False)
    short = replace(
        of,
        **{
            name: getattr(of, name)[:500]
            for name in ("time_s", "field_nt", "calibrated_nt", "clean_field_nt", "magnitude_nt", "position_ecef_km")
        },
    )
    assert not [
        h
        for effect in ("time_offset", "position_offset")
        for h in effect_named(effect).hypotheses(short)
        if h.variant in FAR
    ]
