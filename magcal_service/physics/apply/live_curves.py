"""Curves without a name, live: at the driver's newest value, inside its range, and not at all elsewhere."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from magcal_service.model import Array
from magcal_service.physics.apply.empirical import NAME, OUTSIDE, Empirical
from magcal_service.physics.apply.forward import DriverMissingError, followed
from magcal_service.physics.apply.live_drivers import Held
from magcal_service.physics.scene.scene import Scene


class DriverOutsideError(DriverMissingError):
    """A driver is there, and beyond the range of its curve."""


def added_now(
    curve: Empirical, channels: Mapping[str, Held], scene: Scene | None, now_ns: int, field_nt: Array
) -> tuple[Array, float]:
    """Body field (3,) and growth of the magnitude [nT] at a moment.

    Parameters
    ----------
    channels: the newest values.
    scene: of the moment, for what is computed; may be None for a recorded driver.
    now_ns: the moment.
    field_nt: (3,) the measured vector; a growth needs none.

    Raises DriverMissingError where the driver is missing or stale, DriverOutsideError where it is beyond the range.
    """
    x = _recorded(curve, channels, now_ns) if curve.is_recorded else _computed(curve, scene)
    if not curve.covers(x):
        raise DriverOutsideError(
            f"{NAME}: {curve.driver} is {x:g}; {curve.span[0]:g} to {curve.span[1]:g} is its range"
        )
    body, growth = curve.disturbance(np.array([x]), field_nt[None])
    return body[0], float(growth[0])


def name_of(error: Exception) -> str:
    """What is named as not compensated."""
    return OUTSIDE if isinstance(error, DriverOutsideError) else NAME


def _recorded(curve: Empirical, channels: Mapping[str, Held], now_ns: int) -> float:
    held = channels.get(curve.driver.partition(":")[2])
    if held is None or held.quantity != curve.quantity or curve.column >= len(held.values) or held.is_stale(now_ns):
        raise DriverMissingError(f"{NAME}: driver {curve.driver!r} is missing or stale")
    return held.values[curve.column]


def _computed(curve: Empirical, scene: Scene | None) -> float:
    assert scene is not None, "what is computed takes a scene"
    return float(followed(curve, scene)[-1])
