"""Noise that remembers."""

from __future__ import annotations

import math

import numpy as np

from tests.blind.cause import Cause, Measure
from tests.blind.sensor import Spoiling
from tests.blind.vectors import Floats
from tests.blind.world import World

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


def coloured_noise(world: World, _recorded: bool) -> Cause:
    """The noise of neighbouring samples hangs together; its variance is the world's.

    A first-order process, 1 / f noise over white, or a driver that averages its last values.
    """
    rng = world.streams.rng("coloured_noise")
    form = str(rng.choice(["first order", "1 / f", "moving average"]))
    if form == "first order":
        correlation = keep = float(rng.uniform(0.3, 0.9))

        def colour(white: Floats) -> Floats:
            return remembering(white, keep, white[0])

    elif form == "moving average":
        width = int(rng.integers(2, 7))
        correlation = (width - 1) / width

        def colour(white: Floats) -> Floats:
            before = world.streams.rng("before").normal(0.0, world.noise_nt, (width - 1, 3))
            total = np.cumsum(np.concatenate([np.zeros((1, 3)), before, white]), axis=0)
            return np.asarray((total[width:] - total[:-width]) / math.sqrt(width), dtype=np.float64)

    else:
        flicker = float(rng.uniform(0.4, 0.9))
        keeps = [math.exp(-1.0 / length) for length in LADDER]
        correlation = flicker * sum(keeps) / len(keeps)

        def colour(white: Floats) -> Floats:
            rest = world.streams.rng("flicker")
            total = math.sqrt(1.0 - flicker) * white
            for keep in keeps:
                kicks = rest.normal(0.0, world.noise_nt, (len(white) + 1, 3))
                total = total + math.sqrt(flicker / len(keeps)) * remembering(kicks[1:], keep, kicks[0])
            return np.asarray(total, dtype=np.float64)

    return Cause(
        name="coloured_noise",
        world=world,
        spoil=lambda _scale: Spoiling(),
        parameters=lambda scale: {"correlation": correlation if scale else 0.0, "form": form},
        fixed=True,
        measure=Measure.COLOURED,
        noise=lambda scale, white: colour(white) if scale else white,
    )
