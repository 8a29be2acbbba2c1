"""``[orbit]`` of a scenario: Keplerian elements, or an element set."""

from __future__ import annotations

import numpy as np

from magcal_service.base.errors import MagcalError
from magcal_service.base.typed_toml import Table
from magcal_service.base.typed_toml.record import Reading, read_record
from magcal_service.earth.orbit_elements import LINE, is_element_line
from sim_sensor.orbit import EARTH_RADIUS_KM, KeplerOrbit, Sgp4Orbit


def orbit_section(reading: Reading, name: str) -> KeplerOrbit | Sgp4Orbit:
    """The orbit, whose elements hold at the scenario's start; a circular one where the section is absent."""
    table = reading.table.table(name) or Table({}, reading.table.file, name, reading.table.faults)
    start_ns: int = reading.values["start_ns"]
    if table.has("tle"):
        line1, line2 = table.texts("tle", 2, required=True) or ("", "")
        table.finish()
        return _sgp4(table, line1, line2, start_ns)
    return read_record(table, KeplerOrbit, {"epoch_utc_ns": start_ns})


def _sgp4(table: Table, line1: str, line2: str, start_ns: int) -> Sgp4Orbit:
    orbit = Sgp4Orbit(line1, line2)
    for number, line in enumerate((line1, line2), start=1):
        if not is_element_line(line, number):
            table.refuse("tle", line, f"an element line of {LINE} characters that begins '{number} ', checksum right")
            return orbit
    try:
        radius_km = float(np.linalg.norm(orbit.position_eci_km(np.array([start_ns], dtype=np.int64))))
    except MagcalError as error:
        table.refuse("tle", line1, str(error))
        return orbit
    if not radius_km > EARTH_RADIUS_KM:
        table.refuse(
            "tle", line1, f"at the start it is {radius_km:.0f} km from the centre; use elements near the start"
        )
    return orbit
