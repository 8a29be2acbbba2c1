"""Stretches and instants that a search finds, in both forms of the residual; recorded drivers before inferred."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from magcal_service.diagnosis import screen
from magcal_service.diagnosis.explain import Search
from magcal_service.diagnosis.leftover import _Beside, _transients, largest_product
from magcal_service.diagnosis.linear import Workspace
from magcal_service.diagnosis.locate import locate
from magcal_service.diagnosis.problem import Problem, Term
from magcal_service.diagnosis.solution import solve
from magcal_service.model import Array
from magcal_service.physics.columns import Columns, along_axes
from magcal_service.physics.interface import Block, Hypothesis, Nonlinear
from magcal_service.physics.scene.scene import Scene
from tests.diagnosis.made_up import FLOOR_NT, OTHER, QUICK, SLOW, TIME_S, along, body_form, flown, searching
from tests.physics.scenes import COUNT, NOISE_NT, PERIOD_S, scene

SMALL = 240
UNIT = np.random.default_rng(5).normal(size=(SMALL, 3))
UNIT /= np.linalg.norm(UNIT, axis=1)[:, None]


def small(*, vector: bool, field_nt: Array, noise_nt: float = 1.0) -> tuple[Search, Any, Workspace]:
    """Samples of two seconds whose residual is a field (n, 3) and noise, with a constant in the model."""
    time_s = 2.0 * np.arange(float(SMALL))
    of = Scene(time_s, 0, False, 3e4 * UNIT, 3e4 * UNIT, 3e4 * UNIT, np.full(SMALL, 3e4))
    room = np.broadcast_to(np.eye(3), (SMALL, 3, 3)) if vector else None
    search = Search(Problem(of, noise_nt, room), [])
    noise = np.random.default_rng(6).normal(0.0, noise_nt, (SMALL, 3))
    rows = Columns(body=(field_nt + noise)[None])
    residual = rows.components()[:, 0] if vector else rows.along(UNIT)[:, 0]
    fit = SimpleNamespace(
        problem=search.problem, residual=residual, columns=np.ones((len(residual), 1)), unit=UNIT, terms=()
    )
    return search, fit, search.workspace(fit)  # type: ignore[arg-type]


# Instants


def change(grid_s: Array) -> Hypothesis:
    """A field on each axis from an instant on."""
    number = Nonlinear("from_s", "s", grid_s, "instant")

    def columns(theta: Array) -> Columns:
        return along_axes((2.0 * np.arange(SMALL) >= theta[0]).astype(np.float64))

    return Hypothesis("one", "none", columns, (Block("nt", "nT"),), nonlinear=(number,))


@pytest.mark.parametrize("vector", [False, True])
@pytest.mark.parametrize("first", [31, 100, 153])
def test_an_instant_lies_between_the_last_sample_before_it_and_the_first_after_it(vector: bool, first: int) -> None:
    """Three rows a sample are one instant, too; the grid is no finer than 40 s."""
    late = (np.arange(SMALL) >= first).astype(np.float64)
    search, fit, space = small(vector=vector, field_nt=np.outer(late, [90.0, -70.0, 80.0]))
    found = search._instant(change(np.arange(20.0, 460.0, 40.0)), space, fit, 1.0)
    assert found is not None
    assert found[0].tolist() == [2.0 * first - 1.0]
    rows = search.rows_of(change(np.zeros(1)), found[0], fit)
    assert rows is not None
    assert found[1].nats == pytest.approx(space.gain(rows, 1.0).nats, rel=1e-5)
    assert found[1].amplitudes == pytest.approx([90.0, -70.0, 80.0], abs=0.6)


def test_an_instant_needs_three_places_within_the_recording() -> None:
    search, fit, space = small(vector=False, field_nt=np.zeros((SMALL, 3)))
    assert search._instant(change(np.array([-5.0, 0.0, 100.0, 200.0, 900.0])), space, fit, 1.0) is None
    assert search._instant(change(np.array([50.0, 100.0, 200.0])), space, fit, 1.0) is not None


# Where a residual of vectors sits


def test_vectors_are_located_by_families_and_not_by_lines_or_a_change() -> None:
    """A swing in time of all three components: the family of slow courses, with most of what is beyond the noise."""
    swing = np.outer(np.sin(2.0 * np.pi * np.arange(SMALL) / 200.0), [4.0, 0.0, -3.0])
    search, fit, _ = small(vector=True, field_nt=swing)
    places = locate(search, fit)
    assert places[0].kind == "time"
    assert places[0].says.endswith(")")
    assert places[0].share > 0.9
    assert all(not place.says.startswith(("a change", "a line at")) for place in places)
    assert largest_product(search, fit, 0.3) == 0.0
    assert any(place.says.startswith("a change") for place in locate(*small(vector=False, field_nt=swing)[:2]))


def test_stretches_are_looked_for_in_vectors_too() -> None:
    """Forty samples of three rows each, of which the axis alone that has it counts."""
    spoiled = np.zeros((SMALL, 3))
    spoiled[50:90] = [30.0, 0.0, 0.0]
    search, fit, space = small(vector=True, field_nt=spoiled)
    found = _transients(_Beside(search, fit, space, space), 1.0, 0.0)
    assert found is not None
    there = np.abs(found.signal.reshape(SMALL, 3))
    assert there[55:85, 0].min() > 10.0 * there[np.r_[0:40, 100:SMALL]].max()


# Stretches at no regular times


def bursts(*firsts_s: float, length_s: float, field_nt: tuple[float, float, float]) -> Array:
    on = np.zeros(COUNT)
    for first_s in firsts_s:
        on[(first_s <= TIME_S) & (first_s + length_s > TIME_S)] = 1.0
    return np.outer(on, field_nt)


def test_stretches_are_found_where_they_are_with_what_they_hold() -> None:
    field = bursts(700.0, 2900.0, 6100.0, length_s=240.0, field_nt=(0.0, 400.0, 0.0))
    search, fit = searching(flown(field))
    space = search.workspace(fit)
    sigma = math.sqrt(space.squares / space.count)
    found = _transients(_Beside(search, fit, space, space), sigma, 2.0)
    assert found is not None
    assert found.shape.name == "transients"
    inside = field[:, 1] > 0.0
    assert np.mean(np.abs(found.signal[inside])) > 6.0 * np.mean(np.abs(found.signal[~inside]))
    seen = space.projected((field * fit.unit).sum(axis=1)[:, None])[:, 0]
    assert found.squares == pytest.approx(float(seen @ seen), rel=0.25)
    dearer = _transients(_Beside(search, fit, space, space), sigma, 5.0)
    assert dearer is not None
    assert found.nats - dearer.nats == pytest.approx(3.0, abs=1e-9)


def test_samples_far_out_are_no_stretches() -> None:
    """Each in a place of its own: without the limit on what one sample counts for, they would be found as such."""
    rng = np.random.default_rng(41)
    field = np.zeros((COUNT, 3))
    rows = rng.choice(COUNT, 25, replace=False)
    field[rows] = 7.0 * NOISE_NT * scene().unit[rows]
    search, fit = searching(flown(field))
    space = search.workspace(fit)
    sigma = math.sqrt(space.squares / space.count)
    assert _transients(_Beside(search, fit, space, space), sigma, 0.0) is None
    held = space.clipped(3.5 * sigma)
    assert np.abs(held.residual).max() < 3.6 * sigma
    assert held.squares == pytest.approx(float(held.residual @ held.residual))
    assert np.abs(held.projected(fit.white_columns).T @ held.residual).max() < 1e-6 * np.abs(fit.white_columns).max()


def test_noise_has_no_stretches_and_what_fills_half_of_a_recording_is_none() -> None:
    quiet, at = searching(flown(np.zeros((COUNT, 3))))
    assert _transients(_Beside(quiet, at, quiet.workspace(at), quiet.workspace(at)), NOISE_NT, 0.0) is None
    always = bursts(*np.arange(0.0, COUNT * PERIOD_S, 400.0), length_s=230.0, field_nt=(500.0, 0.0, 0.0))
    search, fit = searching(flown(always))
    assert _transients(_Beside(search, fit, search.workspace(fit), search.workspace(fit)), NOISE_NT, 0.0) is None


# Recorded drivers before inferred ones


def driven(signal: Array, driver: str, **changes: object) -> Hypothesis:
    return replace(body_form("one", driver, along(0, signal)), driver=driver, **changes)  # type: ignore[arg-type]


def taken(channel: Hypothesis, *others: Hypothesis, inferred: str = "inferred:light") -> list[str]:
    """Drivers of the terms after the choice, where a term with an inferred driver had been kept."""
    mine = driven(SLOW, inferred)
    search, fit = searching(flown(along(0, 300.0 * SLOW)), mine, channel, *others)
    fit = solve(search.problem, fit.x, [Term(mine, np.zeros(0), np.array([300.0]))])
    found = search._by_channel(fit, FLOOR_NT)
    return [term.hypothesis.driver for term in found.terms]


def test_a_recorded_driver_that_holds_nearly_as_much_takes_the_place_of_an_inferred_one() -> None:
    assert taken(driven(SLOW + 0.02 * QUICK, "channel:t")) == ["channel:t"]


def test_a_recorded_driver_that_holds_much_less_does_not() -> None:
    assert taken(driven(SLOW + 0.6 * QUICK, "channel:t")) == ["inferred:light"]


def test_a_record_of_another_effect_is_no_driver_of_this_one() -> None:
    other = replace(body_form("other", "", along(0, SLOW)), driver="channel:t")
    assert taken(driven(OTHER, "channel:u"), other) == ["inferred:light"]


def test_a_term_whose_driver_is_recorded_stays() -> None:
    assert taken(driven(SLOW, "channel:t"), inferred="channel:v") == ["channel:v"]


def test_a_recorded_driver_beyond_its_physics_is_not_taken() -> None:
    assert taken(driven(SLOW, "channel:t", largest_nt=50.0)) == ["inferred:light"]


@pytest.mark.parametrize("room", [0, 10**9])
def test_columns_are_those_of_the_first_fit_kept_or_made_again(room: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """So that how many a search has room for decides nothing; looking at other vectors begins anew."""
    monkeypatch.setattr(screen, "_MOST_KEPT_BYTES", room)
    search, fit, _ = small(vector=False, field_nt=np.zeros((SMALL, 3)))
    plain = Hypothesis("one", "none", lambda _: along_axes(np.ones(SMALL)), (Block("nt", "nT"),))
    later = SimpleNamespace(unit=UNIT[::-1])
    asked = [search.rows_of(plain, np.zeros(0), one) for one in (fit, later)]  # type: ignore[arg-type]
    assert all(np.array_equal(rows, UNIT) for rows in asked)
    assert (asked[0] is asked[1]) == (room > 0)
    search.look_at(search.problem, ())
    assert np.array_equal(search.rows_of(plain, np.zeros(0), later), UNIT[::-1])  # type: ignore[arg-type]
