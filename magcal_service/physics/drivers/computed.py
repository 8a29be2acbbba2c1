"""Drivers that are there on any day: computed from place, time, Sun and field, and recorded channels, by their text.

``channel:NAME`` is a recorded channel, ``computed:NAME`` one of ``COMPUTED``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from magcal_service.base.units import CHANNEL_UNITS
from magcal_service.model import Array
from magcal_service.physics.scene.scene import Scene


@dataclass(frozen=True, slots=True)
class Computed:
    """A quantity that needs no recording of its own.

    Parameters
    ----------
    unit: of its values.
    says: what it is, in words.
    values: (n,) on a scene; None where the scene lacks what it takes.
    of_sensor: whether the sensor's own reading or the craft's attitude is in it, so that no reference can follow it.
    """

    unit: str
    says: str
    values: Callable[[Scene], Array | None]
    of_sensor: bool = False


def _knows_sun(scene: Scene) -> bool:
    """Whether the Sun is where the date has it: elsewhere a curve over it could not be used on another day."""
    return scene.in_orbit and not scene.sun_ahead_deg


def _light(scene: Scene) -> Array | None:
    return scene.lit if _knows_sun(scene) else None


def _sun_zenith(scene: Scene) -> Array | None:
    place, sun = scene.position_eci_km, scene.sun_eci
    if place is None or sun is None or not _knows_sun(scene):
        return None
    cosine = np.einsum("ni,ni->n", place, sun) / np.linalg.norm(place, axis=1)
    return np.asarray(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))


def _latitude(scene: Scene) -> Array | None:
    if scene.position_ecef_km is None or not scene.in_orbit:  # elsewhere it is a place within a field, a room
        return None
    x, y, z = scene.position_ecef_km.T
    return np.asarray(np.degrees(np.arctan2(z, np.hypot(x, y))))


def _product(*axes: int) -> Callable[[Scene], Array | None]:
    return lambda scene: np.asarray(np.prod(scene.calibrated_nt[:, axes], axis=1))


def _sun_along(axis: int) -> Callable[[Scene], Array | None]:
    def values(scene: Scene) -> Array | None:
        if scene.sun_body is None or scene.lit is None or not _knows_sun(scene):
            return None
        return np.asarray(scene.sun_body[:, axis] * scene.lit)

    return values


COMPUTED: Final[Mapping[str, Computed]] = {
    "light": Computed("1", "the share of sunlight", _light),
    "sun_zenith": Computed("deg", "the Sun's angle from the zenith", _sun_zenith),
    "latitude": Computed("deg", "the geocentric latitude", _latitude),
    "field_size": Computed("nT", "the size of the field", lambda scene: scene.magnitude_nt),
    **{
        f"field_{name}": Computed("nT", f"the field along {name} of the body", _product(axis), True)
        for axis, name in enumerate("xyz")
    },
    **{
        f"field_{'xyz'[i]}{'xyz'[j]}": Computed(
            "nT2", f"the product of the field along {'xyz'[i]} and {'xyz'[j]} of the body", _product(i, j), True
        )
        for i, j in ((0, 1), (0, 2), (1, 2))
    },
    **{
        f"sun_{name}": Computed(
            "1", f"the cosine of the Sun's angle to {name} of the body, 0 in shadow", _sun_along(axis), True
        )
        for axis, name in enumerate("xyz")
    },
}
"""By name, as ``computed:NAME``."""


def driver_values(scene: Scene, driver: str, column: int = 0, quantity: str = "") -> Array | None:
    """Values (n,) of a driver on a scene; None where the scene lacks it, or its channel is of another quantity."""
    kind, _, name = driver.partition(":")
    if kind == "computed":
        computed = COMPUTED.get(name)
        return None if computed is None else computed.values(scene)
    channel = scene.channels.get(name) if kind == "channel" else None
    if channel is None or channel.quantity != quantity or column >= channel.values.shape[1]:
        return None
    return channel.values[:, column]


def driver_unit(driver: str, quantity: str = "") -> str:
    """Unit of a driver's values."""
    kind, _, name = driver.partition(":")
    if kind == "computed":
        return COMPUTED[name].unit
    return next((unit.base for unit in CHANNEL_UNITS.values() if unit.quantity == quantity), "1")
