"""What a search costs, what it believes, and what it takes: small made-up hypotheses on the clean craft."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from magcal_service.diagnosis import explain
from magcal_service.diagnosis.explain import Search
from magcal_service.diagnosis.linear import BLOCKS, Gain, Workspace
from magcal_service.diagnosis.plausible import all_within_physics
from magcal_service.diagnosis.problem import Fit, Problem, Term
from magcal_service.diagnosis.screen import Candidate, hypotheses_of, with_simpler
from magcal_service.diagnosis.solution import solve
from magcal_service.diagnosis.stages import untold
from magcal_service.model import Array
from magcal_service.physics.catalogue import effect_named
from magcal_service.physics.columns import along_axes
from magcal_service.physics.interface import Block, Hypothesis, Nonlinear
from tests.diagnosis.made_up import (
    FLOOR_NT,
    OTHER,
    QUICK,
    SLOW,
    TIME_S,
    along,
    body_form,
    flown,
    grown_form,
    screened,
    searching,
)
from tests.physics.scenes import COUNT, NOISE_NT, X, scene

# What is looked at costs


def test_the_best_of_several_forms_pays_for_their_number_and_for_its_odds() -> None:
    """Evidence less ln(forms of the effect) less the form's odds; forms of other effects cost nothing."""
    forms = [
        body_form("one", "a", along(0, SLOW), odds=2.0),
        body_form("one", "b", along(1, SLOW)),
        body_form("one", "c", along(2, SLOW), odds=0.5),
        body_form("other", "", along(2, QUICK)),
    ]
    search, fit = searching(flown(along(0, 100.0 * SLOW)), *forms)
    found = {candidate.hypothesis.label: candidate for candidate in screened(search, fit)}
    space = Workspace(fit.residual, fit.columns)
    for form, cost in zip(forms, (math.log(3.0) + 2.0, math.log(3.0), math.log(3.0) + 0.5, 0.0), strict=True):
        gain = space.gain(form.columns(np.zeros(0)).along(fit.unit), NOISE_NT)
        assert found[form.label].nats == pytest.approx(gain.nats - cost, abs=1e-9)


def numbered(role: str, grid: Array, make: Callable[[float], Array]) -> Hypothesis:
    """A form with one nonlinear number that a field along x depends on."""
    number = Nonlinear("number", "s", grid, role)
    return Hypothesis(
        "one", "none", lambda theta: along_axes(make(float(theta[0]))), (Block("nt", "nT"),), nonlinear=(number,)
    )


@pytest.mark.parametrize(
    ("form", "places"),
    [
        (numbered("", np.array([500.0, 900.0, 2000.0]), lambda tau: np.exp(-TIME_S / tau)), 3),
        (numbered("held", np.array([500.0, 900.0]), lambda tau: np.exp(-TIME_S / tau)), 2),
        (numbered("instant", TIME_S[100:1900:100], lambda at: (at <= TIME_S).astype(float)), COUNT),
    ],
    ids=["grid", "held", "instant"],
)
def test_a_number_that_was_searched_costs_the_places_that_were_looked_at(form: Hypothesis, places: int) -> None:
    """ln of the grid's values, or of the samples where every one of them may be the instant."""
    search, fit = searching(flown(along(0, 40.0 * (TIME_S > 4000.0))), form)
    (candidate,) = screened(search, fit)
    assert candidate.nats == pytest.approx(candidate.gain.nats - math.log(places), abs=1e-9)


@pytest.mark.parametrize("row", [930, 1040])
def test_the_instant_of_a_change_is_found_between_those_that_were_tried_first(row: int) -> None:
    """Every sample from the neighbour before the best of the grid to the one after it is looked at."""
    form = numbered("instant", TIME_S[100:1900:100], lambda at: (at <= TIME_S).astype(float))
    search, fit = searching(flown(along(0, 600.0 * (np.arange(COUNT) >= row))), form)
    (candidate,) = screened(search, fit)
    assert float(candidate.theta[0]) == pytest.approx(TIME_S[row] - 2.0, abs=20.0)


