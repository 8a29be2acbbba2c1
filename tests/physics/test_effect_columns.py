"""What each effect adds to the field or to the reference, worked out here from its equation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from magcal_service.physics.catalogue import catalogue, effect_named
from magcal_service.physics.drivers.change import instants
from magcal_service.physics.effects.hysteresis import play
from magcal_service.physics.interface import Value, value_of
from tests.physics.effect_forms import FIELD, SPAN_S, TIME_S, UNIT, added, forms
from tests.physics.scenes import COUNT, PERIOD_S, scene

PRIORS = {
    "axis_skew": (1.0, 1000.0),
    "bias_drift": (5.0, 5000.0),
    "bias_step": (10.0, 5000.0),
    "coloured_noise": (1.0, 2000.0),
    "cubic_response": (5.0, 3000.0),
    "current_loop": (1.0, 30_000.0),
    "external_field": (5.0, 500.0),
    "hysteresis": (10.0, 2000.0),
    "nutation": (10.0, 20000.0),
    "position_offset": (10.0, 30000.0),
    "quantisation": (1.0, 500.0),
    "reference_epoch": (5.0, 3000.0),
    "response_lag": (5.0, 30000.0),
    "saturation": (10.0, 30000.0),
    "scale_drift": (5.0, 5000.0),
    "scale_step": (10.0, 5000.0),
    "spin_rate": (10.0, 50000.0),
    "stuck_axis": (100.0, 100000.0),
    "sun_disturbance": (1.0, 300.0),
    "thermal_bias": (5.0, 5000.0),
    "thermal_scale": (5.0, 5000.0),
    "time_offset": (10.0, 30000.0),
    "tone": (1.0, 1000.0),
    "torquer": (10.0, 50000.0),
}
"""Usual sizes [nT] from the sources that each entry names; what is larger is believed of no recording."""


def test_every_effect_has_the_size_of_its_source() -> None:
    assert {effect.name: effect.prior for effect in catalogue()} == PRIORS


# Errors that take a course


def test_a_bias_drifts_by_its_rate_and_bends_by_its_curve() -> None:
    found = forms("bias_drift")
    rate, curve = np.array([1e-3, -2e-3, 3e-3]), np.array([1e-7, 0.0, -2e-7])
    variants = ["", "quadratic", "relaxing", "over a while", "relaxing from an instant"]
    assert list(found) == [("none", variant) for variant in variants]
    assert added(found["none", ""], rate) == pytest.approx(np.outer(TIME_S, rate))
    both = np.outer(TIME_S, rate) + np.outer(TIME_S**2, curve)
    assert added(found["none", "quadratic"], [rate, curve]) == pytest.approx(both)
    end = np.array([100.0, -50.0, 20.0])
    relaxed = np.outer(1.0 - np.exp(-TIME_S / 900.0), end)
    assert added(found["none", "relaxing"], end, 900.0) == pytest.approx(relaxed)
    between = np.outer(np.interp(TIME_S, [400.0, 1600.0], [0.0, 1.0]), end)
    assert added(found["none", "over a while"], end, 400.0, 1600.0) == pytest.approx(between)
    later = np.outer(np.where(TIME_S > 400.0, 1.0 - np.exp((400.0 - TIME_S) / 900.0), 0.0), end)
    assert added(found["none", "relaxing from an instant"], end, 400.0, 900.0) == pytest.approx(later)
    names = [[(block.name, block.unit) for block in form.blocks] for form in found.values()]
    plain = [[("nt_per_s", "nT/s")], [("nt_per_s", "nT/s"), ("nt_per_s2", "nT/s2")]]
    assert names == [*plain, [("nt_end", "nT")], [("nt_between", "nT")], [("nt_end", "nT")]]
    assert found["none", "relaxing"].nonlinear[0].grid == pytest.approx(
        SPAN_S * np.array([0.02, 0.05, 0.1, 0.2, 0.4, 0.8])
    )


def test_before_the_origin_of_time_nothing_has_relaxed() -> None:
    early = replace(scene(), time_s=TIME_S - 100.0)
    field = added(forms("bias_drift", early)["none", "relaxing"], [1.0, 0.0, 0.0], 500.0)
    assert not field[: int(100.0 / PERIOD_S)].any()


def test_a_gain_drifts_against_the_reading() -> None:
    found = forms("scale_drift")
    rate = np.array([1e-7, -2e-7, 3e-7])
    assert added(found["none", ""], rate) == pytest.approx(-TIME_S[:, None] * rate * FIELD)
    assert [block.name for block in found["none", "relaxing"].blocks] == ["end"]
    assert [block.name for block in found["none", "quadratic"].blocks] == ["per_s", "per_s2"]


def test_a_step_is_there_from_its_instant_on() -> None:
    late = (TIME_S >= 4000.0).astype(float)[:, None]
    step = np.array([100.0, -40.0, 10.0])
    assert added(forms("bias_step")["none", ""], step, 4000.0) == pytest.approx(late * step)
    gain = np.array([0.01, -0.02, 0.03])
    found = forms("scale_step")
    assert added(found["none", ""], gain, 4000.0) == pytest.approx(-late * gain * FIELD)
    assert added(found["none", "one gain"], 0.01, 4000.0) == pytest.approx(-late * 0.01 * FIELD)


def test_instants_are_even_in_samples_and_at_the_end_of_every_pause() -> None:
    even = instants(scene())
    rows = np.linspace(0, COUNT - 1, 98)[1:-1].astype(int)
    assert even.grid == pytest.approx(TIME_S[rows] - 0.5 * PERIOD_S)
    assert even.role == "instant"
    paused = replace(scene(), time_s=TIME_S + 900.0 * (np.arange(COUNT) >= 1207))
    extra = sorted(set(instants(paused).grid.tolist()) - set((paused.time_s[rows] + paused.time_s[rows - 1]) / 2.0))
    assert extra == pytest.approx([paused.time_s[1207] - 0.5 * PERIOD_S])


# The sensor's answer


def test_the_cubic_answer_has_own_cross_and_common_terms() -> None:
    found = forms("cubic_response")
    own, cross = np.array([1e-9, -2e-9, 3e-9]), np.arange(1.0, 7.0).reshape(3, 2) * 1e-9
    assert added(found["none", ""], own) == pytest.approx(own * FIELD**3)
    expected = own * FIELD**3
    for axis, others in enumerate(((1, 2), (0, 2), (0, 1))):
        for number, other in enumerate(others):
            expected[:, axis] += cross[axis, number] * FIELD[:, axis] * FIELD[:, other] ** 2
    flat = np.concatenate([own, cross.reshape(-1)])
    assert added(found["none", "with cross terms of each axis"], flat) == pytest.approx(expected)
    pairs = np.array([4e-9, -5e-9, 6e-9])
    expected = own * FIELD**3
    for pair, (one, other) in zip(pairs, ((0, 1), (0, 2), (1, 2)), strict=True):
        expected[:, one] += pair * FIELD[:, one] * FIELD[:, other] ** 2
        expected[:, other] += pair * FIELD[:, other] * FIELD[:, one] ** 2
    assert added(found["none", "with cross terms"], np.concatenate([own, pairs])) == pytest.approx(expected)
    size = (FIELD**2).sum(axis=1)[:, None]
    assert added(found["none", "by the field's size"], 1e-9) == pytest.approx(1e-9 * FIELD * size)


def test_a_magnitude_shows_every_number_of_the_cross_terms() -> None:
    """Of six it shows three sums; their differences took what heat did, and vectors were off by 770 nT, trusted."""
    forms_of = {h.variant: h for h in effect_named("cubic_response").hypotheses(scene())}
    least = {}
    for variant, form in forms_of.items():
        along = form.columns(np.zeros(0)).along(scene().unit)
        values = np.linalg.svd(along / np.linalg.norm(along, axis=0), compute_uv=False)
        least[form.needs_vectors, variant] = float(values[-1] / values[0])
    for (needs_vectors, variant), share in least.items():
        assert (share < 0.03) is needs_vectors, (variant, share)


def test_a_soft_knee_bends_an_axis_beyond_it() -> None:
    """What is missing grows as the square from the knee on, against the reading, and is whole at the end of range."""
    for axis, name in enumerate("xyz"):
        form = forms("saturation")["none", f"soft knee of {name}"]
        largest = float(np.percentile(np.abs(FIELD[:, axis]), 99.9))
        assert form.constants == {"axis": float(axis), "full_scale_nt": largest}
        expected = np.zeros((COUNT, 3))
        beyond = np.maximum(np.abs(FIELD[:, axis]) - 0.8 * largest, 0.0) / (0.2 * largest)
        expected[:, axis] = -np.sign(FIELD[:, axis]) * 50.0 * beyond**2
        assert added(form, 50.0, 0.8) == pytest.approx(expected)
        assert form.odds == 1.0
        assert form.nonlinear[0].grid == pytest.approx(np.linspace(0.5, 0.97, 12))


def test_permeable_parts_lag_behind_the_field() -> None:
    """The play of each axis less the field, its width a share of the largest; rods put it on every axis."""
    w = scene().calibrated_nt
    scale = float(np.percentile(np.abs(w), 99))
    state, followed = np.zeros(3), np.zeros_like(w)
    for row, value in enumerate(w):
        state = np.clip(state, value - 0.3 * scale, value + 0.3 * scale)
        followed[row] = state
    found = forms("hysteresis")
    share = np.array([0.01, 0.02, -0.03])
    assert added(found["none", ""], share, 0.3) == pytest.approx(share * (followed - w))
    matrix = np.arange(9.0).reshape(3, 3) * 1e-3
    assert added(found["none", "rods along the axes"], matrix, 0.3) == pytest.approx((followed - w) @ matrix)
    assert found["none", ""].constants == {"scale_nt": scale}
    assert found["none", ""].nonlinear[0].grid.tolist() == [0.05, 0.15, 0.3, 0.5, 0.8]


def test_a_play_begins_where_it_was_left() -> None:
    values = np.array([[0.0, 0.0], [5.0, -5.0], [4.0, -4.0]])
    assert play(values, 2.0, np.array([1.5, -3.0])).tolist() == [[1.5, -2.0], [3.0, -3.0], [3.0, -3.0]]


def test_axes_that_are_digitised_later_see_a_later_field() -> None:
    slope = scene().field_slope
    expected = np.stack([np.zeros(COUNT), 0.01 * slope[:, 1], -0.02 * slope[:, 2]], axis=1)
    assert added(forms("axis_skew")["none", ""], [0.01, -0.02]) == pytest.approx(expected)
    pair = replace(value_of([0.01, 0.02], [1e-3, 2e-3], "s"), labels=(("axis y", "axis z"),))
    derived = effect_named("axis_skew").derived({"after_x_s": pair})
    assert derived["delay_s"].value.tolist() == [0.0, 0.01, 0.02]
    assert derived["delay_s"].sigma.tolist() == [0.0, 1e-3, 2e-3]


@pytest.mark.parametrize(("axis", "moves"), [("x", [0, 1, 1]), ("y", [0, 1, 0]), ("z", [0, 0, 1])])
def test_one_axis_behind_the_others_may_be_a_loop_of_metal_around_it(axis: str, moves: list[int]) -> None:
    """The current that a change of the field induces opposes it, so that the axis of the loop answers late."""
    behind = forms("axis_skew")["none", f"axis {axis} behind"]
    assert added(behind, [0.01]) == pytest.approx(0.01 * scene().field_slope * moves)
    (block,) = behind.blocks
    assert (block.least, block.highest) == ((0.0, np.inf) if axis == "x" else (-np.inf, 0.0))
    assert behind.exactly_alike == ("unknown",)
    assert f"a closed loop of metal around axis {axis}" in behind.imitated_by
    found = effect_named("axis_skew").derived(
        {"after_x_s": Value(np.array([0.01]), np.array([0.001]), "s", block.labels)}
    )
    assert found["delay_s"].value.tolist() == [0.01 * one for one in moves]


def test_a_late_answer_is_short_by_the_square_of_its_delay() -> None:
    """tau^2 |dB/dt across|^2 / (2 |B|), against the field; the time constant and its sigma follow from tau^2."""
    slope = scene().field_slope
    across = slope - np.einsum("ni,ni->n", slope, UNIT)[:, None] * UNIT
    loss = (across**2).sum(axis=1) / (2.0 * np.linalg.norm(scene().calibrated_nt, axis=1))
    assert added(forms("response_lag")["none", ""], 0.04, 0.0) == pytest.approx(-0.04 * loss[:, None] * UNIT)
    derived = effect_named("response_lag").derived({"tau2_s2": value_of(0.04, 0.004, "s2")})
    assert (float(derived["tau_s"].value), float(derived["tau_s"].sigma)) == pytest.approx((0.2, 0.01))
    assert effect_named("response_lag").derived({"tau2_s2": value_of(-0.04, 0.004, "s2")}) == {}
    unturned = forms("response_lag", replace(scene(), channels={}, body_from_eci=None))
    names = [variant for (_, variant), form in unturned.items() if not form.needs_vectors]
    assert names == ["by the steps", "by the steps, from its start", "average of samples"]  # test_physics_lag.py
