"""How far a name is believed: probabilities among rivals, and each reason against acting on a result."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from magcal_service.diagnosis.belief import are_rather_unlisted, posterior, unlisted, with_left
from magcal_service.diagnosis.blocks import Gain as BlockGain
from magcal_service.diagnosis.doubts import reasons, stands_out
from magcal_service.diagnosis.explain import CLASS_NATS, Explained, Search
from magcal_service.diagnosis.field_error import FieldError
from magcal_service.diagnosis.instants import has_other_course
from magcal_service.diagnosis.linear import Gain
from magcal_service.diagnosis.problem import Fit, Problem, Term
from magcal_service.diagnosis.rest import Rest
from magcal_service.diagnosis.screen import Candidate, hypotheses_of
from magcal_service.diagnosis.sized import has_size, may_as_well_be
from magcal_service.diagnosis.solution import solve
from magcal_service.model import Array, measure
from magcal_service.physics.catalogue import catalogue, effect_named
from magcal_service.physics.interface import UNLISTED, Block, Finding, Hypothesis, Nonlinear, value_of
from tests.diagnosis.made_up import QUICK, SLOW, along, body_form, searching
from tests.diagnosis.made_up import flown as made_of
from tests.physics.scenes import NOISE_NT, X, scene, spoiled

STEP_NT = np.array([220.0, -140.0, 90.0])
AT_S = 4100.0
ORBIT_S = 2.0 * math.pi / 1.1068e-3  # of the scene


def form(name: str) -> Hypothesis:
    """The first form of an effect on the scene."""
    return effect_named(name).hypotheses(scene())[0]


def problem() -> Problem:
    """The scene with a step of the bias."""
    late = (scene().time_s >= AT_S)[:, None]
    noise = NOISE_NT * np.random.default_rng(31).normal(size=(len(scene()), 3))
    return Problem(spoiled(measure(X, scene().calibrated_nt + STEP_NT * late + noise), scene()), NOISE_NT)


@cache
def fits() -> tuple[Fit, Fit]:
    """Nine errors alone, and with the step."""
    alone = solve(problem(), X)
    return alone, solve(problem(), alone.x, [Term(form("bias_step"), np.array([AT_S]), STEP_NT)])


def explained(rivals: Sequence[tuple[str, float]], own: float = 100.0) -> Explained:
    """The step at ``own`` nats, and rivals at theirs."""
    idle = Gain(0.0, 0.0, 0.0, np.zeros(0))
    ranked = [Candidate(form(name), np.zeros(0), idle, nats) for name, nats in [("bias_step", own), *rivals]]
    return Explained(fits()[1], (tuple(ranked),), (own,), (BlockGain(own, 1.0, 10, 10),))


@pytest.mark.parametrize(("behind", "sized"), [(1.0, False), (10.0, True)])
def test_where_another_course_holds_as_much_a_change_has_no_size(behind: float, sized: bool) -> None:
    """Evenly or relaxing: it begins and ends elsewhere."""
    evenly, relaxing = (replace(form("bias_drift"), variant=variant, in_place=True) for variant in ("even", "relaxing"))
    idle = Gain(0.0, 0.0, 0.0, np.zeros(0))
    ranked = [Candidate(evenly, np.zeros(0), idle, 50.0), Candidate(relaxing, np.zeros(0), idle, 50.0 - behind)]
    others = has_other_course(Term(evenly, np.zeros(0), np.zeros(3)), ranked, CLASS_NATS)
    assert others is not sized
    assert ("size_uncertain" in said(replace(explained([]), courses=(others,)))) is not sized


@pytest.mark.parametrize(("own_nt", "others"), [(0.0, ("current_loop",)), (400.0, ())])
def test_what_only_completes_a_form_may_be_the_cause_that_it_is_met_of_too(
    own_nt: float, others: tuple[str, ...]
) -> None:
    blocks = (Block("nt", "nT", (1,)), Block("second_nt", "nT", (1,), completes=True))
    both = body_form("sun_disturbance", "", along(0, SLOW), along(1, QUICK), if_completed=("current_loop",))
    search, alone = searching(made_of(own_nt * along(0, SLOW) + 900.0 * along(1, QUICK)), replace(both, blocks=blocks))
    fit = solve(search.problem, alone.x, [Term(search.hypotheses[0], np.zeros(0), np.zeros(2))])
    assert may_as_well_be(fit, 0) == others


def test_what_the_sun_is_met_of_in_the_second_degree_may_be_panels() -> None:
    forms = {h.variant: h.if_completed for h in effect_named("sun_disturbance").hypotheses(scene())}
    panels = ("current_loop",)
    assert forms == {"": (), "second degree": panels, "second degree and light": panels}


def said(named: Explained, unexplained: float = 0.0, unknown: bool = False) -> tuple[str, ...]:
    """The reasons against it."""
    return reasons(named, unexplained, unknown)


def test_probabilities_are_those_of_the_nats() -> None:
    """e to the difference, over the sum, less what is left to causes in no catalogue; a class is within 3 nats."""
    found = posterior(explained([("bias_drift", 99.0), ("scale_drift", 96.5), ("tone", 90.0)]), 0)
    weights = [1.0, math.exp(-1.0), math.exp(-3.5), math.exp(-10.0)]
    assert found.own == pytest.approx(0.97 / sum(weights))
    assert found.members == ("bias_step", "bias_drift")
    rivals = dict(found.rivals)
    assert rivals.pop("unknown") == pytest.approx(0.03)
    assert list(rivals) == ["bias_drift", "scale_drift", "tone"]
    assert list(rivals.values()) == pytest.approx([0.97 * weight / sum(weights) for weight in weights[1:]])


def test_a_class_is_what_the_recording_cannot_tell_apart_however_seldom_it_is_met() -> None:
    """A lag behind a late clock by nothing but its odds: improbable, and in the class."""
    idle, odds = Gain(0.0, 0.0, 0.0, np.zeros(0)), 3.0
    seldom = replace(form("bias_drift"), odds=odds)
    named = explained([])
    ranked = (*named.rivals[0], Candidate(seldom, np.zeros(0), idle, 100.0 - odds - 0.5))
    found = posterior(replace(named, rivals=(ranked,)), 0)
    assert found.members == ("bias_step", "bias_drift")
    assert dict(found.rivals)["bias_drift"] == pytest.approx(0.97 / (1.0 + math.exp(odds + 0.5)))


@pytest.mark.parametrize("recorded", [False, True])
def test_a_drift_on_the_ground_without_a_record_may_be_a_sensor_that_warms(recorded: bool) -> None:
    """In orbit warmth follows the light, which is seen or not."""
    channels = scene().channels if recorded else {}
    room = replace(scene(), in_orbit=False, channels=channels)
    for effect, warmth in (("bias_drift", "thermal_bias"), ("scale_drift", "thermal_scale")):
        drift = next(one for one in effect_named(effect).hypotheses(room) if not one.variant)
        named = explained([])
        fit = replace(named.fit, terms=(Term(drift, np.zeros(0), np.full(3, 1e-3)),))
        found = posterior(replace(named, fit=fit, rivals=((),)), 0)
        assert found.members == ((effect,) if recorded else (effect, warmth))
        assert found.own == pytest.approx(0.97 if recorded else 0.485)


def test_a_recorded_driver_leaves_less_to_what_is_in_no_catalogue() -> None:
    named = explained([])
    (term,) = named.fit.terms
    recorded = replace(named.fit, terms=(replace(term, hypothesis=replace(term.hypothesis, driver="channel:one")),))
    assert posterior(named, 0).own == pytest.approx(0.97)
    assert posterior(replace(named, fit=recorded), 0).own == pytest.approx(0.99)


@pytest.mark.parametrize(
    ("variant", "own"),
    [
        ("steps at 2 instants", 0.97),
        ("steps at 3 instants", 0.94),
        ("steps at 5 instants", 0.88),
        ("switched at 5 instants", 0.97 / 2.0),
    ],
)
def test_many_jumps_each_by_its_own_are_believed_less(variant: str, own: float) -> None:
    """What swells and fades is met by steps, too; what is switched on and off by one vector is a load
    or a bias, and no more."""
    jumps = next(one for one in effect_named("bias_step").hypotheses(scene()) if one.variant == variant)
    named = explained([])
    (term,) = named.fit.terms
    theta = np.linspace(1000.0, 7000.0, len(jumps.nonlinear))
    fit = replace(named.fit, terms=(replace(term, hypothesis=jumps, theta=theta),))
    assert posterior(replace(named, fit=fit), 0).own == pytest.approx(own)


@pytest.mark.parametrize(
    ("field_nt", "own"),
    [(STEP_NT, 0.5), (-0.4 * STEP_NT, 0.5), (STEP_NT + 40.0, 0.5), (np.array([90.0, 150.0, 0.0]), 0.97)],
)
def test_a_jump_along_a_current_that_was_inferred_may_be_its_load(field_nt: Array, own: float) -> None:
    currents = effect_named("current_loop").hypotheses(replace(scene(), channels={}))
    lit = next(one for one in currents if one.driver.startswith("inferred") and one.variant == "lit or not")
    named = explained([])
    fit = replace(named.fit, terms=(*named.fit.terms, Term(lit, np.zeros(0), field_nt)))
    twice = replace(named, fit=fit, rivals=((), ()), nats=named.nats * 2, gains=named.gains * 2)
    assert [posterior(twice, index).own for index in range(2)] == pytest.approx([own, 0.97])


@pytest.mark.parametrize(("again_s", "own"), [(ORBIT_S, 0.5), (0.98 * ORBIT_S, 0.5), (0.9 * ORBIT_S, 0.97)])
def test_what_is_switched_once_an_orbit_follows_the_orbit(again_s: float, own: float) -> None:
    """An eclipse does, and an array current with it; what comes again at other times is switched."""
    jumps = next(h for h in effect_named("bias_step").hypotheses(scene()) if h.variant == "switched at 4 instants")
    named = explained([])
    (term,) = named.fit.terms
    theta = np.array([500.0, 1700.0, 500.0 + again_s, 1690.0 + again_s])
    fit = replace(named.fit, terms=(replace(term, hypothesis=jumps, theta=theta),))
    assert posterior(replace(named, fit=fit), 0).own == pytest.approx(own / 2.0)  # the other half is a load's


@pytest.mark.parametrize(
    ("slower", "driver", "own"),
    [(0.6, "none", [0.7, 0.7]), (0.6, "channel:one", [0.97, 0.99]), (1.0, "none", [0.97, 0.97])],
)
def test_two_names_without_a_record_in_less_than_an_orbit_may_be_a_third(
    slower: float, driver: str, own: list[float]
) -> None:
    """A drift and a hysteresis together, for a warmth that nobody recorded."""
    named = explained([])
    other = Term(replace(form("tone"), driver=driver), np.array([0.02]), np.ones(6))
    of = replace(named.fit.problem, scene=replace(scene(), time_s=slower * scene().time_s))
    fit = replace(named.fit, problem=of, terms=(*named.fit.terms, other))
    twice = replace(named, fit=fit, rivals=((), ()), nats=named.nats * 2, gains=named.gains * 2)
    assert [posterior(twice, index).own for index in range(2)] == pytest.approx(own)


CYCLE_S = 130.0


def beside_a_duty(times: float, amplitudes: Sequence[float]) -> list[float]:
    """How far a duty of 130 s, along (1, 1, 1), which may be a load's as well, and a line at so many times its rate are
    believed together."""
    duty = next(
        one for one in effect_named("torquer").hypotheses(scene()) if "period" in {n.role for n in one.nonlinear}
    )
    theta = np.array([CYCLE_S if number.role == "period" else 0.3 for number in duty.nonlinear])
    line = Term(form("tone"), np.array([times / CYCLE_S]), np.array(amplitudes))
    named = explained([])
    fit = replace(named.fit, terms=(Term(duty, theta, np.ones(3)), line))
    twice = replace(named, fit=fit, rivals=((), ()), nats=named.nats * 2, gains=named.gains * 2)
    return [posterior(twice, index).own for index in range(2)]


@pytest.mark.parametrize(("times", "own"), [(2.0, 0.5), (3.0, 0.5), (2.4, 0.97), (0.5, 0.97)])
def test_a_duty_with_a_line_at_a_multiple_of_its_rate_is_some_wave(times: float, own: float) -> None:
    """It is no duty, and no tone of its own, though the line lies across it."""
    assert beside_a_duty(times, [1.0, -1.0, 0.0, 1.0, 1.0, -2.0]) == pytest.approx([0.5 * own, own], abs=1e-9)


@pytest.mark.parametrize(
    ("direction", "own"), [((1.0, 1.0, 0.9), 0.5), ((-2.0, -2.0, -2.0), 0.5), ((1.0, 0.0, 0.5), 0.97)]
)
def test_a_duty_along_a_line_may_be_what_two_lines_beat_by(direction: tuple[float, ...], own: float) -> None:
    """A line at no multiple of a duty's rate, which lies in the duty's own direction, or in another one."""
    assert beside_a_duty(2.4, [*direction, 0.0, 0.0, 0.0]) == pytest.approx([0.5 * own, own], abs=1e-9)


@pytest.mark.parametrize(
    ("effect", "variant", "channels", "members"),
    [
        ("torquer", "regular duty", True, ("torquer", "current_loop")),
        ("torquer", "sign of dB/dt", True, ("torquer",)),
        ("torquer", "momentum dumped at intervals", True, ("torquer", UNLISTED)),
        ("bias_step", "switched at 2 instants", False, ("bias_step", "current_loop")),
        ("bias_step", "switched at 2 instants", True, ("bias_step", "current_loop")),
        ("bias_step", "steps at 2 instants", False, ("bias_step",)),
        ("scale_drift", "", False, ("scale_drift",)),
    ],
)
def test_what_a_load_does_as_well_is_not_told_from_it(
    effect: str, variant: str, channels: bool, members: tuple[str, ...]
) -> None:
    """A constant current on a duty, as of a heater, is a coil's field; one that is switched a bias that comes and goes,
    whatever other circuits were recorded."""
    of = scene() if channels else replace(scene(), channels={})
    switched = next(one for one in effect_named(effect).hypotheses(of) if one.variant == variant)
    named = explained([])
    theta = np.array([number.grid[0] if len(number.grid) else CYCLE_S for number in switched.nonlinear])
    term = Term(switched, theta, np.ones(switched.size))
    found = posterior(replace(named, fit=replace(named.fit, terms=(term,)), rivals=((),)), 0)
    assert found.members == members
    assert found.own == pytest.approx(0.97 / len(members))


@pytest.mark.parametrize(("behind", "members"), [(0.0, True), (10.0, False)])
def test_what_acts_as_a_rival_does_is_in_the_class_with_it(behind: float, members: bool) -> None:
    """A drift that is not told from a field that is switched on and off is not told from a load either."""
    of = replace(scene(), channels={})
    switched = next(h for h in effect_named("bias_step").hypotheses(of) if h.variant == "switched at 2 instants")
    idle = Gain(0.0, 0.0, 0.0, np.zeros(0))
    ranked = [
        Candidate(form("bias_drift"), np.zeros(0), idle, 100.0),
        Candidate(switched, np.zeros(2), idle, 100.0 - behind),
    ]
    named = explained([])
    fit = replace(named.fit, terms=(Term(form("bias_drift"), np.zeros(0), np.ones(3)),))
    found = posterior(replace(named, fit=fit, rivals=(tuple(ranked),)), 0)
    assert found.members == (("bias_drift", "bias_step", "current_loop") if members else ("bias_drift",))
    assert found.own == pytest.approx(0.97 / (1.0 + 2.0 * math.exp(-behind)))


@pytest.mark.parametrize(
    ("larger", "driver", "own"),
    [(40.0, "none", 0.7), (40.0, "channel:one", 0.99), (30.0, "none", 0.97)],
)
def test_a_small_name_beside_a_much_larger_one_may_be_its_other_form(larger: float, driver: str, own: float) -> None:
    """A course that relaxes, fitted as one that bends, leaves a drift; what was recorded is no such rest."""
    named = explained([])
    (term,) = named.fit.terms
    small = replace(term, hypothesis=replace(term.hypothesis, driver=driver))
    fit = replace(named.fit, terms=(small, Term(form("scale_drift"), np.zeros(0), np.full(3, 1e-6))))
    gains = (*named.gains, replace(named.gains[0], nats=larger * named.gains[0].nats))
    twice = replace(named, fit=fit, rivals=((), ()), nats=named.nats * 2, gains=gains)
    assert [posterior(twice, index).own for index in range(2)] == pytest.approx([own, 0.97])


@pytest.mark.parametrize(("larger", "own"), [(4.0, 0.7), (3.0, 0.97)])
def test_beside_a_name_whose_course_is_guessed_a_small_one_is_doubted_earlier(larger: float, own: float) -> None:
    """Currents in space as a polynomial in time leave three tenths, which wrong places take."""
    named = explained([])
    currents = form("external_field")
    assert currents.inexact == 0.3
    fit = replace(named.fit, terms=(*named.fit.terms, Term(currents, np.zeros(0), np.full(currents.size, 1e-6))))
    gains = (*named.gains, replace(named.gains[0], nats=larger * named.gains[0].nats))
    twice = replace(named, fit=fit, rivals=((), ()), nats=named.nats * 2, gains=gains)
    assert [posterior(twice, index).own for index in range(2)] == pytest.approx([own, 0.97])


@pytest.mark.parametrize(
    ("driver", "by", "own_nats", "behind", "odds"),
    [
        ("none", "none", 1000.0, 6.0, math.exp(6.0)),
        ("channel:one", "none", 1000.0, 6.0, math.exp(6.0)),
        ("inferred:light", "none", 1000.0, 6.0, math.exp(1.0)),
        ("inferred:light", "inferred:sun", 1000.0, -6.0, math.exp(-1.0)),
        ("inferred:light", "none", 100.0, 6.0, math.exp(4.0)),
        ("inferred:light", "inferred:light", 1000.0, 6.0, math.exp(6.0)),
        ("none", "channel:one", 1000.0, 22.0, math.exp(2.0)),
        ("inferred:light", "channel:one", 1000.0, 22.0, math.exp(2.0)),
        ("none", "none", 1000.0, 22.0, math.exp(22.0)),
        ("channel:other", "channel:one", 1000.0, 22.0, math.exp(22.0)),
    ],
)
def test_a_course_that_is_inferred_leaves_more_to_its_rivals(
    driver: str, by: str, own_nats: float, behind: float, odds: float
) -> None:
    """It may lose 0.5 % of its evidence by not being the true one: of 1000 nats 5, so 6 behind are 1.

    A rival by the same course loses as much.  One that was recorded may lose 1 % by its own noise and lag.
    """
    named = explained([("bias_drift", own_nats - behind)], own_nats)
    first, other = named.rivals[0]
    named = replace(named, rivals=((first, replace(other, hypothesis=replace(other.hypothesis, driver=by))),))
    (term,) = named.fit.terms
    driven = replace(term, hypothesis=replace(term.hypothesis, driver=driver))
    found = posterior(replace(named, fit=replace(named.fit, terms=(driven,))), 0)
    assert found.own / dict(found.rivals)["bias_drift"] == pytest.approx(odds)
    assert found.members == (("bias_step", "bias_drift") if odds < math.exp(CLASS_NATS) else ("bias_step",))


@pytest.mark.parametrize(
    ("has_memory", "by_samples", "own"), [(True, True, 0.5), (True, False, 0.97), (False, True, 0.97)]
)
def test_what_acts_by_the_samples_order_is_not_told_from_noise_with_a_memory(
    has_memory: bool, by_samples: bool, own: float
) -> None:
    named = with_left(explained([]), 0.0, None if has_memory else Rest(before=1e4, after=29.0, sigma=10.0), 1.0)
    (term,) = named.fit.terms
    acts = replace(term, hypothesis=replace(term.hypothesis, by_samples=by_samples))
    assert posterior(replace(named, fit=replace(named.fit, terms=(acts,))), 0).own == pytest.approx(own)


def test_a_term_that_is_not_among_its_own_rivals_has_its_own_evidence() -> None:
    """The screening may find it below what can be seen, once others are there."""
    named = explained([("bias_drift", 99.0)])
    assert named.own_nats(0) == 100.0
    gone = replace(named, rivals=(named.rivals[0][1:],), nats=(101.0,))
    assert gone.own_nats(0) == 101.0
    assert posterior(gone, 0).own == pytest.approx(0.97 / (1.0 + math.exp(-2.0)))


def test_a_good_name_is_trusted() -> None:
    """The right step, nothing left, no rival near."""
    assert said(explained([("bias_drift", 60.0)])) == ()


@pytest.mark.parametrize(("behind", "expected"), [(3.8, ("name_uncertain",)), (3.9, ())])
def test_a_name_needs_ninety_five_per_cent(behind: float, expected: tuple[str, ...]) -> None:
    """One rival 3.87 nats behind leaves 0.95 beside what is in no catalogue."""
    assert said(explained([("bias_drift", 100.0 - behind)])) == expected


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


@pytest.mark.parametrize(("share", "expected"), [(0.099, ()), (0.101, ("unexplained_structure",))])
def test_little_may_be_left_beside_names(share: float, expected: tuple[str, ...]) -> None:
    """A tenth of the mismatch without a name; where that is the verdict, any share."""
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


@pytest.mark.parametrize(("lasting", "rather"), [(0.0, False), (100.0, False), (120.0, True), (900.0, True)])
def test_a_cause_in_no_catalogue_that_is_clearly_likelier_leaves_no_name(lasting: float, rather: bool) -> None:
    """By what lasts beside a hundred nats; an even chance leaves the name, and so does a slow change of the same."""
    named = replace(explained([]), lasting_nats=lasting)
    assert are_rather_unlisted(named) is rather
    assert not are_rather_unlisted(replace(named, slower=(6.0,)))
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
