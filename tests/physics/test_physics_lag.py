"""A driver that averages: what is lost is known from samples that follow one another, without a gyro."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from magcal_service.diagnosis.plausible import has_its_sign
from magcal_service.model import Array
from magcal_service.physics.catalogue import effect_named
from magcal_service.physics.drivers.late import by_low_pass, longer_by_low_pass
from magcal_service.physics.interface import Hypothesis, value_of
from magcal_service.physics.scene.scene import Scene, Telemetry

PERIOD_S, COUNT = 0.5, 400
TIME_S = PERIOD_S * np.arange(float(COUNT))
LAG = effect_named("response_lag")


def forms_of(scene: Scene) -> tuple[Hypothesis, ...]:
    """The forms that magnitudes show."""
    return tuple(one for one in LAG.hypotheses(scene) if not one.needs_vectors)


def turned(angle: Array) -> Array:
    """A field (n, 3) of 40 uT that turns by angles (n,) about an axis it is inclined to."""
    return 40e3 * np.stack([0.8 * np.cos(angle), 0.8 * np.sin(angle), np.full_like(angle, 0.6)], axis=1)


def averaged(read: Array, share: float) -> Array:
    told = [read[0]]
    for one in read[1:]:
        told.append(share * one + (1.0 - share) * told[-1])
    return np.array(told)


def scene_of(field: Array, time_s: Array = TIME_S) -> Scene:
    return Scene(time_s, 0, False, field, field, field, np.linalg.norm(field, axis=1))


def form(scene: Scene, variant: str = "average of samples") -> Hypothesis:
    return next(one for one in forms_of(scene) if one.variant == variant)


def lost(scene: Scene, variant: str = "average of samples", at_s: float = 0.0) -> Array:
    """What one unit of the amplitude takes off the magnitude (n,) [nT], expanded at a lateness."""
    return -form(scene, variant).columns(np.array([at_s])).along(scene.unit)[:, 0]


@pytest.mark.parametrize("share", [0.3, 0.7, 0.95])
@pytest.mark.parametrize("step", [0.02, 0.1])
def test_the_loss_is_that_of_the_average(share: float, step: float) -> None:
    field = turned(step * np.arange(float(COUNT)))
    told = averaged(field, share)
    missing = np.linalg.norm(field, axis=1) - np.linalg.norm(told, axis=1)
    memory = (1.0 - share) / share**2
    late = slice(60, None)  # the average has settled
    settled = replace(scene_of(told))
    assert memory * lost(settled)[late] == pytest.approx(missing[late], rel=0.5 * memory * step**2 + 0.01)


def test_a_gap_takes_the_step_that_follows_it() -> None:
    angle = 0.05 * np.arange(float(COUNT))
    angle[200:] += 2.0
    time_s = np.where(np.arange(COUNT) < 200, TIME_S, TIME_S + 30.0)
    scene = replace(scene_of(turned(angle), time_s), given={"period_s": PERIOD_S})
    found = lost(scene)
    assert found == pytest.approx(np.full(COUNT, found[100]), rel=0.01)


def test_a_sample_between_gaps_tells_nothing() -> None:
    time_s = np.array([0.0, 0.5, 10.0, 20.0, 20.5])
    scene = replace(scene_of(turned(0.1 * np.arange(5.0)), time_s), given={"period_s": PERIOD_S})
    assert (lost(scene) > 0.0).tolist() == [True, True, False, True, True]


def test_a_known_rate_has_the_low_pass_instead() -> None:
    scene = scene_of(turned(0.05 * np.arange(float(COUNT))))
    steps = ["by the steps", "by the steps, from its start", "average of samples"]
    assert [one.variant for one in forms_of(scene)] == steps
    rate = np.array([0.0, 0.0, 0.1])
    fitted = replace(scene, turning_rad_s=rate)  # a steady turn that was fitted need not be the craft's
    assert [one.variant for one in forms_of(fitted)] == ["", *steps]
    assert [one.by_samples for one in forms_of(fitted)] == [False, True, True, False]
    gyro = {"gyro": Telemetry("gyro", "angular rate", np.tile(rate, (COUNT, 1)))}
    assert [one.variant for one in forms_of(replace(scene, channels=gyro))] == [""]
    names = [[block.name for block in one.blocks] for one in forms_of(fitted)]
    assert names == [["tau2_s2"], ["tau2_s2"], ["tau2_s2", "start_nt"], ["memory"]]


def test_a_turn_that_the_samples_tell_better_is_tried_beside_a_fitted_one() -> None:
    """A slow turn that was fitted to a hundredth hides the samples' own only where those have whole radians between."""
    for step, alone in ((0.1, False), (1.2, True)):
        angle = step * np.cumsum(1.0 + 0.3 * np.sin(TIME_S / 20.0))
        rate = np.zeros((COUNT, 3))
        rate[:, 2] = step * (1.0 + 0.3 * np.sin(TIME_S / 20.0)) / PERIOD_S
        fitted = replace(scene_of(turned(angle)), turning_rad_s=rate)
        assert ("by the steps" not in [one.variant for one in forms_of(fitted)]) is alone


