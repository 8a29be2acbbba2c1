"""How large the field model's errors are taken: the scale they were drawn with, and names that have to beat it."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from magcal_service.diagnosis.doubts import errs_clearly, is_beyond_model, of_noise_and_reference
from magcal_service.diagnosis.explain import Explained, Search
from magcal_service.diagnosis.field_error import SCALES, FieldError, Scale
from magcal_service.diagnosis.field_level import (
    at_scale,
    is_as_smooth,
    is_trifle,
    likeliest,
    log_likelihood,
    needed_scale,
)
from magcal_service.diagnosis.leftover import significant, structures
from magcal_service.diagnosis.problem import Problem, Term
from magcal_service.diagnosis.searching import End, without_names
from magcal_service.diagnosis.signals import strongest_signal
from magcal_service.diagnosis.solution import solve
from magcal_service.model import D_ALL, D_SCALE, Array, measure
from magcal_service.physics.catalogue import effect_named
from magcal_service.physics.scene.scene import Telemetry
from tests.physics.scenes import X, scene, spoiled

NOISE_NT = 10.0


def usual() -> FieldError:
    """Of the flight."""
    found = FieldError.of(scene(), NOISE_NT)
    assert found is not None
    return found


def problem(model_error: float, seed: int, body_nt: Array | float = 0.0) -> Problem:
    """The flight with white noise, a body field, and a model error drawn ``model_error`` times as large as usual."""
    rng = np.random.default_rng(seed)
    error = usual().basis @ (np.sqrt(usual().variance) * rng.standard_normal(len(usual().variance)))
    unit = scene().calibrated_nt / np.linalg.norm(scene().calibrated_nt, axis=1, keepdims=True)
    noise = NOISE_NT * rng.normal(size=(len(scene()), 3))
    field = scene().calibrated_nt + model_error * error[:, None] * unit + body_nt + noise
    return Problem(spoiled(measure(X, field), scene()), NOISE_NT, field_error=usual())


@pytest.mark.parametrize("scale", [1.0, 4.0])
def test_the_scale_that_was_drawn_is_the_likeliest(scale: float) -> None:
    """Errors as usual, and four times as large."""
    assert likeliest(problem(scale, 3), usual(), X)[0].coarse == scale


def test_the_likelihood_is_that_of_the_dense_covariance() -> None:
    """-r'C^-1 r / (2 g^2) - ln det(C) / 2 with C = s^2 I + U diag(v) U' and the gain g that the sensor's noise goes
    through, but for the white noise's own constant."""
    fit = solve(problem(1.0, 5), X)
    count = len(scene())
    error = usual()
    covariance = NOISE_NT**2 * np.eye(count) + (error.basis * error.variance) @ error.basis.T
    dense = -0.5 * float(fit.residual @ np.linalg.solve(covariance, fit.residual)) / fit.noise_gain**2
    dense -= 0.5 * float(np.linalg.slogdet(covariance)[1]) - 0.5 * count * np.log(NOISE_NT**2)
    assert log_likelihood(fit) == pytest.approx(dense, abs=1e-6 * count)


def test_nine_errors_that_shrink_all_are_no_likelier_for_it() -> None:
    """I + D, field and noise less by a tenth: the same residual in the sensor's own units has the same likelihood."""
    fit = solve(problem(0.0, 6), X)
    smaller = np.array(fit.x)
    smaller[D_ALL] *= 0.9
    smaller[D_SCALE] -= 0.1  # (I + D) times 0.9
    shrunk = replace(fit, x=smaller, residual=0.9 * fit.residual)
    assert shrunk.noise_gain == pytest.approx(0.9 * fit.noise_gain)
    assert log_likelihood(shrunk) == pytest.approx(log_likelihood(fit))


def test_sigmas_hold_under_the_models_errors() -> None:
    """Nine errors fitted under them: over eight draws the distances have a mean square of about one."""
    squares = []
    for seed in range(8):
        fit = solve(problem(1.0, 40 + seed), X)
        squares.append(float(np.mean((fit.x - X) ** 2 / np.diagonal(fit.covariance))))
    assert 0.5 < float(np.mean(squares)) < 1.8


