"""Nonlinear numbers moved from the best of a grid: where they end, where they may go, and by which steps."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from magcal_service.diagnosis.linear import Gain
from magcal_service.diagnosis.problem import Problem
from magcal_service.diagnosis.refine import _allowed, _first_step, _last_step, refined
from magcal_service.model import Array
from magcal_service.physics.columns import along_axes
from magcal_service.physics.interface import Block, Hypothesis, Nonlinear
from tests.physics.scenes import NOISE_NT, PERIOD_S, scene

PROBLEM = Problem(scene(), NOISE_NT)
SPAN_S = float(np.ptp(scene().time_s))
GRID = np.array([1.0, 2.0, 4.0, 8.0])


def number(role: str = "", grid: Array = GRID) -> Nonlinear:
    return Nonlinear("number", "s", grid, role)


def moved(nats: Callable[[Array], float | None], start: list[float], *numbers: Nonlinear) -> tuple[Array, Gain, int]:
    """Where the numbers end, their gain, and how often a gain was asked for."""
    asked = 0

    def gain(theta: Array) -> Gain | None:
        nonlocal asked
        asked += 1
        found = nats(theta)
        return None if found is None else Gain(found, 0.0, 0.0, np.zeros(0))

    form = Hypothesis("one", "none", lambda _: along_axes(scene().time_s), (Block("nt", "nT"),), nonlinear=numbers)
    first = gain(np.array(start))
    assert first is not None
    grids = [each.grid for each in numbers]
    theta, best = refined(form, gain, np.array(start), first, grids, PROBLEM)
    return theta, best, asked


@pytest.mark.parametrize("best", [2.3, 3.3, 4.0, 5.7])
def test_a_number_ends_within_its_last_step_of_the_best(best: float) -> None:
    """Two hundredths of itself, from the grid's value beside it."""
    theta, gain, _ = moved(lambda at: -float((at[0] - best) ** 2), [4.0], number())
    assert float(theta[0]) == pytest.approx(best, abs=0.02 * best)
    assert gain.nats == pytest.approx(-float((theta[0] - best) ** 2), abs=1e-12)


@pytest.mark.parametrize(("start", "best", "end"), [(4.0, 20.0, 8.0), (2.0, -3.0, 1.0)])
def test_a_number_goes_as_far_as_its_grid_and_no_farther(start: float, best: float, end: float) -> None:
    theta, _, _ = moved(lambda at: -abs(float(at[0]) - best), [start], number())
    assert float(theta[0]) == pytest.approx(end, rel=0.02)
    assert GRID.min() <= float(theta[0]) <= GRID.max()


def test_what_has_no_gain_is_passed_over() -> None:
    """Above 5 nothing is known: the best below it is found."""
    theta, _, _ = moved(lambda at: None if at[0] > 5.0 else float(at[0]), [4.0], number())
    assert float(theta[0]) == pytest.approx(5.0, rel=0.02)


def test_a_number_without_a_grid_to_move_in_stays() -> None:
    theta, _, asked = moved(lambda at: -float(at[0] ** 2), [4.0], number(grid=np.array([4.0])))
    assert (float(theta[0]), asked) == (4.0, 1)


def test_the_numbers_that_were_given_are_not_written_to() -> None:
    start = np.array([4.0])
    form = Hypothesis("one", "none", lambda _: along_axes(scene().time_s), (Block("nt", "nT"),), nonlinear=(number(),))
    refined(form, lambda at: Gain(float(at[0]), 0, 0, at), start, Gain(4.0, 0, 0, start), [GRID], PROBLEM)
    assert start[0] == 4.0


def test_two_numbers_that_hang_together_are_gone_over_twice() -> None:
    """Each pass takes both a part of the way up the valley a = b to 6: 2, 3.3 after the first, 3.3, 4.2 after two."""
    wide = np.array([1.0, 2.0, 4.0, 8.0])
    theta, _, _ = moved(
        lambda at: -float((at[0] - at[1]) ** 2 + 0.5 * (at[1] - 6.0) ** 2),
        [2.0, 2.0],
        number("", wide),
        number("", wide),
    )
    assert theta == pytest.approx([10.0 / 3.0, 38.0 / 9.0], abs=0.1)


def test_one_number_is_gone_over_once() -> None:
    """Once its step has shrunk to the last one nothing more is asked: halvings of 1 down to 0.08, both ways."""
    _, _, asked = moved(lambda at: -float((at[0] - 4.0) ** 2), [4.0], number())
    assert asked == 1 + 2 * 4


@pytest.mark.parametrize(
    ("role", "value", "allowed"),
    [
        ("frequency", 0.0, False),
        ("frequency", 1e-9, True),
        ("period", -1.0, False),
        ("period", 1e9, True),
        ("", 0.99, False),
        ("", 1.0, True),
        ("", 8.0, True),
        ("instant", 8.01, False),
    ],
)
def test_lines_have_to_be_positive_and_others_within_their_grid(role: str, value: float, allowed: bool) -> None:
    assert _allowed(number(role), value) is allowed


@pytest.mark.parametrize(
    ("role", "value", "grid", "step"),
    [
        ("frequency", 0.02, GRID, 0.25 / SPAN_S),
        ("period", 50.0, GRID, 0.25 * 50.0**2 / SPAN_S),
        ("", 4.0, GRID, 1.0),
        ("", 1.0, GRID, 0.5),
        ("", 8.0, GRID, 2.0),
        ("instant", 2.1, GRID, 0.5),
        ("", 4.0, GRID[:1], 0.0),
    ],
)
def test_the_first_step_is_half_the_gap_below_or_a_quarter_of_a_line(
    role: str, value: float, grid: Array, step: float
) -> None:
    assert _first_step(number(role), value, grid, PROBLEM) == pytest.approx(step)


@pytest.mark.parametrize(
    ("role", "value", "step"),
    [
        ("frequency", 0.02, 0.005 / SPAN_S),
        ("period", 50.0, 0.005 * 50.0**2 / SPAN_S),
        ("instant", 50.0, 0.4 * PERIOD_S),
        ("", 50.0, 1.0),
        ("", -50.0, 1.0),
        ("", 0.0, 2e-5),
    ],
)
def test_the_last_step_is_what_cannot_be_told_apart(role: str, value: float, step: float) -> None:
    assert _last_step(number(role), value, PROBLEM) == pytest.approx(step)


def test_no_numbers_are_tried_twice() -> None:
    """Not even where two numbers are moved in two passes, and the second passes the same places again."""
    seen: list[bytes] = []

    def nats(at: Array) -> float:
        seen.append(at.tobytes())
        return -float((at[0] - 3.3) ** 2 + (at[1] - 5.0) ** 2)

    theta, _, asked = moved(nats, [4.0, 4.0], number(), number())
    assert theta == pytest.approx([3.3, 5.0], rel=0.03)
    assert len(set(seen)) == asked
