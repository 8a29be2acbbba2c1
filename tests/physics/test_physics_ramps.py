"""A change that takes a while: its begin, end and course are found, and what is sudden is left to a step."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from magcal_service.diagnosis.linear import Workspace
from magcal_service.model import Array
from magcal_service.physics.catalogue import effect_named
from magcal_service.physics.columns import Columns
from magcal_service.physics.interface import Hypothesis
from magcal_service.physics.segments import Segments
from tests.physics.test_physics_instants import ALONG, COUNT, FIELD, NOISE_NT, SIZE_NT, TIME_S, flown


def ramp_of(effect: str, count: int = COUNT, variant: str = "over a while") -> Hypothesis:
    (form,) = [one for one in effect_named(effect).hypotheses(flown(TIME_S[:count])) if one.variant == variant]
    return form


def level(from_s: float, to_s: float) -> Array:
    """(n,) of a change between two times, how much has come about."""
    return np.asarray(np.interp(TIME_S, [from_s, to_s], [0.0, 1.0]))


def proposed(form: Hypothesis, field: Array, count: int = COUNT) -> Array:
    """Begins and ends (q, 2) [s] that a form proposes for a body field (n, 3) [nT] under noise."""
    scene = flown(TIME_S[:count])
    noise = np.random.default_rng(12).normal(0.0, NOISE_NT, count)
    model = np.concatenate([scene.unit, scene.unit * FIELD[:count]], axis=1)
    space = Workspace(np.einsum("ni,ni->n", field[:count], scene.unit) + noise, model)

    def sums(columns: Columns, rows: NDArray[np.intp]) -> Segments:
        return space.segments(columns.along(scene.unit), rows)

    assert form.proposals is not None
    return form.proposals(sums, ())


@pytest.mark.parametrize(("from_s", "to_s"), [(900.0, 1100.0), (2500.0, 3300.0), (1000.0, 4500.0)])
def test_a_ramp_is_found_at_its_ends(from_s: float, to_s: float) -> None:
    ((begin, end),) = proposed(ramp_of("bias_drift"), 3.0 * SIZE_NT * level(from_s, to_s)[:, None] * ALONG)
    assert abs(begin - from_s) < 120.0
    assert abs(end - to_s) < 120.0


def test_a_gain_that_changes_over_a_while_is_found_too() -> None:
    growth = 0.02 * level(2000.0, 3000.0)[:, None] * FIELD * np.array([1.0, -1.0, 0.0])
    ((begin, end),) = proposed(ramp_of("scale_drift"), growth)
    assert abs(begin - 2000.0) < 120.0
    assert abs(end - 3000.0) < 120.0


@pytest.mark.parametrize(("from_s", "tau_s"), [(900.0, 200.0), (2500.0, 400.0), (1000.0, 900.0)])
def test_what_relaxes_is_found_by_its_instant_and_its_time_constant(from_s: float, tau_s: float) -> None:
    relaxed = 1.0 - np.exp(-np.maximum(TIME_S - from_s, 0.0) / tau_s)
    form = ramp_of("bias_drift", variant="relaxing from an instant")
    ((begin, tau),) = proposed(form, 3.0 * SIZE_NT * relaxed[:, None] * ALONG)
    assert abs(begin - from_s) < 120.0
    assert tau == pytest.approx(tau_s, rel=0.3)


def test_what_relaxes_as_quickly_as_any_that_is_tried_is_a_jump() -> None:
    form = ramp_of("bias_drift", variant="relaxing from an instant")
    least = float(form.nonlinear[1].grid.min())
    assert form.is_quickest(np.array([1000.0, least]))
    assert not form.is_quickest(np.array([1000.0, 2.0 * least]))
    assert not ramp_of("bias_drift").is_quickest(np.array([1000.0, 2000.0]))


@pytest.mark.parametrize("effect", ["bias_drift", "scale_drift"])
def test_nothing_is_proposed_where_hardly_more_samples_are_than_the_shortest_ramp_has(effect: str) -> None:
    assert len(proposed(ramp_of(effect, 120), np.zeros((COUNT, 3)), 120)) == 0


def test_before_its_begin_there_is_nothing_and_from_its_end_on_all_of_it() -> None:
    form = ramp_of("bias_drift")
    field = form.columns(np.array([1000.0, 2000.0])).field(np.array([100.0, -50.0, 20.0]))
    assert not field[TIME_S <= 1000.0].any()
    np.testing.assert_allclose(
        field[TIME_S >= 2000.0], np.tile([100.0, -50.0, 20.0], (int((TIME_S >= 2000.0).sum()), 1))
    )
    np.testing.assert_allclose(field[TIME_S == 1500.0], [[50.0, -25.0, 10.0]])


@pytest.mark.parametrize(
    ("variant", "theta"), [("over a while", [1547.0, 2353.0]), ("relaxing from an instant", [1547.0, 268.0])]
)
def test_what_comes_about_in_a_gap_is_a_jump(variant: str, theta: list[float]) -> None:
    """No sample has seen it take a while."""
    seen = ramp_of("bias_drift", variant=variant)
    time_s = TIME_S[(TIME_S < 1550.0) | (TIME_S > 2350.0)]
    (unseen,) = [one for one in effect_named("bias_drift").hypotheses(flown(time_s)) if one.variant == variant]
    assert not seen.is_quickest(np.array(theta))
    assert unseen.is_quickest(np.array(theta))
