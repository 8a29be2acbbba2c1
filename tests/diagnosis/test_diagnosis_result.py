"""A diagnosis as entries: numbers by name with their sigmas, where a signal lies, and what is said of the rest."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from magcal_service.diagnosis.entry import plain
from magcal_service.diagnosis.parameters import _instant_sigma, parameters_of
from magcal_service.diagnosis.problem import Fit, Problem, Term
from magcal_service.diagnosis.where import direction, lines, span
from magcal_service.model import Array
from magcal_service.physics.catalogue import effect_named
from magcal_service.physics.columns import Columns, along_axes
from magcal_service.physics.interface import Block, Hypothesis, Nonlinear, value_of
from tests.diagnosis.made_up import (
    QUICK,
    TIME_S,
    along,
    body_form,
    grown_form,
)
from tests.physics.scenes import COUNT, NOISE_NT, PERIOD_S, X, scene


def test_numbers_are_plain_and_what_is_none_is_null() -> None:
    assert plain(np.float64(2.5)) == 2.5
    assert plain(np.float64(np.nan)) is None
    assert plain(np.array([[1.0, np.inf], [3.0, 4.0]])) == [[1.0, None], [3.0, 4.0]]


# Where a signal lies


def timed(times_s: Array) -> Fit:
    return SimpleNamespace(problem=SimpleNamespace(row_time_s=times_s))  # type: ignore[return-value]


def test_a_signal_lies_where_all_but_a_thousandth_of_its_squares_are_on_either_side() -> None:
    times = 10.0 * np.arange(100.0)
    signal = np.zeros(100)
    signal[30:61] = 1.0
    assert span(timed(times), signal) == [300.0, 600.0]
    signal[20] = signal[70] = math.sqrt(31.0 * 0.0009)
    assert span(timed(times), signal) == [300.0, 600.0]
    signal[20] = signal[70] = math.sqrt(31.0 * 0.0012)
    assert span(timed(times), signal) == [200.0, 700.0]


def test_what_begins_within_the_first_fiftieth_begins_at_nought() -> None:
    times = 10.0 * np.arange(101.0)
    for first, begins in ((1, 0.0), (2, 20.0), (3, 30.0)):
        signal = np.zeros(101)
        signal[first:] = 1.0
        assert span(timed(times), signal) == [begins, 1000.0]
    assert span(timed(times), np.zeros(101)) == [0.0, 1000.0]
    assert span(timed(times + 0.04), np.ones(101)) == [0.0, 1000.0]


def term_of(form: Hypothesis, *amplitudes: float) -> Term:
    return Term(form, np.zeros(0), np.array(amplitudes))


def test_a_direction_is_that_of_what_changes_with_its_largest_part_positive() -> None:
    swing = np.outer(QUICK, [0.0, 0.6, 0.8])
    moving = body_form("one", "", swing + np.array([500.0, 0.0, 0.0]))
    assert direction(term_of(moving, 3.0), COUNT) == [0.0, 0.6, 0.8]
    assert direction(term_of(moving, -3.0), COUNT) == [0.0, 0.6, 0.8]
    against = body_form("one", "", np.outer(QUICK, [0.28, -0.96, 0.0]))
    assert direction(term_of(against, 1.0), COUNT) == [-0.28, 0.96, 0.0]
    constant = body_form("one", "", np.tile([0.0, -30.0, 40.0], (COUNT, 1)))
    assert direction(term_of(constant, 2.0), COUNT) == [0.0, -0.6, 0.8]
    assert direction(term_of(grown_form(QUICK), 2.0), COUNT) is None


def test_a_constant_with_next_to_no_change_has_its_own_direction() -> None:
    still = np.tile([30.0, 0.0, 0.0], (COUNT, 1))
    for ripple, axis in ((0.02, [1.0, 0.0, 0.0]), (0.08, [0.0, 1.0, 0.0])):
        form = body_form("one", "", still + along(1, ripple * np.sqrt(2.0) * QUICK))
        assert direction(term_of(form, 1.0), COUNT) == axis


def test_the_strongest_lines_of_a_signal_are_told() -> None:
    """The second where its power is more than a quarter of the first's; never the mean."""
    fit: Any = SimpleNamespace(problem=SimpleNamespace(scene=scene(), is_vector=False))
    bins = 1.0 / (COUNT * PERIOD_S)
    first, second = np.sin(2 * np.pi * 40 * bins * TIME_S), np.cos(2 * np.pi * 90 * bins * TIME_S)
    for share, wanted in ((0.49, [40]), (0.51, [40, 90]), (2.1, [90])):
        found = lines(fit, 7.0 + first + share * second)
        assert found == [float(f"{line * bins:.4g}") for line in wanted]
    assert lines(fit, first + second + np.sin(2 * np.pi * 150 * bins * TIME_S)) != []
    fit.problem.is_vector = True
    assert lines(fit, first) == []


