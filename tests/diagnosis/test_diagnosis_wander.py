"""Courses at no regular times: their evidence against direct sums, found in what has them, absent from noise."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from numpy.typing import NDArray

from magcal_service.diagnosis import wander
from magcal_service.diagnosis.linear import Workspace
from magcal_service.diagnosis.wander import Blocks, first_samples, of_every_axis, two_levels, wandering
from magcal_service.model import Array
from magcal_service.physics.scene.scene import Scene

COUNT, PERIOD_S = 8000, 1.0
TIME_S = PERIOD_S * np.arange(float(COUNT))
ALONG = np.array([0.36, -0.48, 0.8])


def turning() -> Array:
    """(n, 3) directions of the field in a body that spins, and whose axis drifts."""
    polar = 1.2 + 0.5 * np.sin(TIME_S / 2300.0)
    angle = 2.0 * np.pi * 0.02 * TIME_S
    return np.stack([np.sin(polar) * np.cos(angle), np.sin(polar) * np.sin(angle), np.cos(polar)], axis=1)


UNIT = turning()
SCENE = Scene(TIME_S, 0, False, 3e4 * UNIT, 3e4 * UNIT, 3e4 * UNIT, np.full(COUNT, 3e4))


def noise(seed: int) -> Array:
    return np.random.default_rng([9131, seed]).normal(size=COUNT)


def telegraph(seed: int, dwell_s: float) -> NDArray[np.bool_]:
    """(n,) whether it is on: a switch with the same chance at every time."""
    rng = np.random.default_rng([9132, seed])
    return np.cumsum(rng.random(COUNT) < PERIOD_S / dwell_s) % 2 == 1


def blocks_of(residual: Array) -> Blocks:
    """A residual with a bias fitted in any case."""
    space, first = Workspace(residual, UNIT), first_samples(SCENE)
    return Blocks.of(SCENE, first, UNIT, space.segments(UNIT, first), 1.0)


def few(seed: int, count: int) -> Blocks:
    """Random information in a few blocks, one of them after a pause."""
    rng = np.random.default_rng([9133, seed])
    roots = rng.normal(size=(count, 3, 3))
    apart_s = np.where(np.arange(count) == 4, 31.0, 5.0)
    apart_s[0] = 0.0
    return Blocks(
        5 * np.arange(count), apart_s, roots @ roots.swapaxes(1, 2), rng.normal(size=(count, 3)), 1.0, 5 * count
    )


def test_the_evidence_for_wandering_is_that_of_one_normal_distribution(monkeypatch: pytest.MonkeyPatch) -> None:
    """A Kalman filter's sum of innovations against the density of all blocks together."""
    monkeypatch.setattr(wander, "_TIMES", (3.0,))
    monkeypatch.setattr(wander, "_SIZES", np.array([0.7]))
    monkeypatch.setattr(wander, "_half_sphere", lambda _count: ALONG[None])
    for seed in range(5):
        blocks = few(seed, 9)
        normal, right = (part[:, 0] for part in blocks.along(ALONG[None]))
        at_s = np.cumsum(blocks.apart_s)
        before = 0.49 * np.exp(-np.abs(at_s[:, None] - at_s) / 15.0)
        # shown r / n with variance 1 / n: density with the course over that without
        shown, alone = right / normal, np.diag(1.0 / normal)
        log_ratio = -0.5 * (
            np.linalg.slogdet(before + alone)[1]
            - np.linalg.slogdet(alone)[1]
            + shown @ np.linalg.solve(before + alone, shown)
            - shown @ np.linalg.solve(alone, shown)
        )
        assert wandering(blocks).nats == pytest.approx(log_ratio, abs=1e-9)


