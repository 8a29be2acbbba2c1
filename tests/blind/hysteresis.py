"""Permeable parts that remember the field they were in.

A thin rod near the magnetometer is magnetised along itself by the field's component along it.  Its memory is a sum of
play operators: each follows the field only when that has moved by more than its width since the last turning point
(a Prandtl-Ishlinskii model, a special case of Preisach's).  Source: Visintin 1994, Differential Models of Hysteresis.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from tests.blind.cause import Cause
from tests.blind.sensor import Spoiling
from tests.blind.vectors import Floats, dot, random_direction
from tests.blind.world import World

PER_TURN = 24.0
"""Instants in one turn of the craft at which the rods are followed; the turning points are met to 1 % of the swing."""


def play(applied: Floats, widths: Sequence[float], weights: Sequence[float]) -> Floats:
    """Weighted sum (n,) of play operators that follow ``applied`` (n,), each within its half width, from rest."""
    total = np.zeros(len(applied))
    for width, weight in zip(widths, weights, strict=True):
        state, course = 0.0, []
        for value in applied.tolist():
            state = min(max(state, value - width), value + width)
            course.append(state)
        total += weight * np.array(course)
    return total


def rod(world: World, rng: np.random.Generator) -> Floats:
    """Field (n, 3) of one rod at the samples, in any unit, without its part that is linear in the applied field.

    The linear part is a soft-iron one and belongs to D.
    """
    turn_s = math.tau / abs(world.motion.rate.start_rad_s)
    between = max(1, math.ceil(PER_TURN * world.period_s / turn_s))
    step = world.period_s / between
    settling = math.ceil(min(3.0 * turn_s, 200.0) / step / between) * between
    count = settling + (len(world.time_s) - 1) * between + 1
    times = np.asarray((np.arange(count) - settling) * step, dtype=np.float64)
    applied = world.field_body(times) @ random_direction(rng)
    widths = np.sort(rng.uniform(500.0, 15000.0, 4))  # coercive fields of 0.4 to 12 A/m
    magnetised = play(applied, widths.tolist(), rng.exponential(1.0, 4).tolist())
    now, state = applied[settling::between], magnetised[settling::between]
    columns = np.stack([now, np.ones_like(now)], axis=-1)
    branch = state - columns @ np.linalg.lstsq(columns, state, rcond=None)[0]
    return np.asarray(branch[:, None] * random_direction(rng), dtype=np.float64)


def hysteresis(world: World, _recorded: bool) -> Cause:
    """One to three rods: the field they add depends on where the craft came from."""
    rng = world.streams.rng("hysteresis")
    rods = int(rng.integers(1, 4))
    field = np.sum([rod(world, rng) for _ in range(rods)], axis=0)
    field = field / np.sqrt(dot(field, field).mean())
    return Cause(
        name="hysteresis",
        world=world,
        spoil=lambda scale: Spoiling(disturbance=lambda _tags, _body: scale * field),
        parameters=lambda scale: {"rods": rods, "rms_nt": scale},
        scale=100.0,
    )
