"""Columns of a record that always change along with others: one stands for all of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from magcal_service.diagnosis.handover import model_term
from magcal_service.physics.apply.forward import bind
from magcal_service.physics.apply.model_file import parse_model, text_of
from magcal_service.physics.catalogue import effect_named
from magcal_service.physics.drivers.proportion import apart, named
from magcal_service.physics.interface import Hypothesis
from magcal_service.physics.scene.memory import Memory
from magcal_service.physics.scene.scene import Scene, Telemetry
from tests.physics.scenes import scene
from tests.physics.test_model_file import model

RNG = np.random.default_rng(8911)
LOADS = RNG.normal(size=(400, 2))


def with_moment(values: np.ndarray) -> Scene:
    return replace(scene(), channels={"rods": Telemetry("rods", "magnetic moment", values)})


def plain(effect: str, of: Scene) -> Hypothesis:
    """The form by a record of every column."""
    return next(h for h in effect_named(effect).hypotheses(of) if h.driver.startswith("channel") and not h.variant)


def test_columns_of_their_own_are_kept_each() -> None:
    assert apart(LOADS, (0, 1)) == {0: (), 1: ()}


def test_the_largest_stands_for_what_is_in_proportion_to_it() -> None:
    """A constant beside it is the bias's."""
    first, second = LOADS.T
    signals = np.stack([0.5 * first + 3.0, second, -2.0 * first, first], axis=1)
    assert apart(signals, (0, 1, 2, 3)) == {1: (), 2: (0, 3)}


def test_a_sum_of_others_goes_along_with_each() -> None:
    signals = np.stack([*LOADS.T, 0.4 * LOADS.sum(axis=1)], axis=1)
    assert apart(signals, (0, 1, 2)) == {0: (2,), 1: (2,)}


def test_only_the_columns_asked_for_count() -> None:
    signals = np.stack([LOADS[:, 0], LOADS[:, 0], LOADS[:, 1]], axis=1)
    assert apart(signals, (0, 2)) == {0: (), 2: ()}


def test_rounding_makes_no_column_of_its_own() -> None:
    signals = np.round(np.outer(LOADS[:, 0], [1.0, 0.37]), 4)
    assert apart(signals, (0, 1)) == {0: (1,)}


@pytest.mark.parametrize(("own", "expected"), [(0.0, {0: (1,)}), (0.3, {0: (), 1: ()})])
def test_what_records_noise_makes_of_two_in_proportion_is_no_column_of_its_own(own: float, expected: object) -> None:
    """Their noise decided which of two circuits behind one switch makes a field, at 6 sigma, trusted."""
    rng = np.random.default_rng(8917)
    first = np.cumsum(rng.normal(size=3000)) / 20.0
    second = 0.5 * first + own * np.cumsum(rng.normal(size=3000)) / 20.0
    noise = np.array([0.05, 0.05])
    records = np.stack([first, second], axis=1) + noise * rng.standard_normal((3000, 2))
    assert apart(records, (0, 1), noise) == expected


def test_loads_that_look_like_noise_stay_apart() -> None:
    """Each switches from row to row by itself."""
    on = np.random.default_rng(8918).random((2000, 2)) < 0.4
    assert apart(on.astype(np.float64), (0, 1), np.array([0.48, 0.48])) == {0: (), 1: ()}


def test_what_goes_along_is_named() -> None:
    assert named("coil 3", ["coil 1", "coil 2"]) == "coil 3 with coil 1 and coil 2 in proportion"
    assert named("coil 3", []) == "coil 3"


def test_coils_that_were_only_driven_together_have_one_number_for_all() -> None:
    """Nine of them would be any whose sum is right, each with a sigma as if it were known."""
    fired = (np.sin(scene().time_s / 300.0) > 0.6)[:, None]
    of = with_moment(fired * np.array([0.11, 0.066, 0.182]))
    form = plain("torquer", of)
    (block,) = form.blocks
    assert block.shape == (1, 3)
    assert block.labels[0] == ("coil 3 with coil 1 and coil 2 in proportion",)
    assert form.constants == {"column_0": 2.0}
    given = replace(of, given=form.constants)
    assert plain("torquer", given).blocks[0].shape == (1, 3)
    theta = np.zeros(1)
    assert np.array_equal(plain("torquer", given).columns(theta).body, form.columns(theta).body)


def test_circuits_behind_one_switch_have_one_number_for_all() -> None:
    on = (np.sin(scene().time_s / 300.0) > 0.6)[:, None]
    loads = Telemetry("loads", "current", 0.1 + on * np.array([0.3, 0.8]))
    of = replace(scene(), channels={"loads": loads})
    (block,) = plain("current_loop", of).blocks
    assert block.shape == (1, 3)
    assert block.labels[0] == ("circuit 2 with circuit 1 in proportion",)


@pytest.mark.parametrize("variant", ["", "recorded late"])
def test_a_file_of_circuits_behind_one_switch_is_read_and_acts_on_a_moment_of_one(variant: str) -> None:
    """A moment does not show what goes along with what: its one circuit is no row of a matrix."""
    on = (np.sin(scene().time_s / 300.0) > 0.6)[:, None]
    of = replace(scene(), channels={"loads": Telemetry("loads", "current", 0.1 + on * np.array([0.3, 0.8]))})
    form = next(one for one in effect_named("current_loop").hypotheses(of) if one.variant == variant)
    term = model_term(form, np.array([1.0, 30.0][: len(form.nonlinear)]), np.array([10.0, 20.0, 30.0]))
    assert term.amplitudes["nt_per_a"].shape == (1, 3)
    (again,) = parse_model(text_of(model(term)).encode()).terms
    now = replace(
        of,
        time_s=of.time_s[:1],
        calibrated_nt=of.calibrated_nt[:1],
        channels={"loads": Telemetry("loads", "current", np.array([[0.4, 0.9]]))},
    )
    assert bind(again, now, Memory()).disturbance()[0] == pytest.approx(0.9 * np.array([[10.0, 20.0, 30.0]]))