def test_the_evidence_for_every_axis_is_that_of_one_normal_distribution(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(wander, "_TIMES", (3.0,))
    monkeypatch.setattr(wander, "_SIZES", np.array([0.7]))
    for seed in range(5):
        blocks = few(seed, 9)
        at_s = np.cumsum(blocks.apart_s)
        before = np.kron(0.49 * np.exp(-np.abs(at_s[:, None] - at_s) / 15.0), np.eye(3))
        shown = np.concatenate([np.linalg.solve(*one) for one in zip(blocks.normal, blocks.right, strict=True)])
        alone = np.zeros((27, 27))
        for number, normal in enumerate(blocks.normal):
            alone[3 * number : 3 * number + 3, 3 * number : 3 * number + 3] = np.linalg.inv(normal)
        log_ratio = -0.5 * (
            np.linalg.slogdet(before + alone)[1]
            - np.linalg.slogdet(alone)[1]
            + shown @ np.linalg.solve(before + alone, shown)
            - shown @ np.linalg.solve(alone, shown)
        )
        assert of_every_axis(blocks) == pytest.approx(log_ratio, abs=1e-6)


def test_noise_with_a_memory_on_every_axis_is_likelier_than_along_one_direction() -> None:
    """And the other way round, for a field along one direction."""
    rng = np.random.default_rng(9135)
    each = np.zeros((COUNT, 3))
    kept = math.exp(-PERIOD_S / 100.0)
    for number, kicks in enumerate(rng.normal(size=(COUNT - 1, 3)), start=1):
        each[number] = kept * each[number - 1] + math.sqrt(1.0 - kept**2) * kicks
    for field, all_axes in ((0.6 * each, True), (each[:, :1] * ALONG, False)):
        blocks = blocks_of(noise(50) + np.einsum("ni,ni->n", field, UNIT))
        assert (of_every_axis(blocks) > wandering(blocks).nats) == all_axes


def test_the_evidence_for_two_levels_and_their_course_are_sums_over_all_paths(monkeypatch: pytest.MonkeyPatch) -> None:
    """Forward and backward recursions against every one of 2^9 courses."""
    monkeypatch.setattr(wander, "_TIMES", (3.0,))
    monkeypatch.setattr(wander, "_SIZES", np.array([0.7]))
    monkeypatch.setattr(wander, "_DUTIES", (0.3,))
    monkeypatch.setattr(wander, "_half_sphere", lambda _count: ALONG[None])
    for seed in range(5):
        blocks = few(seed, 9)
        kept = np.exp(-blocks.apart_s / 15.0)
        best: list[tuple[float, Array]] = []
        for way in (ALONG, -ALONG):
            normal, right = (part[:, 0] for part in blocks.along(way[None]))
            total, on = 0.0, np.zeros(9)
            for path in itertools.product((0, 1), repeat=9):
                state = np.array(path)
                level = np.where(state == 1, 0.7 * 0.7, -0.3 * 0.7)
                chance = 0.3 if path[0] else 0.7
                for number in range(1, 9):
                    to_on = 0.3 + kept[number] * (path[number - 1] - 0.3)
                    chance *= to_on if path[number] else 1.0 - to_on
                weight = chance * math.exp(float(level @ right - 0.5 * level**2 @ normal))
                total, on = total + weight, on + weight * state
            best.append((math.log(total), on / total))
        found = two_levels(blocks, ALONG)
        both = math.log(0.5 * sum(math.exp(nats) for nats, _ in best)) + math.log(10 / 100)
        assert found.nats == pytest.approx(both, abs=1e-9)
        assert found.share[::5] == pytest.approx(max(best, key=lambda one: one[0])[1], abs=1e-9)


def test_a_field_that_is_switched_at_random_is_found_where_it_is() -> None:
    """Half as much again as a sample's noise, 120 s at a time: its direction and states, and that it has two levels."""
    states = telegraph(0, 120.0)
    residual = noise(0) + 1.5 * states * (UNIT @ ALONG)
    blocks = blocks_of(residual)
    course = wandering(blocks)
    assert course.nats > 100.0
    assert abs(course.direction @ ALONG) > math.cos(math.radians(30.0))
    levels = two_levels(blocks, course.direction)
    assert levels.nats > course.nats + 10.0
    agree = np.mean((levels.share > 0.5) == states)
    assert max(agree, 1.0 - agree) > 0.9
    assert levels.switches == pytest.approx(np.count_nonzero(np.diff(states)), rel=0.3)


def test_a_bias_that_walks_has_no_two_levels() -> None:
    rng = np.random.default_rng(9134)
    kept = math.exp(-PERIOD_S / 200.0)
    walk = np.zeros(COUNT)
    for number, kick in enumerate(rng.normal(size=COUNT - 1), start=1):
        walk[number] = kept * walk[number - 1] + math.sqrt(1.0 - kept**2) * kick
    blocks = blocks_of(noise(1) + 0.7 * walk * (UNIT @ ALONG))
    course = wandering(blocks)
    assert course.nats > 100.0
    assert course.each_s == pytest.approx(200.0, rel=0.6)
    assert two_levels(blocks, course.direction).nats < course.nats


def test_noise_has_no_course() -> None:
    """Averaged over all directions, sizes and times, noise speaks for a course as seldom as promised."""
    nats = []
    for seed in range(2, 42):
        blocks = blocks_of(noise(seed))
        course = wandering(blocks)
        nats += [course.nats, two_levels(blocks, course.direction).nats]
    assert max(nats) < 3.0
    assert np.mean(np.exp(nats)) < 1.0


def test_too_few_samples_have_no_blocks() -> None:
    few_samples = slice(0, 30)
    short = Scene(*(part[few_samples] for part in (TIME_S,)), 0, False, *3 * [UNIT[few_samples]], np.full(30, 3e4))
    assert not len(first_samples(short))