def test_a_lines_frequency_costs_one_place_a_sample() -> None:
    tone = effect_named("tone")
    problem = Problem(flown(along(0, 150.0 * np.sin(2.0 * np.pi * 0.0213 * TIME_S))), NOISE_NT)
    search, fit = Search(problem, hypotheses_of([tone], problem), [tone]), solve(problem, X)
    (candidate,) = screened(search, fit)
    assert candidate.nats == pytest.approx(candidate.gain.nats - math.log(COUNT), abs=1e-9)
    assert float(candidate.theta[0]) == pytest.approx(0.0213, abs=0.1 / float(TIME_S[-1]))


def test_what_a_term_is_worth_pays_for_its_forms_and_its_numbers_too() -> None:
    """Against its absence, with the others there: the drop of a fit without it."""
    grid = np.array([500.0, 900.0, 2000.0, 4000.0])
    form = numbered("", grid, lambda tau: np.exp(-TIME_S / tau))
    beside = body_form("one", "beside", along(1, QUICK))
    search, fit = searching(flown(along(0, 300.0 * np.exp(-TIME_S / 900.0))), form, beside)
    with_it = solve(search.problem, fit.x, [Term(form, np.array([900.0]), np.zeros(3))])
    space = search.workspace(with_it, 0)
    rows = form.columns(with_it.terms[0].theta).along(with_it.unit)
    expected = space.gain(rows, NOISE_NT).nats - math.log(4.0) - math.log(2.0)
    assert search._worth(with_it, 0, NOISE_NT) == pytest.approx(expected, abs=1e-9)


# What is believed


def shares_of(form: Hypothesis, fit: Fit) -> float:
    """How much of a form's only column the nine errors leave, by least squares."""
    column = form.columns(np.zeros(0)).along(fit.unit)[:, 0]
    left = column - fit.columns @ np.linalg.lstsq(fit.columns, column, rcond=None)[0]
    return float(np.linalg.norm(left) / np.linalg.norm(column))


@pytest.mark.parametrize(("share", "believed"), [(0.025, False), (0.036, True)])
def test_what_the_nine_errors_all_but_absorb_is_no_evidence(share: float, believed: bool) -> None:
    """A bias with a ripple: believed from 3 % of its own size on, however many nats its ripple brings."""
    plain = body_form("one", "", along(0, QUICK))
    _, quiet = searching(flown(along(0, 0.0 * QUICK)), plain)
    ripple = share / shares_of(plain, quiet)  # of QUICK against a constant of the same rms along x
    field = along(0, math.sqrt(0.5) + ripple * QUICK)
    form = body_form("one", "", field)
    search, fit = searching(flown(600.0 / ripple * field), form)
    assert shares_of(form, fit) == pytest.approx(share, rel=0.05)
    candidates = screened(search, fit)
    assert bool(candidates) is believed
    assert all(candidate.nats > 20.0 for candidate in candidates)


@pytest.mark.parametrize(("largest_nt", "believed"), [(190.0, False), (240.0, True)])
def test_what_is_larger_than_its_physics_is_not_believed(largest_nt: float, believed: bool) -> None:
    """A growth of the magnitude of 300 nT times a sine: 212 nT rms."""
    form = grown_form(QUICK)
    search, fit = searching(flown(np.zeros((COUNT, 3)), 300.0 * QUICK), form, largest_nt=largest_nt)
    assert bool(screened(search, fit)) is believed
    within = replace(form, largest_nt=largest_nt)
    search, fit = searching(flown(np.zeros((COUNT, 3)), 300.0 * QUICK), within)
    assert bool(screened(search, fit)) is believed


@pytest.mark.parametrize(("amplitude", "believed"), [(0.45, False), (0.56, True), (1.44, True), (1.55, False)])
def test_a_first_look_takes_a_shift_for_whole_to_a_half(amplitude: float, believed: bool) -> None:
    form = grown_form(900.0 * QUICK, is_whole=True)
    search, fit = searching(flown(np.zeros((COUNT, 3)), amplitude * 900.0 * QUICK), form)
    assert bool(screened(search, fit)) is believed


def test_what_is_no_evidence_anyway_is_not_asked_whether_it_is_believable() -> None:
    """Below half of what counts a hypothesis stays in the list, to be compared."""
    form = grown_form(900.0 * QUICK, is_whole=True)
    search, fit = searching(flown(np.zeros((COUNT, 3))), form)
    (candidate,) = screened(search, fit)
    assert candidate.nats < 6.0


