"""Which of two minima a batch start takes: a flight in which the sum of squares alone chose the wrong one."""

import numpy as np
import pytest

from magcal_service.config.settings import FilterConfig
from magcal_service.estimators.parts.start import BatchSolution, batch_start, prior_sigma
from magcal_service.estimators.parts.start_problem import BatchProblem, WindowMeans, gauss_newton, linear_states
from magcal_service.studies.convergence import Job, draw, fly_one
from magcal_service.studies.flights import Flown, fly
from magcal_service.studies.montecarlo import seeds_of

pytest.importorskip("ppigrf")

NUMBER = 184
SECONDS = 567


def flight() -> tuple[Flown, BatchProblem]:
    """Run 184 of the study ``convergence``, seed 1, as a problem of its first samples without spin windows."""
    seed = seeds_of(1, NUMBER + 1)[NUMBER]
    flown = fly(draw(np.random.default_rng(seed)))
    field = flown.measured(seed.spawn(1)[0])[:SECONDS]
    noise, prior = flown.plan.noise_nt, prior_sigma(FilterConfig())
    return flown, BatchProblem(field, flown.magnitude_nt[:SECONDS], WindowMeans.of(()), prior, noise, noise)


def test_a_solution_that_shrinks_the_noise_costs_less_and_is_not_better() -> None:
    flown, problem = flight()
    shrunken = gauss_newton(problem, linear_states(problem)[0])
    right = gauss_newton(problem, flown.truth(0.0))
    assert shrunken is not None
    assert right is not None
    assert np.abs(shrunken[0] - flown.truth(0.0))[:3].max() > 5000.0
    assert float(problem.normal_equations(shrunken[0])[2]) < float(problem.normal_equations(right[0])[2])
    assert problem.advantage(shrunken[0], right[0]) < 0.0


def test_the_start_does_not_take_it() -> None:
    flown, problem = flight()
    found = batch_start(problem.field_nt, problem.magnitude_nt, (), flown.plan.noise_nt, FilterConfig())
    assert not isinstance(found, BatchSolution) or np.abs(found.x - flown.truth(0.0))[:3].max() < 1000.0


def test_the_flight_is_never_trusted_and_wrong() -> None:
    outcome = fly_one(Job(NUMBER, "ukf", seeds_of(1, NUMBER + 1)[NUMBER], 2000))
    assert outcome.trusted_ticks > 0
    assert outcome.wrong_ticks == 0
