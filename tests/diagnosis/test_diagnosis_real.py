"""A craft in orbit, diagnosed without its photodiodes and then held against them, and against another day."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from magcal_service.diagnosis.diagnose import Diagnosis, Verdict, diagnose
from magcal_service.diagnosis.joint.catalogue import Forms
from magcal_service.diagnosis.joint.search import refitted
from magcal_service.diagnosis.problem import Fit, Term
from magcal_service.physics.catalogue import effect_named
from tests.benchmarks.bench_suchai3 import DATA, blind, dark_edges, frozen, light_fit, panel_field, shadow_moved

ORBIT, LATER = DATA / "suchai3" / "2023-08-24.toml", DATA / "suchai3" / "2023-11-13.toml"

pytestmark = [
    pytest.mark.skipif(not ORBIT.exists(), reason="the recording suchai3/2023-08-24 is not in ../shared/data"),
]


@cache
def orbit() -> tuple[Diagnosis, Fit]:
    """One orbit of SUCHAI-3, every second sample of it, and its fit with the effects of sunlight alone."""
    recording = blind(ORBIT)
    diagnosis = diagnose(recording.select(np.arange(len(recording)) % 2 == 0))
    return diagnosis, light_fit(diagnosis)


def test_an_orbit_is_explained_by_heat_and_panels() -> None:
    """Without its photodiodes the orbit is named a gain that follows temperature and currents of the panels."""
    diagnosis, fit = orbit()
    assert diagnosis.verdict is Verdict.NAMED
    assert {term.hypothesis.effect for term in fit.terms} == {"thermal_scale", "current_loop"}
    assert fit.held_out_rms_nt < 0.2 * diagnosis.prepared.baseline.held_out_rms_nt


def test_the_shadow_stands_where_the_photodiodes_saw_it() -> None:
    """The field alone is explained best with the shadow where it is, and the photodiodes are dark just then."""
    diagnosis, fit = orbit()
    model, seen = dark_edges(ORBIT)
    assert np.abs(model - seen).max() < 15.0
    assert fit.held_out_rms_nt < min(shadow_moved(diagnosis, fit, seconds) for seconds in (-60.0, 60.0))


def test_panels_of_one_day_help_on_another() -> None:
    """The panels' field of August, frozen, helps in November, and more than with the Sun anywhere else."""
    if not LATER.exists():
        pytest.skip("the recording suchai3/2023-11-13 is not in ../shared/data")
    later = diagnose(blind(LATER))
    field = panel_field(*orbit())
    helped = frozen(later, field)
    assert helped < 0.85 * later.prepared.baseline.held_out_rms_nt
    assert helped < min(frozen(later, field, turned_deg=turned) for turned in range(45, 360, 45))


def test_a_day_of_several_is_fitted_where_it_leaves_least() -> None:
    """Three days together are best with light that warms a skin in 1003 s and the sensor in 557; August by itself is
    best elsewhere, and a fit from there stays where it began."""
    diagnosis, _ = orbit()
    problem = diagnosis.prepared.problem
    catalogue = Forms.of([effect_named(name) for name in ("thermal_scale", "current_loop")], [problem])
    forms = {form.label: form for form in catalogue.on([problem], ["August"])}
    heat = forms["thermal_scale[answer to light] by inferred:temperature"]
    panels = forms["current_loop[every panel its own circuit] by inferred:array_current"]
    terms = [
        Term(heat, np.array([557.0, 1003.0]), np.zeros(heat.size)),
        Term(panels, np.zeros(0), np.zeros(panels.size)),
    ]
    near, best = (
        refitted(catalogue, [problem], ["August"], diagnosis.prepared.baseline.x, terms, anywhere=anywhere)
        for anywhere in (False, True)
    )
    assert near.converged
    assert best.converged
    assert near.terms[0].theta == pytest.approx([557.0, 1003.0], rel=0.2)
    assert best.terms[0].theta[0] > 2.0 * near.terms[0].theta[0]
    assert best.held_out_rms_nt < near.held_out_rms_nt
