"""What a node sends again when it joins is asked for, held back until it is there, and given in the order of its time.

zenoh brings samples and references stream by stream, so a run of samples may arrive before the references of the same
seconds, and live ones before those that were missed: then ticks would close without their references, or what was
missed would be late for good.  So each stream that appears or comes back is asked for its newest messages, and waits
until it has sent them; the others of its craft go on.
"""

from __future__ import annotations

import heapq
import threading
from collections import deque
from collections.abc import Callable, Iterator
from typing import Final, Generic, NamedTuple, TypeVar

from magcal_service.wire.messages import MagnetometerSample, Message

Raw = TypeVar("Raw")

TOKEN_S: Final = 1.0
"""How long a stream's first message waits for its publisher to show itself and be asked [s]."""

ASKED_S: Final = 10.0
"""How long a publisher may take to send its newest messages again [s]: as long as zenoh waits for replies."""

ALONE_S: Final = 2.0
"""How long samples wait for references, or references for samples, where none have arrived at all [s]; ..."""

ALONE_QUIET_S: Final = 0.4
"""... and how long after the last of them."""

_PAIRED: Final = frozenset(("magnetometer", "reference"))
"""The kinds of which a tick needs both."""

_MOST_HELD: Final = 20_000  # messages of one craft: bounds the memory; at 1 Hz with references nearly three hours
_AT_ONCE: Final = 256  # messages put in order by one call of ``due``, which other craft wait for
_MODULO: Final = 1 << 32  # a publisher's numbers have 32 bits and wrap


class StreamName(NamedTuple):
    """One publisher: the craft and kind of message of its key, its session and its number in that."""

    craft: str
    kind: str
    source: str
    session: str
    entity: str


class _Stream(Generic[Raw]):
    """What has come of one publisher, by the numbers that it gives its messages."""

    __slots__ = ("held", "here", "missing", "newest", "open_until_s")

    def __init__(self) -> None:
        self.open_until_s: float | None = None  # until then more is expected of what it sends again
        self.here = True
        self.held: dict[int, Message | Raw] = {}  # messages, and what was sent again as it came
        self.newest: int | None = None  # of those passed on
        self.missing: set[int] = set()  # those between that were not passed on

    def take(self) -> dict[int, Message | Raw]:
        """Everything held, which is held no longer."""
        held, self.held, self.open_until_s = self.held, {}, None
        return held

    def is_new(self, number: int) -> bool:
        """Whether a message has not been passed on before; it counts as passed on from now."""
        ahead = 1 if self.newest is None else _ahead(number, self.newest)
        if ahead <= 0:
            known = number not in self.missing
            self.missing.discard(number)
            return not known
        if 1 < ahead <= _MOST_HELD and self.newest is not None:
            self.missing.update((self.newest + one) % _MODULO for one in range(1, ahead))
        if len(self.missing) > _MOST_HELD:
            self.missing.clear()
        self.newest = number
        return True


class _Hold(Generic[Raw]):
    """The streams of one craft that wait."""

    def __init__(self, now_s: float) -> None:
        self.streams: dict[StreamName, _Stream[Raw]] = {}
        self.begun_s = self.last_s = now_s

    @property
    def size(self) -> int:
        return sum(len(stream.held) for stream in self.streams.values())

    def until_s(self, flowing: set[str]) -> float:
        """When it ends if nothing more arrives [s]; ``flowing`` are the kinds of the craft that do not wait."""
        size = self.size
        if size >= _MOST_HELD:
            return self.begun_s
        open_s = [stream.open_until_s for stream in self.streams.values() if stream.open_until_s is not None]
        if open_s:
            return max(open_s)
        held = {name.kind for name, stream in self.streams.items() if stream.held} & _PAIRED
        missed = size > len(self.streams)
        if missed and held and held | flowing != _PAIRED:
            return min(self.begun_s + ALONE_S, self.last_s + ALONE_QUIET_S)
        return self.begun_s


class _Ordered:
    """Messages of one craft that leave in turns, and the streams that they are of."""

    def __init__(self) -> None:
        self.messages: deque[Message] = deque()
        self.streams: set[StreamName] = set()


