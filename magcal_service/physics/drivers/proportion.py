"""Columns of a record that always change along with others: what each of them does by itself shows nowhere.

Coils that were only ever driven together, loads behind one switch.  Their columns are multiples of one another beside a
constant, which the bias takes up, so a fit of each could have any numbers whose sum is right.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from magcal_service.model import Array
from magcal_service.physics.scene.scene import Scene, Telemetry

_LEAST_OWN: Final = 1e-3  # of its swing, that a column has by itself: as little as what varies at all


def apart_in(scene: Scene, *channels: Telemetry) -> Mapping[int, tuple[int, ...]]:
    """Of all columns of some channels, counted through, those that vary by themselves, each with what goes along."""
    moving = np.flatnonzero(np.concatenate([channel.varies for channel in channels])).tolist()
    if len(moving) < 2:
        return dict.fromkeys(moving, ())
    name = f"apart {' '.join(channel.name for channel in channels)}"
    return scene.once(name, lambda: apart(np.concatenate([c.values for c in channels], axis=1), moving))


def apart(signals: Array, columns: Sequence[int]) -> dict[int, tuple[int, ...]]:
    """The columns of ``columns`` that vary by themselves, in rising order, each with those that go along with it.

    The one with the largest swing stands for those in proportion to it (Gram-Schmidt with pivoting).

    Parameters
    ----------
    signals: (n, k), one kind of quantity.
    """
    moving = signals[:, list(columns)] - signals[:, list(columns)].mean(axis=0)
    own = np.array(moving)
    swing = np.linalg.norm(moving, axis=0)
    free = np.ones(len(columns), dtype=bool)
    kept: list[int] = []
    while free.any():
        left = np.where(free, np.linalg.norm(own, axis=0), -1.0)
        free &= left > _LEAST_OWN * swing
        if not free.any():
            break
        best = int(np.argmax(np.where(free, left, -1.0)))
        axis = own[:, best] / left[best]
        own -= np.outer(axis, axis @ own)
        free[best] = False
        kept.append(best)
    shares = np.linalg.lstsq(moving[:, kept], moving, rcond=None)[0] if kept else np.zeros((0, len(columns)))
    goes_along = np.abs(shares) * swing[kept][:, None] > _LEAST_OWN * swing
    return {
        int(columns[one]): tuple(
            int(columns[other]) for other in np.flatnonzero(goes_along[row]).tolist() if other not in kept
        )
        for row, one in sorted(enumerate(kept), key=lambda pair: columns[pair[1]])
    }


def named(name: str, others: Sequence[str]) -> str:
    """What a number belongs to: a column, with those that go along with it."""
    return f"{name} with {' and '.join(others)} in proportion" if others else name
