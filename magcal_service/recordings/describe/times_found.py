"""The times that a log was found to have."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Times:
    """The sampled rows' times.

    Parameters
    ----------
    seconds: (n,) Unix seconds where ``absolute``, else since some start; NaN where there is none.
    absolute: whether the date is known.
    columns: numbers of the columns that they are from.
    format: as the descriptor names it; empty for a pattern or a rate.
    """

    seconds: FloatArray
    absolute: bool
    columns: tuple[int, ...] = ()
    format: str = ""