def test_a_name_has_to_be_likelier_than_larger_errors() -> None:
    """Large model errors alone need their scale; a step beside usual ones does not, once it is named."""
    restless = problem(4.0, 7)
    alone = solve(restless, X)
    scale, names_hold = needed_scale(usual(), likeliest(restless, usual(), alone.x), alone)
    assert (scale.coarse, names_hold) == (4.0, False)
    step = (scene().time_s >= 4100.0)[:, None] * np.array([400.0, -300.0, 200.0])
    stepped = problem(1.0, 9, step)
    baseline = solve(stepped, X)
    form = effect_named("bias_step").hypotheses(scene())[0]
    named = solve(stepped, X, [Term(form, np.array([4100.0]), np.array([400.0, -300.0, 200.0]))])
    assert needed_scale(usual(), likeliest(stepped, usual(), baseline.x), named) == (Scale(), True)
    assert at_scale(stepped, usual(), Scale(2.0, 1.0)).field_error is not None


def test_what_follows_a_channel_is_no_error_of_the_field_model() -> None:
    """A gain by a voltage that drifts, some 150 nT of it, would take four times the usual errors; a channel that has
    nothing to do with errors as large takes none of them."""
    volts = np.sin(scene().time_s / 1500.0) + 0.3 * np.sin(scene().time_s / 611.0)
    recorded = {"volts": Telemetry("volts", "voltage", volts[:, None])}
    for drawn, gain, holds in ((1.0, 0.006, True), (4.0, 0.0, False)):
        made = problem(drawn, 19, gain * volts[:, None] * scene().calibrated_nt)
        made = replace(made, scene=replace(made.scene, channels=recorded))
        small = at_scale(made, usual(), Scale(0.25, 1.0))
        search = Search(small, [])
        fit = search.refreshed(solve(small, X))
        alone = likeliest(made, usual(), fit.x)
        assert alone[0].coarse > 1.0
        followed = strongest_signal(search, fit, 0.3 * NOISE_NT)
        assert followed is not None
        assert needed_scale(usual(), alone, fit, followed)[1] is holds
        assert followed.says.startswith("a gain that follows the recorded volts") or not holds


@pytest.mark.parametrize(("drawn", "scale", "doubtful"), [(4.0, 4.0, True), (0.0, 4.0, False), (4.0, 2.0, False)])
def test_a_reference_that_errs_beyond_field_models_is_doubted(drawn: float, scale: float, doubtful: bool) -> None:
    """Where the recording is likeliest with more than twice the usual errors, and what is left shows them."""
    fit = solve(at_scale(problem(drawn, 11), usual(), Scale(scale, scale)), X)
    assert is_beyond_model(fit) is doubtful


@pytest.mark.parametrize(
    ("drawn", "scale", "doubtful"), [(2.5, 2.0, True), (0.7, 2.0, False), (2.5, 1.0, False), (0.7, 1.0, False)]
)
def test_a_reference_that_clearly_errs_by_more_than_is_usual_is_doubted(
    drawn: float, scale: float, doubtful: bool
) -> None:
    """As one of old coefficients does: likelier so by more than 6 nats, and that much is left."""
    fit = solve(at_scale(problem(drawn, 11), usual(), Scale(scale, 1.0)), X)
    assert errs_clearly(fit) is doubtful
    assert not is_beyond_model(fit)


@pytest.mark.parametrize(("named", "left", "doubtful"), [(False, 1.4, True), (False, 1.0, False), (True, 1.4, False)])
def test_what_noise_and_usual_errors_do_not_add_up_to_is_doubted(named: bool, left: float, doubtful: bool) -> None:
    """`agree to the noise: 39 nT are left, over 11 nT, and 22 nT that the field model may err by` was trusted."""
    fit = solve(at_scale(problem(0.0, 11), usual(), Scale(0.25, 1.0)), X)
    error = fit.problem.field_error
    assert error is not None
    assert error.may_be_nt == error.usual_nt > error.rms_nt
    most = float(np.hypot(fit.noise_gain * error.noise_nt, error.usual_nt))
    grown = replace(fit, residual=fit.residual * left * most / fit.rms_nt)
    assert of_noise_and_reference(grown, named=named, stated=True)["field_model_doubtful"] is doubtful


