"""Sums over stretches against the normal equations of what they sum."""

from __future__ import annotations

import numpy as np
import pytest

from magcal_service.physics.segments import Segments


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
    folded = of.folds.folded(np.array([[0, 1, 3], [3, 4, 5]]))
    assert folded.normal[0] == pytest.approx(of.normal[0] + of.normal[3])
    assert folded.right[1] == pytest.approx(of.right[1] + of.right[2] + of.right[4])
    assert folded.inside[1] == pytest.approx(of.inside[1] + of.inside[2] + of.inside[4])


@pytest.mark.parametrize("rounds", [3, 400])
def test_few_cuts_and_many_are_folded_alike(rounds: int) -> None:
    """Many are folded by a product with all stretches, few row by row; here against the stretches one after another."""
    of, rng = random_segments(40), np.random.default_rng(8)
    cuts = np.sort(rng.integers(0, 41, (rounds, 4)), axis=1)
    folded = of.folds.folded(cuts)
    for part in range(3):
        chosen = [np.arange(first, end) for first, end in cuts[:, part : part + 2].tolist()]
        stretches = np.concatenate(chosen)
        assert folded.normal[part] == pytest.approx(of.normal[stretches].sum(axis=0))
        assert folded.inside[part] == pytest.approx(of.inside[stretches].sum(axis=0))
        assert folded.right[part] == pytest.approx(of.right[stretches].sum(axis=0))


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
