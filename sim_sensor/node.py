"""The simulated sensor node: a ``Simulation`` on a ``Link``, paced by the monotonic clock.

``run_node`` is the only place of the simulator that waits.  It knows nothing of flow control: a caller that goes
faster than its daemon wraps the link (``flow.WindowedLink``).
"""

from __future__ import annotations

import math
import threading
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field

from magcal_service.links.base import Link
from magcal_service.wire.messages import Message
from sim_sensor.simulation import Simulation

__all__ = ["NodeReport", "OnResult", "Simulation", "run_node"]

_SLICE_S = 0.05  # longest wait before the stop event is looked at again
_POLL_EVERY = 16  # messages between two looks at what has come back, at full speed
OnResult = Callable[[Message], None]


@dataclass
class NodeReport:
    """What a node has done: messages handed to the link by kind, and the simulated time of the last one [s]."""

    sent: Counter[str] = field(default_factory=Counter)
    elapsed_s: float = 0.0

    @property
    def messages(self) -> int:
        """All messages handed to the link."""
        return sum(self.sent.values())

    def note(self, emit_s: float, message: Message) -> None:
        """Count one message."""
        self.sent[type(message).__name__] += 1
        self.elapsed_s = max(self.elapsed_s, emit_s)


def run_node(
    simulation: Simulation,
    link: Link,
    speed: float = 1.0,
    stop: threading.Event | None = None,
    on_result: OnResult | None = None,
    on_sent: Callable[[NodeReport], None] | None = None,
) -> NodeReport:
    """Send the whole simulation on a link and hand back what was sent.

    Parameters
    ----------
    speed: simulated seconds per second; 0 for as fast as possible.
    stop: set it to end early.
    on_result: called, in this thread, for every message that comes back.
    on_sent: called after every message sent, for progress.

    Raises ValueError for a speed that is negative or not finite, and whatever the callbacks raise.
    """
    if not (speed >= 0.0 and math.isfinite(speed)):
        raise ValueError(f"speed {speed!r} is refused; give 0 for full speed or simulated seconds per second")
    stop = stop or threading.Event()
    report, begin = NodeReport(), time.monotonic()
    for emit_s, message in simulation.emissions():
        if speed > 0.0:
            _receive_until(begin + emit_s / speed, link, stop, on_result)
        elif report.messages % _POLL_EVERY == 0:
            _receive(link, 0.0, on_result)
        if stop.is_set():
            break
        link.send(message)
        report.note(emit_s, message)
        if on_sent is not None:
            on_sent(report)
    return report


def _receive_until(deadline: float, link: Link, stop: threading.Event, on_result: OnResult | None) -> None:
    """Receive until the monotonic ``deadline`` [s] or a stop."""
    while not stop.is_set():
        left = deadline - time.monotonic()
        if left <= 0.0:
            return
        _receive(link, min(left, _SLICE_S), on_result)


def _receive(link: Link, timeout_s: float, on_result: OnResult | None) -> None:
    for message in link.receive(timeout_s):
        if on_result is not None:
            on_result(message)
