"""Columns, blocks, labels and words of the catalogue's interface, by hand."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from magcal_service.model import Array
from magcal_service.physics.acting import ActsOn, direct
from magcal_service.physics.apply.model_file import ModelTerm
from magcal_service.physics.catalogue import effect_named
from magcal_service.physics.interface import (
    Block,
    Columns,
    Hypothesis,
    Segments,
    along_axes,
    common_gain,
    gains,
    in_words,
    joined,
    oscillation,
    value_of,
)

UNIT = np.array([[0.6, 0.0, 0.8], [0.0, 1.0, 0.0]])
AXES = Columns(axes=np.array([[[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]], [[7.0, 8.0, 9.0], [10.0, 11.0, 12.0]]]))
BODY = Columns(body=np.array([[[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]]))
GROWTH = Columns(magnitude=np.array([[1.0, 2.0], [3.0, -4.0]]))


def test_columns_along_the_field() -> None:
    """Each signal on each axis; a vector by its part along the field; a growth as it is."""
    assert AXES.along(UNIT).tolist() == [[0.6, 0.0, 3.0 * 0.8, 4.2, 0.0, 9.0 * 0.8], [0.0, 5.0, 0.0, 0.0, 11.0, 0.0]]
    assert BODY.along(UNIT) == pytest.approx(np.array([[0.6 + 2.4], [5.0]]))
    assert GROWTH.along(UNIT).tolist() == [[1.0, 3.0], [2.0, -4.0]]


def test_components_are_three_rows_a_sample() -> None:
    rows = AXES.components()
    assert rows is not None
    assert rows.shape == (6, 6)
    assert rows[0].tolist() == [1.0, 0.0, 0.0, 7.0, 0.0, 0.0]
    assert rows[4].tolist() == [0.0, 5.0, 0.0, 0.0, 11.0, 0.0]
    assert BODY.components() == pytest.approx(np.arange(1.0, 7.0)[:, None])
    assert GROWTH.components() is None


def test_fields_and_growths_are_sums_over_amplitudes() -> None:
    field = AXES.field(np.array([1.0, 10.0, 100.0, 2.0, 20.0, 200.0]))
    assert field.tolist() == [[15.0, 180.0, 2100.0], [24.0, 270.0, 3000.0]]
    assert BODY.field(np.array([2.0])).tolist() == [[2.0, 4.0, 6.0], [8.0, 10.0, 12.0]]
    assert GROWTH.field(np.ones(2)).tolist() == [[0.0] * 3] * 2
    assert np.asarray(GROWTH.growth(np.array([2.0, 1.0]))).tolist() == [5.0, 0.0]
    assert BODY.growth(np.ones(1)) == 0.0


def test_sizes_are_root_mean_squares_over_the_samples() -> None:
    assert AXES.sizes() == pytest.approx([math.sqrt(8.5), math.sqrt(14.5), math.sqrt(22.5), *AXES.sizes()[3:]])
    assert float(AXES.sizes()[5]) == pytest.approx(math.sqrt((81.0 + 144.0) / 2.0))
    assert BODY.sizes() == pytest.approx([math.sqrt((14.0 + 77.0) / 2.0)])
    assert GROWTH.sizes() == pytest.approx([math.sqrt(2.5), math.sqrt(12.5)])


def test_signals_go_along_every_axis_and_gains_against_the_reading() -> None:
    signal, field = np.array([2.0, 3.0]), np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]])
    assert along_axes(signal).field(np.array([1.0, 10.0, 100.0])).tolist() == [[2.0, 20.0, 200.0], [3.0, 30.0, 300.0]]
    both = along_axes(np.stack([signal, -signal], axis=1))
    assert both.field(np.array([1.0, 1.0, 1.0, 1.0, 1.0, 0.0])).tolist() == [[0.0, 0.0, 2.0], [0.0, 0.0, 3.0]]
    assert gains(field, signal).field(np.array([1.0, 0.5, 0.0])).tolist() == [[-2.0, -2.0, 0.0], [-12.0, -7.5, 0.0]]
    assert common_gain(field, signal).field(np.array([0.5])).tolist() == [[-1.0, -2.0, -3.0], [-6.0, -7.5, -9.0]]


def test_an_oscillation_has_cosine_and_sine() -> None:
    field = oscillation(np.array([0.0, 0.25, 0.5]), 1.0).field(np.array([1.0, 0.0, 0.0, 0.0, 1.0, 0.0]))
    assert field == pytest.approx(np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]), abs=1e-12)


def test_parts_of_a_form_are_joined_in_their_order() -> None:
    assert joined(AXES, AXES).axes is not None
    assert joined(AXES, AXES).along(UNIT).shape == (2, 12)
    bodies = joined(BODY, Columns(body=2.0 * BODY.body)) if BODY.body is not None else BODY
    assert bodies.along(UNIT) == pytest.approx(np.array([[3.0, 6.0], [5.0, 10.0]]))


@pytest.mark.parametrize(("shape", "size"), [((3,), 3), ((2, 3), 6), ((), 1), ((1, 3), 3)])
def test_a_block_has_as_many_amplitudes_as_its_shape(shape: tuple[int, ...], size: int) -> None:
    assert Block("name", "nT", shape).size == size
    assert Block("name", "nT").shape == (3,)


def test_a_label_names_effect_form_and_driver() -> None:
    plain = Hypothesis("heat", "none", lambda _: BODY, (Block("a", "nT"), Block("b", "nT", ())))
    assert (plain.label, plain.size) == ("heat", 4)
    assert replace(plain, variant="late").label == "heat[late]"
    assert replace(plain, driver="channel:t").label == "heat by channel:t"
    assert replace(plain, variant="late", driver="channel:t").label == "heat[late] by channel:t"
    assert (plain.odds, plain.largest_nt, plain.is_whole) == (0.0, math.inf, False)


@pytest.mark.parametrize(
    ("value", "sigma", "words"),
    [
        (12.3456, 0.1, "12.35"),
        (12.3456, 0.3, "12.35"),
        (12.3456, 1.0, "12.3"),
        (12.3456, 12.0, "12"),
        (-12.3456, 0.02, "-12.346"),
        (12.3456, math.nan, "12.346"),
        (12.3456, 0.0, "12.346"),
        (0.00012345, 1e-6, "1.234e-04"),
        (0.0, 1e-6, "0.0e+00"),
        (1.0, 1e-6, "1.0000000e+00"),
        (1.0, 1.1e-5, "1.000000"),
        ([1.0, 2.0], [0.1, 1.0], "(1.00, 2.0)"),
    ],
)
def test_numbers_have_as_many_digits_as_their_sigma_deserves(value: object, sigma: object, words: str) -> None:
    assert in_words(value_of(value, sigma, "nT")) == words  # type: ignore[arg-type]


def test_a_sentence_is_the_first_whose_numbers_are_there() -> None:
    effect = replace(
        effect_named("tone"), title="a made-up thing", says=("{a} by {driver}", "{b} alone", "{b} and {a}")
    )
    number = value_of(1.0, 0.1, "nT")
    assert effect.sentence({"a": number}, "channel:bus") == "1.00 by the recorded bus"
    assert effect.sentence({"a": number}, "inferred:array_current") == "1.00 by the inferred array current"
    assert effect.sentence({"b": number}, "none") == "1.00 alone"
    assert effect.sentence({}, "none") == "A made-up thing."


def random_segments(count: int) -> Segments:
    rng = np.random.default_rng(3)
    square = rng.normal(size=(count, 2, 2))
    return Segments(
        square @ np.swapaxes(square, 1, 2), 0.1 * rng.normal(size=(count, 4, 2)), rng.normal(size=(count, 2))
    )


def test_a_drop_is_that_of_the_normal_equations_of_what_is_switched_on() -> None:
    """With a millionth of the trace as a tie, so that nothing is singular."""
    of = random_segments(3)
    for chosen in np.array([[1.0, 0.0, 1.0], [0.0, 1.0, 0.0]]):
        normal, inside, right = (np.tensordot(chosen, part, 1) for part in (of.normal, of.inside, of.right))
        left = normal - inside.T @ inside
        left += (0.5e-6 * np.trace(normal) + 1e-9) * np.eye(2)
        assert float(of.drop(chosen[None])[0]) == pytest.approx(float(right @ np.linalg.solve(left, right)))
    nothing = of.drop(np.zeros((1, 3)))
    assert nothing.tolist() == [0.0]


def test_folded_stretches_are_the_sums_between_cuts() -> None:
    """Two rounds of two: stretches 0 and 3 belong to the first part, 1 and 2 and 4 to the second."""
    of = random_segments(5)
    folded = of.running.folded(np.array([[0, 1, 3], [3, 4, 5]]))
    assert folded.normal[0] == pytest.approx(of.normal[0] + of.normal[3])
    assert folded.right[1] == pytest.approx(of.right[1] + of.right[2] + of.right[4])
    assert folded.inside[1] == pytest.approx(of.inside[1] + of.inside[2] + of.inside[4])


def test_alone_leaves_out_what_else_is_fitted() -> None:
    of = random_segments(4)
    of = Segments(of.normal + np.eye(2), of.inside, of.right)
    assert of.alone.inside.shape == (4, 0, 2)
    assert of.alone.drops == pytest.approx(
        [r @ np.linalg.solve(n, r) for n, r in zip(of.normal, of.right, strict=True)], rel=1e-3
    )
    assert (of.drops > of.alone.drops).all()  # what is left of a column beside others is less, for the same drop


def test_pairs_are_each_stretch_with_the_next() -> None:
    of = random_segments(4)
    chosen = np.array([[1.0, 1.0, 0.0, 0.0], [0.0, 1.0, 1.0, 0.0], [0.0, 0.0, 1.0, 1.0]])
    assert of.pairs.drops == pytest.approx(of.drop(chosen))


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
