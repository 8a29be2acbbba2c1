"""Ends of ranges: found on a lattice by what is missing there, and nowhere else."""

from __future__ import annotations

import numpy as np
import pytest

from magcal_service.model import Array, measure
from magcal_service.samples.stops import Stop, _Samples, stops

X = np.array([4000.0, -2500.0, 1200.0, 0.03, -0.05, 0.02, 0.01, -0.02, 0.015])
SIGMA_NT = 200.0
COUNT = 6000
SHALLOW_NT = 44_400.0


def turning(seed: int, sigma_nt: float = SIGMA_NT) -> tuple[Array, Array]:
    """B (n, 3) and |H| (n,) [nT] of a craft that turns 20 degrees a sample in a field that turns slowly."""
    rng = np.random.default_rng(seed)
    angle, slow = 0.349 * np.arange(COUNT), 2.0 * np.pi * np.arange(COUNT) / 2900.0
    size = 35_000.0 + 9000.0 * np.cos(2.0 * slow)
    across, along = np.cos(slow + 0.4), np.sin(slow + 0.4)
    field = size[:, None] * np.stack([across * np.cos(angle), across * np.sin(angle), along], axis=1)
    return measure(X, field + rng.normal(0.0, sigma_nt, field.shape)), size


def rounded(field: Array, step_nt: float) -> Array:
    return np.round(field / step_nt) * step_nt


def stopped(field: Array, axis: int, at_nt: float) -> Array:
    """The same, with an axis that ends at a value, on the value's side of zero."""
    field = field.copy()
    side = np.sign(at_nt)
    field[:, axis] = side * np.minimum(side * field[:, axis], side * at_nt)
    return field


def where(field: Array, size: Array) -> list[tuple[int, float]]:
    return [(one.axis, one.at_nt) for one in stops(field, size)]


@pytest.mark.parametrize(("axis", "at_nt"), [(0, 43_800.0), (1, -45_900.0), (2, 32_700.0)])
def test_a_stop_on_a_lattice_is_found_by_what_is_missing(axis: int, at_nt: float) -> None:
    """At 1.5 sigma of lattice, where the end comes less than five times as often as a level beside it."""
    field, size = turning(50)
    field = stopped(rounded(field, 300.0), axis, at_nt)
    counts = np.unique(np.abs(field[:, axis] - at_nt), return_counts=True)[1]
    assert counts[0] < 5.0 * counts[1:6].max()
    assert where(field, size) == [(axis, at_nt)]


def test_a_shallow_stop_shows_by_its_count_and_what_is_missing_together() -> None:
    """Neither by itself: few samples reach it, and come less than three times as often as those beside them."""
    field, size = turning(56)
    coarse = rounded(field, 300.0)
    field = stopped(coarse, 0, SHALLOW_NT)
    counts = np.unique(np.abs(field[:, 0] - SHALLOW_NT), return_counts=True)[1]
    assert 2.0 * counts[1:6].max() < counts[0] < 3.0 * counts[1:6].max()
    assert where(field, size) == [(0, SHALLOW_NT)]
    assert where(coarse, size) == []


def test_a_value_that_comes_thrice_where_each_comes_once_is_a_stop() -> None:
    """By no magnitude.  Two are none, nor is one sample sent three times, nor what comes so on a coarser lattice."""
    field, _ = turning(57)
    nowhere, fine = np.full(COUNT, np.nan), rounded(field, 0.01)
    third = float(np.sort(fine[:, 1])[-3])
    assert where(stopped(fine, 1, third), nowhere) == [(1, third)]
    assert where(stopped(fine, 1, float(np.sort(fine[:, 1])[-2])), nowhere) == []
    held = fine.copy()
    top = int(np.argmax(fine[:, 1]))
    held[top : top + 3] = held[top]
    assert where(held, nowhere) == []
    assert where(rounded(stopped(fine, 1, third), 100.0), nowhere) == []


def test_without_magnitudes_only_the_count_shows_a_stop() -> None:
    """None is found where the end comes too seldom for it, and one is where it comes often."""
    field, size = turning(51)
    nowhere = np.full(COUNT, np.nan)
    assert where(stopped(rounded(field, 300.0), 0, 43_800.0), nowhere) == []
    (stop,) = stops(stopped(field, 0, 40_000.0), nowhere)
    assert (stop.axis, stop.at_nt) == (0, 40_000.0)
    assert not stop.near.any()
    assert where(stopped(rounded(field, 300.0), 0, 43_800.0), size) == [(0, 43_800.0)]


def test_each_of_several_stops_is_found_and_no_axis_beside_them() -> None:
    """What is missing on one axis is not held against another that is at its end at the time."""
    field, size = turning(52)
    both = stopped(stopped(rounded(field, 300.0), 1, 40_500.0), 0, -36_000.0)
    assert where(both, size) == [(0, -36_000.0), (1, 40_500.0)]


