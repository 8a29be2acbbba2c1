"""A recording as the messages that a live link would have delivered, row by row in file order."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from magcal_service.recordings.recording import Channel, Position, Recording, Reference
from magcal_service.recordings.table import FloatArray
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

Maker = Callable[[int, int], Message | None]
"""Row and its time [ns] to the row's message, or None where the row has none."""


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
    makers = [stamp.reference(recording.reference)]
    if recording.position is not None:
        makers.append(stamp.position(recording.position))
    if telemetry:
        sequence = _sequence()
        makers += [stamp.channel(channel, sequence) for channel in recording.channels.values()]
    makers.append(stamp.magnetometer(recording.field_body_nt))
    for name, vectors_nt in recording.further.items():
        makers.append(_Stamp(craft, name, recording.clock).magnetometer(vectors_nt))
    for row, time_ns in enumerate(recording.time_ns.tolist()):
        for make in makers:
            message = make(row, time_ns)
            if message is not None:
                yield message


def _ends_the_daemon(message: Message) -> bool:
    return isinstance(message, Command) and message.name == "shutdown"


def _sequence() -> Iterator[int]:
    """0, 1, 2, ... and round again after 2**32 - 1."""
    return (number % _SEQUENCE_END for number in itertools.count())


def _complete(values: FloatArray) -> list[bool]:
    """Rows of (n, k) whose values are all finite."""
    complete: list[bool] = np.all(np.isfinite(values), axis=1).tolist()
    return complete


class _Stamp:
    """Holds what all messages of a recording carry; each method gives the maker of one kind of message."""

    def __init__(self, craft: str, source: str, clock: Clock) -> None:
        self._craft, self._source, self._clock = craft, source, clock

    def magnetometer(self, field_nt: FloatArray) -> Maker:
        """Vectors (n, 3) [nT]; rows without one give none."""
        craft, source, clock, sequence = self._craft, self._source, self._clock, _sequence()
        known, vectors = _complete(field_nt), list(map(tuple, field_nt.tolist()))

        def make(row: int, time_ns: int) -> Message | None:
            if not known[row]:
                return None
            return MagnetometerSample(
                craft=craft,
                source=source,
                sequence=next(sequence),
                time_ns=time_ns,
                clock=clock,
                field_body_nt=vectors[row],
            )

        return make

    def reference(self, reference: Reference) -> Maker:
        """A vector with its frame where there is one, else the magnitude."""
        craft, source, clock, sequence = self._craft, self._source, self._clock, _sequence()
        known = np.isfinite(reference.magnitude_nt).tolist()
        vector_nt, frame = reference.vector_nt, reference.frame
        vectors = None if vector_nt is None else list(map(tuple, vector_nt.tolist()))
        magnitudes = reference.magnitude_nt.tolist()

        def make(row: int, time_ns: int) -> Message | None:
            if not known[row]:
                return None
            return ReferenceSample(
                craft=craft,
                source=source,
                sequence=next(sequence),
                time_ns=time_ns,
                clock=clock,
                field_nt=None if vectors is None else vectors[row],
                frame=frame,
                magnitude_nt=magnitudes[row] if vectors is None else None,
            )

        return make

    def position(self, position: Position) -> Maker:
        """Rows without a position give none."""
        craft, source, clock, sequence = self._craft, self._source, self._clock, _sequence()
        known = _complete(position.km)
        vectors = list(map(tuple, position.km.tolist()))

        def make(row: int, time_ns: int) -> Message | None:
            if not known[row]:
                return None
            return PositionSample(
                craft=craft,
                source=source,
                sequence=next(sequence),
                time_ns=time_ns,
                clock=clock,
                position_km=vectors[row],
                frame=position.frame,
            )

        return make

    def channel(self, channel: Channel, sequence: Iterator[int]) -> Maker:
        """Rows where any of the channel's values is missing give none."""
        craft, source, clock = self._craft, self._source, self._clock
        name, unit = channel.spec.wire_name, channel.spec.unit
        known = _complete(channel.values)
        values = list(map(tuple, channel.values.tolist()))

        def make(row: int, time_ns: int) -> Message | None:
            if not known[row]:
                return None
            return TelemetrySample(
                craft=craft,
                source=source,
                sequence=next(sequence),
                time_ns=time_ns,
                clock=clock,
                channel=name,
                unit=unit,
                values=values[row],
            )

        return make
