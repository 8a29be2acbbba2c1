"""Each reason against acting on a result."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from magcal_service.diagnosis.belief import (
    Posterior,
    _is_rather_unlisted,
    are_rather_unlisted,
    posterior,
    unlisted,
    with_left,
)
from magcal_service.diagnosis.doubts import reasons, stands_out
from magcal_service.diagnosis.explain import Explained, Search
from magcal_service.diagnosis.field_error import FieldError
from magcal_service.diagnosis.linear import Gain
from magcal_service.diagnosis.problem import Fit, Problem, Term
from magcal_service.diagnosis.rest import Rest
from magcal_service.diagnosis.screen import Candidate, hypotheses_of
from magcal_service.diagnosis.sized import has_size
from magcal_service.diagnosis.solution import solve
from magcal_service.model import measure
from magcal_service.physics.catalogue import catalogue, effect_named
from magcal_service.physics.interface import UNLISTED, Block, Finding, Nonlinear, value_of
from tests.diagnosis.made_up import SLOW, along, body_form, searching
from tests.diagnosis.made_up import flown as made_of
from tests.diagnosis.step_explained import explained, fits, form, problem, said
from tests.physics.scenes import NOISE_NT, X, scene, spoiled


@pytest.mark.parametrize(
    ("left", "own"),
    [
        ({"lasting_nats": 4.0}, 0.9615),
        ({"lasting_nats": 25.0}, 0.8),
        ({"shaped_nats": 25.0}, 0.96),
        ({"shaped_nats": 100.0}, 0.75),
        ({"shaped_nats": 25.0, "lasting_nats": 4.0}, 0.96),
    ],
)
def test_what_is_left_may_be_the_rest_of_a_cause_in_no_catalogue(left: dict[str, float], own: float) -> None:
    """A name that holds 100 nats, and the rest by its share of the two; the rivals' odds among themselves stay."""
    alone = posterior(replace(explained([]), **left), 0)
    assert alone.own == pytest.approx(own, abs=1e-4)
    assert alone.rivals == (("unknown", pytest.approx(1.0 - own, abs=1e-4)),)
    assert alone.members == ("bias_step",)
    beside = posterior(replace(explained([("bias_drift", 98.0)]), **left), 0)
    assert dict(beside.rivals)["unknown"] == pytest.approx(1.0 - own, abs=1e-4)
    assert dict(beside.rivals)["bias_drift"] / beside.own == pytest.approx(math.exp(-2.0))
    assert sum(p for _, p in beside.rivals) + beside.own == pytest.approx(1.0)


def test_what_is_left_is_counted_by_its_squares_or_its_share() -> None:
    """A family of shapes over twice the variance; what lasts by its share beside all names (100 nats)."""
    named, two = explained([]), 2.0 * fits()[1].white_rms_nt ** 2
    for after, lasting in ((300.0, 100.0 * 0.03 / 0.97), (29.0, 0.0)):
        left = with_left(named, 5e6, Rest(before=1e4, after=after, sigma=10.0), 1.0)
        assert (left.shaped_nats, left.lasting_nats) == (pytest.approx(5e6 / two), pytest.approx(lasting))
    none = with_left(named, 0.0, None, 1.0)
    assert (none.shaped_nats, none.lasting_nats) == (0.0, 0.0)
    half = with_left(named, 0.0, Rest(before=1e4, after=5000.0, sigma=10.0), 1.0)
    assert posterior(half, 0).own == pytest.approx(0.5)


@pytest.mark.parametrize(("share", "expected"), [(0.049, ()), (0.051, ("unexplained_structure",))])
def test_little_may_be_left_beside_names(share: float, expected: tuple[str, ...]) -> None:
    """A twentieth of the mismatch without a name; where that is the verdict, any share."""
    assert said(explained([]), share) == expected
    assert said(explained([]), 0.0, unknown=True) == ("unexplained_structure",)


def test_what_did_not_arrive_or_collapsed_is_not_trusted() -> None:
    """Both are asked of the fit itself."""
    named = explained([])
    assert said(replace(named, fit=replace(named.fit, converged=False))) == ("not_converged",)
    shrunk = np.array(named.fit.x)
    shrunk[3] = -0.7
    assert "collapsed" in said(replace(named, fit=replace(named.fit, x=shrunk)))


