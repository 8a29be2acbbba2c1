"""What only whole vectors show beside a recorded attitude: samples of another time than the attitude's.

A vector that is late points elsewhere as soon as the craft turns, whatever the field's size does.  To second order in
between: w(t + s) = w + s w' + s^2 w'' / 2 of a clock that is off by s, and w - tau w' + tau^2 w'' of a low-pass; so the
two are told apart where the second order shows.
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
    scene: Scene, effect: str, variant: str, name: str, first: float, second: float, longest_s: float
) -> Hypothesis:
    """Samples of another time than the attitude that is recorded with them.

    Parameters
    ----------
    name: of its amplitude [s], which is positive.
    first, second: of s w' and of s^2 w'' for an amplitude of s.
    longest_s: amplitude at most [s], and less where the craft turns by half a radian in less.
    """
    slope = scene.field_slope
    rate = float(np.sqrt(np.mean(slope**2) / max(float(np.mean(scene.calibrated_nt**2)), 1e-300)))
    most = min(longest_s, _MOST_TURN / max(rate, 1e-9))
    column = first * slope
    if scene.moved_s is not None:
        bend = scene.once("bend of whole vectors", lambda: scene.slope(slope))
        column = column + second * np.clip(np.abs(scene.moved_s), 0.0, most)[:, None] * bend
    return Hypothesis(
        effect,
        "none",
        partial(_alone, column),
        (Block(name, "s", (), most=most, least=0.0),),
        variant,
        needs_vectors=True,
        moves_s=partial(_moved, first),
    )


def _alone(field_nt: Array, _theta: Array) -> Columns:
    return Columns(body=field_nt[None])


def _moved(first: float, amplitudes: Array) -> float:
    return first * float(amplitudes[0])