def sized(form: Hypothesis, amplitude: float, largest_nt: float = math.inf) -> bool:
    """Whether a term of this amplitude is no larger than its physics."""
    search, fit = searching(flown(np.zeros((COUNT, 3))), form, largest_nt=largest_nt)
    term = Term(search.hypotheses[0], np.zeros(0), np.array([amplitude]))
    return all_within_physics(replace(fit, terms=(term,)))


@pytest.mark.parametrize(("amplitude", "fits"), [(0.74, False), (0.76, True), (1.0, True), (1.24, True), (1.26, False)])
def test_a_fitted_shift_is_whole_to_a_quarter(amplitude: float, fits: bool) -> None:
    assert sized(grown_form(900.0 * QUICK, is_whole=True), amplitude) is fits


@pytest.mark.parametrize(("across", "fits"), [(2.7, True), (2.95, False)])
def test_parts_that_cancel_may_be_three_times_what_shows(across: float, fits: bool) -> None:
    """100 nT along the field show; with parts across it that do not, the whole may have 300 nT."""
    unit = scene().unit
    sideways = np.cross(unit, [0.0, 0.0, 1.0])
    sideways /= np.linalg.norm(sideways, axis=1)[:, None]
    form = body_form("one", "", unit + across * sideways)
    assert sized(form, 99.0, 100.0) is fits
    assert not sized(form, 101.0, 100.0)


@pytest.mark.parametrize(("growth_nt", "fits"), [(99.0, True), (101.0, False)])
def test_a_growth_of_the_reference_has_its_largest_size(growth_nt: float, fits: bool) -> None:
    assert sized(grown_form(np.sign(QUICK)), growth_nt, 100.0) is fits


# What held-out blocks say


@pytest.mark.parametrize(
    ("inside", "outside", "agrees"), [(100.0, 29.0, False), (100.0, 31.0, True), (0.0, 5.0, False), (-1.0, 5.0, False)]
)
def test_held_out_blocks_have_to_gain_a_third_of_what_the_fit_gains(
    inside: float, outside: float, agrees: bool
) -> None:
    def standing_for(squares: float, held_out: float) -> Fit:
        return SimpleNamespace(sensor_residual=np.sqrt([squares]), sensor_held_out=np.sqrt([held_out]))

    search, _ = searching(flown(np.zeros((COUNT, 3))))
    assert search.agrees(standing_for(1000.0, 1100.0), standing_for(1000.0 - inside, 1100.0 - outside)) is agrees