def test_a_gain_within_its_scatter_does_not_stand_out() -> None:
    """An effect that held-out blocks do not gain by, here one that was fitted to nothing; the true one does."""
    idle = solve(problem(), fits()[0].x, [Term(form("tone"), np.array([0.0213]), np.zeros(6))])
    assert not stands_out(fits()[0], idle, 0.3 * NOISE_NT)
    assert stands_out(fits()[0], explained([]).fit, 0.3 * NOISE_NT)


def test_a_number_at_the_end_of_its_search_is_no_size() -> None:
    """A time constant as long as the longest that was tried bounds it from below; one within has a value."""
    (term,) = fits()[1].terms
    slow = replace(term.hypothesis, nonlinear=(Nonlinear("time_constant_s", "s", np.array([100.0, 5000.0])),))
    for tau_s, sized in ((4900.0, True), (5000.0, False), (100.0, True)):
        fit = replace(fits()[1], terms=(replace(term, hypothesis=slow, theta=np.array([tau_s])),))
        assert has_size(fit, 0) is sized


def test_an_effect_has_a_size_where_one_of_its_numbers_is_three_sigma() -> None:
    """Here the step's: as fitted, and each number taken to 2.9 and one of them to 3.1 of its own sigma."""
    fit = fits()[1]
    assert has_size(fit, 0)
    sigma = np.sqrt(np.diagonal(fit.covariance)[9:12])
    for most, expected in ((2.9, False), (3.1, True)):
        faint = replace(fit, terms=(replace(fit.terms[0], amplitudes=sigma * np.array([2.9, -2.9, most])),))
        assert has_size(faint, 0) is expected
        assert ("size_uncertain" in said(replace(explained([]), fit=faint))) is not expected


def test_what_only_completes_a_form_is_no_size_of_it() -> None:
    """A field of the Sun's direction of which only the second degree, or what is alike in every direction, is seen."""
    fit = fits()[1]
    (term,) = fit.terms
    own, other = replace(term.hypothesis.blocks[0], shape=(1,)), replace(term.hypothesis.blocks[0], shape=(2,))
    sigma = np.sqrt(np.diagonal(fit.covariance)[9:12])
    for completes, z, expected in (
        (True, (0.4, 6.8, 6.6), False),
        (True, (3.1, 0.1, 0.1), True),
        (False, (0.4, 6.8, 0.0), True),
    ):
        form = replace(term.hypothesis, blocks=(own, replace(other, completes=completes)))
        seen = replace(fit, terms=(replace(term, hypothesis=form, amplitudes=sigma * np.array(z)),))
        assert has_size(seen, 0) is expected


def test_a_search_tempers_rivals_and_keeps_the_truth() -> None:
    """On the step with its whole catalogue: the step alone, seen in most blocks, its rivals behind."""
    search = Search(problem(), hypotheses_of(catalogue(), problem()), catalogue())
    found = search.run(fits()[0], 0.3 * NOISE_NT)
    assert [term.hypothesis.effect for term in found.fit.terms] == ["bias_step"]
    gain = found.gains[0]
    assert gain.dispersion < 1.8
    assert gain.seen >= 0.8 * gain.expected > 0
    believed = posterior(found, 0)
    assert all(probability < 0.01 for name, probability in believed.rivals if name != "unknown")
    assert believed.own > 0.75  # a step of so few nats in a scene of 4 s is not seen to be quicker than ten minutes


def noisier(
    times: float,
    *,
    tails: float = 0.0,
    alone: bool = True,
    memory: bool = False,
    added_nt: float = 0.0,
    wide: float = 0.0,
) -> tuple[str, ...]:
    """The reasons where noise is so many times what was stated, with spikes in a share ``tails`` of the samples."""
    rng = np.random.default_rng(43)
    noise = times * NOISE_NT * rng.normal(size=(len(scene()), 3))
    out = rng.random(len(scene())) < tails
    noise[out] += 5.0 * NOISE_NT * scene().unit[out]
    x = X + wide * np.array([0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0])
    fit = solve(Problem(spoiled(measure(x, scene().calibrated_nt) + noise, scene()), NOISE_NT), x)
    said = {"level_nt": value_of(times * NOISE_NT, 1.0, "nT")} if memory else {}
    added = {"added_noise_nt": value_of(added_nt, 0.0, "nT")} if added_nt else {}
    findings = {"found": Finding({**said, **added}, 20.0, 0.0)}
    return reasons(Explained(fit), 0.0, False, stated=alone, findings=findings)


