"""The configuration of each magnetometer of a craft: what its own table says, else what the craft's does.

The first one that is listed, or where none is the first that is heard, is the craft's own: its results have the source
``magcal``, as those of a craft with one magnetometer.  Every other one is beside it; its results have its own source.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

from magcal_service.config.rules import RESERVED_SOURCE
from magcal_service.config.settings import CraftConfig, MagnetometerConfig
from magcal_service.wire.messages import Message

MAGNETOMETERS: Final = "magnetometers"
"""Counter of a status: how many magnetometers of the craft have one, where there are several."""

_SENSOR = ("noise_nt", "range_nt", "axis_stuck_s", "stuck_samples")
_FILTER = ("prior_bias_nt", "prior_D", "process_noise_bias_nt", "process_noise_D")


def own_magnetometer(craft: CraftConfig) -> CraftConfig:
    """The configuration of the craft's own magnetometer."""
    if not craft.magnetometers:
        return craft
    first = craft.magnetometers[0]
    merged = _merged(craft, first)
    spin, physics = first.spin or craft.spin, first.physics or craft.physics
    return replace(merged, spin=spin, physics=physics, hears=first.source)


def beside(craft: CraftConfig, source: str) -> CraftConfig:
    """The configuration of another magnetometer, listed or not.

    Spin and physics are not the craft's: an axis is one of the sensor's own axes, and what a coil does to a sensor
    depends on where that is.
    """
    listed = [one for one in craft.magnetometers if one.source == source]
    own = listed[0] if listed else MagnetometerConfig(source)
    return replace(_merged(craft, own), spin=own.spin, physics=own.physics, hears=source, source=source)


def of_source(craft: CraftConfig, source: str) -> CraftConfig:
    """The configuration of a magnetometer of a recording: where none is listed, each as the craft's own."""
    own = own_magnetometer(craft)
    return own if own.hears in ("", source) else beside(craft, source)


def _merged(craft: CraftConfig, own: MagnetometerConfig) -> CraftConfig:
    """The craft's sensor and filter with what is the magnetometer's own."""
    sensor = {name: getattr(own, name) for name in _SENSOR if getattr(own, name) is not None}
    filtered = {name: getattr(own, name) for name in _FILTER if getattr(own, name) is not None}
    return replace(
        craft,
        sensor=replace(craft.sensor, **sensor),
        filter=replace(craft.filter, **filtered),
        magnetometers=(),
        max_sources=CraftConfig(craft.name).max_sources,
    )


def label(craft: str, source: str) -> str:
    """What one magnetometer of a craft is called where both are told in one word: ``demo``, ``demo/mag2``."""
    return f"{craft}/{source}" if source else craft


def label_of(result: Message) -> str:
    """What the magnetometer of an estimate or a status is called."""
    return label(result.craft, "" if result.source == RESERVED_SOURCE else result.source)
