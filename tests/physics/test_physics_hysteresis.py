"""What remembers the field: little by little, between the samples, and not the noise."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from magcal_service.diagnosis.linear import Workspace
from magcal_service.model import Array
from magcal_service.physics.catalogue import effect_named
from magcal_service.physics.columns import Columns
from magcal_service.physics.drivers.between import is_coarse, smooth_field, smoothing, with_turning_points
from magcal_service.physics.effects.hysteresis import gradual
from magcal_service.physics.interface import Hypothesis
from magcal_service.physics.scene.scene import Scene
from magcal_service.physics.segments import Segments, Sums
from tests.blind.hysteresis import play as one_rod
from tests.physics.scenes import scene

AXIS = np.array([0.36, 0.48, 0.8])
LEVEL_NT = 40e3


def turned(angle: Array) -> Array:
    """A field (n, 3) in a body that turns by angles (n,) about ``AXIS``, which the field is inclined to.

    The inclination swings by 0.3 rad over 20 turns, so that loops are of many sizes.
    """
    side = np.cross(AXIS, [1.0, 0.0, 0.0])
    side /= np.linalg.norm(side)
    other = np.cross(AXIS, side)
    tilt = 0.9 + 0.3 * np.sin(angle / 20.0)
    around = np.cos(angle)[:, None] * side - np.sin(angle)[:, None] * other
    return np.asarray(LEVEL_NT * (np.cos(tilt)[:, None] * AXIS + np.sin(tilt)[:, None] * around))


def flight(rate_rad_s: float, count: int, noise_nt: float = 0.0, knows_rate: bool = True) -> Scene:
    """One sample a second of a craft that turns at a rate."""
    time_s = np.arange(float(count))
    noise = noise_nt * np.random.default_rng(3).normal(size=(count, 3))
    field = turned(rate_rad_s * time_s) + noise
    return Scene(
        time_s=time_s,
        origin_ns=0,
        utc=False,
        field_nt=field,
        calibrated_nt=field,
        clean_field_nt=field,
        magnitude_nt=np.full(count, LEVEL_NT),
        turning_rad_s=rate_rad_s * AXIS if knows_rate else None,
    )


def forms(on: Scene) -> dict[str, Hypothesis]:
    return {form.variant: form for form in effect_named("hysteresis").hypotheses(on)}


def stepped(course: Array, length: float, exponent: float = 1.0) -> Array:
    """dz = dh (1 - sign(dh z) |z / length|^exponent) in 400 steps between values of h (n,): Bouc and Wen."""
    state, found = 0.0, [0.0]
    for change in np.diff(course).tolist():
        for _ in range(400):
            state += change / 400.0 * (1.0 - math.copysign(1.0, change * state) * abs(state / length) ** exponent)
        found.append(state)
    return np.array(found)


def test_what_gives_way_follows_its_own_differential_equation() -> None:
    course = 1000.0 * np.random.default_rng(1).normal(size=(40, 2)).cumsum(axis=0)
    expected = np.stack([stepped(axis, 1500.0) for axis in course.T], axis=1)
    assert gradual(course, 1500.0) == pytest.approx(expected, abs=5.0)
    assert float(np.abs(gradual(course, 1500.0)).max()) < 1500.0


def test_what_gives_way_begins_where_it_was_left() -> None:
    course = 1000.0 * np.random.default_rng(2).normal(size=(200, 3)).cumsum(axis=0)
    whole = gradual(course, 2000.0)
    assert gradual(course[120:], 2000.0, whole[120]) == pytest.approx(whole[120:])
    assert gradual(course[:1], 2000.0, np.array([1.0, 2.0, 3.0])).tolist() == [[1.0, 2.0, 3.0]]


def test_turning_points_between_samples_are_followed() -> None:
    """At five samples a turn the memory of what lies between is met to 3 % of its rms; without, a quarter is wrong."""
    rate = 2.0 * math.pi / 5.3
    coarse = flight(rate, 400)
    fine = gradual(turned(rate * np.arange(0.0, 399.01, 0.02)), 8000.0)[::50]
    between = gradual(with_turning_points(coarse, coarse.calibrated_nt), 8000.0)[::2]
    size = float(np.sqrt(np.mean(fine**2)))
    assert float(np.sqrt(np.mean((between - fine) ** 2))) < 0.03 * size
    assert float(np.sqrt(np.mean((gradual(coarse.calibrated_nt, 8000.0) - fine) ** 2))) > 0.2 * size
    assert is_coarse(coarse)
    assert not is_coarse(flight(rate, 400, knows_rate=False))
    assert not is_coarse(flight(0.1, 400))


@pytest.mark.parametrize("start", [0.0, math.pi])
def test_a_sample_at_its_own_extreme_has_no_other_before_the_next(start: float) -> None:
    """A field that turns about z from +-x exactly: the first sample is the extreme, and what follows lies within."""
    coarse = flight(0.6, 9)
    angle = start + 0.6 * (coarse.time_s - coarse.time_s[0])
    field = 30_000.0 * np.stack([np.cos(angle), -np.sin(angle), np.zeros(9)], axis=1)
    field[0, 1] = 0.0
    about_z = replace(coarse, body_from_eci=None, turning_rad_s=np.array([0.0, 0.0, 0.6]), channels={})
    dense = with_turning_points(about_z, field)
    assert min(dense[0, 0], dense[2, 0]) - 1e-6 <= dense[1, 0] <= max(dense[0, 0], dense[2, 0]) + 1e-6


def test_noise_is_smoothed_as_far_as_the_turn_allows() -> None:
    """Noise of 300 nT on a slow turn falls to less than a third, a fast turn is left as it is."""
    slow = flight(0.01, 2000, noise_nt=300.0)
    half = smoothing(slow)
    assert half == 32
    left = smooth_field(slow, half) - turned(0.01 * slow.time_s)
    assert float(np.sqrt(np.mean(left**2))) < 100.0
    fast = flight(1.0, 400, noise_nt=300.0)
    assert smoothing(fast) == 0
    assert smooth_field(fast, 0) is fast.calibrated_nt


def test_smoothing_ends_at_a_pause() -> None:
    """Two stretches are smoothed as if they were two recordings; one shorter than the window is left as it is."""
    whole = flight(0.01, 1000, noise_nt=300.0)
    late = replace(whole, time_s=whole.time_s + 5000.0 * (np.arange(1000) >= 600))
    alone = replace(whole, **{name: getattr(whole, name)[:600] for name in ("time_s", "calibrated_nt", "magnitude_nt")})
    assert smooth_field(late, 16)[:600] == pytest.approx(smooth_field(alone, 16))
    short = replace(whole, time_s=whole.time_s + 5000.0 * (np.arange(1000) >= 980))
    assert smooth_field(short, 16)[980:].tolist() == whole.calibrated_nt[980:].tolist()


def test_rods_hold_back_what_they_do_not_follow_yet() -> None:
    """Along the axes, each its own or on every axis."""
    on = flight(0.1, 300)
    scale = float(np.percentile(np.abs(on.calibrated_nt), 99))
    found = forms(on)
    course = smooth_field(on, smoothing(on))
    along = np.stack([stepped(axis, 0.2 * scale) for axis in course.T], axis=1)
    share, theta = np.array([0.01, 0.02, -0.03]), np.array([0.2])
    assert found["gradual"].columns(theta).field(share) == pytest.approx(-share * along, abs=0.5)
    matrix = np.arange(9.0).reshape(3, 3) * 1e-3
    rods = found["gradual, rods along the axes"].columns(theta).field(matrix.ravel())
    assert rods == pytest.approx(-along @ matrix, abs=0.5)


def test_what_was_fitted_between_samples_needs_the_rate() -> None:
    """A model says so by its constant; without a rate only what goes by the samples is there."""
    given = {"scale_nt": 4e4, "turns_between": 1.0}
    assert "gradual" in forms(replace(flight(1.0, 50), given=given))
    sharp = {"", "rods along the axes", "one strip"}
    assert set(forms(replace(flight(1.0, 50, knows_rate=False), given=given))) == sharp


def nine_of(on: Scene) -> Array:
    """(n, 9) what the magnitude shows of the nine errors."""
    unit, field = on.unit, on.calibrated_nt
    mixed = [unit[:, a] * field[:, b] + unit[:, b] * field[:, a] for a, b in ((0, 1), (0, 2), (1, 2))]
    return np.concatenate([unit, unit * field / LEVEL_NT, np.stack(mixed, axis=1) / LEVEL_NT], axis=1)


def sums_of(residual: Array, on: Scene) -> Sums:
    """Sums over a residual (n,) beside the nine errors, columns of unit rms."""

    def sums(columns: Columns, first_rows: NDArray[np.intp]) -> Segments:
        return Workspace(residual, nine_of(on)).segments(columns.along(on.unit), first_rows)

    return sums


@pytest.mark.parametrize("variant", ["one strip", "gradual, one strip"])
def test_a_strip_is_proposed_near_its_direction(variant: str) -> None:
    """Of any direction, from what rods along the axes would have to be: its own number of degrees and width."""
    on = flight(0.1, 1500)
    form = forms(on)[variant]
    amplitudes = np.array([0.02, -0.01, 0.03])
    theta = np.array([0.15 if "gradual" in variant else 0.3, 65.0, -40.0])
    answer = form.columns(theta).field(amplitudes)
    course = on.calibrated_nt @ direction(65.0, -40.0)
    scale = float(np.percentile(np.abs(on.calibrated_nt), 99))
    held = -stepped(course, 0.15 * scale) if "gradual" in variant else one_rod(course, [0.3 * scale], [1.0]) - course
    settled = slice(200, None)
    assert answer[settled] == pytest.approx(np.outer(held, amplitudes)[settled], abs=8.0)
    assert form.proposals is not None
    proposed = form.proposals(sums_of(np.einsum("ni,ni->n", answer, on.unit), on), [form.nonlinear[0].grid])
    nearest = max(abs(direction(*each[1:]) @ direction(65.0, -40.0)) for each in proposed)
    assert nearest > np.cos(np.radians(25.0))


def direction(tilt_deg: float, turn_deg: float) -> Array:
    tilt, turn = np.radians([tilt_deg, turn_deg])
    return np.array([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)])


def left_by(form: Hypothesis, disturbance: Array, on: Scene) -> float:
    """Share of what the magnitude shows of a disturbance (n, 3) that a form leaves at its best."""
    unit, nine = on.unit, nine_of(on)
    course = np.einsum("ni,ni->n", unit, disturbance)
    before = course - nine @ np.linalg.lstsq(nine, course, rcond=None)[0]
    shares = []
    for width in np.geomspace(0.02, 1.0, 12):
        columns = np.concatenate([nine, form.columns(np.array([width])).along(unit)], axis=1)
        columns /= np.linalg.norm(columns, axis=0)
        after = course - columns @ np.linalg.lstsq(columns, course, rcond=1e-9)[0]
        shares.append(float(after @ after) / float(before @ before))
    return min(shares)


def test_other_models_of_hysteresis_leave_little() -> None:
    """Along the axes 2 % of Bouc and Wen's with exponent 2 (one play leaves 7 %), and 5 % of four plays each."""
    on = flight(0.1, 1500)
    form = forms(on)["gradual, rods along the axes"]
    sharper = np.stack([stepped(axis, 9000.0, 2.0) for axis in on.calibrated_nt.T], axis=1)
    assert left_by(form, sharper, on) < 0.025
    rng = np.random.default_rng(5)
    widths = [np.sort(rng.uniform(500.0, 15000.0, 4)).tolist() for _ in range(3)]
    plays = [one_rod(axis, each, [1.0] * 4) for axis, each in zip(on.calibrated_nt.T, widths, strict=True)]
    assert left_by(form, np.stack(plays, axis=1), on) < 0.05
    assert left_by(forms(on)["rods along the axes"], sharper, on) > 0.05


def test_the_scene_of_the_catalogue_has_every_form() -> None:
    sharp = {"", "rods along the axes", "one strip"}
    expected = sharp | {"gradual", "gradual, rods along the axes", "gradual, one strip"}
    assert set(forms(scene())) == expected
