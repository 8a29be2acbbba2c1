"""The reference field of a craft that sends positions and no field: IGRF-14, computed where the position arrives."""

from __future__ import annotations

from functools import lru_cache
from typing import Final

import numpy as np

from magcal_service.base.errors import InputRefusedError
from magcal_service.earth.geomagnetic import eci_from_ecef, igrf_eci_nt
from magcal_service.trust.height_sense import HeightSense
from magcal_service.wire.messages import Clock, Frame, PositionSample, ReferenceSample

NOT_USED: Final = "reference_not_used"
"""Counts reference messages of a craft whose field is computed here: one of two would be wrong unseen."""

UNPLACED: Final = "position_without_utc"
"""Counts positions whose clock is not UTC: the field turns with the Earth."""

OUTSIDE: Final = "position_out_of_range"
"""Counts positions where the model says nothing: another unit, or a date beyond it."""


def watch_height(sense: HeightSense, position: PositionSample) -> None:
    """Give a position that a reference was computed at to the watch over the positions' height."""
    time_s = position.time_ns * 1e-9
    if sense.wants(time_s):
        sense.push(time_s, inertial_place_km(position))


def inertial_place_km(position: PositionSample) -> tuple[float, float, float]:
    """A position on UTC in axes that do not turn [km]."""
    if position.frame is not Frame.ECEF:
        return position.position_km
    x, y, z = eci_from_ecef(np.array([position.time_ns], dtype=np.int64), np.array([position.position_km]))[0].tolist()
    return x, y, z


@lru_cache(maxsize=16)
def reference_at(position: PositionSample) -> ReferenceSample | str:
    """The main field at a position, as a reference message in ECI; the name of a counter where there is none.

    Parameters
    ----------
    position: in ECI or ECEF [km], on UTC.

    Each magnetometer of a craft asks for the same position, so the newest are remembered.

    The crust and the currents above the craft are not in it: some 20 to 100 nT (``geomagnetic``).
    """
    if position.clock is not Clock.UTC:
        return UNPLACED
    time_ns = np.array([position.time_ns], dtype=np.int64)
    try:
        x, y, z = igrf_eci_nt(time_ns, np.array([inertial_place_km(position)]))[0].tolist()
    except InputRefusedError:
        return OUTSIDE
    return ReferenceSample(
        craft=position.craft,
        source=position.source,
        sequence=position.sequence,
        time_ns=position.time_ns,
        clock=position.clock,
        field_nt=(x, y, z),
        frame=Frame.ECI,
    )