@pytest.mark.parametrize(("count", "offered"), [(63, False), (64, True)])
def test_a_course_needs_sixty_four_samples(count: int, offered: bool) -> None:
    scene = scene_of(turned(0.05 * np.arange(float(count))), TIME_S[:count])
    assert bool(forms_of(scene)) is offered


def test_samples_that_seldom_follow_one_another_have_no_form() -> None:
    time_s = TIME_S + 30.0 * (np.arange(COUNT) // 50)
    assert forms_of(scene_of(turned(0.05 * np.arange(float(COUNT))), time_s)) == ()


@pytest.mark.parametrize("step", [0.02, 0.15, 1.4])
def test_samples_that_are_lost_one_by_one_leave_the_turn_known(step: float) -> None:
    """One in twelve is lost, two in a row at times, so that nowhere sixty-four follow one another."""
    rng = np.random.default_rng(11)
    kept = rng.random(4 * COUNT) > 1.0 / 12.0
    time_s = PERIOD_S * np.arange(4.0 * COUNT)
    angle = step * np.cumsum(1.0 + 0.2 * np.sin(time_s / 60.0))
    field = turned(angle) + rng.normal(0.0, 100.0, (len(angle), 3))
    whole, some = lost(scene_of(field, time_s))[kept], lost(scene_of(field[kept], time_s[kept]))
    inside = slice(40, -40)
    assert some[inside] == pytest.approx(whole[inside], rel=0.03, abs=0.1 * whole.mean())
    assert some.mean() == pytest.approx(whole.mean(), rel=0.01)


def test_stamps_that_jitter_leave_the_turn_as_it_is() -> None:
    """Rows fall on the places that they are nearest to from the first on, and not each by its own step."""
    rng = np.random.default_rng(12)
    time_s = PERIOD_S * np.arange(4.0 * COUNT)
    jittered = time_s + 0.4 * PERIOD_S * rng.uniform(-1.0, 1.0, len(time_s))
    even, found = (lost(scene_of(turned(0.1 * time_s / PERIOD_S), at)) for at in (time_s, jittered))
    assert found.mean() == pytest.approx(even.mean(), rel=0.02)


def test_noise_of_the_step_is_smoothed() -> None:
    rate = 0.06 + 0.05 * np.sin(TIME_S / 30.0)
    field = turned(np.cumsum(rate))
    noisy = field + np.random.default_rng(5).normal(0.0, 300.0, field.shape)
    clean, found = lost(scene_of(field)), lost(scene_of(noisy))
    assert np.std(found - clean) < 0.05 * np.std(clean)
    assert found.mean() == pytest.approx(clean.mean(), rel=0.01)


def test_less_than_no_memory_is_no_average() -> None:
    average = form(scene_of(turned(0.05 * np.arange(float(COUNT)))))
    assert has_its_sign(average, np.array([0.0]))
    assert not has_its_sign(average, np.array([-0.01]))


def test_the_share_of_a_new_sample_follows_from_the_memory() -> None:
    found = LAG.derived({"memory": value_of(2.0, 0.03, "1"), "period_s": value_of(0.5, np.nan, "s")})
    share = found["new_share"]
    assert (1.0 - float(share.value)) / float(share.value) ** 2 == pytest.approx(2.0)
    moved = LAG.derived({"memory": value_of(2.03, 0.03, "1"), "period_s": value_of(0.5, np.nan, "s")})["new_share"]
    assert float(share.sigma) == pytest.approx(float(share.value - moved.value), rel=0.03)
    assert float(found["tau_s"].value) == pytest.approx(0.5 * 2.0**0.5)
    assert float(found["tau_s"].sigma) == pytest.approx(0.5 * (2.03**0.5 - 2.0**0.5), rel=0.03)


def low_passed(tau_s: float, rate_rad_s: Array, grows: float, begins: float = 1.0) -> tuple[Array, Array]:
    """A field (n, 3) whose length changes too, as a low-pass in a hundred steps a sample has it; and its length.

    It begins with so many times the field.
    """
    fine = 100
    time_s = PERIOD_S / fine * np.arange(COUNT * fine)
    angle = np.interp(time_s, TIME_S, np.cumsum(rate_rad_s) * PERIOD_S)
    length = 40e3 * (1.0 + grows * np.sin(2.0 * np.pi * time_s / 1000.0))
    field = turned(angle) * (length / 40e3)[:, None]
    field[0] *= begins
    told = averaged(field, 1.0 - float(np.exp(-PERIOD_S / fine / tau_s)))
    return told[::fine], length[::fine]


@pytest.mark.parametrize("tau_s", [0.5, 2.0, 4.0])
@pytest.mark.parametrize("rate_rad_s", [0.005, 0.1, 0.3])
def test_a_low_pass_is_late_with_the_course_and_short_by_the_turn(tau_s: float, rate_rad_s: float) -> None:
    """A slow craft's lag is a late clock, a fast one's a loss, that between both: to 1 % of an exact filter's."""
    rate = rate_rad_s * (1.0 + 0.3 * np.sin(TIME_S / 20.0))
    told, length = low_passed(tau_s, rate, 0.2)
    missing = length - np.linalg.norm(told, axis=1)
    settled = slice(80, -20)
    moved = seen(told, length, tau_s)
    found = tau_s**2 * lost(moved, "by the steps", tau_s)
    assert np.std((found - missing)[settled]) < 0.01 * np.std(missing[settled])
    assert form(moved, "by the steps").nonlinear[0].grid == pytest.approx([tau_s])
    assert form(moved, "by the steps").moves_s(np.array([tau_s**2])) == pytest.approx(-tau_s)


def seen(told: Array, length: Array, late_s: float) -> Scene:
    """The scene that a fit has of vectors that were told late: of the field's length, as late as it has found them."""
    straight = told * (length / np.linalg.norm(told, axis=1))[:, None]
    return Scene(TIME_S, 0, False, told, straight, told, length, moved_s=np.full(COUNT, -late_s))


@pytest.mark.parametrize("share", [0.2, 0.5])
def test_an_average_of_samples_that_turn_is_followed_exactly(share: float) -> None:
    field = turned(np.cumsum(0.15 * (1.0 + 0.5 * np.sin(TIME_S / 15.0))))
    told = averaged(field, share)
    length = np.linalg.norm(field, axis=1)
    late_s = PERIOD_S * (1.0 - share) / share
    found = (1.0 - share) / share**2 * lost(seen(told, length, late_s), at_s=late_s)
    missing = length - np.linalg.norm(told, axis=1)
    settled = slice(80, -20)
    assert np.std((found - missing)[settled]) < 0.01 * np.std(missing[settled])


def test_what_a_low_pass_held_at_its_start_is_a_number_of_its_own() -> None:
    """One that begins 5 % longer than the field: 2000 nT, which decay."""
    tau_s = 4.0
    told, length = low_passed(tau_s, np.full(COUNT, 0.08), 0.0, begins=1.05)
    scene = seen(told, length, tau_s)
    plain, begun = form(scene, "by the steps"), form(scene, "by the steps, from its start")
    missing = length - np.linalg.norm(told, axis=1)
    without = tau_s**2 * -plain.columns(np.array([tau_s])).along(scene.unit)[:, 0] - missing
    columns = begun.columns(np.array([tau_s])).along(scene.unit)
    start_nt = float(columns[:, 1] @ without / (columns[:, 1] @ columns[:, 1]))
    assert (begun.blocks[1].name, begun.blocks[1].is_start, begun.refines) == ("start_nt", True, plain.label)
    assert start_nt == pytest.approx(2000.0, rel=0.1)
    assert np.std(without - start_nt * columns[:, 1]) < 0.1 * np.std(without)


def test_a_start_is_followed_until_it_is_forgotten() -> None:
    """|y_k| = E |y_(k-1)| cos a + sqrt(|c_k|^2 - E^2 |y_(k-1)|^2 sin^2 a), twice, from two beginnings."""
    length = np.linalg.norm(turned(0.1 * TIME_S), axis=1) * (1.0 + 0.2 * np.sin(TIME_S / 30.0))
    rate, steps = np.full(COUNT, 0.16), np.full(COUNT, PERIOD_S)
    steps[0] = np.inf
    tau_s, more = 3.0, 500.0
    plain = by_low_pass(length, rate, steps, tau_s)
    kept, turn = np.exp(-PERIOD_S / tau_s), rate[0] * PERIOD_S
    beside = np.sqrt((plain[1:] - kept * np.cos(turn) * plain[:-1]) ** 2 + (kept * np.sin(turn) * plain[:-1]) ** 2)
    longer = plain + 0.0
    longer[0] += more
    for row, came in enumerate(beside, 1):
        across = kept * np.sin(turn) * longer[row - 1]
        longer[row] = kept * np.cos(turn) * longer[row - 1] + np.sqrt(came**2 - across**2)
    found = longer_by_low_pass(length, rate, steps, tau_s, more)
    assert found == pytest.approx(longer - plain, abs=1e-6)
    assert found[10] > 1.0
    assert not found[-100:].any()


def test_a_start_that_is_not_in_the_scene_adds_nothing() -> None:
    scene = seen(*low_passed(4.0, np.full(COUNT, 0.08), 0.0), 4.0)
    later = replace(scene, time_s=scene.time_s + 600.0)
    columns = form(later, "by the steps, from its start").columns(np.array([4.0])).along(scene.unit)
    assert not columns[:, 1].any()


def test_the_lateness_of_an_average_follows_from_its_memory() -> None:
    """Of y_k = a x_k + (1 - a) y_(k-1) the mean delay is (1 - a) / a samples."""
    moves_s = form(scene_of(turned(0.05 * np.arange(float(COUNT))))).moves_s
    assert moves_s is not None
    for share in (0.2, 0.5, 0.9):
        assert moves_s(np.array([(1.0 - share) / share**2])) == pytest.approx(-PERIOD_S * (1.0 - share) / share)


def test_a_low_pass_by_the_steps_has_the_time_constant_that_it_was_made_with() -> None:
    """By turn and course alike; a share of new samples that would lose as much is said beside it."""
    seen = {"tau2_s2": value_of(4.0, 0.2, "s2"), "order": value_of(1.0, np.nan, "1")}
    found = LAG.derived({**seen, "period_s": value_of(2.0, np.nan, "s")})
    assert (float(found["tau_s"].value), float(found["tau_s"].sigma)) == pytest.approx((2.0, 0.1))
    assert (1.0 - float(found["new_share"].value)) / float(found["new_share"].value) ** 2 == pytest.approx(1.0)


@pytest.mark.parametrize(("order", "sigma_s"), [(2.0, 0.05), (1.0, 0.1)])
def test_the_time_constant_is_known_by_the_power_that_is_seen(order: float, sigma_s: float) -> None:
    """Of tau^2 = 4 +- 0.2: by the turn, which grows with tau^2, half as well known as by the course, if 5 % are."""
    seen = {"tau2_s2": value_of(4.0, 0.2, "s2"), "order": value_of(order, np.nan, "1")}
    assert float(LAG.derived(seen)["tau_s"].sigma) == pytest.approx(sigma_s)


# Whole vectors


def whole(effect: str, variant: str, scene: Scene) -> Hypothesis:
    return next(one for one in effect_named(effect).hypotheses(scene) if one.variant == variant)


def moved_by(scene: Scene, effect: str, variant: str, size_s: float) -> Array:
    """The vectors (n, 3) as a form has them where it is made at its own size, or at first, where nothing is known."""
    form = whole(effect, variant, scene)
    column = form.columns(np.array([number.grid[0] for number in form.nonlinear])).body
    assert column is not None
    return np.asarray(scene.calibrated_nt + size_s * column[0])


@pytest.mark.parametrize("rate_rad_s", [0.02, 0.2])
@pytest.mark.parametrize("tau_s", [0.1, 0.5, 4.0])
def test_a_low_pass_of_whole_vectors_is_that_of_a_turn(rate_rad_s: float, tau_s: float) -> None:
    """The part across the axis is divided by 1 + i w tau, from the first sample on; beside a gap too."""
    time_s = TIME_S + 40.0 * (np.arange(COUNT) >= 250)
    angle = rate_rad_s * time_s
    phase, size = np.arctan(rate_rad_s * tau_s), 1.0 / np.hypot(1.0, rate_rad_s * tau_s)
    read = turned(angle - phase) * np.array([size, size, 1.0])
    scene = replace(scene_of(turned(angle), time_s), moved_s=np.full(COUNT, -tau_s))
    off_nt = np.linalg.norm(moved_by(scene, "response_lag", "of whole vectors", tau_s) - read, axis=1)
    since_s = np.where(np.arange(COUNT) < 250, time_s, time_s - time_s[250])
    inside = (since_s > 10.0 * tau_s + 3.0) & ~np.isin(np.arange(COUNT), (248, 249, 398, 399))
    assert off_nt[inside].max() < 0.5
    assert off_nt.max() < 0.015 * np.linalg.norm(turned(angle) - read, axis=1).max()


@pytest.mark.parametrize(("variant", "sign"), [("ahead of the attitude", 1.0), ("behind the attitude", -1.0)])
def test_vectors_of_another_time_are_those_of_the_turn_then(variant: str, sign: float) -> None:
    """A third of a radian later, or before, past both ends of each stretch as well."""
    rate_rad_s, size_s = 0.1, 3.3
    time_s = TIME_S + 40.0 * (np.arange(COUNT) >= 250)
    scene = replace(scene_of(turned(rate_rad_s * time_s), time_s), moved_s=np.full(COUNT, sign * size_s))
    found = moved_by(scene, "time_offset", variant, size_s)
    off_nt = np.linalg.norm(found - turned(rate_rad_s * (time_s + sign * size_s)), axis=1)
    assert off_nt[50:200].max() < 0.1
    assert off_nt.max() < 50.0  # of 10 uT


def test_what_a_low_pass_of_whole_vectors_began_with_fades() -> None:
    scene = replace(scene_of(turned(0.05 * TIME_S)), moved_s=np.full(COUNT, -2.0))
    begun = whole("response_lag", "of whole vectors, from its start", scene).columns(np.array([2.0])).body
    assert begun is not None
    assert begun.shape == (4, COUNT, 3)
    assert begun[1:, 8] == pytest.approx(np.eye(3) * np.exp(-8 * PERIOD_S / 2.0))
