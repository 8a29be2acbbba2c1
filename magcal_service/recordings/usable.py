"""Whether a recording can be calibrated at all."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from magcal_service.base.errors import Fault, RecordingError
from magcal_service.recordings.recording import Recording

FEWEST_SAMPLES: Final = 50
"""Nine unknowns from scalar residuals: below this not even the residual's level is known to 10 %."""


def refuse_hopeless(recording: Recording, found: Sequence[str] = ()) -> None:
    """Raise ``RecordingError`` where no calibration is possible whatever the method.

    Parameters
    ----------
    found: what is wrong with the recording, in words; where there is something, that is the reason.
    """
    name = recording.name
    usable = recording.sorted_unique()
    if len(usable) < FEWEST_SAMPLES:
        accepted = (
            f"at least {FEWEST_SAMPLES} samples with a reference are needed; {'; '.join(found) or 'record longer'}"
        )
        raise RecordingError([Fault(f"{name}: samples", len(usable), accepted)])
    spread = np.linalg.eigvalsh(np.cov(usable.field_body_nt.T))
    if spread[0] <= 0.0:
        accepted = "a sensor whose three axes all vary is needed; look for a stuck or unwired axis"
        raise RecordingError([Fault(f"{name}: magnetometer", "one axis or plane of values only", accepted)])