@pytest.mark.parametrize(
    ("step_nt", "axis", "at_nt"), [(300.0, 0, 42_600.0), (40.0, 1, -44_000.0), (100.0, 2, 32_000.0)]
)
def test_what_stops_before_its_noise_is_found_with_all_that_the_noise_moves(
    step_nt: float, axis: int, at_nt: float
) -> None:
    """Half of what is stopped lies inside of the end then, as short as what lies at it: of the two none tells."""
    field, size = turning(52, sigma_nt=0.0)
    noise = np.random.default_rng(53).normal(0.0, SIGMA_NT, field.shape)
    side = np.sign(at_nt)
    beyond = side * field[:, axis] > side * at_nt
    spoiled = stopped(rounded(stopped(field, axis, at_nt) + noise, step_nt), axis, at_nt)
    assert where(rounded(field + noise, step_nt), size) == []
    (found,) = stops(spoiled, size)
    assert (found.axis, found.at_nt) == (axis, at_nt)
    assert np.mean(found.spoiled[beyond]) > 0.98
    assert np.count_nonzero(found.spoiled & ~beyond) < 0.5 * np.count_nonzero(beyond)


def test_without_any_noise_nothing_is_taken_away_from_an_end() -> None:
    """An end that comes often, of samples that fit to the last digit."""
    size = np.full(COUNT, 40_000.0)
    field = 40_000.0 * np.stack([np.ones(COUNT), np.zeros(COUNT), np.zeros(COUNT)], axis=1)
    samples = _Samples(field, size, np.ones(COUNT, dtype=bool))
    samples.__dict__["noise_nt"] = 0.0
    end = Stop(0, 1.0, 40_000.0, np.ones(COUNT, dtype=bool), np.zeros(COUNT, dtype=bool))
    assert samples.excess_in_reach(end, samples.known) == 0.0


def test_the_axes_of_a_sensor_have_one_range() -> None:
    """An end that shows nothing of itself is a stop at the value at which another axis stops, and at no other."""
    field, size = turning(53)
    coarse = stopped(rounded(field, 600.0), 2, 33_600.0)
    assert where(coarse, size) == []
    assert where(stopped(coarse, 0, -33_600.0), size) == [(0, -33_600.0), (2, 33_600.0)]
    assert where(stopped(coarse, 0, -33_000.0), size) == [(0, -33_000.0)]


@pytest.mark.parametrize("step_nt", [20.0, 200.0, 600.0])
def test_an_end_that_noise_reaches_is_no_stop(step_nt: float) -> None:
    """The largest of a turning field on a lattice, in five recordings."""
    for seed in range(60, 65):
        field, size = turning(seed)
        assert where(rounded(field, step_nt), size) == []


@pytest.mark.parametrize("step_nt", [60.0, 200.0, 600.0])
def test_a_bend_towards_the_end_is_no_stop(step_nt: float) -> None:
    """A cubic response that lacks 4 uT at the end, and a soft knee that takes up to two fifths of the growth."""
    field, size = turning(70)
    largest = np.abs(field).max(axis=0)
    cubic = field - 4000.0 * (field / largest) ** 3
    assert where(rounded(cubic, step_nt), size) == []
    beyond = np.maximum(np.abs(field) / largest - 0.9, 0.0) / 0.1
    knee = field - np.sign(field) * 0.2 * 0.1 * largest * beyond**2
    assert where(rounded(knee, step_nt), size) == []


def test_a_bias_that_drifts_is_no_stop() -> None:
    """By 4 uT along each axis, over the recording and to and fro."""
    field, size = turning(80)
    course = np.linspace(-1.0, 1.0, COUNT)
    for drift in (course, np.sin(5.0 * course), np.sign(course)):
        assert where(rounded(field + 2000.0 * drift[:, None], 300.0), size) == []


@pytest.mark.parametrize("step_nt", [9000.0, 25_000.0])
def test_an_axis_that_stays_within_a_few_steps_of_its_lattice_has_no_stop(step_nt: float) -> None:
    """One that holds still but for a few samples, and one that turns over four levels."""
    field, size = turning(85)
    assert where(rounded(field, step_nt), size) == []
    field[:, 2] = np.where(np.arange(COUNT) % 40 == 0, 1.0, 2.0) * step_nt
    assert where(rounded(field, step_nt), size) == []


def test_samples_near_a_stop_are_those_that_noise_alone_kept_from_it() -> None:
    """Within three sigma of it without their noise, and not at it: of ten that are found nine are, and the reverse."""
    field, size = turning(90)
    clean, _ = turning(90, sigma_nt=0.0)
    (stop,) = stops(stopped(field, 2, 32_400.0), size)
    expected = (clean[:, 2] > 32_400.0 - 3.0 * SIGMA_NT) & ~stop.rows
    assert np.count_nonzero(expected) > 30
    assert np.count_nonzero(stop.near & expected) > 0.9 * max(np.count_nonzero(one) for one in (stop.near, expected))


