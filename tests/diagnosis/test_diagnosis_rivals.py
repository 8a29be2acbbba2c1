"""Names against rivals that are fitted in their place, and fits against one another under the sensor's own noise."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from magcal_service import read_recording
from magcal_service.diagnosis.blocks import gain_over
from magcal_service.diagnosis.diagnose import Diagnosis, diagnose
from magcal_service.diagnosis.instants import timed
from magcal_service.diagnosis.joint.problem import JointProblem
from magcal_service.diagnosis.parameters import parameters_of
from magcal_service.diagnosis.problem import Problem, Term, evaluate
from magcal_service.diagnosis.rivals import RECORDED_NATS, is_as_sudden, tempered
from magcal_service.diagnosis.screen import Candidate
from magcal_service.diagnosis.sized import has_size
from magcal_service.diagnosis.solution import solve
from magcal_service.diagnosis.squares import with_noise_of
from magcal_service.model import d_matrix, measure
from magcal_service.physics.catalogue import effect_named
from magcal_service.physics.columns import along_axes
from magcal_service.physics.interface import Block, Hypothesis, Nonlinear
from tests.blind.draw import draw_case as draw_blind
from tests.blind.recording import write_case as write_blind
from tests.diagnosis.made_up import FLOOR_NT, OTHER, QUICK, SLOW, TIME_S, along, body_form, flown, searching
from tests.physics.scenes import COUNT, NOISE_NT, X, scene, spoiled
from tests.regimes.case import draw_case
from tests.regimes.write import write_case

# Fits are compared by what they leave as the sensor's own noise


@pytest.mark.parametrize("d", [0.2, -0.3])
def test_a_sensor_s_noise_is_the_same_whatever_gain_its_errors_have(d: float) -> None:
    """|(I + D) n| along the field has (1 + d) times the noise per axis, and the sensor's own has once."""
    x = np.concatenate([X[:3], [d, d, d, 0.0, 0.0, 0.0]])
    clean = scene()
    noise = np.random.default_rng(5).normal(0.0, NOISE_NT, (COUNT, 3))
    noisy = spoiled(measure(x, clean.calibrated_nt) + noise, clean)
    fit = solve(Problem(noisy, NOISE_NT), x)
    assert fit.noise_gain == pytest.approx(1.0 + d, rel=2e-3)
    assert fit.white_rms_nt == pytest.approx((1.0 + d) * NOISE_NT, rel=0.04)
    assert np.sqrt(np.mean(fit.sensor_residual**2)) == pytest.approx(NOISE_NT, rel=0.04)
    assert np.sqrt(np.mean(fit.sensor_held_out**2)) == pytest.approx(NOISE_NT, rel=0.04)


def test_several_recordings_have_the_gain_of_all_their_samples() -> None:
    part = Problem(flown(along(0, 0.0 * SLOW)), NOISE_NT)
    other = X + np.concatenate([np.zeros(3), [0.1, 0.1, 0.1], np.zeros(3)])
    joint = evaluate(JointProblem.of([part, part]), np.concatenate([X, other]), ())
    each = [evaluate(part, x, ()).noise_gain for x in (X, other)]
    assert each[1] > each[0] + 0.09
    assert joint.noise_gain == pytest.approx(np.sqrt(np.mean(np.square(each))), rel=1e-9)


def test_noise_that_turns_with_the_gains_of_the_axes_is_no_difference_between_two_fits() -> None:
    """Gains of the axes across the spin that are off by 1.5 % made the same noise scatter over blocks twice as much."""
    part = Problem(flown(along(0, 0.0 * SLOW)), NOISE_NT)
    fit = evaluate(part, X, ())
    other = evaluate(part, X + np.concatenate([np.zeros(3), [0.015, 0.015, -0.002], np.zeros(3)]), ())
    noise = np.random.default_rng(6).normal(0.0, NOISE_NT, (COUNT, 3))
    mine, its = (np.einsum("ni,ni->n", one.unit, noise @ (np.eye(3) + d_matrix(one.x[:9])).T) for one in (fit, other))
    fit, other = replace(fit, residual=mine), replace(other, residual=its)
    blocks = np.arange(COUNT) * 50 // COUNT
    apart = with_noise_of(fit, other)
    assert gain_over(its * fit.noise_gain / other.noise_gain, mine, blocks, NOISE_NT**2).dispersion > 2.0
    assert gain_over(apart, mine, blocks, NOISE_NT**2).dispersion < 1.5
    assert float(apart @ apart) == pytest.approx(float(mine @ mine), rel=2e-3)


