"""What a refit may not make of an effect: beyond its rms, its field, its whole, or its numbers' physics."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from magcal_service.diagnosis.plausible import WHOLE, within_physics
from magcal_service.diagnosis.problem import Fit, Problem, Term, evaluate
from magcal_service.model import Array
from magcal_service.physics.columns import Columns, along_axes
from magcal_service.physics.interface import Block, Hypothesis
from tests.physics.scenes import NOISE_NT, X, scene

SIGNAL = np.sin(2.0 * np.pi * scene().time_s / 900.0)


def fit_of(amplitudes: Array, largest_nt: float = 1e6, **changes: object) -> Fit:
    """One body-fixed swing of given amplitudes, as if it had been fitted."""
    form = Hypothesis("toy", "none", lambda _: along_axes(SIGNAL), (Block("nt", "nT"),), largest_nt=largest_nt)
    term = Term(replace(form, **changes), np.zeros(0), amplitudes)  # type: ignore[arg-type]
    return evaluate(Problem(scene(), NOISE_NT), X, [term])


def test_the_rms_in_the_residual_is_bounded() -> None:
    """Just within, and just beyond, the rms that the form may have there."""
    swing = np.array([100.0, 0.0, 0.0])
    fit = fit_of(swing)
    seen = float(np.sqrt(np.mean((fit.unit[:, 0] * SIGNAL * 100.0) ** 2)))
    assert within_physics(fit_of(swing, 1.01 * seen), 0)
    assert not within_physics(fit_of(swing, 0.99 * seen), 0)


def test_a_field_that_cancels_in_the_residual_is_bounded_too() -> None:
    """A field across H adds nothing to |B|, and is held to three times the largest size."""

    def across(_: Array) -> Columns:
        unit = scene().calibrated_nt / np.linalg.norm(scene().calibrated_nt, axis=1, keepdims=True)
        other = np.cross(unit, [0.0, 0.0, 1.0])
        return Columns(body=(other / np.linalg.norm(other, axis=1, keepdims=True))[None])

    one = {"columns": across, "blocks": (Block("nt", "nT", ()),)}
    assert within_physics(fit_of(np.array([299.0]), 100.0, **one), 0)
    assert not within_physics(fit_of(np.array([301.0]), 100.0, **one), 0)


def test_numbers_are_bounded_in_their_own_unit() -> None:
    """Each amplitude by what its block says, whatever its rms in this recording."""
    bounded = {"blocks": (Block("nt", "nT", most=50.0),)}
    assert within_physics(fit_of(np.array([-50.0, 10.0, 0.0]), **bounded), 0)
    assert not within_physics(fit_of(np.array([-50.5, 10.0, 0.0]), **bounded), 0)


@pytest.mark.parametrize(("amplitude", "is_one"), [(1.0 + 0.99 * WHOLE, True), (1.0 + 1.01 * WHOLE, False)])
def test_a_whole_shift_has_the_amplitude_one(amplitude: float, is_one: bool) -> None:
    """A shift is all of its field or none."""
    whole = {"is_whole": True, "blocks": (Block("nt", "nT", ()),), "columns": lambda _: Columns(body=scene_field())}
    assert within_physics(fit_of(np.array([amplitude]), **whole), 0) is is_one


def scene_field() -> Array:
    """(1, n, 3) a small body field."""
    return np.tile(np.array([1.0, 2.0, 3.0]), (1, len(scene()), 1))
