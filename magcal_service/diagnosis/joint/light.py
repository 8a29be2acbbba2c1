"""Recorded light beside the computed one: whether a channel is dark where the Earth's shadow is computed to be.

The drivers that are computed of sunlight (``inferred:temperature``, ``inferred:array_current``) stand and fall with the
shadow.  Photodiodes, or a panel's current, are its witness, whether or not an effect follows them themselves.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any, Final, Protocol

import numpy as np

from magcal_service.diagnosis.explain import RIVAL_SHARE, Explained
from magcal_service.diagnosis.rivals import is_recorded
from magcal_service.diagnosis.words import percent
from magcal_service.model import Array
from magcal_service.physics.scene.scene import Scene

_SURE: Final = (0.01, 0.99)
"""Shares of sunlight below which a row is in shadow and above which it is in light: in between is the penumbra."""

_FEWEST: Final = 60
"""Rows in light, and in shadow, of which anything is said; choice: a minute of each at 1 Hz."""

_AGREES: Final = 0.95
"""Mean of the shares of light and of shadow that a channel tells right, from which on it shows light: what shows
something else tells half of them."""

_BY_LIGHT: Final = frozenset({"inferred:temperature", "inferred:array_current"})

_SPLITS: Final = 32  # levels between dark and lit that are tried, evenly over a channel's values

_NO_LIGHT: Final = frozenset({"temperature", "angular rate", "field", "time"})
"""Quantities that follow light late, or not at all."""


@dataclass(frozen=True, slots=True)
class LightSeen:
    """A channel that shows the light that was computed.

    Parameters
    ----------
    channel: its name.
    share: of the rows in full light or full shadow, those that it tells right.
    rows: how many those are.
    """

    channel: str
    share: float
    rows: int

    def __str__(self) -> str:
        return (
            f"channel {self.channel} agrees with the computed shadow: dark in it and lit outside of it "
            f"in {100.0 * self.share:.1f} % of {self.rows} rows"
        )

    def to_dict(self) -> dict[str, Any]:
        """As ``diagnosis.json`` has it."""
        return {**asdict(self), "share": round(self.share, 4)}


def light_seen(scene: Scene, rate_rad_s: float | None) -> tuple[LightSeen, ...]:
    """The channels that show the computed light.

    Parameters
    ----------
    scene: one recording with its channels.
    rate_rad_s: of a steady turn: no few sensors see every side, so a row counts as lit if within half a turn of it one
        is; None: there is none, and each row counts by itself.
    """
    lit = scene.lit
    if lit is None:
        return ()
    dark, bright = lit < _SURE[0], lit > _SURE[1]
    counts = [int(np.count_nonzero(dark)), int(np.count_nonzero(bright))]
    if min(counts) < _FEWEST:
        return ()
    found = []
    for channel in scene.channels.values():
        if channel.quantity in _NO_LIGHT:
            continue
        level = _brightest(channel.values, _half_turn(scene, rate_rad_s))
        splits = np.unique(np.quantile(level, np.linspace(0.0, 1.0, _SPLITS + 1)[1:-1]))
        told = [(float(np.mean(level[dark] <= at)), float(np.mean(level[bright] > at))) for at in splits.tolist()]
        of_dark, of_bright = max(told, key=lambda one: one[0] + one[1])
        if of_dark + of_bright >= 2.0 * _AGREES:
            right = (of_dark * counts[0] + of_bright * counts[1]) / sum(counts)
            found.append(LightSeen(channel.name, right, sum(counts)))
    return tuple(found)


class Lit(Protocol):
    """A recording with what shows its light."""

    @property
    def name(self) -> str:
        """Of the recording."""

    @property
    def light(self) -> tuple[LightSeen, ...]:
        """Channels that show the computed light."""


def light_lines(recordings: Sequence[Lit], explained: Explained) -> list[str]:
    """One line for each channel that shows a recording's light, and for each effect by light what it is as a driver."""
    found = [f"{one.name}: {seen}" for one in recordings for seen in one.light]
    channels = list(dict.fromkeys(seen.channel for one in recordings for seen in one.light))
    by_light = [k for k, term in enumerate(explained.fit.terms) if term.hypothesis.driver in _BY_LIGHT]
    said = [(explained.fit.terms[k].hypothesis.effect, as_driver(explained, k, channels)) for k in by_light]
    return [*found, *(f"{effect}: {line}" for effect, line in said if line)]


def as_driver(explained: Explained, index: int, channels: Sequence[str]) -> str:
    """What these channels hold as the driver of a term that is inferred, in words; empty where none came near it."""
    mine = explained.fit.terms[index].hypothesis
    if is_recorded(mine) or not channels:
        return ""
    own = explained.own_nats(index)
    held = {c.hypothesis.driver.removeprefix("channel:"): c.nats for c in explained.drivers[index]}
    said = [f"{name} {percent(max(held[name], 0.0) / max(own, 1e-12))}" for name in channels if name in held]
    least = [name for name in channels if name not in held]
    said += [f"{' and '.join(least)} less than {percent(RIVAL_SHARE)}"] if least else []
    return f"of what {mine.driver.removeprefix('inferred:').replace('_', ' ')} holds, as drivers: {', '.join(said)}"


def _half_turn(scene: Scene, rate_rad_s: float | None) -> int:
    """Samples of half a turn, no more than a tenth of the recording."""
    if not rate_rad_s:
        return 0
    return min(math.ceil(math.pi / abs(rate_rad_s) / scene.period_s), len(scene) // 10)


def _brightest(values: Array, half: int) -> Array:
    """(n,) the largest of a channel's values (n, k) over rows up to ``half`` away."""
    largest = np.pad(values.max(axis=1), half, mode="edge")
    return np.asarray(np.lib.stride_tricks.sliding_window_view(largest, 2 * half + 1).max(axis=1))
