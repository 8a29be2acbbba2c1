"""Recordings in passes: a slow name has to foretell whole passes from the others."""

from __future__ import annotations

import numpy as np
import pytest

from magcal_service.diagnosis.blocks import pass_numbers
from magcal_service.diagnosis.passes import foretells
from magcal_service.diagnosis.problem import Fit, Problem, Term
from magcal_service.diagnosis.solution import solve
from magcal_service.model import Array, measure
from magcal_service.physics.columns import along_axes
from magcal_service.physics.interface import Block, Hypothesis
from magcal_service.physics.scene.scene import Scene
from tests.physics.scenes import NOISE_NT, X, scene

HELD = 40  # samples in a pass


def test_passes_are_few_stretches_far_apart() -> None:
    apart = np.concatenate([np.arange(240.0) + 6000.0 * number for number in range(3)])
    numbers = pass_numbers(apart)
    assert numbers is not None
    assert np.unique(numbers).tolist() == [0, 1, 2]
    assert np.bincount(numbers).tolist() == [240, 240, 240]


@pytest.mark.parametrize(
    "time_s",
    [
        np.arange(5000.0),
        np.concatenate([np.arange(5000.0), np.arange(5700.0, 9000.0)]),  # one gap in a recording
        np.concatenate([np.arange(240.0) + 6000.0 * number for number in range(13)]),
        np.concatenate([np.arange(240.0) + 600.0 * number for number in range(3)]),
    ],
    ids=["whole", "gap", "thirteen", "near"],
)
def test_what_is_whole_has_gaps_or_many_passes_is_no_few_passes(time_s: Array) -> None:
    assert pass_numbers(time_s) is None


def fitted(count: int, course: Array, added_nt: Array) -> Fit:
    """A term that follows a course (n,), on ``count`` passes of a flight that have ``added_nt`` (n,) along x."""
    whole = scene()
    step = len(whole) // count
    rows = np.concatenate([np.arange(HELD) + number * step for number in range(count)])
    field = whole.calibrated_nt[rows] + added_nt[:, None] * np.array([1.0, 0.0, 0.0])
    noise = NOISE_NT * np.random.default_rng(count).normal(size=field.shape)
    measured = measure(X, field + noise)
    times = rows * (6000.0 / step)
    flown = Scene(
        times, 0, False, measured, field, measured, np.linalg.norm(whole.calibrated_nt[rows], axis=1), in_orbit=True
    )
    form = Hypothesis("made_up", "none", lambda _: along_axes(course), (Block("nt", "nT"),))
    return solve(Problem(flown, NOISE_NT), X, [Term(form, np.zeros(0), np.array([1.0, 0.0, 0.0]))])


def courses(count: int, seed: int) -> tuple[Array, Array]:
    """One value a pass (n,), drawn; and one a sample (n,), which goes on within passes as well."""
    rng = np.random.default_rng(seed)
    slow = np.repeat(rng.normal(0.0, 300.0, count), HELD)
    return slow, rng.normal(0.0, 300.0, count * HELD)


@pytest.mark.parametrize("count", [4, 10])
def test_a_course_that_goes_on_within_passes_is_foretold(count: int) -> None:
    _, quick = courses(count, 3)
    assert foretells(fitted(count, quick, quick), 0)


@pytest.mark.parametrize("count", [3, 4])
def test_a_value_in_one_pass_is_not_foretold_from_the_others(count: int) -> None:
    """One pass is off by 300 nT; a name that acts in that one alone holds all of it, and foretells nothing."""
    alone = np.repeat((np.arange(count) == 1).astype(float), HELD)
    assert not foretells(fitted(count, alone, 300.0 * alone), 0)


def test_a_value_for_each_of_many_passes_is_foretold_by_what_it_follows() -> None:
    slow, _ = courses(10, 5)
    assert foretells(fitted(10, slow, slow), 0)


def test_a_value_for_each_pass_that_goes_with_another_is_not_foretold() -> None:
    """What differs from pass to pass, named by a course that has nothing to do with it: twelve draws, three passes."""
    said = 0
    for seed in range(12):
        (true, _), (other, _) = courses(3, 100 + seed), courses(3, 200 + seed)
        said += foretells(fitted(3, other, true), 0)
    assert said <= 2


def test_where_there_are_no_passes_there_is_nothing_to_foretell() -> None:
    _, quick = courses(4, 3)
    whole = fitted(4, quick, np.zeros(4 * HELD))
    dense = Problem(
        Scene(
            np.arange(len(quick)) * 1.0,
            0,
            False,
            *([whole.problem.scene.field_nt] * 3),
            whole.problem.scene.magnitude_nt,
        ),
        NOISE_NT,
    )
    assert foretells(solve(dense, X, whole.terms), 0)
