"""Small pieces of a diagnosis by hand: grids, columns of a term, bounds, lines, slots, and a model's terms."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from magcal_service.diagnosis.collapse import is_collapsed
from magcal_service.diagnosis.grids import combinations, tried_first
from magcal_service.diagnosis.handover import model_term, terms_of
from magcal_service.diagnosis.lines import folded, slots
from magcal_service.diagnosis.problem import Problem, Term, free_numbers
from magcal_service.diagnosis.rivals import best_of_each
from magcal_service.diagnosis.screen import Candidate, search_cost
from magcal_service.diagnosis.solution import _blocked, _inside, _moved
from magcal_service.diagnosis.term_columns import columns_of
from magcal_service.model import Array
from magcal_service.physics.columns import along_axes
from magcal_service.physics.interface import Block, Hypothesis, Nonlinear
from magcal_service.physics.scene.scene import Scene

GRID = np.array([1.0, 2.0, 4.0])


def timed(time_s: Array) -> Scene:
    field = np.ones((len(time_s), 3))
    return Scene(time_s, 0, True, field, field, field, field[:, 0])


def form(size: int, *numbers: Nonlinear) -> Hypothesis:
    return Hypothesis("one", "none", lambda _: along_axes(np.ones(3)), (Block("nt", "nT", (size,)),), nonlinear=numbers)


def number(role: str = "", grid: Array = GRID) -> Nonlinear:
    return Nonlinear("number", "s", grid, role)


# What is tried first


def test_a_grid_is_that_of_the_number_or_of_the_residuals_lines() -> None:
    lines = np.array([0.02, 0.05])
    assert tried_first(number(), lines, 0.01).tolist() == GRID.tolist()
    assert tried_first(number("instant"), None, None).tolist() == GRID.tolist()
    assert tried_first(number("frequency"), lines, 0.01).tolist() == [0.02, 0.05]
    for role in ("frequency", "period"):
        assert len(tried_first(number(role), None, 0.01)) == 0
        assert len(tried_first(number(role), np.zeros(0), 0.01)) == 0


def test_a_period_shows_as_a_line_or_as_side_lines_of_the_spin() -> None:
    """Each line, and it less and more the spin; or the wave whose third it is, near the spin itself.  What is slower
    than five minutes is a step."""
    lines = np.array([0.05, 0.012])
    alone = tried_first(number("period"), lines, None)
    assert alone == pytest.approx([1.0 / 0.012, 1.0 / 0.05])
    beside = tried_first(number("period"), lines, 0.01)
    assert beside == pytest.approx([1.0 / f for f in (0.012, 0.022, 0.04, 0.05, 0.06)])
    by_third = tried_first(number("period"), lines, 0.0042)  # 0.012 / 3 is hidden by the spin, 0.05 / 3 is not
    assert by_third == pytest.approx([1.0 / f for f in (0.004, 0.0078, 0.012, 0.0162, 0.0458, 0.05, 0.0542)])
    edge = tried_first(number("period"), np.array([1.0 / 299.0, 1.0 / 301.0]), None)
    assert edge == pytest.approx([1.0 / round(1.0 / 299.0, 7)])


def test_several_grids_give_every_combination() -> None:
    found = combinations([np.array([1.0, 2.0]), np.array([5.0, 6.0, 7.0])])
    assert found.tolist() == [[a, b] for a in (1.0, 2.0) for b in (5.0, 6.0, 7.0)]


@pytest.mark.parametrize(
    ("role", "count", "places"),
    [("", 50, 3), ("held", 50, 3), ("instant", 50, 50), ("frequency", 50, 50), ("period", 1, 2)],
)
def test_a_search_costs_its_places(role: str, count: int, places: int) -> None:
    assert search_cost(number(role), Problem(timed(np.arange(float(count))), 1.0)) == pytest.approx(math.log(places))
    assert search_cost(number("", np.zeros(0)), Problem(timed(np.arange(5.0)), 1.0)) == 0.0


# Columns of a term


def terms() -> list[Term]:
    """Three terms: sizes 3, 2, 1; of their numbers one, none and two are free."""
    return [
        Term(form(3, number(), number("instant")), np.array([2.0, 3.0]), np.array([1.0, 2.0, 3.0])),
        Term(form(2, number("held")), np.array([4.0]), np.array([4.0, 5.0])),
        Term(form(1, number("frequency"), number()), np.array([0.02, 1.5]), np.array([6.0])),
    ]


def fitted() -> Any:
    return SimpleNamespace(problem=SimpleNamespace(size=9), terms=tuple(terms()), linear_size=15, x=np.arange(9.0))


def test_columns_of_a_term_are_its_amplitudes_and_its_free_numbers() -> None:
    fit = fitted()
    assert [free_numbers(term) for term in fit.terms] == [[0], [], [0, 1]]
    assert columns_of(fit, 0).tolist() == [9, 10, 11, 15]
    assert columns_of(fit, 1).tolist() == [12, 13]
    assert columns_of(fit, 2).tolist() == [14, 16, 17]
    with pytest.raises(IndexError):
        columns_of(fit, 3)


def test_a_step_moves_errors_amplitudes_and_free_numbers_inside_their_range() -> None:
    step = np.concatenate([np.ones(9), 10.0 * np.arange(1.0, 7.0), [0.5, 0.001, 9.0]])
    x, moved = _moved(fitted(), step)
    assert x.tolist() == (np.arange(9.0) + 1.0).tolist()
    assert [term.amplitudes.tolist() for term in moved] == [[11.0, 22.0, 33.0], [44.0, 55.0], [66.0]]
    assert [term.theta.tolist() for term in moved] == [[2.5, 3.0], [4.0], [pytest.approx(0.021), 4.0]]
    assert _blocked(fitted(), step).tolist() == [False] * 15 + [False, False, True]


@pytest.mark.parametrize(
    ("role", "grid", "value", "kept"),
    [
        ("", GRID, 0.5, 1.0),
        ("", GRID, 3.0, 3.0),
        ("", GRID, 5.0, 4.0),
        ("frequency", GRID, 9.0, 9.0),
        ("", GRID[:1], 9.0, 9.0),
    ],
)
def test_a_number_stays_within_what_its_grid_spans(role: str, grid: Array, value: float, kept: float) -> None:
    assert _inside(form(3, number(role, grid)), 0, value) == kept


@pytest.mark.parametrize(("d11", "collapsed"), [(-0.61, True), (-0.59, False), (1.49, False), (1.51, True)])
def test_a_sensor_is_none_beyond_two_fifths_and_their_inverse(d11: float, collapsed: bool) -> None:
    for axis in range(3):
        x = np.zeros(9)
        x[3 + axis] = d11
        assert is_collapsed(x) is collapsed


def test_of_each_effect_the_best_form_is_kept_in_order() -> None:
    ranked = [
        Candidate(replace(form(3), effect=name, variant=variant), np.zeros(0), None, nats)  # type: ignore[arg-type]
        for name, variant, nats in (("a", "x", 9.0), ("b", "", 8.0), ("a", "y", 7.0), ("c", "", 6.0))
    ]
    assert [(one.hypothesis.effect, one.nats) for one in best_of_each(ranked, lambda h: h.effect)] == [
        ("a", 9.0),
        ("b", 8.0),
        ("c", 6.0),
    ]


# Lines


@pytest.mark.parametrize(
    ("line_hz", "seen_hz"), [(0.1, 0.1), (0.5, 0.5), (0.6, 0.4), (0.9, 0.1), (1.0, 0.0), (1.3, 0.3), (-0.2, 0.2)]
)
def test_a_line_appearsfolded_by_the_rate(line_hz: float, seen_hz: float) -> None:
    assert folded(line_hz, 1.0) == pytest.approx(seen_hz)


def test_samples_stand_on_an_even_grid_and_long_pauses_are_cut() -> None:
    """By ones of the period; where the grid would be too long, a pause counts as one mean stretch."""
    time_s = np.array([5.0, 7.0, 9.1, 10.9, 25.0])
    of = timed(time_s)
    of.__dict__["period_s"] = 2.0
    assert slots(of).tolist() == [0, 1, 2, 3, 10]
    far = np.concatenate([np.arange(30.0), 1e6 + np.arange(10.0), 2e6 + np.arange(20.0)])
    cut = slots(timed(far))
    assert cut.tolist() == [*range(30), *range(49, 59), *range(78, 98)]


# A model's terms


def test_a_models_term_has_its_numbers_by_name_and_shape() -> None:
    hypothesis = Hypothesis(
        "heat",
        "channel:t",
        lambda _: along_axes(np.ones(3)),
        (Block("matrix", "nT", (2, 3)), Block("one", "nT", ())),
        "late",
        (Nonlinear("tau_s", "s", GRID), Nonlinear("at_s", "s", GRID, "instant")),
        {"zero": 20.0},
    )
    made = model_term(hypothesis, np.array([3.0, 7.0]), np.arange(7.0))
    assert (made.effect, made.driver, made.variant) == ("heat", "channel:t", "late")
    assert made.amplitudes["matrix"].tolist() == [[0.0, 1.0, 2.0], [3.0, 4.0, 5.0]]
    assert float(made.amplitudes["one"]) == 6.0
    assert (made.nonlinear, made.constants, made.sigma) == ({"tau_s": 3.0, "at_s": 7.0}, {"zero": 20.0}, {})


def test_terms_of_a_fit_have_the_sigmas_of_their_places() -> None:
    sigmas = np.arange(18.0) + 100.0
    fit: Any = SimpleNamespace(**{**vars(fitted()), "covariance": np.diag(sigmas**2)})
    found = terms_of(fit)
    assert [term.sigma["nt"].tolist() for term in found] == [[109.0, 110.0, 111.0], [112.0, 113.0], [114.0]]
    assert [term.amplitudes["nt"].tolist() for term in found] == [[1.0, 2.0, 3.0], [4.0, 5.0], [6.0]]
