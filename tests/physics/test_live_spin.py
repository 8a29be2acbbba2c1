"""The spin axis in space from the field along the axis: known in minutes, and not taken for its mirror image."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from magcal_service.model import Array
from magcal_service.physics.apply.live_spin import _cost, _on_sphere, axis_of, axis_sums_with, no_axis_sums

AXIS = np.array([0.6, 0.0, 0.8])


def arc(count: int, degrees: float, bend: float) -> Array:
    """Directions (n, 3) of a field that goes through an angle in the plane of x and y, and rises out of it."""
    angle = np.radians(np.linspace(0.0, degrees, count))
    along = np.stack([np.cos(angle), np.sin(angle), bend * np.sin(2.0 * angle)], axis=1)
    return np.asarray(along / np.linalg.norm(along, axis=1)[:, None])


def sums_of(directions: Array, seed: int, offset: float = 0.0, noise: float = 0.01) -> Array:
    """What the stream has summed."""
    rng = np.random.default_rng([5150, seed])
    sums = no_axis_sums()
    for direction in directions:
        sums = axis_sums_with(sums, direction, float(direction @ AXIS) + offset + noise * rng.standard_normal())
    return sums


@pytest.mark.parametrize("seed", range(4))
def test_seven_minutes_of_a_low_orbit_make_it_known_to_a_tenth(seed: int) -> None:
    """Nine errors of another day are off by a percent; without the length, its sigma would be 0.23 rad."""
    found = axis_of(sums_of(arc(450, 40.0, 0.2), seed, offset=0.01))
    assert found is not None
    assert np.linalg.norm(found) == pytest.approx(1.0)
    assert np.arccos(found @ AXIS) < 0.1


def test_in_a_plane_the_mirror_image_fits_as_well_and_nothing_is_said() -> None:
    assert axis_of(sums_of(arc(1200, 80.0, 0.0), 1)) is None
    assert axis_of(sums_of(arc(1200, 80.0, 0.5), 1)) is not None


def test_of_a_field_that_has_hardly_turned_nothing_is_said() -> None:
    assert axis_of(sums_of(arc(60, 1.0, 0.5), 2)) is None
    assert axis_of(no_axis_sums()) is None


def test_what_misses_by_much_more_than_it_may_is_not_sure() -> None:
    """A craft that nutates by a third leaves as much along its axis."""
    assert axis_of(sums_of(arc(450, 40.0, 0.5), 3, noise=0.3)) is None


@cache
def whole_sphere() -> tuple[Array, NDArray[np.intp], NDArray[np.intp]]:
    """A fine grid of directions (n, 3), and all pairs of them that are less than 0.08 apart, as rows (m,) and (m,)."""
    index = np.arange(20000) + 0.5
    polar, around = np.arccos(1.0 - 2.0 * index / 20000), np.pi * (1.0 + 5.0**0.5) * index
    grid = np.stack([np.cos(around) * np.sin(polar), np.sin(around) * np.sin(polar), np.cos(polar)], axis=1)
    one, other = cKDTree(grid).query_pairs(0.08, output_type="ndarray").T
    return grid, one, other


@pytest.mark.parametrize("seed", range(8))
def test_the_minimum_on_the_sphere_is_that_of_a_search_over_all_of_it(seed: int) -> None:
    """Both minima, by brute force: every point of a fine grid that is below its neighbours."""
    rng = np.random.default_rng([77, seed])
    half = rng.standard_normal((3, 3))
    normal, right = half @ half.T, 0.3 * rng.standard_normal(3)
    best, mirror, multiplier = _on_sphere(normal, right)
    assert (normal - multiplier * np.eye(3)) @ best == pytest.approx(right, abs=1e-6)
    grid, one, other = whole_sphere()
    cost = np.einsum("ni,ij,nj->n", grid, normal, grid) - 2.0 * grid @ right
    assert _cost(best, normal, right) <= cost.min() + 1e-9
    lowest = np.ones(len(grid), dtype=bool)
    lowest[one[cost[one] > cost[other]]] = lowest[other[cost[other] > cost[one]]] = False
    others = [point for point in grid[lowest] if point @ best < 0.99]
    assert (mirror is None) == (not others)
    if mirror is not None:
        assert max(float(point @ mirror) for point in others) > 0.995
