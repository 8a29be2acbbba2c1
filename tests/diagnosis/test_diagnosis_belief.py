"""How far a name is believed: probabilities among rivals, and each reason against acting on a result."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from magcal_service.diagnosis.belief import posterior, with_left
from magcal_service.diagnosis.explain import CLASS_NATS
from magcal_service.diagnosis.instants import has_other_course
from magcal_service.diagnosis.linear import Gain
from magcal_service.diagnosis.problem import Term
from magcal_service.diagnosis.rest import Rest
from magcal_service.diagnosis.screen import Candidate
from magcal_service.diagnosis.sized import may_as_well_be
from magcal_service.diagnosis.solution import solve
from magcal_service.model import Array
from magcal_service.physics.catalogue import effect_named
from magcal_service.physics.interface import UNLISTED, Block
from tests.diagnosis.made_up import QUICK, SLOW, along, body_form, searching
from tests.diagnosis.made_up import flown as made_of
from tests.diagnosis.step_explained import STEP_NT, explained, form, said
from tests.physics.scenes import scene

CURRENTS = effect_named("current_loop").hypotheses(replace(scene(), channels={}))
ORBIT_S = 2.0 * math.pi / 1.1068e-3  # of the scene


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


@pytest.mark.parametrize(("second_nt", "others"), [(-300.0, ("sun_disturbance",)), (-200.0, ())])
def test_what_two_amplitudes_of_opposite_signs_leave_open_is_an_open_name(
    second_nt: float, others: tuple[str, ...]
) -> None:
    """Of panels on both sides of a craft whose sums are not seen, as of a field that follows the Sun's direction."""
    apart = (("sun_disturbance", np.array([[1.0, 1.0]])),)
    both = body_form("current_loop", "", along(0, SLOW), along(1, QUICK), if_none=apart)
    of = made_of(300.0 * along(0, SLOW) + second_nt * along(1, QUICK))
    search, alone = searching(of, replace(both, blocks=(Block("nt", "nT", (2,)),)))
    fit = solve(search.problem, alone.x, [Term(search.hypotheses[0], np.zeros(0), np.zeros(2))])
    assert may_as_well_be(fit, 0) == others


def test_what_the_sun_is_met_of_in_the_second_degree_may_be_panels() -> None:
    forms = {h.variant: h.if_completed for h in effect_named("sun_disturbance").hypotheses(scene())}
    panels = ("current_loop",)
    assert forms == {"": (), "second degree": panels, "second degree and light": panels}


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
    lit = next(one for one in CURRENTS if one.driver.startswith("inferred") and one.variant == "lit or not")
    named = explained([])
    fit = replace(named.fit, terms=(*named.fit.terms, Term(lit, np.zeros(0), field_nt)))
    twice = replace(named, fit=fit, rivals=((), ()), nats=named.nats * 2, gains=named.gains * 2)
    assert [posterior(twice, index).own for index in range(2)] == pytest.approx([own, 0.97])


@pytest.mark.parametrize(
    ("direction", "driver", "own"),
    [
        ([0.0, -1.0, 0.0], "inferred:temperature", 0.7),
        ([0.9, -0.3, 0.3], "inferred:temperature", 0.97),
        ([0.0, -1.0, 0.0], "channel:one", 0.97),
    ],
)
def test_two_that_are_inferred_along_one_line_may_be_one_of_another_course(
    direction: list[float], driver: str, own: float
) -> None:
    """A thermoelectric current, which follows how fast a warmth changes, was heat less a current, both for sure."""
    (lit,) = (h for h in CURRENTS if h.driver.startswith("inferred") and h.variant == "lit or not")
    heats = next(h for h in effect_named("thermal_bias").hypotheses(scene()) if h.variant == "answer to light")
    warm = Term(replace(heats, driver=driver, imitated_by=""), np.array([900.0, 300.0]), np.zeros(6))
    warm = replace(warm, amplitudes=np.array([*(400.0 * np.array(direction)), 0.0, 0.0, 0.0]))
    named = explained([])
    fit = replace(named.fit, terms=(Term(lit, np.zeros(0), np.array([20.0, 800.0, -30.0])), warm))
    twice = replace(named, fit=fit, rivals=((), ()), nats=named.nats * 2, gains=named.gains * 2)
    assert posterior(twice, 0).own == pytest.approx(own)


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
        ("channel:one", "none", 1000.0, -22.0, math.exp(-2.0)),
        ("channel:one", "inferred:light", 1000.0, -22.0, math.exp(-2.0)),
        ("channel:one", "channel:other", 1000.0, -22.0, math.exp(-22.0)),
        ("inferred:light", "channel:one", 1000.0, 22.0, math.exp(2.0)),
        ("none", "none", 1000.0, 22.0, math.exp(22.0)),
        ("channel:other", "channel:one", 1000.0, 22.0, math.exp(22.0)),
    ],
)
def test_a_course_that_is_inferred_leaves_more_to_its_rivals(
    driver: str, by: str, own_nats: float, behind: float, odds: float
) -> None:
    """It may lose 0.5 % of its evidence by not being the true one: of 1000 nats 5, so 6 behind are 1.

    A rival by the same course loses as much.  One that was recorded may lose 1 % by its own noise and lag, as a rival
    and as a name that one without a record is ahead of.
    """
    named = explained([("bias_drift", own_nats - behind)], own_nats)
    ranked = {one.hypothesis.effect: one for one in named.rivals[0]}
    first, other = ranked["bias_step"], ranked["bias_drift"]
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
