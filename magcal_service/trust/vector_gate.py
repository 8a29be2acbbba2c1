"""Whether a calibrated vector is as long as the field was a moment ago: asked before it leaves, of each by itself.

A verdict is made of ticks, after their vectors have left; a spike, or the first seconds of swapped axes, would leave as
trusted.  The reference's newest length is there already, and the field's length changes by so much a second at most.
"""

from __future__ import annotations

import math
from typing import Final

from magcal_service.wire.messages import CalibratedVector

FASTEST_NT_S: Final = 60.0
"""Change of the length along a low orbit at the most [nT/s]: 7.6 km/s times 8 nT/km, at the edge of the anomaly."""

OLDEST_S: Final = 30.0
"""Age of the reference [s] from which on it says too little: the field may have changed by 1.8 uT."""

_SIGMA: Final = 6.0
"""Of noise and estimate together: one vector in 5e8 is beyond by them alone."""

_IN_DOUBT: Final = 0.01
"""Of the field, what noise that is not normal, and a scale that nothing can show, may add."""


def strays(vector: CalibratedVector, reference_nt: float, age_s: float) -> bool:
    """Whether a vector is longer or shorter than all that is allowed for explains.

    Parameters
    ----------
    vector: as it would be sent.
    reference_nt: length of the newest reference [nT].
    age_s: between it and the sample, either way [s].
    """
    if age_s > OLDEST_S:
        return False
    xx, _, _, yy, _, zz = vector.covariance_nt2
    variance = max(xx, yy, zz)
    allowed = _SIGMA * math.sqrt(variance) + FASTEST_NT_S * age_s + _IN_DOUBT * reference_nt
    allowed += vector.protection_nt or 0.0
    length = math.hypot(*vector.field_body_nt) - variance / reference_nt
    return not abs(length - reference_nt) <= allowed  # what is no number strays as well
