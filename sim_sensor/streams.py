"""One random stream per cause, all from one seed.

The order of ``Stream`` is part of the recording format: a new stream goes to the end, so that switching an effect on,
or adding one, never changes the numbers that another draws.
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np


class Stream(IntEnum):
    """Who draws; the value is the index of the child seed."""

    PARAMETERS = 0
    MAGNETOMETER = 1
    TEMPERATURE = 2
    CURRENT = 3
    SUN = 4
    GYRO = 5
    REFERENCE = 6
    POSITION = 7
    TORQUER = 8
    FAULTS = 9


def generator(seed: int, stream: Stream) -> np.random.Generator:
    """The generator of one stream, at its beginning."""
    return np.random.default_rng(child(seed, stream))


def child(seed: int, stream: Stream) -> np.random.SeedSequence:
    """The child seed of one stream, which may be spawned further (each link fault has its own)."""
    return np.random.SeedSequence(seed).spawn(len(Stream))[stream]