def test_more_than_the_stated_noise_is_not_trusted() -> None:
    """Where it was stated, and no level of its own was found; a few samples far out are no noisier sensor."""
    assert noisier(1.1) == ()
    assert noisier(1.3) == ("noisier_than_stated",)
    assert noisier(0.5) == ()
    assert noisier(1.0, tails=0.03) == ()
    assert noisier(1.3, alone=False) == ()
    assert noisier(1.3, memory=True) == ()
    assert noisier(1.3, added_nt=0.8 * NOISE_NT) == ()
    assert noisier(1.0, wide=0.35) == ()  # a sensor that shows too little: its noise grows with what it shows
    assert noisier(1.3, wide=0.35) == ("noisier_than_stated",)


@pytest.mark.parametrize(
    ("share", "stated", "expected"), [(0.019, False, ()), (0.021, False, ("rough_residual",)), (0.021, True, ())]
)
def test_noise_larger_than_any_sensors_is_none(share: float, stated: bool, expected: tuple[str, ...]) -> None:
    """2 % of the field, where nobody stated it."""
    named = explained([])
    noise_nt = share * float(scene().magnitude_nt.mean())
    rough = replace(named, fit=replace(named.fit, problem=replace(named.fit.problem, noise_nt=noise_nt)))
    assert reasons(rough, 0.0, False, stated) == expected


def test_a_rival_that_comes_to_nothing_in_a_names_place_gives_it_back(monkeypatch: pytest.MonkeyPatch) -> None:
    """To first order it was ahead; expanded where it led itself it holds nothing, and is no rival any more."""
    effects = tuple(effect_named(name) for name in ("bias_drift", "scale_step"))
    alone, step = fits()
    others = hypotheses_of(effects, step.problem)
    search = Search(step.problem, [step.terms[0].hypothesis, *others], effects, close={one.label for one in others})
    drift = next(one for one in search.hypotheses if one.effect == "bias_drift" and not one.variant)
    ahead = solve(problem(), alone.x, [Term(drift, np.zeros(0), np.full(3, 0.03))])

    def first_order(_: Search, fit: Fit, *_rest: object) -> Fit | None:
        return ahead if fit is step else None

    monkeypatch.setattr(Search, "_with_better", first_order)
    monkeypatch.setattr(Search, "refreshed", lambda _, fit: alone if fit is ahead else fit)
    found = search.compared(step, 0.3 * NOISE_NT)
    assert [term.hypothesis.effect for term in found.fit.terms] == ["bias_step"]
    assert search.problem is step.problem
    names = [one.hypothesis.effect for one in found.rivals[0]]
    assert names[0] == "bias_step"
    assert "bias_drift" not in names
    assert "scale_step" in names


@pytest.mark.parametrize(("own", "rather"), [(0.02, True), (0.06, False)])
def test_a_name_at_two_per_cent_is_none_though_what_is_likelier_has_a_form(own: float, rather: bool) -> None:
    """A Sun's field was said at 2 %, beside a gain that follows a thermometer by more than any sensor's does."""
    rivals = (("unknown", 0.95 - own), ("thermal_scale", 0.05))
    assert _is_rather_unlisted(Posterior(own, rivals, ("sun_disturbance", "unknown", "thermal_scale"))) is rather


@pytest.mark.parametrize(("lasting", "rather"), [(0.0, False), (100.0, False), (120.0, True), (900.0, True)])
def test_a_cause_in_no_catalogue_that_is_clearly_likelier_leaves_no_name(lasting: float, rather: bool) -> None:
    """By what lasts beside a hundred nats; an even chance leaves the name, and so does a slow change of the same."""
    named = replace(explained([]), lasting_nats=lasting)
    assert are_rather_unlisted(named) is rather
    slow: Any = SimpleNamespace(likelihoods=(6.0,))
    assert not are_rather_unlisted(replace(explained([]), slower=slow))
    assert not are_rather_unlisted(Explained(fits()[0]))