@pytest.mark.parametrize(("own_noise_nt", "doubtful"), [(0.0, True), (NOISE_NT, True), (400.0, False)])
def test_beside_noise_with_a_memory_a_reference_is_doubted_by_how_much_is_left(
    own_noise_nt: float, doubtful: bool
) -> None:
    """Such noise hangs together as the field model's errors do, and would be taken for them."""
    fit = solve(at_scale(problem(2.5, 11), usual(), Scale(2.0, 1.0)), X)
    found = of_noise_and_reference(fit, named=False, stated=True, own_noise_nt=own_noise_nt)
    assert found["field_model_doubtful"] is doubtful


@pytest.mark.parametrize(("drawn", "doubtful"), [(3.0, True), (1.5, False)])
def test_beneath_a_loud_sensor_s_noise_they_are_doubted_by_how_they_hang_together(drawn: float, doubtful: bool) -> None:
    """150 nT of noise hide errors three times the usual: less than a fifth more is left."""
    loud_nt = 150.0
    error = FieldError.of(scene(), loud_nt)
    assert error is not None
    quiet = problem(drawn, 17)
    extra = np.sqrt(loud_nt**2 - NOISE_NT**2) * np.random.default_rng(18).normal(size=(len(scene()), 3))
    spoilt = spoiled(quiet.scene.field_nt + extra, scene())
    fit = solve(at_scale(Problem(spoilt, loud_nt, field_error=error), error, Scale(4.0, 1.0)), X)
    assert fit.held_out_rms_nt < 1.2 * np.hypot(fit.noise_gain * loud_nt, error.usual_nt)
    assert is_beyond_model(fit) is doubtful


@pytest.mark.parametrize("drawn", [1.0, 4.0])
def test_what_is_left_without_a_name_is_judged_under_the_errors_that_suit_it(drawn: float) -> None:
    """Names were sought under the least errors; once none has stood, a recording whose model errs as usual has nothing
    left.  Of one that errs four times as much it is not said."""
    least = at_scale(problem(drawn, 13), usual(), min(SCALES))
    search = Search(least, [])
    fit = search.refreshed(solve(least, X))
    left = structures(search, fit, None, NOISE_NT)
    assert significant(left[0])
    end = End(search, Explained(fit), left, NOISE_NT, np.zeros(0))
    found = without_names(end, SimpleNamespace(spin=None, baseline=fit, alone=None))  # type: ignore[arg-type]
    if drawn > 1.0:
        assert found is end
        return
    error = found.search.problem.field_error
    assert error is not None
    assert error.scale.coarse == drawn
    assert not significant(found.left[0])
    assert without_names(found, SimpleNamespace(spin=None, baseline=fit, alone=None)) is found  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("period_s", "white_nt", "placed", "may_be"),
    [(2400.0, 1.5, False, True), (2400.0, 1.5, True, False), (2400.0, 3.0, False, False), (20.0, 1.5, False, False)],
)
def test_without_places_a_smooth_trifle_may_be_the_models_own(
    period_s: float, white_nt: float, placed: bool, may_be: bool
) -> None:
    """As smooth as errors along an orbit, and less than a tenth of the usual 22 nT once they are whitened."""
    of = scene() if placed else replace(scene(), position_ecef_km=None)
    error = FieldError.of(of, NOISE_NT)
    assert error is not None
    signal = 8.0 * np.sin(2.0 * np.pi * of.time_s / period_s)
    known = Problem(of, NOISE_NT, field_error=error)
    assert (is_trifle(known, white_nt**2) and is_as_smooth(known, signal)) is may_be
    assert not is_trifle(replace(known, field_error=None), white_nt**2)
