"""What lasts in a residual beside the names, from one sample to the next."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from magcal_service.diagnosis.field_error import FieldError
from magcal_service.diagnosis.problem import Fit, Problem, Term
from magcal_service.diagnosis.rest import Rest
from magcal_service.diagnosis.solution import solve
from magcal_service.model import Array, measure
from magcal_service.physics.catalogue import effect_named
from tests.physics.scenes import NOISE_NT, X, scene, spoiled

STEP_NT = np.array([220.0, -140.0, 90.0])
AT_S = 4100.0


def fit_with(disturbance_nt: Array, noise_nt: float = NOISE_NT, stated_nt: float = NOISE_NT) -> tuple[Fit, Fit]:
    """Nine errors alone, and with the step; in the samples (n, 3) besides the step is a disturbance."""
    late = (scene().time_s >= AT_S)[:, None]
    noise = noise_nt * np.random.default_rng(71).normal(size=(len(scene()), 3))
    seen = spoiled(measure(X, scene().calibrated_nt + STEP_NT * late + disturbance_nt + noise), scene())
    problem = Problem(seen, stated_nt)
    alone = solve(problem, X)
    form = effect_named("bias_step").hypotheses(scene())[0]
    return alone, solve(problem, alone.x, [Term(form, np.array([AT_S]), STEP_NT)])


def rest(disturbance_nt: Array, noise_nt: float = NOISE_NT, stated_nt: float = NOISE_NT) -> Rest:
    """Of these."""
    return Rest.of(*fit_with(disturbance_nt, noise_nt, stated_nt))


@cache
def nothing() -> Array:
    """No disturbance (n, 3)."""
    return np.zeros((len(scene()), 3))


def along_field(size_nt: float) -> Array:
    """A disturbance (n, 3) along the field, of this amplitude, three times an hour: all of it is seen."""
    course = np.sin(2.0 * np.pi * scene().time_s / 1200.0)
    return size_nt * course[:, None] * scene().unit


def test_white_noise_leaves_nothing_however_large_it_is() -> None:
    """As stated, and three times as large as stated."""
    for noise_nt in (NOISE_NT, 3.0 * NOISE_NT):
        found = rest(nothing(), noise_nt)
        assert abs(found.after) < 3.0 * found.sigma
        assert found.sigma == pytest.approx(noise_nt**2 / np.sqrt(len(scene())), rel=0.1)
        assert not found.is_much
        assert found.share == 0.0


def test_what_a_name_does_not_hold_is_measured() -> None:
    """Half of the amplitude's square, within its own scatter."""
    found = rest(along_field(1.5 * NOISE_NT))
    assert found.after == pytest.approx(0.5 * (1.5 * NOISE_NT) ** 2, abs=4.0 * found.sigma + 0.03 * NOISE_NT**2)
    assert found.share == pytest.approx(found.after / found.before)
    assert found.is_much


@pytest.mark.parametrize(("after", "much"), [(200.1, True), (199.9, False), (-60.0, False)])
@pytest.mark.parametrize("is_free", [True, False])
def test_how_much_is_too_much(after: float, is_free: bool, much: bool) -> None:
    """2 % of 10 000, where that is more than noise; a free form has as much and can be excluded to be a quarter."""
    assert Rest(1e4, after, 10.0, is_free).is_much is much


@pytest.mark.parametrize(("after", "much"), [(30.1, True), (29.9, False)])
def test_what_may_be_noise_is_not_too_much(after: float, much: bool) -> None:
    """Three sigma of 10, whatever share that is."""
    assert Rest(100.0, after, 10.0).is_much is much


@pytest.mark.parametrize(("after", "much"), [(0.0, True), (-200.0, False)])
def test_a_free_form_has_to_exclude_a_quarter(after: float, much: bool) -> None:
    """Within two sigma of 300: a quarter of 2000 is 500."""
    found = Rest(2000.0, after, 300.0, is_free=True)
    assert found.is_much is much
    assert found.unsafe_share == pytest.approx((after + 600.0) / 2000.0)
    assert Rest(2000.0, after, 300.0).unsafe_share == 0.0
    assert not Rest(2000.0, after, 300.0, is_free=False).is_much