def test_samples_near_many_stops_are_told_as_surely_as_near_one() -> None:
    """A range that ends within the field, where half of the samples are at an end."""
    field, size = turning(91)
    clean, _ = turning(91, sigma_nt=0.0)
    limit, short = 30_000.0, field
    for axis, side in ((0, 1.0), (0, -1.0), (1, 1.0), (1, -1.0), (2, 1.0), (2, -1.0)):
        short = stopped(short, axis, side * limit)
    found = stops(short, size)
    assert len(found) >= 4
    at_one = np.any([one.rows for one in found], axis=0)
    near = np.any([one.near for one in found], axis=0)
    reached = [one.side * clean[:, one.axis] > limit - 3.0 * SIGMA_NT for one in found]
    expected = np.any(reached, axis=0) & ~at_one
    assert np.count_nonzero(near ^ expected) < 0.1 * np.count_nonzero(expected)


def test_two_ends_at_one_value_are_stops_by_less_of_a_count() -> None:
    """At four times the values beside them, and not where they differ; nor where the field is one, as in a room."""
    counts = np.array([40, 10, 10, 10, 10, 10, 10])
    changing = np.linspace(30_000.0, 50_000.0, 2000)
    column = np.concatenate(
        [np.repeat(30_000.0 - 100.0 * np.arange(len(counts)), counts), np.linspace(-2e4, 2e4, 1900)]
    )
    other = column[::-1].copy()
    rest = 10.0 * np.arange(2000.0)
    unknown = np.where(np.arange(2000) < 50, changing, np.nan)  # too few to fit anything to
    unknown[-1] = 50_000.0
    assert where(np.stack([column, other, rest], axis=1), unknown) == [(0, 30_000.0), (1, 30_000.0)]
    assert where(np.stack([column, -other, rest], axis=1), unknown) == [(0, 30_000.0), (1, -30_000.0)]
    assert where(np.stack([column, other + 100.0, rest], axis=1), unknown) == []
    assert where(np.stack([column, other, rest], axis=1), np.full(2000, 43_000.0)) == []


def test_a_turntable_that_holds_each_axis_up_has_no_stop() -> None:
    """Each in turn along the field of a room, eight stations of thirty samples, on a lattice of five sigma."""
    angle = np.repeat(np.arange(8) * np.pi / 4.0, 30)
    level = np.stack([20_000.0 * np.cos(angle), 20_000.0 * np.sin(angle), np.full(len(angle), 43_000.0)], axis=1)
    held = np.concatenate([np.roll(level, axis, axis=1) for axis in range(3)])
    field = rounded(held + np.random.default_rng(9081).normal(0.0, 30.0, held.shape), 150.0)
    assert where(field, np.full(len(field), float(np.hypot(20_000.0, 43_000.0)))) == []


def test_what_reaches_a_stated_range_is_at_a_stop_however_seldom_it_is() -> None:
    """On a lattice where the samples alone show no stop; with those near it, and up to whatever lies beyond."""
    field, size = turning(92)
    coarse = stopped(rounded(field, 600.0), 2, 33_600.0)
    assert where(coarse, size) == []
    (stop,) = stops(coarse, size, 33_600.0)[-1:]
    assert (stop.axis, stop.at_nt) == (2, 33_600.0)
    assert np.array_equal(stop.rows, coarse[:, 2] >= 33_600.0)
    assert stop.near.any()
    one = np.zeros((200, 3))
    one[7, 1] = -50_100.0
    (alone,) = stops(one, np.full(200, np.nan), 50_000.0)
    assert (alone.axis, alone.at_nt, np.flatnonzero(alone.rows).tolist()) == (1, -50_000.0, [7])


def test_a_stated_range_that_nothing_reaches_changes_nothing() -> None:
    """Beside a stop below it, which the samples show."""
    field, size = turning(93)
    short = stopped(field, 0, 40_000.0)
    (stop,), (stated,) = stops(short, size), stops(short, size, 60_000.0)
    assert (stop.axis, stop.at_nt) == (stated.axis, stated.at_nt) == (0, 40_000.0)
    assert np.array_equal(stop.spoiled, stated.spoiled)


def test_an_end_on_the_coarse_part_of_an_uneven_lattice_is_no_stop() -> None:
    """Steps of 15 nT from 20 uT on and of 0.5 nT below: 60 ends of clean recordings, each three times or more."""
    for seed in range(300, 310):
        field, size = turning(seed, sigma_nt=30.0)
        uneven = np.where(np.abs(field) > 20_000.0, rounded(field, 15.0), rounded(field, 0.5))
        assert where(uneven, size) == []
        assert where(uneven, np.full(COUNT, np.nan)) == []
