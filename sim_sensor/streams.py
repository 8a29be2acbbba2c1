"""One random stream per cause, all from one seed.

The order of ``Stream`` is part of the recording format: a new stream goes to the end, so that switching an effect on,
or adding one, never changes the numbers that another draws.
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np


class Stream(IntEnum):
    """Who draws; the value is the index of the child seed."""

    PARAMETERS = 0  # errors, spin and whatever else the scenario leaves to chance
    MAGNETOMETER = 1  # the sensor's noise
    TEMPERATURE = 2  # noise of this telemetry channel
    CURRENT = 3  # noise of this telemetry channel
    SUN = 4  # noise of this telemetry channel
    GYRO = 5  # noise of this telemetry channel
    REFERENCE = 6  # the reference's own noise
    POSITION = 7  # noise of positions
    TORQUER = 8  # noise of this telemetry channel
    FAULTS = 9  # link faults; each has a child of this stream
    BESIDE = 10  # noise of further magnetometers; each has a child of this stream


def generator(seed: int, stream: Stream) -> np.random.Generator:
    """The generator of one stream, at its beginning."""
    return np.random.default_rng(child(seed, stream))


def child(seed: int, stream: Stream) -> np.random.SeedSequence:
    """The child seed of one stream, which may be spawned further (each link fault has its own)."""
    return np.random.SeedSequence(seed).spawn(len(Stream))[stream]