def test_a_class_counts_as_a_whole_against_what_is_in_no_catalogue() -> None:
    """Two names that are not told apart share what is left to names."""
    alike = replace(explained([("bias_drift", 100.0)]), lasting_nats=100.0)
    assert posterior(alike, 0).own == pytest.approx(0.25)
    assert not are_rather_unlisted(alike)


def test_what_acts_exactly_so_in_no_catalogue_is_said() -> None:
    """A gain on a beat, where momentum may be dumped on it."""
    dumped = next(h for h in effect_named("torquer").hypotheses(scene()) if h.variant == "momentum dumped at intervals")
    named = explained([])
    fit = replace(named.fit, terms=(Term(dumped, np.array([500.0, 0.3, 0.1]), np.ones(6)),))
    assert unlisted(replace(named, fit=fit), 0) == "a gain that changes on the same beat, by a cause in no catalogue"
    assert unlisted(named, 0) == ""


@pytest.mark.parametrize(
    ("errs", "behind", "members"), [(True, 75.0, True), (True, 300.0, False), (False, 75.0, False)]
)
def test_among_a_field_models_errors_a_change_over_a_while_is_hardly_told_from_a_jump(
    errs: bool, behind: float, members: bool
) -> None:
    """Its ends follow them: of 1600 nats 75 more are no odds of 10^32."""
    ramp = next(h for h in effect_named("scale_drift").hypotheses(scene()) if h.variant == "over a while")
    idle = Gain(0.0, 0.0, 0.0, np.zeros(0))
    ranked = [
        Candidate(ramp, np.zeros(2), idle, 1600.0),
        Candidate(form("scale_step"), np.zeros(1), idle, 1600.0 - behind),
    ]
    named = explained([])
    error = FieldError.of(scene(), NOISE_NT) if errs else None
    terms = (Term(ramp, np.array([3000.0, 3120.0]), np.full(3, 1e-3)),)
    fit = replace(named.fit, terms=terms, problem=replace(named.fit.problem, field_error=error))
    found = posterior(replace(named, fit=fit, rivals=(tuple(ranked),), nats=(1600.0,)), 0)
    assert found.members == (("scale_drift", "scale_step") if members else ("scale_drift",))
    assert dict(found.rivals).get("scale_step", 0.0) == pytest.approx(0.087 if members else 0.0, abs=0.01)


@pytest.mark.parametrize(("highest", "sized"), [(math.inf, True), (1000.0, True), (890.0, False)])
def test_an_amplitude_beside_the_most_that_its_physics_has_is_no_size(highest: float, sized: bool) -> None:
    """It may be another cause, which has more: 900 nT, known to a few."""
    own = replace(body_form("one", "", along(0, SLOW)), blocks=(Block("nt", "nT", (1,), highest=highest),))
    search, alone = searching(made_of(900.0 * along(0, SLOW)), own)
    fit = solve(search.problem, alone.x, [Term(search.hypotheses[0], np.zeros(0), np.zeros(1))])
    assert fit.terms[0].amplitudes[0] == pytest.approx(900.0, abs=25.0)
    assert has_size(fit, 0) is sized


@pytest.mark.parametrize("in_orbit", [True, False])
def test_on_the_ground_one_gain_that_steps_may_be_the_field_itself(in_orbit: bool) -> None:
    """A magnitude does not tell them apart; in orbit nothing moves the field at an instant."""
    of = replace(scene(), in_orbit=in_orbit)
    one = next(h for h in effect_named("scale_step").hypotheses(of) if h.variant == "one gain")
    named = explained([])
    fit = replace(named.fit, terms=(Term(one, np.array([4100.0]), np.full(1, 0.01)),))
    found = posterior(replace(named, fit=fit, rivals=((),)), 0)
    assert found.members == (("scale_step",) if in_orbit else ("scale_step", UNLISTED))
    assert found.own == pytest.approx(0.97 if in_orbit else 0.97 / 2.0)
