"""A recording's vectors as a fit has them: what a scene's columns are made of."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from magcal_service.model import Array


class Vectors(NamedTuple):
    """Vectors (n, 3) [nT] by the nine errors and effects that are known so far, radial noise subtracted.

    Parameters
    ----------
    calibrated_nt: w = (I + D) B - b - d.
    clean_field_nt: the measured vector that would give ``calibrated_nt``: what columns are made of, because the
        residual is the radial noise, and a column that holds it too would explain it.
    moved_s: (n,) how far along its course the fit moves the reference [s]; what moves it is expanded halfway there.
        None: nowhere.
    undisturbed_nt: the measured vector as it would be without what was left out, (I + D)^-1 (w + b).  None: as
        ``clean_field_nt``, nothing is known of what was left out.
    """

    calibrated_nt: Array
    clean_field_nt: Array
    moved_s: Array | None = None
    undisturbed_nt: Array | None = None

    @classmethod
    def together(cls, each: Sequence[Vectors]) -> Vectors:
        """Those of several recordings, one after another; a part that one of them lacks is None."""
        calibrated_nt, clean_field_nt = (np.concatenate([found[k] for found in each]) for k in (0, 1))
        return cls(
            calibrated_nt,
            clean_field_nt,
            _together([found.moved_s for found in each]),
            _together([found.undisturbed_nt for found in each]),
        )

    def part(self, rows: slice) -> Vectors:
        """Those of some rows."""
        moved_s, other = self.moved_s, self.undisturbed_nt
        return Vectors(
            self.calibrated_nt[rows],
            self.clean_field_nt[rows],
            None if moved_s is None else moved_s[rows],
            None if other is None else other[rows],
        )


def _together(parts: Sequence[Array | None]) -> Array | None:
    known = [part for part in parts if part is not None]
    return np.concatenate(known) if len(known) == len(parts) else None
