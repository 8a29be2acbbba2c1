"""Names against families without a name: what merely fits goes, what holds nearly all stays."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from magcal_service.diagnosis import nameless
from magcal_service.diagnosis.belief import Posterior
from magcal_service.diagnosis.blocks import Gain
from magcal_service.diagnosis.explain import Explained
from magcal_service.diagnosis.leftover import Structure
from magcal_service.diagnosis.nameless import spoken_against, standing
from magcal_service.diagnosis.problem import Term
from magcal_service.diagnosis.shapes import body_shape
from magcal_service.diagnosis.solution import solve
from magcal_service.model import Array
from magcal_service.physics.catalogue import catalogue
from magcal_service.physics.interface import Nonlinear
from tests.diagnosis.made_up import FLOOR_NT, QUICK, SLOW, TIME_S, along, body_form, flown, searching
from tests.physics.scenes import COUNT, scene


def stands(*terms_nt: tuple[str, Array, float], is_free: bool = False, is_left: bool = True) -> Explained:
    """What is left of names with these fields, beside a slow course that no name has."""
    forms = [replace(body_form(name, "", field), is_free=is_free) for name, field, _ in terms_nt]
    course = sum(size * field for _, field, size in terms_nt) + along(2, 150.0 * np.cos(TIME_S / 300.0))
    search, fit = searching(flown(course), *forms)
    terms = [Term(form, np.zeros(0), np.array([0.0])) for form in search.hypotheses]
    found = search.compared(solve(search.problem, fit.x, terms), FLOOR_NT)
    return standing(search, fit, found, None, FLOOR_NT, is_left)


def test_a_name_that_holds_nearly_all_stays_and_one_that_holds_little_goes() -> None:
    """Beside 150 nT without a name: 900 nT are three quarters of all and more, 100 nT are not."""
    assert len(stands(("one", along(0, SLOW), 900.0)).fit.terms) == 1
    assert stands(("one", along(0, SLOW), 100.0)).fit.terms == ()


def against(size_nt: float, *, is_free: bool = False) -> str:
    """What is said against a name of such a size beside what is left."""
    form = replace(body_form("one", "", along(0, SLOW)), is_free=is_free)
    search, fit = searching(flown(size_nt * along(0, SLOW) + along(2, 150.0 * np.cos(TIME_S / 300.0))), form)
    found = search.compared(solve(search.problem, fit.x, [Term(form, np.zeros(0), np.array([0.0]))]), FLOOR_NT)
    return spoken_against(search, fit, found, None, FLOOR_NT)


def test_what_speaks_against_a_name_is_said_by_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    """ "Held-out blocks, its rivals or shapes without a name" was all of it at once."""
    shapes = "shapes without a name do more in its place"
    assert against(900.0) == ""
    assert against(100.0) == shapes
    assert against(900.0, is_free=True) == shapes
    monkeypatch.setattr(nameless, "_may_be_the_models", lambda *_: True)
    assert against(900.0) == "the field model may err by as much, as smoothly"
    monkeypatch.undo()
    likely = Posterior(0.01, (("unknown", 0.99),), ("one",))
    monkeypatch.setattr(nameless, "posterior", lambda *_: likely)
    assert against(900.0) == "a cause in no catalogue is far likelier in its place"
    monkeypatch.setattr(nameless, "posterior", lambda *_: replace(likely, rivals=(("two", 0.99),)))
    assert against(900.0) == "two is far likelier in its place"
    monkeypatch.undo()
    monkeypatch.setattr(nameless, "stands_out", lambda *_: False)
    assert against(900.0) == "what held-out blocks gain by it does not stand out of their scatter"
    monkeypatch.setattr(nameless, "_WORSE", 0.0)
    assert against(900.0) == "held-out blocks are left with more by it"


def test_a_free_form_has_to_be_likelier_than_a_family_without_a_name() -> None:
    """A slow course of time holds its field and the rest besides; a form with physics of its own may fall short."""
    assert stands(("one", along(0, SLOW), 900.0), is_free=True).fit.terms == ()
    assert stands(("one", along(0, SLOW), 900.0), is_free=True, is_left=False).fit.terms == ()
    assert len(stands(("one", along(0, SLOW), 900.0), is_free=False, is_left=False).fit.terms) == 1


@pytest.mark.parametrize(("inflated", "left"), [(1.0, 1), (1.9, 1), (2.2, 0), (300.0, 0)])
def test_a_name_whose_evidence_a_fit_without_it_does_not_bear_out_goes(inflated: float, left: int) -> None:
    """Its evidence to first order taken so many times: from twice what a refit shows on it is no name."""
    search, fit = searching(flown(900.0 * along(0, SLOW)), body_form("one", "", along(0, SLOW)))
    terms = [Term(form, np.zeros(0), np.array([0.0])) for form in search.hypotheses]
    found = search.compared(solve(search.problem, fit.x, terms), FLOOR_NT)
    cost = found.gains[0].nats - found.nats[0] * found.gains[0].dispersion
    nats = inflated * found.nats[0]
    told = replace(found.gains[0], nats=nats * found.gains[0].dispersion + cost)
    found = replace(found, nats=(nats,), gains=(told,))
    assert len(standing(search, fit, found, None, FLOOR_NT, is_left=False).fit.terms) == left


@pytest.mark.parametrize("names", [["", "larger"], ["larger"]])
def test_what_does_not_arrive_stands_in_a_simpler_form_that_does(names: list[str]) -> None:
    """A form whose second amplitude is a bias, which nothing tells apart from the nine errors, and one without it."""
    both = {"": (along(0, SLOW),), "larger": (along(0, SLOW), along(1, np.ones(COUNT)))}
    forms = [body_form("one", name, *both[name]) for name in names]
    search, fit = searching(flown(900.0 * along(0, SLOW)), *forms)
    larger = search.hypotheses[-1]
    found = search.compared(solve(search.problem, fit.x, [Term(larger, np.zeros(0), np.zeros(2))]), FLOOR_NT)
    stalled = replace(found, fit=replace(found.fit, converged=False))
    reached = nameless._in_a_simpler_form(search, stalled.fit, FLOOR_NT)
    assert reached.converged == (len(names) > 1)
    assert [term.hypothesis.variant for term in reached.terms] == names[:1]


def test_what_does_not_arrive_stands_in_the_form_that_it_refines(monkeypatch: pytest.MonkeyPatch) -> None:
    """A current recorded late by a fifth of a sample, at whose lateness the model bends: the name was lost with it."""
    field = along(0, SLOW)
    late = body_form("one", "late", 1.0001 * field + along(1, 1e-3 * QUICK), refines="one")
    search, fit = searching(flown(900.0 * field), body_form("one", "", field), late)
    form = next(one for one in search.hypotheses if one.variant == "late")
    found = search.compared(solve(search.problem, fit.x, [Term(form, np.zeros(0), np.zeros(1))]), FLOOR_NT)
    stalled = replace(found, fit=replace(found.fit, converged=False))
    monkeypatch.setattr(nameless, "ended", lambda fit: fit)
    reached = standing(search, fit, stalled, None, FLOOR_NT, is_left=False)
    assert [term.hypothesis.variant for term in reached.fit.terms] == [""]
    assert reached.fit.converged


@pytest.mark.parametrize(
    ("role", "size_nt", "share", "is_left", "left"),
    [
        ("period", 900.0, 0.4, True, 1),
        ("period", 900.0, 0.6, True, 0),
        ("period", 900.0, 0.6, False, 1),
        ("frequency", 900.0, 0.6, False, 0),
        ("period", 900.0, 0.999, False, 0),
        ("period", 9.0, 0.6, False, 0),
    ],
)
def test_a_duty_that_the_attitude_half_holds_stays_where_it_clearly_holds_more_and_leaves_nothing(
    monkeypatch: pytest.MonkeyPatch, role: str, size_nt: float, share: float, is_left: bool, left: int
) -> None:
    """``share``: of what it holds, what a family of the attitude would hold in its place.  A tone does not: it may be
    the Sun's, which no such family follows."""
    frequency = Nonlinear("number", "Hz", np.empty(0), role)  # type: ignore[arg-type]
    field = along(0, SLOW)
    line = replace(body_form("one", "", field), nonlinear=(frequency,))
    search, fit = searching(flown(size_nt * field), line)
    with_line = solve(search.problem, fit.x, [Term(search.hypotheses[0], np.array([0.01]), np.array([0.0]))])
    own = float((fit.sensor_residual**2).sum() - (with_line.sensor_residual**2).sum())
    turning = replace(body_shape(search.problem, "field", "", SLOW[:, None]), of_attitude=True)
    held = Structure(turning, 50.0, share * own * fit.noise_gain**2, lambda: SLOW)
    monkeypatch.setattr(nameless, "structures", lambda *_: [held])
    found = Explained(with_line, ((),), (200.0,), (Gain(200.0, 1.0, 9, 9),))
    monkeypatch.setattr(nameless, "_held_by_refit", lambda *_: 200.0)
    outdone = nameless._first_outdone(search, found, None, FLOOR_NT, is_left)
    assert (outdone is None) == bool(left)
    said = spoken_against(search, fit, found, None, FLOOR_NT)
    assert ("functions of the attitude" in said) == (not left or (role, is_left, share) == ("period", False, 0.6))


def test_nothing_is_outdone_where_nothing_was_found() -> None:
    search, fit = searching(flown(np.zeros((COUNT, 3))))
    found = Explained(fit)
    assert standing(search, fit, found, None, FLOOR_NT, is_left=True) is found


@pytest.mark.parametrize(
    ("effect", "free"), [("hysteresis", True), ("torquer", True), ("scale_step", False), ("thermal_bias", False)]
)
def test_forms_without_a_driver_that_bend_as_they_like_are_free(effect: str, free: bool) -> None:
    (entry,) = [one for one in catalogue() if one.name == effect]
    forms = [form for form in entry.hypotheses(scene()) if not form.driver.startswith("channel")]
    assert {form.is_free for form in forms} == {free}
