"""The Cramer-Rao bounds against the published table, against each other, and against numerical derivatives."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from magcal_service.estimators.interface import InformationSet
from magcal_service.model import Array
from magcal_service.studies.bounds import Flight, _spin_rows, bound_over_time, bound_sigma
from tests.estimators.method_data import NEAR_NORMAL, paper_field

DIAGONAL = (1.0, 1.0, 1.0)

# 3 sigma as the table prints them: bx and by, bz [nT], D11 and D22, D33, D12, D13 and D23; half a unit of the last
PUBLISHED = [
    (InformationSet.SCALAR, DIAGONAL, (13.5, 10.4, 5.5e-4, 3.7e-4, 4.4e-4, 3.9e-4), (0.05, 0.05, *[5e-6] * 4)),
    (
        InformationSet.SCALAR,
        NEAR_NORMAL,
        (14.2, 111.0, 4e-4, 1.2e-2, 2.8e-4, 1.1e-3),
        (0.05, 0.5, 5e-5, 5e-4, 5e-6, 5e-5),
    ),
    (InformationSet.VECTOR_SPIN, DIAGONAL, (7.05, 7.14, 3.8e-4, 2.9e-4, 2.7e-4, 2.3e-4), (0.005, 0.005, *[5e-6] * 4)),
    (
        InformationSet.VECTOR_SPIN,
        NEAR_NORMAL,
        (7.1, 14.4, 2.8e-4, 1.6e-3, 2e-4, 2.9e-4),
        (0.05, 0.05, 5e-6, 5e-5, 5e-6, 5e-6),
    ),
]


@pytest.mark.parametrize(("known", "direction", "published", "rounding"), PUBLISHED)
def test_against_the_published_bounds_of_the_papers_orbit(
    known: InformationSet,
    direction: tuple[float, float, float],
    published: tuple[float, ...],
    rounding: tuple[float, ...],
) -> None:
    """2 %, and half a unit of the digit to which they are printed; pairs are printed as one number."""
    bx, by, bz, d11, d22, d33, d12, d13, d23 = 3.0 * bound_sigma(paper_field(direction).flight(), known)
    ours = np.array([(bx + by) / 2, bz, (d11 + d22) / 2, d33, d12, (d13 + d23) / 2])
    assert np.all(np.abs(ours - published) <= 0.02 * np.array(published) + np.array(rounding))


@pytest.mark.parametrize("direction", [DIAGONAL, NEAR_NORMAL])
def test_more_knowledge_never_raises_a_bound(direction: tuple[float, float, float]) -> None:
    flight = paper_field(direction).flight()
    by_set = [bound_sigma(flight, known) for known in InformationSet]
    for less, more in pairwise(by_set):
        assert np.all(more <= less * (1.0 + 1e-9))


def test_an_unknown_body_axis_costs_accuracy_across_it_only() -> None:
    flight = paper_field(NEAR_NORMAL).flight()
    known = bound_sigma(flight, InformationSet.VECTOR_SPIN)
    unknown = bound_sigma(flight, InformationSet.VECTOR_SPIN, body_axis_known=False)
    assert np.all(unknown >= known * (1.0 - 1e-9))
    assert unknown[0] > 1.2 * known[0]
    assert unknown[3] < 1.05 * known[3]


@pytest.mark.parametrize("known", list(InformationSet))
def test_a_bound_only_falls_with_time(known: InformationSet) -> None:
    over_time = bound_over_time(paper_field().flight(), known, np.array([600.0, 1800.0, 6000.0, 18000.0]))
    assert np.all(np.diff(over_time, axis=0) < 0.0)


def test_the_last_of_the_bounds_over_time_is_the_final_one() -> None:
    flight = paper_field().flight()
    over_time = bound_over_time(flight, InformationSet.SCALAR_SPIN, np.array([900.0, flight.times_s[-1]]))
    np.testing.assert_allclose(over_time[-1], bound_sigma(flight, InformationSet.SCALAR_SPIN), rtol=1e-12)


def test_a_bound_is_proportional_to_the_noise() -> None:
    field = paper_field()
    one, two = (bound_sigma(field.flight(noise_nt=noise), InformationSet.VECTOR_SPIN) for noise in (100.0, 200.0))
    np.testing.assert_allclose(two, 2.0 * one, rtol=1e-9)


def test_too_few_samples_have_no_bound() -> None:
    assert np.all(np.isinf(bound_over_time(paper_field().flight(), InformationSet.SCALAR, np.array([4.0]))))


@pytest.mark.parametrize("known", [InformationSet.SCALAR_SPIN, InformationSet.VECTOR_SPIN])
def test_a_set_with_spin_refuses_a_flight_without(known: InformationSet) -> None:
    flight = replace(paper_field().until(600.0).flight(), spin_axis=None)
    with pytest.raises(ValueError, match="needs a spin axis"):
        bound_sigma(flight, known)


def test_a_set_with_spin_windows_refuses_a_flight_without_their_length() -> None:
    flight = replace(paper_field().until(600.0).flight(), window_s=0.0)
    with pytest.raises(ValueError, match="needs the length of a spin window"):
        bound_sigma(flight, InformationSet.SCALAR_SPIN)


def rotation(vector: Array) -> Array:
    """exp([v]x) by the eigenvectors of [v]x, independent of Rodrigues' formula."""
    x, y, z = vector
    values, vectors = np.linalg.eig(np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]))
    return np.real((vectors * np.exp(values)) @ np.linalg.inv(vectors))


def test_the_nuisance_rows_are_the_numerical_derivatives_of_the_spin() -> None:
    axis, rate = np.array([0.36, -0.48, 0.8]), 0.7
    times = np.linspace(-20.0, 20.0, 9)
    start = np.array([20_000.0, -10_000.0, 30_000.0])

    def field(theta: Array, rate_vector: Array) -> Array:
        return np.stack([rotation(-rate_vector * t) @ rotation(theta) @ start for t in times])

    zero, steady = np.zeros(3), axis * rate
    flight = Flight(times, field(zero, steady), np.zeros(9), 1.0, axis, rate)
    rows = _spin_rows(flight, body_axis_known=False)
    h = 1e-6
    turns = [(field(e, steady) - field(-e, steady)) / (2 * h) for e in h * np.eye(3)]
    rates = [(field(zero, steady + e) - field(zero, steady - e)) / (2 * h) for e in h * np.eye(3)]
    np.testing.assert_allclose(rows[:, :, :3], np.stack(turns, axis=2), rtol=0.0, atol=1e-2)
    np.testing.assert_allclose(rows[:, :, 3:], -np.stack(rates, axis=2), rtol=0.0, atol=1e-1)
