"""A driver that averages: what is lost is known from samples that follow one another, without a gyro."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from magcal_service.diagnosis.plausible import above_least
from magcal_service.model import Array
from magcal_service.physics.catalogue import effect_named
from magcal_service.physics.interface import Hypothesis, value_of
from magcal_service.physics.scene.scene import Scene, Telemetry

PERIOD_S, COUNT = 0.5, 400
TIME_S = PERIOD_S * np.arange(float(COUNT))
LAG = effect_named("response_lag")


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
    return next(one for one in LAG.hypotheses(scene) if one.variant == variant)


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
    assert found[200] == pytest.approx(found[201])
    assert found[0] == pytest.approx(found[1])
    assert found == pytest.approx(np.full(COUNT, found[1]))


def test_a_sample_between_gaps_tells_nothing() -> None:
    time_s = np.array([0.0, 0.5, 10.0, 20.0, 20.5])
    scene = replace(scene_of(turned(0.1 * np.arange(5.0)), time_s), given={"period_s": PERIOD_S})
    assert (lost(scene) > 0.0).tolist() == [True, True, False, True, True]


def test_a_known_rate_has_the_low_pass_instead() -> None:
    scene = scene_of(turned(0.05 * np.arange(float(COUNT))))
    assert [one.variant for one in LAG.hypotheses(scene)] == ["by the steps", "average of samples"]
    rate = np.array([0.0, 0.0, 0.1])
    fitted = replace(scene, turning_rad_s=rate)  # a steady turn that was fitted need not be the craft's
    assert [one.variant for one in LAG.hypotheses(fitted)] == ["", "by the steps", "average of samples"]
    gyro = {"gyro": Telemetry("gyro", "angular rate", np.tile(rate, (COUNT, 1)))}
    assert [one.variant for one in LAG.hypotheses(replace(scene, channels=gyro))] == [""]
    assert [one.blocks[0].name for one in LAG.hypotheses(fitted)] == ["tau2_s2", "tau2_s2", "memory"]


@pytest.mark.parametrize(("count", "offered"), [(63, False), (64, True)])
def test_a_course_needs_sixty_four_samples(count: int, offered: bool) -> None:
    scene = scene_of(turned(0.05 * np.arange(float(count))), TIME_S[:count])
    assert bool(LAG.hypotheses(scene)) is offered


def test_samples_that_seldom_follow_one_another_have_no_form() -> None:
    time_s = TIME_S + 30.0 * (np.arange(COUNT) // 50)
    assert LAG.hypotheses(scene_of(turned(0.05 * np.arange(float(COUNT))), time_s)) == ()


def test_noise_of_the_step_is_smoothed_and_its_mean_is_a_constant() -> None:
    rate = 0.06 + 0.05 * np.sin(TIME_S / 30.0)
    field = turned(np.cumsum(rate))
    noisy = field + np.random.default_rng(5).normal(0.0, 300.0, field.shape)
    clean, found = lost(scene_of(field)), lost(scene_of(noisy))
    offset = (found - clean).mean()
    three = 3**2  # a step is taken over 0.2 rad, three samples of 0.06 rad
    assert offset == pytest.approx(6.0 * 300.0**2 / 80e3 / three, rel=0.35)
    assert np.std(found - clean - offset) < 0.15 * np.std(clean)


def test_less_than_no_memory_is_no_average() -> None:
    average = form(scene_of(turned(0.05 * np.arange(float(COUNT)))))
    assert above_least(average, np.array([0.0]))
    assert not above_least(average, np.array([-0.01]))


def test_the_share_of_a_new_sample_follows_from_the_memory() -> None:
    found = LAG.derived({"memory": value_of(2.0, 0.03, "1"), "period_s": value_of(0.5, np.nan, "s")})
    share = found["new_share"]
    assert (1.0 - float(share.value)) / float(share.value) ** 2 == pytest.approx(2.0)
    moved = LAG.derived({"memory": value_of(2.03, 0.03, "1"), "period_s": value_of(0.5, np.nan, "s")})["new_share"]
    assert float(share.sigma) == pytest.approx(float(share.value - moved.value), rel=0.03)
    assert float(found["tau_s"].value) == pytest.approx(0.5 * 2.0**0.5)
    assert float(found["tau_s"].sigma) == pytest.approx(0.5 * (2.03**0.5 - 2.0**0.5), rel=0.03)


def low_passed(tau_s: float, rate_rad_s: Array, grows: float) -> tuple[Array, Array]:
    """A field (n, 3) whose length changes too, as a low-pass in a hundred steps a sample has it; and its length."""
    fine = 100
    time_s = PERIOD_S / fine * np.arange(COUNT * fine)
    angle = np.interp(time_s, TIME_S, np.cumsum(rate_rad_s) * PERIOD_S)
    length = 40e3 * (1.0 + grows * np.sin(2.0 * np.pi * time_s / 1000.0))
    field = turned(angle) * (length / 40e3)[:, None]
    told = averaged(field, 1.0 - float(np.exp(-PERIOD_S / fine / tau_s)))
    return told[::fine], length[::fine]


@pytest.mark.parametrize("tau_s", [0.5, 2.0, 4.0])
@pytest.mark.parametrize("rate_rad_s", [0.005, 0.1])
def test_a_low_pass_is_late_with_the_course_and_short_by_the_turn(tau_s: float, rate_rad_s: float) -> None:
    """A slow craft's lag is a late clock, a fast one's a loss, that between both: to 4 % of an exact filter's."""
    rate = rate_rad_s * (1.0 + 0.3 * np.sin(TIME_S / 20.0))
    told, length = low_passed(tau_s, rate, 0.2)
    missing = length - np.linalg.norm(told, axis=1)
    settled = slice(80, -20)
    scene = Scene(TIME_S, 0, False, told, told * (length / np.linalg.norm(told, axis=1))[:, None], told, length)
    moved = replace(scene, moved_s=np.full(COUNT, -tau_s))
    found = tau_s**2 * lost(moved, "by the steps", tau_s)
    assert np.std((found - missing)[settled]) < 0.04 * np.std(missing[settled])
    assert form(moved, "by the steps").nonlinear[0].grid == pytest.approx([tau_s])
    assert form(moved, "by the steps").moves_s(np.array([tau_s**2])) == pytest.approx(-tau_s)


def test_the_lateness_of_an_average_follows_from_its_memory() -> None:
    """Of y_k = a x_k + (1 - a) y_(k-1) the mean delay is (1 - a) / a samples."""
    moves_s = form(scene_of(turned(0.05 * np.arange(float(COUNT))))).moves_s
    assert moves_s is not None
    for share in (0.2, 0.5, 0.9):
        assert moves_s(np.array([(1.0 - share) / share**2])) == pytest.approx(-PERIOD_S * (1.0 - share) / share)


@pytest.mark.parametrize(("order", "sigma_s"), [(2.0, 0.05), (1.0, 0.1)])
def test_the_time_constant_is_known_by_the_power_that_is_seen(order: float, sigma_s: float) -> None:
    """Of tau^2 = 4 +- 0.2: by the turn, which grows with tau^2, half as well known as by the course, if 5 % are."""
    seen = {"tau2_s2": value_of(4.0, 0.2, "s2"), "order": value_of(order, np.nan, "1")}
    assert float(LAG.derived(seen)["tau_s"].sigma) == pytest.approx(sigma_s)
