"""Noise that remembers."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from tests.blind.cause import Cause, Measure
from tests.blind.sensor import Spoiling
from tests.blind.vectors import Floats
from tests.blind.world import World

Colour = Callable[[Floats], Floats]
LADDER = (1.0, 4.0, 16.0, 64.0, 256.0)  # time constants [samples] whose sum falls as 1 / f between them


def remembering(white: Floats, keep: float, first: Floats) -> Floats:
    """x[k] = keep x[k-1] + sqrt(1 - keep^2) white[k] from x[-1] = ``first`` (m,); white (n, m) of any variance."""
    share = math.sqrt(1.0 - keep**2)
    columns = []
    for kicks, start in zip(white.T.tolist(), first.tolist(), strict=True):
        state, course = start, []
        for kick in kicks:
            state = keep * state + share * kick
            course.append(state)
        columns.append(course)
    return np.array(columns).T


def _first_order(world: World, rng: np.random.Generator) -> tuple[float, Colour]:
    keep = float(rng.uniform(0.3, 0.9))
    return keep, lambda white: remembering(white, keep, world.streams.rng("first").normal(0.0, world.noise_nt, 3))


def _moving_average(world: World, rng: np.random.Generator) -> tuple[float, Colour]:
    """Of the last two to six values of a driver."""
    width = int(rng.integers(2, 7))

    def colour(white: Floats) -> Floats:
        before = world.streams.rng("before").normal(0.0, world.noise_nt, (width - 1, 3))
        total = np.cumsum(np.concatenate([np.zeros((1, 3)), before, white]), axis=0)
        return np.asarray((total[width:] - total[:-width]) / math.sqrt(width), dtype=np.float64)

    return (width - 1) / width, colour


def _flicker(world: World, rng: np.random.Generator) -> tuple[float, Colour]:
    """1 / f noise, a ladder of first-order processes, over white noise."""
    share = float(rng.uniform(0.4, 0.9))
    keeps = [math.exp(-1.0 / length) for length in LADDER]

    def colour(white: Floats) -> Floats:
        rest = world.streams.rng("flicker")
        total = math.sqrt(1.0 - share) * white
        for keep in keeps:
            kicks = rest.normal(0.0, world.noise_nt, (len(white) + 1, 3))
            total = total + math.sqrt(share / len(keeps)) * remembering(kicks[1:], keep, kicks[0])
        return np.asarray(total, dtype=np.float64)

    return share * sum(keeps) / len(keeps), colour


_FORMS = {"first order": _first_order, "moving average": _moving_average, "1 / f": _flicker}


def coloured_noise(world: World, _recorded: bool) -> Cause:
    """The noise of neighbouring samples hangs together; its variance is the world's."""
    rng = world.streams.rng("coloured_noise")
    form = str(rng.choice(sorted(_FORMS)))
    correlation, colour = _FORMS[form](world, rng)
    return Cause(
        name="coloured_noise",
        world=world,
        spoil=lambda _scale: Spoiling(),
        parameters=lambda scale: {"correlation": correlation if scale else 0.0, "form": form},
        fixed=True,
        measure=Measure.COLOURED,
        noise=lambda scale, white: colour(white) if scale else white,
    )
