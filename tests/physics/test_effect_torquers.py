"""What coils, a duty and a tone add to the field, worked out here from their equations."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from magcal_service.physics.catalogue import effect_named
from magcal_service.physics.effects.torquer import remembered
from magcal_service.physics.interface import value_of
from magcal_service.physics.scene.memory import Memory
from magcal_service.physics.scene.scene import Scene, Telemetry
from tests.physics.effect_forms import TIME_S, added, forms
from tests.physics.scenes import COUNT, PERIOD_S, scene


def test_torquers_add_their_field_with_decay_and_remanence() -> None:
    moment = scene().channels["torquer"].values
    found = forms("torquer")
    m = np.arange(9.0).reshape(3, 3)
    plain = found["channel:torquer", ""]
    assert added(plain, m, 0.0) == pytest.approx(moment @ m)
    decayed = np.array(moment)
    for row in range(1, COUNT):
        decayed[row] += (decayed[row - 1] - moment[row]) * math.exp(-PERIOD_S / 3.0)
    assert added(plain, m, 3.0) == pytest.approx(decayed @ m)
    largest = float(np.abs(moment).max())
    signs, last = np.zeros_like(moment), np.zeros(3)
    for row, value in enumerate(moment):
        last = np.where(np.abs(value) > 0.02 * largest, np.sign(value), last)
        signs[row] = last
    form = found["channel:torquer", "with remanence"]
    both = np.concatenate([m, 10.0 * m])
    assert added(form, both, 0.0) == pytest.approx(moment @ m + signs @ (10.0 * m))
    assert form.constants == {"column_0": 0.0, "column_1": 1.0, "column_2": 2.0, "largest_am2": largest}
    assert plain.nonlinear[0].grid.tolist() == [0.0, 0.1, 0.3, 1.0, 3.0]
    derived = effect_named("torquer").derived({"nt_per_am2": value_of(m, m + 1.0, "nT/(A m2)")})
    assert derived["nt_per_am2"].value.tolist() == m.T.tolist()
    assert derived["nt_per_am2"].sigma.tolist() == (m.T + 1.0).tolist()
    assert effect_named("torquer").derived({}) == {}


def test_a_coil_that_is_never_used_is_left_out_and_a_core_begins_where_it_was_left() -> None:
    values = np.stack([np.sign(np.sin(TIME_S / 71.0)), np.zeros(COUNT)], axis=1)
    of = replace(scene(), channels={"coils": Telemetry("coils", "magnetic moment", values)})
    assert forms("torquer", of)["channel:coils", ""].constants == {"column_0": 0.0}
    memory = Memory(-1, {"sign": np.array([-1.0, 1.0])})
    begun = replace(scene(), memory=memory)
    commands = np.array([[0.0, 0.0], [0.021, -0.019], [0.0, 1.0]])
    assert remembered(begun, commands, 1.0).tolist() == [[-1.0, 1.0], [1.0, 1.0], [1.0, 1.0]]
    assert memory.states["sign"].tolist() == [1.0, 1.0]


def test_a_regular_duty_is_on_for_its_share_from_its_phase_on() -> None:
    form = forms("torquer")["inferred:duty", "regular duty"]
    field = added(form, [10.0, 20.0, 30.0], 100.0, 0.3, 0.25)
    on = np.mod(TIME_S - 25.0, 100.0) < 30.0
    assert field == pytest.approx(on[:, None] * np.array([10.0, 20.0, 30.0]))
    assert [number.role for number in form.nonlinear] == ["period", "held", "held"]
    assert form.nonlinear[1].grid == pytest.approx(np.arange(1, 13) / 24.0)
    assert form.nonlinear[2].grid == pytest.approx(np.arange(24) / 24.0)


def test_a_tone_has_a_size_over_all_its_amplitudes() -> None:
    form = forms("tone")["none", ""]
    p, q = np.array([3.0, 0.0, 4.0]), np.array([0.0, 12.0, 0.0])
    angle = 2.0 * np.pi * 0.02 * TIME_S
    expected = np.outer(np.cos(angle), p) + np.outer(np.sin(angle), q)
    assert added(form, [p, q], 0.02) == pytest.approx(expected)
    sigma = np.array([1.0, 2.0, 3.0])
    derived = effect_named("tone").derived({"cosine_nt": value_of(p, sigma, "nT"), "sine_nt": value_of(q, sigma, "nT")})
    spread = math.sqrt(3.0**2 + 12.0**2 + 24.0**2) / 13.0
    found = derived["amplitude_nt"]
    assert (float(found.value), float(found.sigma)) == pytest.approx((13.0, spread))


@pytest.mark.parametrize(("count", "offered"), [(63, False), (64, True)])
def test_a_tone_needs_64_samples_to_be_looked_for(count: int, offered: bool) -> None:
    field = np.ones((count, 3))
    short = Scene(np.arange(float(count)), 0, True, field, field, field, field[:, 0])
    assert bool(effect_named("tone").hypotheses(short)) is offered
    assert effect_named("tone").hypotheses(replace(short, given={}))
