"""A recording as the messages that a live link would have delivered, row by row in file order."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from magcal_service.recordings.recording import Channel, Position, Recording, Reference
from magcal_service.recordings.table import FloatArray, IntArray
from magcal_service.wire.messages import (
    Clock,
    Command,
    MagnetometerSample,
    Message,
    PositionSample,
    ReferenceSample,
    TelemetrySample,
)

SOURCE = "recording"
_SEQUENCE_END = 1 << 32  # a sequence number has 32 bits on the wire
_AT_ONCE = 1 << 12  # rows that are numbers of Python at a time: they take ten times the memory of an array's

Values = tuple[float, ...]
Part = tuple[Iterator[Values | None], Callable[[int, Values], Message]]
"""What each row has of one kind, None where it has nothing, and what makes its message of a time [ns] and that."""


def messages(
    recording: Recording, craft: str = "craft", *, source: str | None = None, telemetry: bool = True
) -> Iterator[Message]:
    """Every row's messages: reference, position, channels, and last the magnetometer sample that they belong to.

    Parameters
    ----------
    recording: rows in the order in which they are to arrive.
    craft, source: what the messages carry; the recording's own source where none is given.
    telemetry: False leaves the channels out.

    Each kind of message counts its own sequence from 0, so no gap is seen where a row has no reference or a channel
    no value (a channel's sample needs all of its values).  The same recording gives the same messages, always.

    A recorded session gives the messages that its service received, with their own sources and sequences, but for a
    command that ended it: a replay goes on to the end of the recording.
    """
    if recording.stream is not None:
        for received in recording.stream:
            if (telemetry or not isinstance(received, TelemetrySample)) and not _ends_the_daemon(received):
                yield received if received.craft == craft else replace(received, craft=craft)
        return
    stamp = _Stamp(craft, source or recording.source or SOURCE, recording.clock)
    parts = [stamp.reference(recording.reference)]
    if recording.position is not None:
        parts.append(stamp.position(recording.position))
    if telemetry:
        sequence = _sequence()
        parts += [stamp.channel(channel, sequence) for channel in recording.channels.values()]
    parts.append(stamp.magnetometer(recording.field_body_nt))
    for name, vectors_nt in recording.further.items():
        parts.append(_Stamp(craft, name, recording.clock).magnetometer(vectors_nt))
    makers = [make for _, make in parts]
    for time_ns, *row in zip(_instants(recording.time_ns), *(rows for rows, _ in parts), strict=True):
        for values, make in zip(row, makers, strict=True):
            if values is not None:
                yield make(time_ns, values)


def _ends_the_daemon(message: Message) -> bool:
    return isinstance(message, Command) and message.name == "shutdown"


def _sequence() -> Iterator[int]:
    """0, 1, 2, ... and round again after 2**32 - 1."""
    return (number % _SEQUENCE_END for number in itertools.count())


def _instants(time_ns: IntArray) -> Iterator[int]:
    """Times (n,) [ns] one by one."""
    for begin in range(0, len(time_ns), _AT_ONCE):
        yield from time_ns[begin : begin + _AT_ONCE].tolist()


def _rows(values: FloatArray) -> Iterator[Values | None]:
    """Rows of (n, k) one by one, None where a value is not finite."""
    for begin in range(0, len(values), _AT_ONCE):
        some = values[begin : begin + _AT_ONCE]
        whole = np.all(np.isfinite(some), axis=1).tolist()
        yield from (tuple(row) if is_whole else None for row, is_whole in zip(some.tolist(), whole, strict=True))


class _Stamp:
    """Holds what all messages of a recording carry; each method gives the rows and the maker of one kind of message."""

    def __init__(self, craft: str, source: str, clock: Clock) -> None:
        self._craft, self._source, self._clock = craft, source, clock

    def magnetometer(self, field_nt: FloatArray) -> Part:
        """Vectors (n, 3) [nT]; rows without one give none."""
        craft, source, clock, sequence = self._craft, self._source, self._clock, _sequence()

        def make(time_ns: int, field_body_nt: Values) -> Message:
            x, y, z = field_body_nt
            return MagnetometerSample(
                craft=craft,
                source=source,
                sequence=next(sequence),
                time_ns=time_ns,
                clock=clock,
                field_body_nt=(x, y, z),
            )

        return _rows(field_nt), make

    def reference(self, reference: Reference) -> Part:
        """A vector with its frame where there is one, else the magnitude."""
        craft, source, clock, sequence = self._craft, self._source, self._clock, _sequence()
        vector_nt, frame, magnitude_nt = reference.vector_nt, reference.frame, reference.magnitude_nt

        def make(time_ns: int, field: Values) -> Message:
            return ReferenceSample(
                craft=craft,
                source=source,
                sequence=next(sequence),
                time_ns=time_ns,
                clock=clock,
                field_nt=None if vector_nt is None else (field[0], field[1], field[2]),
                frame=frame,
                magnitude_nt=field[0] if vector_nt is None else None,
            )

        return _rows(magnitude_nt[:, None] if vector_nt is None else vector_nt), make

    def position(self, position: Position) -> Part:
        """Rows without a position give none."""
        craft, source, clock, sequence = self._craft, self._source, self._clock, _sequence()
        frame = position.frame

        def make(time_ns: int, position_km: Values) -> Message:
            x, y, z = position_km
            return PositionSample(
                craft=craft,
                source=source,
                sequence=next(sequence),
                time_ns=time_ns,
                clock=clock,
                position_km=(x, y, z),
                frame=frame,
            )

        return _rows(position.km), make

    def channel(self, channel: Channel, sequence: Iterator[int]) -> Part:
        """Rows where any of the channel's values is missing give none."""
        craft, source, clock = self._craft, self._source, self._clock
        name, unit = channel.spec.wire_name, channel.spec.unit

        def make(time_ns: int, values: Values) -> Message:
            return TelemetrySample(
                craft=craft,
                source=source,
                sequence=next(sequence),
                time_ns=time_ns,
                clock=clock,
                channel=name,
                unit=unit,
                values=values,
            )

        return _rows(channel.values), make