# Instants by joint solutions


def step_form() -> Hypothesis:
    """A field along each axis from an instant on."""
    grid = TIME_S[50:-50:100]
    return Hypothesis(
        "one",
        "none",
        lambda theta: along_axes((theta[0] <= TIME_S).astype(float)),
        (Block("step_nt", "nT"),),
        nonlinear=(Nonlinear("at_s", "s", grid, "instant"),),
    )


@pytest.mark.parametrize("off_s", [-900.0, 0.0, 700.0])
def test_an_instant_that_a_fit_has_wrong_is_sought_again(off_s: float) -> None:
    form, at_s = step_form(), 4002.0
    search, fit = searching(flown(along(1, 500.0 * (at_s <= TIME_S))), form)
    began = solve(search.problem, fit.x, [Term(form, np.array([at_s + off_s]), np.zeros(3))])
    found = timed(search, began, 0)
    assert abs(float(found.terms[0].theta[0]) - at_s) <= 8.0
    assert found.converged
    assert (found.sensor_residual**2).sum() <= (began.sensor_residual**2).sum()


@pytest.mark.parametrize("width_s", [240.0, 1200.0])
def test_the_ends_of_a_change_that_takes_a_while_are_moved_by_joint_solutions(width_s: float) -> None:
    """From 150 s off at either end, and known to what the diagnosis says they are."""
    (form,) = [one for one in effect_named("bias_drift").hypotheses(scene()) if one.variant == "over a while"]
    edges = np.array([4000.0, 4000.0 + width_s])
    search, fit = searching(flown(along(1, 900.0 * np.interp(TIME_S, edges, [0.0, 1.0]))), form)
    began = solve(search.problem, fit.x, [Term(form, edges + np.array([-150.0, 150.0]), np.zeros(3))])
    found = timed(search, began, 0)
    values = parameters_of(found, 0, effect_named("bias_drift"))
    for name, edge in zip(("from_s", "to_s"), edges, strict=True):
        assert 0.0 < float(values[name].sigma) < 60.0
        assert abs(float(values[name].value) - edge) < 4.0 * float(values[name].sigma)


@pytest.mark.parametrize("relaxes", [True, False])
def test_a_change_that_takes_a_while_takes_the_course_that_leaves_least(relaxes: bool) -> None:
    """Begun with the other course, at joint solutions of either."""
    forms = {one.variant: one for one in effect_named("bias_drift").hypotheses(scene()) if one.in_place}
    evenly, relaxing = forms["over a while"], forms["relaxing from an instant"]
    since = np.maximum(TIME_S - 3000.0, 0.0)
    course = 1.0 - np.exp(-since / 600.0) if relaxes else np.minimum(since / 1500.0, 1.0)
    search, fit = searching(flown(along(1, 1500.0 * course)), evenly, relaxing)
    form, theta = (evenly, [3000.0, 5000.0]) if relaxes else (relaxing, [3000.0, 600.0])
    found = timed(search, solve(search.problem, fit.x, [Term(form, np.array(theta), np.zeros(3))]), 0).terms[0]
    assert found.hypothesis is (relaxing if relaxes else evenly)
    np.testing.assert_allclose(found.theta, [3000.0, 600.0 if relaxes else 4500.0], atol=90.0)


def test_a_change_that_takes_a_while_is_held_against_each_form_of_a_sudden_one() -> None:
    """Three others are fitted where they come near; a jump at one instant is, too, whatever comes nearer."""
    effects = [effect_named(name) for name in ("bias_drift", "bias_step")]
    forms = {one.label: one for effect in effects for one in effect.hypotheses(scene())}
    while_, sudden = forms["bias_drift[over a while]"], forms["bias_step"]
    jump = 300.0 * (TIME_S >= 4000.0)
    search, fit = searching(flown(along(1, jump)), while_, sudden)
    fit = timed(search, solve(search.problem, fit.x, [Term(while_, np.array([3000.0, 5000.0]), np.zeros(3))]), 0)
    assert is_as_sudden(sudden, while_)
    assert not is_as_sudden(while_, sudden)
    sigma = max(fit.white_rms_nt, FLOOR_NT)
    ranked = search.screen(search.workspace(fit, 0), fit, sigma)
    blocks = search.problem.blocks(fit.white_residual)
    by_fit = tempered(search, ranked, fit, 0, search.workspace(fit, 0), blocks, sigma, most_fitted=1)
    assert by_fit[0].hypothesis is sudden
    assert abs(float(by_fit[0].theta[0]) - 4000.0) <= 8.0


