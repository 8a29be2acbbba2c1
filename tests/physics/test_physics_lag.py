"""A driver that averages: what is lost is known from samples that follow one another, without a gyro."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from magcal_service.diagnosis.plausible import above_least
from magcal_service.model import Array
from magcal_service.physics.catalogue import effect_named
from magcal_service.physics.interface import Hypothesis, value_of
from magcal_service.physics.scene.scene import Scene

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


def only(scene: Scene) -> Hypothesis:
    (form,) = LAG.hypotheses(scene)
    return form


def lost(scene: Scene) -> Array:
    """What one unit of memory takes off the magnitude (n,) [nT]."""
    return -only(scene).columns(np.zeros(0)).along(scene.unit)[:, 0]


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
    assert only(scene).variant == "average of samples"
    gyro = replace(scene, turning_rad_s=np.array([0.0, 0.0, 0.1]))
    assert (only(gyro).variant, only(gyro).blocks[0].name) == ("", "tau2_s2")


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
    assert offset == pytest.approx(6.0 * 300.0**2 / 80e3, rel=0.35)
    assert np.std(found - clean - offset) < 0.1 * np.std(clean)


def test_less_than_no_memory_is_no_average() -> None:
    form = only(scene_of(turned(0.05 * np.arange(float(COUNT)))))
    assert above_least(form, np.array([0.0]))
    assert not above_least(form, np.array([-0.01]))


def test_the_share_of_a_new_sample_follows_from_the_memory() -> None:
    found = LAG.derived({"memory": value_of(2.0, 0.03, "1"), "period_s": value_of(0.5, np.nan, "s")})
    share = found["new_share"]
    assert (1.0 - float(share.value)) / float(share.value) ** 2 == pytest.approx(2.0)
    moved = LAG.derived({"memory": value_of(2.03, 0.03, "1"), "period_s": value_of(0.5, np.nan, "s")})["new_share"]
    assert float(share.sigma) == pytest.approx(float(share.value - moved.value), rel=0.03)
    assert float(found["tau_s"].value) == pytest.approx(0.5 * 2.0**0.5)
    assert float(found["tau_s"].sigma) == pytest.approx(0.5 * (2.03**0.5 - 2.0**0.5), rel=0.03)