class Joining(Generic[Raw]):
    """The streams of all craft, and those that wait.

    ``shown``, ``gone``, ``again`` and ``complete`` may be called from any thread; the others belong to the one who
    receives.

    Parameters
    ----------
    turn: most messages of one craft that ``due`` gives at once.
    decode: makes a message of what was sent again; None where it is refused.
    most: streams remembered; the messages of further ones pass as they come.
    """

    def __init__(self, turn: int, decode: Callable[[Raw], Message | None], most: int = 1 << 12) -> None:
        self._turn, self._decode, self._most = turn, decode, most
        self._lock = threading.Lock()
        self._count = 0
        self._streams: dict[str, dict[StreamName, _Stream[Raw]]] = {}
        self._holds: dict[str, _Hold[Raw]] = {}
        self._ordered: dict[str, _Ordered] = {}

    def shown(self, name: StreamName, now_s: float) -> bool:
        """A publisher appears, or is back; whether it is to be asked for its newest messages, which ``again`` takes."""
        with self._lock:
            stream = self._stream(name)
            if stream is not None:
                stream.here = True
                self._hold(name, stream, now_s, now_s + ASKED_S)
        return stream is not None

    def gone(self, name: StreamName) -> None:
        """A publisher is not there any more."""
        with self._lock:
            stream = self._streams.get(name.craft, {}).get(name)
            if stream is not None:
                stream.here = False

    def again(self, name: StreamName, number: int, raw: Raw) -> None:
        """A message that a publisher which was asked sends again."""
        with self._lock:
            hold = self._holds.get(name.craft)
            if hold is not None and name in hold.streams and hold.size < _MOST_HELD:
                hold.streams[name].held.setdefault(number, raw)

    def complete(self, name: StreamName, now_s: float) -> None:
        """A publisher has sent again what it was asked for."""
        with self._lock:
            hold = self._holds.get(name.craft)
            if hold is not None and name in hold.streams:
                hold.streams[name].open_until_s = None
                hold.last_s = now_s

    def keeps(self, name: StreamName, number: int, message: Message, now_s: float) -> bool:
        """Whether a message is not to be passed on now: it is held, and ``due`` returns it later, or it has been."""
        with self._lock:
            known = name in self._streams.get(name.craft, ())
            stream = self._stream(name)
            if stream is None:
                return False
            if not known:
                self._hold(name, stream, now_s, now_s + TOKEN_S)
            hold = self._holds.get(name.craft)
            if hold is not None and name in hold.streams:
                hold.last_s = now_s
                stream.held[number] = message
                return True
            if not stream.is_new(number):
                return True
        ordered = self._ordered.get(name.craft)
        if ordered is None or name not in ordered.streams:
            return False
        ordered.messages.append(message)  # those before it are still on their way
        return True

    def due(self, now_s: float) -> list[Message]:
        """The messages that need not wait any longer, at most a turn of each craft."""
        if not self._holds and not self._ordered:
            return []
        count = 0
        with self._lock:
            crafts = list(self._holds)
        for craft in crafts:
            if count >= _AT_ONCE:
                break
            count += self._release(craft, now_s)
        return [message for craft in list(self._ordered) for message in self._turn_of(craft)]

    def wait_s(self, now_s: float, longest_s: float) -> float:
        """How long to wait for more before ``due`` has something [s]."""
        if self._ordered:
            return 0.0
        with self._lock:
            ends_s = [self._until_s(craft) for craft in self._holds]
        return min([longest_s, *(max(0.0, end_s - now_s) for end_s in ends_s)])

    def _until_s(self, craft: str) -> float:
        hold = self._holds[craft]
        flowing = {
            name.kind
            for name, stream in self._streams[craft].items()
            if stream.here and stream.newest is not None and name not in hold.streams
        }
        return hold.until_s(flowing & _PAIRED)

    def _stream(self, name: StreamName) -> _Stream[Raw] | None:
        """The stream of a publisher; None where there are too many."""
        of_craft = self._streams.setdefault(name.craft, {})
        if name not in of_craft:
            if self._count >= self._most and not self._forget_one():
                return None
            of_craft[name] = _Stream()
            self._count += 1
        return of_craft[name]

    def _forget_one(self) -> bool:
        for craft, of_craft in self._streams.items():
            for name, stream in of_craft.items():
                if not (stream.here or (craft in self._holds and name in self._holds[craft].streams)):
                    del of_craft[name]
                    self._count -= 1
                    return True
        return False

    def _hold(self, name: StreamName, stream: _Stream[Raw], now_s: float, until_s: float) -> None:
        hold = self._holds.setdefault(name.craft, _Hold(now_s))
        hold.streams[name] = stream
        stream.open_until_s = until_s

    def _release(self, craft: str, now_s: float) -> int:
        """Put what was held, if its hold is over, in order behind what is on its way; how many messages that are."""
        with self._lock:
            if now_s < self._until_s(craft):
                return 0
            hold = self._holds.pop(craft)
            held = [(stream, stream.take()) for stream in hold.streams.values()]
        messages = [message for stream, raw in held for message in self._new(stream, raw)]
        if messages:
            ordered = self._ordered.setdefault(craft, _Ordered())
            ordered.messages.extend(in_order_of_time(messages))
            ordered.streams.update(hold.streams)
        return len(messages)

    def _new(self, stream: _Stream[Raw], held: dict[int, Message | Raw]) -> Iterator[Message]:
        """What was held of a stream, by its numbers, without what was passed on before."""
        base = next(iter(held), 0)
        for number in sorted(held, key=lambda number: _ahead(number, base)):
            one = held[number]
            message = one if isinstance(one, Message) else self._decode(one)
            if message is not None and stream.is_new(number):
                yield message

    def _turn_of(self, craft: str) -> list[Message]:
        waiting = self._ordered[craft].messages
        taken = [waiting.popleft() for _ in range(min(self._turn, len(waiting)))]
        if not waiting:
            del self._ordered[craft]
        return taken


def _ahead(number: int, other: int) -> int:
    """How far a number is ahead of another, negative where it is behind."""
    return (number - other + _MODULO // 2) % _MODULO - _MODULO // 2


def in_order_of_time(messages: list[Message]) -> list[Message]:
    """Messages of several sources merged by time, references first; each source's of one kind stay in their order."""
    streams: dict[tuple[str, type[Message]], list[Message]] = {}
    for message in messages:
        streams.setdefault((message.source, type(message)), []).append(message)
    return list(heapq.merge(*streams.values(), key=lambda one: (one.time_ns, isinstance(one, MagnetometerSample))))
