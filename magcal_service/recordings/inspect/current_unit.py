"""The unit of recorded currents, by their size."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np

from magcal_service.base.units import CHANNEL_UNITS
from magcal_service.recordings.inspect.finding import Code, Seen
from magcal_service.recordings.inspect.log import Log

MOST_A: Final = 100.0
"""Current that flows half of the time at the most [A]: a bus of 28 V that carries 2.8 kW, more than a craft of half a
tonne makes; in a CubeSat milliamperes are as many."""


def current_unit(log: Log) -> Iterator[Seen]:
    """Currents of hundreds of amperes for half of the log: milliamperes that were called amperes."""
    for channel in log.recording.channels.values():
        if channel.spec.quantity != "current":
            continue
        current = np.abs(CHANNEL_UNITS[channel.spec.unit].to_base(channel.values[log.rows]))
        known = current[np.isfinite(current).all(axis=1)]
        usual = float(np.median(known, axis=0).max()) if len(known) else 0.0
        if usual > MOST_A:
            name = channel.spec.name
            says = f"by its unit {channel.spec.unit} the channel {name} has {usual:.3g} A half of the time, "
            says += f"and a small craft's bus has {MOST_A:g} A at the most: likely it is in mA"
            yield Seen(
                Code.CURRENT_UNIT, False, log.rows, says, f'check channels.{name}: if it is so, write unit = "mA"'
            )
