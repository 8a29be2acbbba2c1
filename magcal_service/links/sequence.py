"""Losses, seen by the gaps in each source's own sequence numbers."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

from magcal_service.wire.kinds import kind_of
from magcal_service.wire.messages import Message

_MODULO = 1 << 32  # sequence numbers have 32 bits on the wire and wrap
_HALF = 1 << 31  # less than half the circle on is ahead, anything else behind (as the serial numbers of RFC 1982)
WINDOW = 64  # how far back a number may lie and still be the same run of the source, out of order or doubled


@dataclass(slots=True)
class SourceRecord:
    """What happened to one kind of message from one source on this link.

    Parameters
    ----------
    craft, source, kind: whose messages these are.
    received: messages that arrived, doubled ones included.
    lost: sequence numbers that were skipped and have not arrived since.
    doubled: messages that had arrived before.
    late: messages that arrived after one with a higher number.
    restarts: how often the source began to count anew.
    last_sequence: the highest number of the present run.
    """

    craft: str
    source: str
    kind: str
    received: int = 0
    lost: int = 0
    doubled: int = 0
    late: int = 0
    restarts: int = 0
    last_sequence: int = -1
    _last_time_ns: int = field(default=0, repr=False)
    _recent: dict[int, int] = field(default_factory=dict, repr=False)

    def note(self, sequence: int, time_ns: int) -> str:
        """Count one message; returns ``next``, ``gap``, ``doubled``, ``late`` or ``restarted``.

        A number at or below the highest one is a double where number and time [ns] are known, late where the time
        lies before the newest one and the number at most ``WINDOW`` back, and otherwise the source's restart.
        """
        self.received += 1
        ahead = (sequence - self.last_sequence) % _MODULO
        if self.received == 1:
            outcome = "next"
        elif sequence in self._recent:
            outcome = "doubled" if self._recent[sequence] == time_ns else "restarted"
        elif ahead < _HALF:
            outcome = "next" if ahead == 1 else "gap"
        else:
            near = _MODULO - ahead <= WINDOW and time_ns <= self._last_time_ns
            outcome = "late" if near else "restarted"
        self._apply(outcome, sequence, time_ns, ahead)
        return outcome

    def _apply(self, outcome: str, sequence: int, time_ns: int, ahead: int) -> None:
        if outcome == "doubled":
            self.doubled += 1
            return
        if outcome == "restarted":
            self.restarts += 1
            self._recent.clear()
        elif outcome == "gap":
            self.lost += ahead - 1
        elif outcome == "late":
            self.late += 1
            self.lost = max(0, self.lost - 1)
        if outcome != "late":
            self.last_sequence, self._last_time_ns = sequence, time_ns
        self._recent[sequence] = time_ns
        if len(self._recent) > WINDOW:
            del self._recent[next(iter(self._recent))]


class SequenceTracker:
    """One ``SourceRecord`` for each craft, source and kind; sums go to ``counters`` as they change.

    The sums are ``lost``, ``doubled``, ``late`` and ``restarted``; messages of sources beyond the first ``limit`` are
    counted as ``untracked``.
    """

    def __init__(self, counters: Counter[str], limit: int) -> None:
        self._counters, self._limit = counters, limit
        self._records: dict[tuple[str, str, type[Message]], SourceRecord] = {}

    def note(self, message: Message) -> None:
        """Count one accepted message for its source."""
        key = (message.craft, message.source, type(message))
        record = self._records.get(key)
        if record is None:
            if len(self._records) >= self._limit:
                self._counters["untracked"] += 1
                return
            record = self._records[key] = SourceRecord(message.craft, message.source, kind_of(message).name)
        lost = record.lost
        outcome = record.note(message.sequence, message.time_ns)
        if outcome in ("doubled", "late", "restarted"):
            self._counters[outcome] += 1
        if record.lost != lost:
            self._counters["lost"] += record.lost - lost

    def records(self) -> tuple[SourceRecord, ...]:
        """All records, in the order in which the sources first appeared."""
        return tuple(self._records.values())
