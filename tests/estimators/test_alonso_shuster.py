"""The published case of TWO-STEP: Alonso & Shuster 2002.

Circular orbit of 560 km and 38 degrees, field of 1994, one sample every 8 s, 15 rpm, 2.0 mG isotropic noise.  15 rpm at
8 s is two whole turns a sample: taken literally the craft does not turn at all between samples.  Date, node, spin axis
and the number of samples are not known here; taken are the equinox of 1994, a node of 240 deg, the axis towards the Sun
and one orbit, so the published sigmas can be met to a factor only.
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest

from magcal_service.config.settings import CraftConfig, FilterConfig, SensorConfig
from magcal_service.estimators import find_method
from magcal_service.estimators.interface import InformationSet, StateEstimate
from magcal_service.estimators.parts.magnitude_sums import MagnitudeSums
from magcal_service.estimators.parts.noise_level import NoiseLevel
from magcal_service.estimators.parts.start import prior_sigma
from magcal_service.estimators.two_step import Solution, two_step
from magcal_service.model import Array
from magcal_service.studies.bounds import Flight, bound_sigma
from magcal_service.studies.flights import FlightPlan, fly
from magcal_service.ticks.assembler import Tick

EQUINOX_1994_NS = 764_208_000 * 10**9
TRUTH = (3000.0, 6000.0, 9000.0, 0.05, 0.10, 0.05, 0.05, 0.05, 0.05)  # nT; 1 mG = 100 nT
NOISE_NT = 200.0
EVERY_S = 8

PUBLISHED = np.array([2951.0, 5996.0, 9013.0, 0.0487, 0.1005, 0.0492])  # nT, -
PUBLISHED_SIGMA = np.array([33.0, 19.0, 32.0, 0.0014, 0.0011, 0.0023])

RATES_RPM = {"whole turns": 15.0, "half turns": 18.75, "turning": 15.6}
"""Spin rates that turn the craft by 720, 900 and 748.8 degrees between two samples."""


@cache
def flight(convention: str) -> Flight:
    """The noise-free samples, by how far the craft turns between two of them."""
    plan = FlightPlan(
        start_utc_ns=EQUINOX_1994_NS,
        altitude_km=560.0,
        inclination_deg=38.0,
        node_deg=240.0,
        spin_eci=(1.0, 0.0, 0.0),  # the Sun at the equinox
        rate_rpm=RATES_RPM[convention],
        phase_rad=math.radians(160.0),
        duration_s=5744,
        x=TRUTH,
    )
    flown = fly(plan)
    return Flight(flown.times_s[::EVERY_S], flown.field_body_nt[::EVERY_S], np.array(TRUTH), NOISE_NT)


def samples(convention: str) -> tuple[Array, Array, Array]:
    """Times (n,) [s], measured vectors (n, 3) and |H| (n,) [nT]."""
    field = flight(convention).field_body_nt
    noisy = field + NOISE_NT * np.random.default_rng(2002).standard_normal(field.shape)
    measured = np.linalg.solve(np.eye(3) + d_of(TRUTH), (noisy + np.array(TRUTH[:3])).T).T
    return flight(convention).times_s, measured, np.linalg.norm(field, axis=1)


def d_of(x: tuple[float, ...]) -> Array:
    """D (3, 3), written out apart from the model that is tested."""
    return np.array([[x[3], x[6], x[7]], [x[6], x[4], x[8]], [x[7], x[8], x[5]]])


def batch(convention: str) -> Solution:
    _, measured, magnitude = samples(convention)
    sums = MagnitudeSums()
    sums.add(measured, magnitude)
    solution = two_step(sums, NoiseLevel(NOISE_NT), prior_sigma(FilterConfig()))
    assert isinstance(solution, Solution)
    return solution


def played(method: str, convention: str) -> StateEstimate:
    times, measured, magnitude = samples(convention)
    estimator = find_method(method).build(CraftConfig("craft", sensor=SensorConfig(noise_nt=NOISE_NT)))
    for i in range(len(times)):
        estimator.handle(Tick(i, times[i : i + 1], measured[i : i + 1], magnitude[i : i + 1], None))
    return estimator.estimate()


def test_against_alonso_shuster_2002() -> None:
    """Half a turn between samples: sigmas within a factor of 1.8, estimates within 3 combined sigmas [nT, -]."""
    solution = batch("half turns")
    sigma = np.sqrt(np.diagonal(solution.covariance))[:6]
    ratio = sigma / PUBLISHED_SIGMA
    assert ratio.max() < 1.8
    assert ratio.min() > 1.0 / 1.8
    assert sigma[0] > sigma[1]  # the published order: bx worse than by
    assert np.abs((solution.x[:6] - PUBLISHED) / np.hypot(sigma, PUBLISHED_SIGMA)).max() < 3.0


def test_whole_turns_between_samples_cannot_give_the_published_sigmas() -> None:
    """Even the bound is then at least twice the published sigma, for each of the six [nT, -]."""
    bound = bound_sigma(flight("whole turns"), InformationSet.SCALAR)[:6]
    assert (bound / PUBLISHED_SIGMA).min() > 2.0


def test_a_craft_that_turns_evenly_between_samples_gives_x_and_y_the_same_sigma() -> None:
    """Within 10 %, where the published ones differ by 74 %: that phase convention is not theirs either."""
    sigma = np.sqrt(np.diagonal(batch("turning").covariance))
    assert sigma[0] / sigma[1] == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize("convention", ["half turns", "turning"])
def test_two_step_attains_the_bound_to_5_percent(convention: str) -> None:
    sigma = np.sqrt(np.diagonal(batch(convention).covariance))
    assert sigma / bound_sigma(flight(convention), InformationSet.SCALAR) == pytest.approx(np.ones(9), abs=0.05)


@pytest.mark.parametrize("convention", ["half turns", "turning"])
@pytest.mark.parametrize("method", ["two-step", "scalar-ukf", "ukf"])
def test_every_method_finds_the_true_errors_within_its_sigma(method: str, convention: str) -> None:
    """Within 3.5 sigma, which for the filters is up to four times the bound: they discount what made their start."""
    state = played(method, convention)
    sigma = np.sqrt(np.diagonal(state.covariance))
    ratio = sigma / bound_sigma(flight(convention), InformationSet.SCALAR)
    assert np.abs((state.x - np.array(TRUTH)) / sigma).max() < 3.5
    assert ratio.min() > 0.9
    assert ratio.max() < 4.0


if __name__ == "__main__":
    for name in RATES_RPM:
        own = bound_sigma(flight(name), InformationSet.SCALAR)[:6]
        print(f"{name:<12}", " ".join(f"{value:8.4g}" for value in own), " ratio", (own / PUBLISHED_SIGMA).round(2))
    answer = batch("half turns")
    print("estimate    ", " ".join(f"{value:8.5g}" for value in answer.x[:6]))
    print("its sigma   ", " ".join(f"{value:8.3g}" for value in np.sqrt(np.diagonal(answer.covariance))[:6]))
