"""Blocks, labels, sentences and direct forms of the catalogue's interface, by hand."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from magcal_service.base.units import CHANNEL_UNITS
from magcal_service.model import Array
from magcal_service.physics.acting import ActsOn, direct
from magcal_service.physics.apply.model_file import ModelTerm
from magcal_service.physics.catalogue import catalogue, effect_named
from magcal_service.physics.columns import Columns
from magcal_service.physics.interface import Block, Hypothesis, value_of


@pytest.mark.parametrize(("shape", "size"), [((3,), 3), ((2, 3), 6), ((), 1), ((1, 3), 3)])
def test_a_block_has_as_many_amplitudes_as_its_shape(shape: tuple[int, ...], size: int) -> None:
    assert Block("name", "nT", shape).size == size
    assert Block("name", "nT").shape == (3,)


def test_a_label_names_effect_form_and_driver() -> None:
    plain = Hypothesis("heat", "none", lambda _: Columns(), (Block("a", "nT"), Block("b", "nT", ())))
    assert (plain.label, plain.size) == ("heat", 4)
    assert replace(plain, variant="late").label == "heat[late]"
    assert replace(plain, driver="channel:t").label == "heat by channel:t"
    assert replace(plain, variant="late", driver="channel:t").label == "heat[late] by channel:t"
    assert (plain.odds, plain.largest_nt, plain.is_whole) == (0.0, math.inf, False)


def test_a_sentence_is_the_first_whose_numbers_are_there() -> None:
    effect = replace(
        effect_named("tone"), title="a made-up thing", says=("{a} by {driver}", "{b} alone", "{b} and {a}")
    )
    number = value_of(1.0, 0.1, "nT")
    assert effect.sentence({"a": number}, "channel:bus") == "1.00 by the recorded bus"
    assert effect.sentence({"a": number}, "channel:bus", ["channel:rail"]) == "1.00 by the recorded bus (or rail)"
    assert effect.sentence({"a": number}, "inferred:array_current") == "1.00 by the inferred array current"
    assert effect.sentence({"b": number}, "none") == "1.00 alone"
    assert effect.sentence({}, "none") == "A made-up thing."


def term(amplitudes: Array, driver: str = "channel:coils") -> ModelTerm:
    return ModelTerm("torquer", driver, "", {"k": amplitudes})


def test_a_direct_form_takes_its_columns_and_rows_in_order() -> None:
    made = direct(term(np.array([[1.0, 2.0, 3.0], [10.0, 20.0, 30.0]])), "magnetic moment", "k", [2, 0], 0.5)
    assert made is not None
    assert made.field((1.5, 9.0, 2.5), (0.0, 0.0, 0.0)) == [2.0 + 10.0, 4.0 + 20.0, 6.0 + 30.0]
    assert (made.channel, made.quantity, made.columns, made.zero) == ("coils", "magnetic moment", (2, 0), 0.5)


@pytest.mark.parametrize(
    ("of", "columns"),
    [
        (term(np.ones(3), "none"), [0]),
        (term(np.ones(3)), []),
        (term(np.ones(3)), [-1]),
        (term(np.ones(3)), [0, 1]),
        (term(np.ones((1, 3))), [0, 1]),
        (term(np.ones((3, 1))), [0]),
        (replace(term(np.ones(3)), nonlinear={"decay_s": 1.0}), [0]),
    ],
)
def test_what_is_no_direct_form_is_none(of: ModelTerm, columns: list[int]) -> None:
    assert direct(of, "magnetic moment", "k", columns) is None
    assert direct(term(np.ones(3)), "magnetic moment", "k", [0]) is not None
    assert direct(term(np.ones((1, 3))), "magnetic moment", "k", [0]) is not None


def test_kinds_of_reference_and_of_what_is_live() -> None:
    assert [kind for kind in ActsOn if kind.is_reference] == [ActsOn.REFERENCE, ActsOn.REFERENCE_TIME]


def test_a_record_that_is_there_already_is_not_asked_for() -> None:
    """Of a recorded current the eclipse edge is left; each quantity is one that a channel can have."""
    loop = effect_named("current_loop")
    assert loop.separation(()) == f"{loop.separated_by}; or a bus current channel"
    assert loop.separation({"current", "temperature"}) == loop.separated_by
    known = {unit.quantity for unit in CHANNEL_UNITS.values()}
    asked = {effect.name: {of for of, _ in effect.or_record} for effect in catalogue() if effect.or_record}
    assert len(asked) == 5
    assert all(of <= known for of in asked.values())
    assert not [effect.name for effect in catalogue() if " channel" in effect.separated_by]
