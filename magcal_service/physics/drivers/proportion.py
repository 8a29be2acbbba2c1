"""Columns of a record that always change along with others: what each of them does by itself shows nowhere.

Coils that were only ever driven together, loads behind one switch.  Their columns are multiples of one another beside a
constant, which the bias takes up, so a fit of each could have any numbers whose sum is right.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from magcal_service.model import Array
from magcal_service.physics.drivers.readout import noise_in
from magcal_service.physics.scene.scene import Scene, Telemetry

_LEAST_OWN: Final = 1e-3  # of its swing, that a column has by itself: as little as what varies at all

_NEARLY: Final = 0.3  # of its swing: with less left beside others a column hangs together with them by 0.95 and more
_OF_NOISE: Final = 1.5  # times what the records' noise makes of what is left, up to which that is all that it is


def apart_in(scene: Scene, *channels: Telemetry) -> Mapping[int, tuple[int, ...]]:
    """Of all columns of some channels, counted through, those that vary by themselves, each with what goes along."""
    moving = np.flatnonzero(np.concatenate([channel.varies for channel in channels])).tolist()
    if len(moving) < 2:
        return dict.fromkeys(moving, ())
    name = f"apart {' '.join(channel.name for channel in channels)}"
    noise = np.array([noise_in(scene, one, column) for one in channels for column in range(one.values.shape[1])])
    return scene.once(name, lambda: apart(np.concatenate([c.values for c in channels], axis=1), moving, noise))


def apart(signals: Array, columns: Sequence[int], noise: Array | None = None) -> dict[int, tuple[int, ...]]:
    """The columns of ``columns`` that vary by themselves, in rising order, each with those that go along with it.

    The one with the largest swing stands for those in proportion to it (Gram-Schmidt with pivoting).

    Parameters
    ----------
    signals: (n, k), one kind of quantity.
    noise: (k,) of their records, 1 sigma; None: they have none.  A column nearly in proportion to others whose own part
        is what their noise makes has none of its own.
    """
    moving = signals[:, list(columns)] - signals[:, list(columns)].mean(axis=0)
    own = np.array(moving)
    swing = np.linalg.norm(moving, axis=0)
    free = np.ones(len(columns), dtype=bool)
    variance = np.zeros(len(columns)) if noise is None else len(signals) * noise[list(columns)] ** 2
    kept: list[int] = []
    while free.any():
        left = np.where(free, np.linalg.norm(own, axis=0), -1.0)
        free &= left > _LEAST_OWN * swing
        free &= (left > _NEARLY * swing) | (left > _OF_NOISE * np.sqrt(variance))
        if not free.any():
            break
        best = int(np.argmax(np.where(free, left, -1.0)))
        axis = own[:, best] / left[best]
        shares = axis @ own
        own -= np.outer(axis, shares)
        variance = variance + (shares / left[best]) ** 2 * variance[best] * free
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
