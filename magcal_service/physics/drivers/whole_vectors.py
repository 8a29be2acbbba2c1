"""What only whole vectors show beside a recorded attitude: samples of another time than the attitude's.

A vector that is late points elsewhere as soon as the craft turns, whatever the field's size does.  A clock that is off
by s gives w(t + s) = w + s w' + s^2 w'' / 2.  What answers late does so as well, to first order: of samples behind the
attitude nothing tells a clock from a filter, whose second order is its own.
"""

from __future__ import annotations

from functools import partial
from typing import Final

import numpy as np

from magcal_service.model import Array
from magcal_service.physics.columns import Columns
from magcal_service.physics.interface import Block, Hypothesis
from magcal_service.physics.scene.scene import Scene

_MOST_TURN: Final = 0.5
"""Turn of the field in the body in between [rad], at the most: a clock's third order is a fortieth of it."""


def another_time(
    scene: Scene, effect: str, variant: str, name: str, sign: float, longest_s: float, as_well: tuple[str, ...] = ()
) -> Hypothesis:
    """Samples of another time than the attitude that is recorded with them.

    Parameters
    ----------
    name: of its amplitude [s], which is positive.
    sign: 1 of samples ahead of the attitude, -1 of those behind.
    longest_s: amplitude at most [s]; a search takes less where the craft turns by half a radian in less.
    as_well: effects that look so, too.
    """
    slope = scene.field_slope
    rate = float(np.sqrt(np.mean(slope**2) / max(float(np.mean(scene.calibrated_nt**2)), 1e-300)))
    most = min(longest_s, _MOST_TURN / max(rate, 1e-9))
    column = sign * slope
    if scene.moved_s is not None:
        bend = scene.once("bend of whole vectors", lambda: scene.slope(slope))
        column = column + 0.5 * np.clip(sign * scene.moved_s, 0.0, most)[:, None] * bend
    return Hypothesis(
        effect,
        "none",
        partial(_alone, column),
        (Block(name, "s", (), most=longest_s if scene.is_given else most, least=0.0),),
        variant,
        as_well=as_well,
        needs_vectors=True,
        moves_s=partial(_moved, sign),
    )


def _alone(field_nt: Array, _theta: Array) -> Columns:
    return Columns(body=field_nt[None])


def _moved(sign: float, amplitudes: Array) -> float:
    return sign * float(amplitudes[0])