def test_a_form_that_foretells_no_block_from_the_others_is_not_taken() -> None:
    """25 offsets, each for two blocks that are off by numbers of their own: hundreds of nats inside, none outside."""
    block = np.arange(COUNT) * BLOCKS // COUNT
    offsets = np.random.default_rng(5).normal(0.0, 300.0, BLOCKS)
    form = grown_form(*(block // 2 == number for number in range(BLOCKS // 2)))
    search, fit = searching(flown(np.zeros((COUNT, 3)), offsets[block]), form)
    assert screened(search, fit)[0].nats > 100.0
    assert search.run(fit, FLOOR_NT).fit.terms == ()


# What the search takes


def labels(terms: Sequence[Term]) -> list[str]:
    return sorted(term.hypothesis.label for term in terms)


def test_a_form_that_came_first_gives_way_to_the_right_one_once_the_rest_is_there() -> None:
    """A mixture of both causes explains most alone; beside the second cause its sibling, the first, does better."""
    first, second = along(0, SLOW), along(1, QUICK)
    forms = (
        body_form("one", "mixed", first + second + 0.5 * along(2, OTHER)),
        body_form("one", "pure", first),
        body_form("other", "", second),
    )
    search, fit = searching(flown(400.0 * (first + second)), *forms)
    assert screened(search, fit)[0].hypothesis.variant == "mixed"
    found = search.run(fit, FLOOR_NT)
    assert labels(found.fit.terms) == ["one[pure]", "other"]
    for term in found.fit.terms:
        assert float(term.amplitudes[0]) == pytest.approx(400.0, abs=25.0)


def test_two_causes_are_taken_one_after_the_other_and_nothing_that_is_not_there() -> None:
    forms = (
        body_form("one", "", along(0, SLOW)),
        body_form("other", "", along(1, QUICK)),
        body_form("idle", "", along(2, OTHER)),
    )
    search, fit = searching(flown(along(0, 300.0 * SLOW) - along(1, 150.0 * QUICK)), *forms)
    found = search.run(fit, FLOOR_NT)
    assert [term.hypothesis.effect for term in found.fit.terms] == ["one", "other"]
    assert float(found.fit.terms[0].amplitudes[0]) == pytest.approx(300.0, abs=20.0)
    assert float(found.fit.terms[1].amplitudes[0]) == pytest.approx(-150.0, abs=20.0)
    assert [next(rival.hypothesis.effect for rival in of_term) for of_term in found.rivals] == ["one", "other"]
    worth = [nats * gain.dispersion for nats, gain in zip(found.nats, found.gains, strict=True)]
    assert worth == pytest.approx([found.rivals[0][0].nats, found.rivals[1][0].nats], abs=1e-6)


def test_what_a_refit_leads_out_of_its_physics_gives_its_turn_to_the_next_form(monkeypatch: pytest.MonkeyPatch) -> None:
    """It was found within it, and what was found stood alone: nothing was named where a record explained all."""
    forms = (body_form("one", "", along(0, SLOW)), body_form("other", "", along(0, SLOW + 0.15 * QUICK)))
    search, fit = searching(flown(along(0, 300.0 * SLOW)), *forms)
    allowed = {"other"}
    monkeypatch.setattr(Search, "_exchanged", lambda _, fit, __: fit)  # it would be tried again there
    monkeypatch.setattr(explain, "within_physics", lambda at, index: at.terms[index].hypothesis.label in allowed)
    found = search.selected(fit, FLOOR_NT, untold)
    assert [term.hypothesis.label for term in found.terms] == ["other"]
    allowed.clear()
    stood = search.problem
    assert not search.selected(fit, FLOOR_NT, untold).terms
    assert search.problem is stood


def test_no_form_that_its_refit_leads_out_of_its_physics_takes_anothers_place(monkeypatch: pytest.MonkeyPatch) -> None:
    """A step of -31 847 nT, of 20 000 at the most, was named for a quadrotor's compass: its exchange was within it."""
    forms = (body_form("one", "", along(0, SLOW + 0.3 * QUICK)), body_form("other", "", along(0, SLOW)))
    search, fit = searching(flown(along(0, 300.0 * SLOW)), *forms)
    search.close.update(form.label for form in forms)
    fit = solve(search.problem, fit.x, [Term(forms[0], np.zeros(0), np.zeros(1))])
    found = search.compared(fit, FLOOR_NT)
    assert [term.hypothesis.label for term in found.fit.terms] == ["other"]
    refreshed, beyond = Search.refreshed, []
    monkeypatch.setattr(Search, "refreshed", lambda of, at: beyond.append(refreshed(of, at)) or beyond[-1])
    monkeypatch.setattr(explain, "within_physics", lambda at, _: at not in beyond)
    monkeypatch.setattr(explain, "all_within_physics", lambda at: at not in beyond)
    found = search.compared(fit, FLOOR_NT)
    assert len(beyond) == 1
    assert [term.hypothesis.label for term in found.fit.terms] == ["one"]


def test_a_term_that_another_makes_superfluous_is_pruned() -> None:
    """The mixture beside both of its parts is worth nothing and goes; both parts stay."""
    first, second = along(0, SLOW), along(1, QUICK)
    forms = (body_form("mixed", "", first + second), body_form("one", "", first), body_form("other", "", second))
    search, fit = searching(flown(400.0 * first + 150.0 * second), *forms)
    terms = [Term(form, np.zeros(0), np.array([100.0])) for form in search.hypotheses]
    full = solve(search.problem, fit.x, [*terms[1:], replace(terms[0], hypothesis=forms[0])])
    kept = search._pruned(full, FLOOR_NT)
    assert len(kept.terms) == 2
    assert kept.rms_nt == pytest.approx(full.rms_nt, rel=1e-3)


def test_what_a_computed_driver_stood_for_is_looked_for_again_once_another_name_has_its_place() -> None:
    """A guess exact to a tenth stands for 1.5 % of its evidence; what takes its place leaves that to others."""
    slow, faint = along(0, SLOW), along(1, QUICK)
    guess = replace(body_form("guess", "", along(0, SLOW + 0.1 * OTHER)), driver="inferred:warmth")
    search, fit = searching(
        flown(400.0 * slow + 50.0 * faint), guess, body_form("exact", "", slow), body_form("faint", "", faint)
    )
    search.close |= {form.label for form in search.hypotheses}
    both = solve(
        search.problem, fit.x, [Term(form, np.zeros(0), np.array([100.0])) for form in (guess, search.hypotheses[2])]
    )
    alone = search._pruned(both, FLOOR_NT)
    assert labels(alone.terms) == [guess.label]
    assert labels(search.again(search.problem, alone, FLOOR_NT).fit.terms) == ["exact", "faint"]


# Classes


def candidate(effect: str, nats: float) -> Candidate:
    return Candidate(body_form(effect, "", along(0, SLOW)), np.zeros(0), SimpleNamespace(), nats)  # type: ignore[arg-type]


@pytest.mark.parametrize(("near", "found"), [(True, ["true"]), (False, [])])
def test_what_only_takes_another_s_place_is_never_one_effect_more(near: bool, found: list[str]) -> None:
    """Alone it is not named, though nothing else is there; in the place of one that comes near it, it is."""
    field = SLOW + 0.5 * QUICK
    forms = [replace(body_form("true", "", along(0, field)), in_place=True)]
    forms += [body_form("near", "", along(0, SLOW))] if near else []
    search, fit = searching(flown(150.0 * along(0, field)), *forms)
    assert [term.hypothesis.effect for term in search.run(fit, FLOOR_NT).fit.terms] == found


def test_of_every_effect_that_comes_near_the_best_form_stays_a_rival_however_many_one_has() -> None:
    """Fourteen forms of one before the only one of another, which another effect beside it hides at first."""
    many = [body_form("many", f"{k}", along(0, SLOW + 0.02 * k * QUICK)) for k in range(14)]
    search, fit = searching(flown(along(0, 150.0 * SLOW)), *many, body_form("other", "", along(0, SLOW + 0.6 * QUICK)))
    ranked = search._ranked(fit, FLOOR_NT, ())
    assert [candidate.hypothesis.effect for candidate in ranked] == ["many"] * 14 + ["other"]
    assert "other" in search.close
    assert len(search.close) == 13


# What was recorded comes first


def test_a_record_stays_where_a_free_shape_holds_hardly_more() -> None:
    """A record with noise of its own holds a little less than the course itself; a far better one takes its place."""
    rng = np.random.default_rng(5)
    for noise, kept in ((0.01, "recorded"), (1.0, "course")):
        record = SLOW + rng.normal(0.0, noise, COUNT)
        forms = [
            replace(body_form("recorded", "", along(0, record)), driver="channel:load"),
            body_form("course", "", along(0, SLOW)),
        ]
        search, fit = searching(flown(along(0, 200.0 * SLOW)), *forms)
        begun = solve(search.problem, X, [Term(search.hypotheses[0], np.zeros(0), np.zeros(1))])
        search.close = {form.label for form in forms}
        found = search._exchanged(begun, FLOOR_NT)
        assert [term.hypothesis.effect for term in found.terms] == [kept]
        assert fit.rms_nt > found.rms_nt


@pytest.mark.parametrize(("least_nats", "tried"), [(0.0, ["whole", "plain"]), (8.5, ["whole"])])
def test_where_the_largest_form_of_an_effect_fails_its_best_simpler_one_is_tried(
    least_nats: float, tried: list[str]
) -> None:
    """By the same driver, with fewer amplitudes, and with evidence enough; neither a larger form nor another effect."""

    def candidate(effect: str, variant: str, size: int, nats: float, driver: str = "none") -> Candidate:
        form = Hypothesis(effect, driver, lambda _: along_axes(SLOW), (Block("nt", "nT", (size,)),), variant)
        return Candidate(form, np.zeros(0), Gain(nats, 0.0, 0.0, np.zeros(size)), nats)

    ranked = [
        candidate("one", "whole", 9, 10.0),
        candidate("two", "other", 3, 9.5),
        candidate("one", "by another", 3, 9.0, "channel:other"),
        candidate("one", "as large", 9, 9.0),
        candidate("one", "plain", 6, 8.0),
        candidate("one", "plainest", 3, 7.0),
    ]
    assert [one.hypothesis.variant for one in with_simpler(ranked[0], ranked, least_nats)] == tried