@pytest.mark.parametrize(
    ("edges", "sized"), [((3000.0, 5000.0), True), ((5000.0, 7900.0), False), ((90.0, 4000.0), False)]
)
def test_a_change_that_is_cut_off_by_an_end_of_the_recording_has_no_size(edges: tuple[float, ...], sized: bool) -> None:
    """It may be going on: where it ends beside the last sample it was said to end there, trusted."""
    (form,) = [one for one in effect_named("bias_drift").hypotheses(scene()) if one.variant == "over a while"]
    search, fit = searching(flown(along(1, 900.0 * np.interp(TIME_S, edges, [0.0, 1.0]))), form)
    fit = solve(search.problem, fit.x, [Term(form, np.array(edges), np.zeros(3))])
    assert has_size(fit, 0) is sized


def test_a_form_without_an_instant_stays_as_it_is() -> None:
    form = body_form("one", "", along(0, SLOW))
    search, fit = searching(flown(along(0, 100.0 * SLOW)), form)
    began = solve(search.problem, fit.x, [Term(form, np.zeros(0), np.zeros(1))])
    assert timed(search, began, 0) is began


# Rivals by their own fit


def placed(*forms: Hypothesis) -> tuple[dict[str, Candidate], dict[str, Candidate], float]:
    """Rivals of the first form in its place, to first order and as they are compared; and their noise [nT]."""
    search, fit = searching(flown(along(0, 60.0 * SLOW)), *forms)
    fit = solve(search.problem, fit.x, [Term(forms[0], np.zeros(0), np.zeros(forms[0].size))])
    space, sigma = search.workspace(fit, 0), max(fit.white_rms_nt, FLOOR_NT)
    ranked = search.screen(space, fit, sigma)
    by_fit = tempered(search, ranked, fit, 0, space, search.problem.blocks(fit.white_residual), sigma)
    return *({one.hypothesis.effect: one for one in found} for found in (ranked, by_fit)), sigma  # type: ignore[return-value]


def test_rivals_that_come_near_are_fitted_and_others_are_not() -> None:
    """Where the nine errors hardly move, a rival's fit says what its first order did."""
    mine = body_form("mine", "", along(0, SLOW))
    near = body_form("near", "", along(0, SLOW + 0.15 * QUICK))
    far = body_form("far", "", along(0, OTHER))
    first, by_fit, _ = placed(mine, near, far)
    own = by_fit["mine"]
    assert first["near"].nats > 0.7 * own.nats > first["far"].nats
    assert by_fit["near"].nats == pytest.approx(first["near"].nats, abs=3.0)
    assert by_fit["near"].gain.amplitudes != pytest.approx(first["near"].gain.amplitudes, abs=1e-9)
    assert by_fit["far"].gain.amplitudes == pytest.approx(first["far"].gain.amplitudes, abs=1e-12)
    assert own.nats > by_fit["near"].nats > by_fit["far"].nats


@pytest.mark.parametrize(("own_driver", "rival_driver", "odds"), [("none", "none", 0), ("none", "channel:a", 1)])
def test_what_was_recorded_has_its_odds_as_a_rival_and_as_a_name(own_driver: str, rival_driver: str, odds: int) -> None:
    def nats(*drivers: str) -> float:
        fields = (SLOW, SLOW + 0.15 * QUICK)
        forms = [
            replace(body_form(name, "", along(0, field)), driver=driver)
            for name, field, driver in zip(("mine", "near"), fields, drivers, strict=True)
        ]
        _, by_fit, _ = placed(*forms)
        return by_fit["near"].nats - by_fit["mine"].nats

    equal = nats("none", "none")
    assert nats(own_driver, rival_driver) - equal == pytest.approx(odds * RECORDED_NATS, abs=1e-6)
    assert nats(rival_driver, own_driver) - equal == pytest.approx(-odds * RECORDED_NATS, abs=1e-6)


@pytest.mark.parametrize(("most", "is_one"), [(math.inf, True), (10.0, False)])
def test_what_is_beyond_its_physics_once_it_is_fitted_is_no_rival(most: float, is_one: bool) -> None:
    """To first order a field of the Sun's direction was 12 nats before recorded panels, and no size it ever has."""
    mine = body_form("mine", "", along(0, SLOW))
    near = body_form("near", "", along(0, SLOW + 0.15 * QUICK))
    first, by_fit, _ = placed(mine, replace(near, blocks=(replace(near.blocks[0], most=most),)))
    assert first["near"].nats > 0.7 * first["mine"].nats
    assert ("near" in by_fit) is is_one