@pytest.mark.parametrize(("count", "told"), [(15, 0), (16, 1)])
def test_lines_need_sixteen_samples(count: int, told: int) -> None:
    short = SimpleNamespace(time_s=np.arange(float(count)), period_s=1.0)
    fit: Any = SimpleNamespace(problem=SimpleNamespace(scene=short, is_vector=False))
    assert len(lines(fit, np.sin(2 * np.pi * np.arange(count) / 4.0))) == told


# Parameters


def numbered(*names: tuple[str, str], most: float = 5000.0) -> Hypothesis:
    """Two blocks, and nonlinear numbers of these names and roles."""
    return Hypothesis(
        "one",
        "none",
        lambda _: along_axes(np.zeros((COUNT, 4))),
        (Block("matrix", "nT", (2, 3)), Block("vector", "1/K"), Block("one", "s", ())),
        nonlinear=tuple(Nonlinear(name, "s", np.array([1.0, most]), role) for name, role in names),
        constants={"zero_degc": 20.0, "held_s": 7.0},
    )


def test_a_number_is_off_by_no_more_than_it_was_searched_over() -> None:
    form = numbered(("a_s", ""), most=3.0)
    term = Term(form, np.array([2.5]), np.arange(10.0))
    fit: Any = SimpleNamespace(
        terms=[term], covariance=np.diag(np.full(20, 1e12)), problem=SimpleNamespace(size=9), linear_size=19
    )
    assert float(parameters_of(fit, 0, effect_named("bias_drift"))["a_s"].sigma) == 2.0


def test_parameters_are_taken_from_their_places_with_their_sigmas() -> None:
    """Amplitudes of the second term stand behind those of the first; its free numbers behind the first's."""
    first, second = numbered(("a_s", "")), numbered(("held_s", "held"), ("b_s", ""), ("c_s", "frequency"))
    terms = [
        Term(first, np.array([5.0]), np.arange(10.0)),
        Term(second, np.array([1.0, 2.0, 3.0]), 100.0 + np.arange(10.0)),
    ]
    sigmas = np.arange(9 + 20 + 3) + 1000.0
    fit: Any = SimpleNamespace(
        terms=terms, covariance=np.diag(sigmas**2), problem=SimpleNamespace(size=9), linear_size=29
    )
    effect = replace(
        effect_named("bias_drift"),
        units={"zero_degc": "degC"},
        derived=lambda found: {"double": value_of(2.0 * found["one"].value, np.nan, "s")},
    )
    found = parameters_of(fit, 1, effect)
    assert found["matrix"].value.tolist() == [[100.0, 101.0, 102.0], [103.0, 104.0, 105.0]]
    assert found["matrix"].sigma == pytest.approx(1019.0 + np.arange(6.0).reshape(2, 3))
    assert found["vector"].value.tolist() == [106.0, 107.0, 108.0]
    assert found["vector"].sigma == pytest.approx([1025.0, 1026.0, 1027.0])
    assert (float(found["one"].value), float(found["one"].sigma)) == pytest.approx((109.0, 1028.0))
    assert [float(found[name].value) for name in ("held_s", "b_s", "c_s")] == [1.0, 2.0, 3.0]
    assert math.isnan(float(found["held_s"].sigma))
    assert [float(found[name].sigma) for name in ("b_s", "c_s")] == pytest.approx([1030.0, 1031.0])
    assert (float(found["zero_degc"].value), found["zero_degc"].unit) == (20.0, "degC")
    assert float(found["double"].value) == 218.0
    assert [value.unit for value in found.values()][:3] == ["nT", "1/K", "s"]


