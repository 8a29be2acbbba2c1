"""One random stream per purpose, all children of one seed."""

from __future__ import annotations

import zlib
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, slots=True)
class Streams:
    """The random streams of one attempt at one case.

    A stream is known by its name, so that drawing more from one, or adding one, changes no number of another.

    Parameters
    ----------
    seed: of the case, 0 or more.
    kind: of the case; the same seed gives unlike cases for unlike kinds.
    attempt: counts the draws that were thrown away because the effect could not be strong enough in them.
    """

    seed: int
    kind: str
    attempt: int = 0

    def rng(self, name: str) -> np.random.Generator:
        """The generator of one stream, at its beginning."""
        key = (zlib.crc32(self.kind.encode()), self.attempt, zlib.crc32(name.encode()))
        return np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=key))
