"""A load's current whose record is held in the rows between readouts, or has noise of its own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from magcal_service.diagnosis.explain import Search
from magcal_service.diagnosis.problem import Fit, Problem, Term
from magcal_service.diagnosis.screen import Candidate, hypotheses_of
from magcal_service.diagnosis.solution import solve
from magcal_service.model import Array, measure
from magcal_service.physics.catalogue import effect_named
from magcal_service.physics.interface import Hypothesis, value_of
from magcal_service.physics.scene.scene import Telemetry
from tests.physics.scenes import NOISE_NT, X, scene, spoiled

PER_A_NT = np.array([260.0, -180.0, 140.0])
READ_S = 30.0


def load_a(at_s: Array) -> Array:
    """A heater of 1 A under its thermostat, on for 40 to 80 s at a time."""
    return (np.sin(at_s / 23.0) + np.sin(at_s / 61.0) > 0.4).astype(np.float64)


def best_by(record_a: Array, rng: np.random.Generator) -> tuple[Search, Fit, Candidate]:
    """A search over a flight beside the load, the nine errors alone, and the best form by its record (n,) [A]."""
    of = scene()
    noise = rng.normal(0.0, NOISE_NT, (len(of), 3))
    field = measure(X, of.calibrated_nt + np.outer(load_a(of.time_s), PER_A_NT) + noise)
    channels = {"heater": Telemetry("heater", "current", record_a[:, None])}
    problem, effects = (
        Problem(replace(spoiled(field, of), channels=channels), NOISE_NT),
        (effect_named("current_loop"),),
    )
    search = Search(problem, hypotheses_of(effects, problem), effects)
    baseline = solve(problem, X)
    return search, baseline, search.screen(search.workspace(baseline), baseline, baseline.rms_nt)[0]


@pytest.mark.parametrize("age_s", [0.0, 12.0])
def test_a_held_record_of_a_load_gives_the_field_per_ampere(age_s: float) -> None:
    """As it is recorded it comes out small by a third and more; between readouts to a few per cent."""
    read_s = np.floor((scene().time_s - age_s) / READ_S) * READ_S
    search, baseline, best = best_by(load_a(read_s), np.random.default_rng(8881))
    problem = search.problem
    assert best.hypothesis.label == "current_loop[recorded late] by channel:heater"
    plain = next(h for h in search.hypotheses if h.label == "current_loop by channel:heater")
    late, as_recorded = (
        solve(problem, baseline.x, [Term(form, theta, np.zeros(3))])
        for form, theta in ((best.hypothesis, best.theta), (plain, np.zeros(0)))
    )
    shares = [fit.terms[0].amplitudes @ PER_A_NT / (PER_A_NT @ PER_A_NT) for fit in (late, as_recorded)]
    assert shares[0] == pytest.approx(1.0, abs=0.06)
    assert shares[1] < 0.7
    assert late.terms[0].theta[0] + 0.5 * late.terms[0].theta[1] == pytest.approx(age_s + 0.5 * READ_S, abs=3.0)


def test_a_record_with_noise_of_its_own_gives_the_field_per_ampere() -> None:
    """As it is recorded it comes out small by a third; averaged over the time that it seems to be held, by a tenth."""
    rng = np.random.default_rng(8915)
    search, baseline, best = best_by(load_a(scene().time_s) + 0.35 * rng.standard_normal(len(scene())), rng)
    assert best.hypothesis.label == "current_loop[recorded with noise] by channel:heater"
    assert best.hypothesis.constants["record_noise_a"] == pytest.approx(0.35, abs=0.03)
    fit = solve(search.problem, baseline.x, [Term(best.hypothesis, best.theta, np.zeros(3))])
    sigma = np.sqrt(np.diagonal(fit.covariance)[-3:])
    assert np.all(np.abs(fit.terms[0].amplitudes - PER_A_NT) < 3.0 * sigma)
    assert fit.terms[0].amplitudes @ PER_A_NT / (PER_A_NT @ PER_A_NT) == pytest.approx(1.0, abs=0.06)


def late_form(record_a: Array) -> Hypothesis:
    """The form by a heater's record (n,) [A] that is read out late."""
    of = replace(scene(), channels={"heater": Telemetry("heater", "current", record_a[:, None])})
    return next(one for one in effect_named("current_loop").hypotheses(of) if one.variant == "recorded late")


def test_a_record_that_repeats_is_said_to_be_held_and_another_to_be_averaged() -> None:
    """A record of which hardly a row is the one before was not held, whatever time its form has."""
    time_s = scene().time_s
    held, mean = load_a(np.floor(time_s / READ_S) * READ_S), np.round(np.sin(time_s / 40.0), 3)
    assert 0.0 < np.mean(mean[1:] == mean[:-1]) < 0.02  # its last digit
    effect = effect_named("current_loop")
    said, asked = [], []
    for record, constants in ((held, {"column_0": 0.0}), (mean, {"column_0": 0.0, "averaged": 1.0})):
        form = late_form(record)
        assert form.constants == constants
        found = {
            "nt_per_a": value_of(PER_A_NT, np.ones(3), "nT/A"),
            "late_s": value_of(12.0, 0.5, "s"),
            "held_s": value_of(30.0, 1.0, "s"),
            **{name: value_of(value, np.nan, "1") for name, value in form.constants.items()},
        }
        values = {**found, **effect.derived(found)}
        said.append(effect.sentence(values, form.driver).partition("before its row and ")[2])
        asked.append(effect.next_record(values, form.driver))
        given = replace(
            scene(), channels={"heater": Telemetry("heater", "current", held[:, None])}, given=form.constants
        )
        again = next(one for one in effect.hypotheses(given) if one.variant == form.variant)
        assert again.constants == constants  # as its file has it, whatever it is applied to
    assert said == ["held for 30.0 ± 1.0 s.", "averaged over 30.0 ± 1.0 s."]
    assert asked == [
        "read channel heater out with every sample: its record is 12.00 ± 0.50 s older than its row, and held for "
        "30.0 ± 1.0 s",
        "read channel heater out with every sample: its record is 12.00 ± 0.50 s older than its row, and a mean over "
        "30.0 ± 1.0 s",
    ]


@pytest.mark.parametrize(
    ("number", "unit", "asked"),
    [
        ("lag_s", "s", "read field and channel heater through the same filter: one lags by 2.00 ± 0.10 s"),
        (
            "record_noise_a",
            "A",
            "record channel heater with less noise than 2.00 ± 0.10 A, as by a mean of more readings",
        ),
        ("none", "s", ""),
    ],
)
def test_what_to_record_otherwise_is_said_of_a_record_alone(number: str, unit: str, asked: str) -> None:
    effect, found = effect_named("current_loop"), {number: value_of(2.0, 0.1, unit)}
    assert effect.next_record(found, "channel:heater") == asked
    assert effect.next_record(found, "inferred:array_current") == ""