def jumping(course: Array, residual: Array) -> Callable[[float, float], float]:
    """Sigma of a jump's instant by its time and size, where it shows as ``course`` (n,), beside a residual (n,)."""
    form = Hypothesis(
        "one",
        "none",
        lambda theta: Columns(magnitude=(course * (theta[0] <= TIME_S))[None]),
        (Block("nt", "nT", ()),),
        nonlinear=(Nonlinear("at_s", "s", TIME_S[::100], "instant"),),
    )

    def sigma(at_s: float, size_nt: float) -> float:
        term = Term(form, np.array([at_s]), np.array([size_nt]))
        fit = Fit(
            Problem(scene(), NOISE_NT), X, (term,), residual, np.zeros((COUNT, 0)), scene().unit, FIELD, np.zeros(0)
        )
        return _instant_sigma(fit, term, 0)

    return sigma


def test_an_instant_is_as_sure_as_its_likelihood_is_narrow() -> None:
    """Even over what shows nothing; exponential on either side where each sample says the same."""
    noise = 10.0 * (-1.0) ** np.arange(COUNT)
    blind = np.where((TIME_S > 3960.0) & (TIME_S < 4100.0), 0.0, 1.0)
    sigma = jumping(blind, noise)
    assert sigma(2002.0, 1000.0) == pytest.approx(PERIOD_S / math.sqrt(12.0))
    assert sigma(4030.0, 1000.0) == pytest.approx(70.0 / math.sqrt(3.0), rel=0.06)
    assert sigma(0.0, 1e-6) == pytest.approx(TIME_S[-1] / math.sqrt(3.0), rel=0.01)
    # costs of size^2 / 2 noise^2 a sample: a density of exp(-|k| / 25) in samples, by which sigma is 25 sqrt(2)
    assert sigma(2002.0, 10.0 * math.sqrt(2.0 / 25.0)) == pytest.approx(25.0 * math.sqrt(2.0) * PERIOD_S, rel=0.05)


def test_an_instant_errs_by_its_sigma() -> None:
    """In noise, at the likeliest instant of each draw: of 1500 draws 78 % are within one sigma, 90 % within two."""
    rng, size, jump_at = np.random.default_rng(97), 4.0, 1000
    distances = []
    for _ in range(200):
        data = 10.0 * rng.normal(size=COUNT) - size * (np.arange(COUNT) >= jump_at)
        # sum of (data + size)^2 over the rows after k: the likeliest k is where its cumulated excess is least
        excess = np.concatenate([np.cumsum(((data + size) ** 2 - data**2)[::-1])[::-1], [0.0]])
        row = int(np.argmin(excess[1:-1])) + 1
        at_s = 0.5 * float(TIME_S[row] + TIME_S[row - 1])
        sigma = jumping(np.ones(COUNT), data + size * (np.arange(COUNT) >= row))(at_s, size)
        distances.append(abs(at_s - 0.5 * float(TIME_S[jump_at] + TIME_S[jump_at - 1])) / sigma)
    assert 0.68 < float(np.mean(np.array(distances) < 1.0)) < 0.88
    assert float(np.mean(np.array(distances) < 2.0)) > 0.83


FIELD = scene().calibrated_nt
