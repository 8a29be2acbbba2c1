"""Columns of the three forms, and those made of signals, by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from magcal_service.physics.columns import Columns, along_axes, common_gain, gains, joined, oscillation

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
