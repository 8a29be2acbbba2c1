"""A node that sends a craft's reference field: IGRF-14 along element sets, or at positions that it hears."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np

from magcal_service.base.errors import Fault, InputRefusedError, MagcalError
from magcal_service.daemon.own_reference import reference_at, watch_height
from magcal_service.earth.orbit_elements import read_element_sets
from magcal_service.links.base import Link
from magcal_service.links.silence import why_silent
from magcal_service.trust.height_sense import HeightSense
from magcal_service.trust.reasons import REMEDIES, Reason
from magcal_service.wire.messages import Clock, Frame, PositionSample

log = logging.getLogger("magcal")

SOURCE: Final = "igrf"
"""Source of what the node sends."""

_LOOK_S: Final = 10.0  # between two looks at the file and at who is there; choice: an operator waits no longer
_DAY_NS: Final = 86_400 * 10**9  # ns of a day
_AGES: Final = ((0.5, 6), (1.0, 7), (2.0, 40), (3.0, 130), (5.0, 300), (7.0, 900))
"""Age of an element set [days], and what it costs the magnitude at 450 km, rms [nT]: docs/recording-format.md."""


def cost_of(age_days: float) -> str:
    """What an age of element sets costs the reference, in words."""
    known = next((f"about {nt} nT" for days, nt in _AGES if age_days <= days), f"more than {_AGES[-1][1]} nT")
    return f"{age_days:.1f} days from the epoch, {known} rms of the field at 450 km"


@dataclass
class Sent:
    """What the node has done.

    Parameters
    ----------
    references: sent.
    refused: positions or instants without a field, by why.
    """

    references: int = 0
    refused: dict[str, int] = field(default_factory=dict)


class Elements:
    """The element sets of a file, read anew when it changes.

    Parameters
    ----------
    path: two-line element sets of one craft.
    most_days: how far from every epoch a position is still given [days].

    Raises as ``read_element_sets``.
    """

    def __init__(self, path: Path, most_days: float) -> None:
        self.path, self._most_days = path, most_days
        self._sets, self._seen = read_element_sets(path), self._stamp()

    def age_days(self, now_ns: int) -> float:
        """How far ``now_ns`` is from the nearest epoch [days]."""
        return float(self._sets.ages_ns(np.array([now_ns], dtype=np.int64))[0]) / _DAY_NS

    def refuse_old(self, now_ns: int) -> None:
        """Raise ``InputRefusedError`` where no set is near enough."""
        age = self.age_days(now_ns)
        if age > self._most_days:
            accepted = f"sets within {self._most_days:g} days are accepted; fetch newer ones, or raise --max-age-days"
            raise InputRefusedError([Fault(f"{self.path}: epoch", f"{age:.1f} days from now", accepted)])

    def refresh(self, now_ns: int) -> None:
        """Read the file again where it has changed; one that is refused is logged, and the sets before it stay."""
        if self._stamp() == self._seen:
            return
        self._seen = self._stamp()
        before = self._sets
        try:
            self._sets = read_element_sets(self.path)
            if self._sets.number != before.number:
                raise InputRefusedError(
                    [Fault("craft", self._sets.number, f"sets of craft {before.number} are accepted")]
                )
            self.refuse_old(now_ns)
            log.info("%s was read again; %s", self.path, cost_of(self.age_days(now_ns)))
        except MagcalError as error:
            self._sets = before
            log.error("%s is not used, the sets before it stay: %s", self.path, error)

    def position(self, craft: str, number: int, now_ns: int) -> PositionSample | str:
        """Where the craft is, ECI; why not, where no set is near enough or SGP4 gives none."""
        if self.age_days(now_ns) > self._most_days:
            return "old_elements"
        (place,) = self._sets.positions_km(np.array([now_ns], dtype=np.int64))
        if not np.all(np.isfinite(place)):
            return "no_orbit"
        x, y, z = place.tolist()
        return PositionSample(
            craft=craft, source=SOURCE, sequence=number, time_ns=now_ns, clock=Clock.UTC,
            position_km=(x, y, z), frame=Frame.ECI,
        )  # fmt: skip

    def _stamp(self) -> tuple[int, int] | None:
        try:
            about = self.path.stat()
        except OSError:
            return None
        return about.st_mtime_ns, about.st_size


def run_along(
    link: Link,
    craft: str,
    elements: Elements,
    rate_hz: float,
    stop: threading.Event,
    now_ns: Callable[[], int] = time.time_ns,
) -> Sent:
    """Send position and field along element sets, ``rate_hz`` [1/s] times a second, until ``stop``.

    A position goes before its field, for what else is worked out from it.
    """
    sent, period_s, look_s = Sent(), 1.0 / rate_hz, time.monotonic() + _LOOK_S
    due_s, number = time.monotonic(), 0
    while not stop.is_set():
        _send(link, elements.position(craft, number, now_ns()), sent, with_position=True)
        number = (number + 1) % (1 << 32)  # 32 bits on the wire
        link.receive(0.0)
        if time.monotonic() > look_s:
            look_s = time.monotonic() + _LOOK_S
            elements.refresh(now_ns())
            _log_alone(link, craft)
        due_s = max(due_s + period_s, time.monotonic() - period_s)
        stop.wait(max(0.0, due_s - time.monotonic()))
    return sent


def run_beside(link: Link, heard: Link, craft: str, stop: threading.Event) -> Sent:
    """Send the field at each position of the craft that is heard on ``heard``, a viewer's end, until ``stop``."""
    sent, height, look_s = Sent(), HeightSense(), time.monotonic() + _LOOK_S
    while not stop.is_set():
        positions = [message for message in heard.receive(0.2) if isinstance(message, PositionSample)]
        for position in positions:
            theirs = position.craft == craft and position.source != SOURCE
            if theirs and _send(link, position, sent, with_position=False):
                _watch(height, position)
        link.receive(0.0)
        if time.monotonic() > look_s:
            look_s = time.monotonic() + _LOOK_S
            _log_alone(link, craft)
            if not sent.references:
                log.warning("no position of craft %s has come yet: send position messages, with times in UTC", craft)
    return sent


def _watch(height: HeightSense, position: PositionSample) -> None:
    """Log once that positions do not fall as they should."""
    before = height.said
    watch_height(height, position)
    if height.said and not before:
        log.warning("%s: %s", height.said, REMEDIES[Reason.HEIGHT_DISAGREES])


def _send(link: Link, position: PositionSample | str, sent: Sent, *, with_position: bool) -> bool:
    """Send the field at a position; whether there is one."""
    found = position if isinstance(position, str) else reference_at(position)
    if isinstance(found, str):
        if found not in sent.refused:
            log.error("no reference is sent for a position: %s; further ones are counted, not logged", found)
        sent.refused[found] = sent.refused.get(found, 0) + 1
        return False
    if with_position and isinstance(position, PositionSample):
        link.send(position)
    link.send(found)
    sent.references += 1
    return True


def _log_alone(link: Link, craft: str) -> None:
    served = link.served()
    if link.alone or (served is not None and craft not in served):
        log.warning("the reference does not reach craft %s: %s", craft, why_silent(link, [craft]))
