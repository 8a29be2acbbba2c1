"""Changes at several instants: found to the sample where they are sudden, and nothing proposed for what is slow."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from magcal_service.diagnosis.linear import Workspace
from magcal_service.model import Array
from magcal_service.physics.catalogue import effect_named
from magcal_service.physics.columns import Columns
from magcal_service.physics.drivers import instants
from magcal_service.physics.interface import Hypothesis
from magcal_service.physics.scene.scene import Scene
from magcal_service.physics.segments import Segments

COUNT, PERIOD_S, NOISE_NT, SIZE_NT = 3000, 2.0, 50.0, 150.0
TIME_S = PERIOD_S * np.arange(float(COUNT))
SPAN_S = float(TIME_S[-1])
ANGLE = TIME_S / 11.0
FIELD = 30e3 * np.stack([np.cos(ANGLE), np.sin(ANGLE), np.sin(TIME_S / 900.0)], axis=1)
FIELD += np.array([0.0, 0.0, 5e3])
ALONG = np.array([0.5, -0.7, 0.51])


def flown(time_s: Array = TIME_S) -> Scene:
    size = np.linalg.norm(FIELD[: len(time_s)], axis=1)
    return Scene(time_s, 0, False, FIELD[: len(time_s)], FIELD[: len(time_s)], FIELD[: len(time_s)], size)


def proposed(signal: Array, seed: int = 3, along: Array = ALONG) -> list[tuple[Hypothesis, Array]]:
    """Forms that are proposed for a body field ``along * signal`` under noise, with their instants."""
    scene = flown()
    field = signal[:, None] * along if signal.ndim == 1 else signal
    noise = np.random.default_rng(seed).normal(0.0, NOISE_NT, COUNT)
    model = np.concatenate([scene.unit, scene.unit * FIELD], axis=1)
    space = Workspace(np.einsum("ni,ni->n", field, scene.unit) + noise, model)

    def sums(columns: Columns, rows: NDArray[np.intp]) -> Segments:
        return space.segments(columns.along(scene.unit), rows)

    found = []
    for form in effect_named("bias_step").hypotheses(scene):
        if form.proposals is not None:
            found += [(form, theta) for theta in form.proposals(sums, ())]
    return found


def after(*rows: int) -> Array:
    """(n,) how many of the instants before these rows have been."""
    return np.searchsorted(np.array(rows), np.arange(COUNT), side="right").astype(np.float64)


@pytest.mark.parametrize("rows", [(700, 1450), (400, 900, 2100), (300, 420, 1800, 2400), (350, 700, 1100, 1500, 1900)])
def test_what_is_switched_is_found_at_its_instants_with_one_amplitude(rows: tuple[int, ...]) -> None:
    ((form, theta),) = proposed(SIZE_NT * (after(*rows) % 2.0))
    assert form.variant == f"switched at {len(rows)} instants"
    assert [block.name for block in form.blocks] == ["switched_nt"]
    assert np.abs(theta / PERIOD_S - (np.array(rows) - 0.5)).max() <= 8.0
    assert form.columns(theta).field(ALONG)[[0, (rows[0] + rows[1]) // 2]].tolist() == [[0.0] * 3, ALONG.tolist()]


def test_steps_of_their_own_are_found_with_an_amplitude_each() -> None:
    amounts = SIZE_NT * np.array([[1.0, 0.3, -0.4], [-0.2, 0.9, 1.1], [0.8, -1.2, 0.1]])
    reached = np.stack([np.arange(COUNT) >= row for row in (500, 1400, 2300)], axis=1)
    ((form, theta),) = proposed(reached @ amounts)
    assert form.variant == "steps at 3 instants"
    assert form.blocks[0].shape == (3, 3)
    assert np.abs(theta / PERIOD_S - np.array([499.5, 1399.5, 2299.5])).max() <= 8.0
    assert form.columns(theta).field(amounts.reshape(-1))[-1] == pytest.approx(amounts.sum(axis=0))


SHARE = TIME_S / SPAN_S
SLOW = {
    "nothing": 0.0 * SHARE,
    "an orbit's heat": np.sin(2.0 * np.pi * 1.8 * SHARE),
    "quick heat in light and shadow": np.tanh(6.0 * np.sin(2.0 * np.pi * 1.8 * SHARE)),
    "relaxation": np.exp(-SHARE / 0.15),
    "a parabola": 4.0 * (SHARE - 0.5) ** 2,
    "ramps of a twelfth": np.interp(SHARE, [0.2, 0.28, 0.5, 0.58, 0.8, 0.88], [0.0, 1.0, 1.0, 0.0, 0.0, 1.0]),
    "a wandering bias": np.cumsum(np.random.default_rng(8).normal(0.0, 0.03, COUNT)),
}


@pytest.mark.parametrize("size", [1.0, 4.0])
@pytest.mark.parametrize("name", SLOW)
def test_nothing_is_proposed_for_what_is_slow(name: str, size: float) -> None:
    for seed in (1, 2):
        assert proposed(size * SIZE_NT * SLOW[name], seed) == []


def test_nothing_is_proposed_for_what_switches_more_often_than_six_times() -> None:
    rows = np.linspace(0, COUNT, 16, dtype=int)[1:-1]
    assert proposed(SIZE_NT * (after(*rows.tolist()) % 2.0)) == []


def test_one_step_is_no_series() -> None:
    assert proposed(SIZE_NT * after(1300)) == []


@pytest.mark.parametrize(
    ("apart", "widths"), [(4, [4]), (8, [8]), (9, [8, 9]), (30, [8, 16, 30]), (64, [8, 16, 32, 64])]
)
def test_ramps_reach_from_a_few_samples_to_the_nearer_neighbour(apart: int, widths: list[int]) -> None:
    ramps = instants._ramps(np.array([1000, 1000 + apart]), 0, COUNT)
    assert [round(8 / 7 * float(np.ptp(edge))) for edge in ramps] == pytest.approx(widths, abs=1.5)
    assert [float(edge.mean()) for edge in ramps] == pytest.approx([1000.0] * len(widths), abs=0.6)


def test_too_few_samples_are_not_searched() -> None:
    family = instants._Family(flown(TIME_S[:383]), lambda signal: Columns(axes=signal[None, :, None] * np.ones(3)))
    assert family.best(lambda *_: pytest.fail("looked for")) is None


def test_every_instant_is_charged_and_the_form_is_a_free_one() -> None:
    forms = [form for form in effect_named("bias_step").hypotheses(flown()) if form.proposals is not None]
    assert {len(form.nonlinear) for form in forms} == {2, 3, 4, 5, 6}
    assert all(number.role == "instant" for form in forms for number in form.nonlinear)
    assert all(form.is_free for form in forms)
    (one,) = [form for form in effect_named("bias_step").hypotheses(flown()) if form.proposals is None]
    assert (one.variant, one.is_free) == ("", False)


def test_what_was_on_at_the_end_of_the_recording_stays_on() -> None:
    later = replace(flown(TIME_S[:5] + 9000.0), given={})
    forms = {form.variant: form for form in effect_named("bias_step").hypotheses(later)}
    switched = [forms[f"switched at {count} instants"] for count in (2, 3)]
    assert [form.columns(np.arange(100.0, 100.0 + len(form.nonlinear))).field(ALONG)[0].any() for form in switched] == [
        False,
        True,
    ]
