"""What became of a recording's rows on the way into a diagnosis, and of their places."""

from __future__ import annotations

from typing import Final

import numpy as np

from magcal_service.diagnosis.prepare import Prepared
from magcal_service.recordings.inspect.account import Account
from magcal_service.recordings.inspect.inspection import Inspection
from magcal_service.recordings.scene_of import is_orbit_guessed

_GUESSED: Final = (
    "made in orbit: guessed by how the reference's size changes; errors of a field model count, and currents in space "
    "are looked for, until [platform] kind says otherwise"
)

_UNPLACED: Final = "and others are too far in time; nothing that follows light, the Sun or the place was looked for"


def account_of(inspection: Inspection, prepared: Prepared) -> Account:
    """What the reader, the inspection and the preparation have left out of the log, and how many rows are fitted."""
    return inspection.account_to_diagnose.less(prepared.left_out)


def made_where(prepared: Prepared) -> list[str]:
    """What is only guessed of where a recording was made, or was not used of its places, a line each.

    A row without a place that no others are near enough to fill leaves all without.
    """
    recording, ecef = prepared.recording, prepared.problem.scene.position_ecef_km
    lines = []
    if recording.position is not None and ecef is None:
        missing = int((~np.isfinite(recording.position.km).all(axis=1)).sum())
        lines += [f"places: {missing} rows have none, {_UNPLACED}"] if missing else []
    return [*lines, _GUESSED] if is_orbit_guessed(recording, ecef) else lines