@pytest.mark.parametrize(
    ("before", "after", "is_free", "likely"),
    [
        (2000.0, 200.0, True, 0.16),
        (600.0, -10.0, True, 0.5),
        (0.0, -10.0, True, 0.5),
        (2000.0, 1800.0, True, 0.9),
        (600.0, 100.0, False, 0.0),
    ],
)
def test_what_is_only_not_excluded_is_as_likely_as_not_at_the_most(
    before: float, after: float, is_free: bool, likely: float
) -> None:
    """By the square of the share that two sigma of 300 leave open, up to a half; what does last counts by its share."""
    assert Rest(before, after, 300.0, is_free).likely_share == pytest.approx(likely)


def test_several_recordings_count_by_their_rows() -> None:
    """Twice one recording: the same rest, known to a root of two better; a quiet one beside it halves it."""
    noisy, quiet = fit_with(along_field(1.5 * NOISE_NT)), fit_with(nothing())
    one, other = Rest.of(*noisy), Rest.of(*quiet)
    twice = Rest.of_all([noisy, noisy])
    assert (twice.before, twice.after) == (pytest.approx(one.before), pytest.approx(one.after))
    assert twice.sigma == pytest.approx(one.sigma / np.sqrt(2.0))
    both = Rest.of_all([noisy, quiet])
    assert both.after == pytest.approx(0.5 * (one.after + other.after))
    assert both.sigma == pytest.approx(0.5 * np.hypot(one.sigma, other.sigma))


@pytest.mark.parametrize("size_nt", [10.0, 120.0])
def test_what_field_models_usually_err_by_is_taken_off(size_nt: float) -> None:
    """22 nT of it: of a course of 7 nT rms all, of one of 85 nT hardly anything."""
    alone, fit = fit_with(along_field(size_nt), noise_nt=1.0)
    usual = FieldError.of(scene(), 1.0)
    assert usual is not None
    rows = fit.held_out_residual
    under = replace(fit, problem=replace(fit.problem, field_error=usual))
    under.__dict__["_held_out"] = rows, rows  # the same residual under such errors
    whole, less = Rest.of(alone, fit).after, Rest.of(alone, under)
    assert less.after == pytest.approx(max(whole - usual.rms_nt**2, 0.0), rel=0.01)
    assert less.after + less.excused == pytest.approx(whole)
    assert (less.after > 0.9 * whole) is (size_nt > 100.0)


@pytest.mark.parametrize(("excused", "likely"), [(0.0, 0.0), (150.0, 0.0), (400.0, 0.2), (3000.0, 0.5)])
def test_another_cause_may_hide_in_what_the_field_model_errs_by(excused: float, likely: float) -> None:
    """As likely as not, by its share of the mismatch of 1000, where it is more than noise, three sigma of 60."""
    assert Rest(1000.0, 0.0, 60.0, False, excused).likely_share == pytest.approx(likely)


def test_all_that_lasts_stands_out_of_noise_whoever_errs() -> None:
    """Two thirds of it without the third that the field model errs by would not."""
    assert Rest(1000.0, 140.0, 60.0, False, 70.0).share == pytest.approx(0.14)
    assert Rest(1000.0, 140.0, 60.0).share == 0.0


def test_rows_on_both_sides_of_a_gap_do_not_follow_one_another() -> None:
    """One jump over two rows counts, and does not where a pause lies between them."""
    alone, fit = fit_with(nothing())
    jumped = np.array(fit.residual)
    jumped[999:1001] += 3e4
    late = np.array(scene().time_s)
    late[1000:] += 100.0
    apart = replace(fit.problem, scene=replace(fit.problem.scene, time_s=late))
    together = Rest.of(alone, replace(fit, residual=jumped)).after
    assert together == pytest.approx(3e4**2 / (len(scene()) - 1), rel=0.05)
    assert abs(Rest.of(alone, replace(fit, residual=jumped, problem=apart)).after) < 0.01 * together
