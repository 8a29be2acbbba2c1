"""Further magnetometers of the same craft: each with its own errors, times and mounting, and magnets near it alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from magcal_service.base.typed_toml.keys import inline, number, sections, text
from magcal_service.base.typed_toml.record import Reading
from magcal_service.config.rules import RESERVED_SOURCE
from magcal_service.wire.fields import NAME
from magcal_service.wire.messages import Estimate, Vector
from sim_sensor.declarations import LONGEST_S, vector
from sim_sensor.sensor import Sensor

Floats = npt.NDArray[np.float64]

OWN_SOURCE = "mag"
"""Source of the samples of ``[magnetometer]``."""


def is_own(estimate: Estimate) -> bool:
    """Whether an estimate is of the craft's own magnetometer, the first that the daemon has heard."""
    return estimate.source == RESERVED_SOURCE


@dataclass(frozen=True)
class Magnet:
    """A field that one magnetometer alone sees for a while.

    Parameters
    ----------
    at_s, for_s: from when and for how long [s].
    field_nt: added to what the sensor measures, in its own axes [nT].
    """

    at_s: float = number(minimum=0.0, maximum=LONGEST_S, unit="s")
    for_s: float = number(LONGEST_S, 0.0, LONGEST_S, unit="s")
    field_nt: Vector = vector(5e5, unit="nT")


def _check_source(reading: Reading, name: str, source: str) -> None:
    if source == OWN_SOURCE or (reading.table.has(name) and not NAME.fullmatch(source)):
        accepted = f'1 to 32 characters of A-Z a-z 0-9 _ -, other than "{OWN_SOURCE}", are accepted'
        reading.table.refuse(name, source, accepted)


@dataclass(frozen=True)
class Beside:
    """One further magnetometer.

    Parameters
    ----------
    source: of its samples.
    offset_s: its first sample's time after the start [s].
    turned_deg: from the craft's axes to the sensor's own: a turn about this vector by its length [deg].
    sensor: as that of ``[magnetometer]``.
    magnets: near it alone.
    """

    source: str = text(accepted="the source of its samples", check=_check_source)
    offset_s: float = number(0.0, 0.0, 3600.0, unit="s")
    turned_deg: Vector = vector(180.0, unit="deg")
    sensor: Sensor = inline(Sensor)
    magnets: tuple[Magnet, ...] = sections(Magnet, name="magnet")

    def own_axes(self, field_body_nt: Floats) -> Floats:
        """Vectors (n, 3) of the craft's axes in the sensor's own."""
        turn = np.radians(np.array(self.turned_deg))
        angle = float(np.linalg.norm(turn))
        if angle == 0.0:
            return field_body_nt
        x, y, z = (turn / angle).tolist()
        cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        matrix = np.eye(3) - np.sin(angle) * cross + (1.0 - np.cos(angle)) * (cross @ cross)
        return np.asarray(field_body_nt @ matrix.T)

    def magnets_nt(self, elapsed_s: Floats) -> Floats:
        """What the magnets add (n, 3) [nT], in the sensor's axes."""
        field = np.zeros((len(elapsed_s), 3))
        for one in self.magnets:
            near = (elapsed_s >= one.at_s) & (elapsed_s < one.at_s + one.for_s)
            field += np.outer(near, one.field_nt)
        return field