def test_a_term_is_compared_at_the_numbers_of_its_fit() -> None:
    """Not at those that are best to first order: rivals are judged beside what was fitted."""
    form = step_form()
    search, fit = searching(flown(along(1, 90.0 * (TIME_S >= 4002.0))), form)
    fit = solve(search.problem, fit.x, [Term(form, np.array([4202.0]), np.zeros(3))])
    space, sigma = search.workspace(fit, 0), fit.white_rms_nt
    ranked = search.screen(space, fit, sigma, among=[form])
    (own,) = tempered(search, ranked, fit, 0, space, search.problem.blocks(fit.white_residual), sigma)
    assert ranked[0].theta[0] != 4202.0
    assert own.theta[0] == 4202.0
    assert own.gain.amplitudes == pytest.approx(fit.terms[0].amplitudes, rel=0.05, abs=1.0)


# On the cases that showed it, among the effects that were taken for one another


def of_blind(seed: int, kind: str, folder: Path, *among: str) -> Diagnosis:
    return diagnosed(write_blind(draw_blind(seed, kind), folder / "case"), among)


def of_regime(seed: int, index: int, folder: Path, *among: str) -> Diagnosis:
    case = draw_case(seed, index)
    folder.mkdir(exist_ok=True)
    return diagnosed(write_case(case, folder / "case"), among)


def diagnosed(descriptor: Path, among: tuple[str, ...]) -> Diagnosis:
    return diagnose(read_recording(descriptor), effects=tuple(effect_named(name) for name in among))


def names_of(diagnosis: Diagnosis) -> list[str]:
    return [term.hypothesis.effect for term in diagnosis.fit.terms]


def test_a_step_on_a_craft_that_looks_down_is_no_drift(tmp_path: Path) -> None:
    """To first order, where the step's nine errors are not, the drift was 39 nats better."""
    assert names_of(of_regime(4201, 50, tmp_path, "bias_step", "bias_drift")) == ["bias_step"]


def test_sunlight_is_not_said_for_sure_beside_the_panel_currents_that_were_recorded(tmp_path: Path) -> None:
    """They explain as much, with more numbers: it was 0.97, trusted."""
    assert "name_uncertain" in of_regime(5201, 94, tmp_path, "sun_disturbance", "current_loop").reasons


def test_a_fit_that_stalls_beside_its_end_is_taken_there(tmp_path: Path) -> None:
    """Axes digitised one after another, at a steady spin nearly a skew: the fit stalled, and nothing was named."""
    diagnosis = of_blind(510200060, "axis_skew", tmp_path, "axis_skew", "response_lag")
    assert names_of(diagnosis) == ["axis_skew"]
    assert diagnosis.fit.converged


def test_a_name_that_grows_the_field_is_not_refused_for_its_larger_noise(tmp_path: Path) -> None:
    """A place 9 km too low grows the field by 0.4 %, and its noise, which is more than the name explains."""
    diagnosis = of_blind(410100093, "position_offset", tmp_path, "position_offset", "scale_drift")
    assert names_of(diagnosis) == ["position_offset"]
    assert diagnosis.reasons == ()


@pytest.mark.parametrize("of", ["blind", "regime"])
def test_a_line_of_the_craft_s_own_turning_is_no_tone(of: str, tmp_path: Path) -> None:
    """A product of two components of the field, and the size of its change, have lines where the craft turns."""
    if of == "blind":
        diagnosis = of_blind(410100022, "outside:field_product", tmp_path, "tone", "cubic_response")
    else:
        diagnosis = of_regime(4203, 58, tmp_path, "tone", "cubic_response")
    assert names_of(diagnosis) == []
    assert diagnosis.reasons == ("unexplained_structure",)


@pytest.mark.parametrize("seed", [610100016, 710100012])
def test_one_product_that_holds_more_than_a_cubic_s_nine_numbers_is_no_cubic(seed: int, tmp_path: Path) -> None:
    """The cubic left nothing beside it, and was trusted."""
    diagnosis = of_blind(seed, "outside:field_product", tmp_path, "cubic_response")
    assert "cubic_response" not in names_of(diagnosis)
    assert diagnosis.reasons == ("unexplained_structure",)


def test_a_true_line_beside_a_turning_craft_stays_one(tmp_path: Path) -> None:
    diagnosis = of_blind(410100034, "tone", tmp_path, "tone", "cubic_response")
    assert names_of(diagnosis) == ["tone"]
    assert diagnosis.reasons == ()
