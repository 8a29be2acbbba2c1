"""When changes come about, by joint solutions: two jumps that a slow change and one jump stood for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from magcal_service.diagnosis import instants
from magcal_service.diagnosis.explain import Search
from magcal_service.diagnosis.instants import in_stages, jumps_instead, timed
from magcal_service.diagnosis.problem import Fit, Problem, Term
from magcal_service.diagnosis.screen import hypotheses_of
from magcal_service.diagnosis.solution import solve
from magcal_service.model import Array, measure
from magcal_service.physics.catalogue import effect_named
from tests.physics.scenes import NOISE_NT, X, scene, spoiled

FIRST_S, SECOND_S = 3100.0, 5300.0
FIRST_NT, SECOND_NT = np.array([400.0, -300.0, 500.0]), np.array([-200.0, 900.0, 600.0])


def found(second_takes_s: float) -> tuple[Search, Fit]:
    """A jump, and a change that takes so long, fitted as a jump and a change over 400 s."""
    of = scene()
    course = np.clip((of.time_s - SECOND_S) / second_takes_s + 0.5, 0.0, 1.0)
    field = np.outer(of.time_s >= FIRST_S, FIRST_NT) + np.outer(course, SECOND_NT)
    noise = np.random.default_rng(9061).normal(0.0, NOISE_NT, (len(of), 3))
    problem = Problem(spoiled(measure(X, of.calibrated_nt + field + noise), of), NOISE_NT)
    effects = (effect_named("bias_drift"), effect_named("bias_step"))
    search = Search(problem, hypotheses_of(effects, problem), effects)
    ramp = next(h for h in search.hypotheses if (h.effect, h.variant) == ("bias_drift", "over a while"))
    jump = next(h for h in search.hypotheses if (h.effect, h.variant) == ("bias_step", ""))
    terms = [
        Term(ramp, np.array([SECOND_S - 200.0, SECOND_S + 200.0]), SECOND_NT),
        Term(jump, np.array([FIRST_S]), FIRST_NT),
    ]
    return search, solve(problem, X, terms)


def test_a_slow_change_beside_a_jump_gives_way_to_a_second_jump() -> None:
    search, fit = found(1e-3)
    (term,) = jumps_instead(search, fit, 0.3 * NOISE_NT).terms
    assert term.hypothesis.label == "bias_step[steps at 2 instants]"
    assert term.theta == pytest.approx([FIRST_S, SECOND_S], abs=12.0)
    assert term.amplitudes == pytest.approx(np.concatenate([FIRST_NT, SECOND_NT]), abs=150.0)


def test_a_change_that_takes_a_while_stays_beside_a_jump() -> None:
    search, fit = found(900.0)
    assert jumps_instead(search, fit, 0.3 * NOISE_NT) is fit


def alone(field: Array) -> tuple[Search, Fit]:
    """A change of the bias (n, 3) [nT], fitted as one that is even over 1200 s."""
    of = scene()
    noise = np.random.default_rng(9062).normal(0.0, NOISE_NT, (len(of), 3))
    problem = Problem(spoiled(measure(X, of.calibrated_nt + field + noise), of), NOISE_NT)
    effects = (effect_named("bias_drift"), effect_named("bias_step"))
    search = Search(problem, hypotheses_of(effects, problem), effects)
    ramp = next(h for h in search.hypotheses if (h.effect, h.variant) == ("bias_drift", "over a while"))
    term = Term(ramp, np.array([SECOND_S - 600.0, SECOND_S + 600.0]), SECOND_NT)
    return search, search.refreshed(solve(problem, X, [term]))


def names(search: Search, fit: Fit) -> list[str]:
    """Forms in the term's place, best first, those within three nats of it only."""
    found = search.compared(fit, 0.3 * NOISE_NT)
    return [one.hypothesis.label for one in found.rivals[0] if one.nats > found.own_nats(0) - 3.0]


def test_two_jumps_that_follow_one_another_are_not_an_even_change_alone() -> None:
    """By a third of a microtesla each, ten minutes apart: the even change between them holds about as much."""
    time_s = scene().time_s
    reached = np.mean([time_s >= SECOND_S - 300.0, time_s >= SECOND_S + 300.0], axis=0)
    search, fit = alone(np.outer(reached, SECOND_NT))
    assert "bias_step[steps at 2 instants]" in names(search, fit)


def test_an_even_change_is_no_two_jumps() -> None:
    search, fit = alone(np.outer(np.clip((scene().time_s - SECOND_S) / 1200.0 + 0.5, 0.0, 1.0), SECOND_NT))
    assert names(search, fit) == ["bias_drift[over a while]"]


def test_two_jumps_in_place_of_a_change_are_where_they_happened() -> None:
    time_s = scene().time_s
    field = np.outer(time_s >= FIRST_S, FIRST_NT) + np.outer(time_s >= SECOND_S, SECOND_NT)
    search, fit = alone(field)
    (pair,) = in_stages(search, fit, 0, search.workspace(fit, 0), fit.white_rms_nt)
    assert pair.theta == pytest.approx([FIRST_S, SECOND_S], abs=12.0)


def test_a_name_is_among_its_rivals_whatever_its_size_to_first_order(monkeypatch: pytest.MonkeyPatch) -> None:
    """A strong one may be beyond its physics there, as fitted within: another form of it was held against the rest."""
    search, fit = alone(np.outer(scene().time_s >= FIRST_S, FIRST_NT))
    mine = fit.terms[0].hypothesis
    believed = Search._is_believable
    monkeypatch.setattr(
        Search,
        "_is_believable",
        lambda self, one, space, of: one.hypothesis is not mine and believed(self, one, space, of),
    )
    ranked = search._rivals(fit, 0, fit.white_rms_nt)
    assert [one.theta.tolist() for one in ranked if one.hypothesis is mine] == [fit.terms[0].theta.tolist()]


@pytest.mark.parametrize("away", [0.2, -0.2])
def test_an_instant_that_is_moved_to_where_less_is_left_is_not_solved_again_where_it_was(
    away: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    search, _ = found(1e-3)
    jump = next(h for h in search.hypotheses if (h.effect, h.variant) == ("bias_step", ""))
    fit = solve(search.problem, X, [Term(jump, np.array([FIRST_S]), FIRST_NT)])
    span_s = float(np.ptp(search.problem.scene.time_s))
    true_s, places = FIRST_S + away * span_s, [FIRST_S]

    def solved(before: Fit, index: int, theta: Array, amplitudes: Array) -> Fit:
        places.append(float(theta[0]))
        return replace(before, terms=(replace(before.terms[index], theta=theta),), converged=True)

    monkeypatch.setattr(search, "screen", lambda *_, **__: [])
    monkeypatch.setattr(instants, "_at", solved)
    monkeypatch.setattr(instants, "inside_nt2", lambda one: (float(one.terms[0].theta[0]) - true_s) ** 2)
    assert float(timed(search, fit, 0).terms[0].theta[0]) == pytest.approx(true_s, abs=0.02 * span_s)
    assert len({round(place, 6) for place in places}) == len(places) == 9
