"""The window of samples on the way."""

from __future__ import annotations

from collections import deque

import pytest

from magcal_service.links.base import Link
from magcal_service.wire.messages import CalibratedVector, MagnetometerSample, Message, ReferenceSample, Verdict
from sim_sensor.demo.flow import WindowedLink


def sample(sequence: int) -> MagnetometerSample:
    return MagnetometerSample(
        craft="c", source="mag", sequence=sequence, time_ns=sequence, field_body_nt=(float(sequence), 0.0, 0.0)
    )


def ignore(message: Message) -> None:
    """Take a message and do nothing."""


class FarEnd(Link):
    """Answers samples only when asked for messages, ``at_once`` at a time, and never those in ``deaf_to``."""

    def __init__(self, at_once: int = 1, deaf_to: frozenset[int] = frozenset()) -> None:
        super().__init__("far-end:")
        self.at_once, self.deaf_to = at_once, deaf_to
        self.waiting: deque[MagnetometerSample] = deque()
        self.most_waiting = 0

    def send(self, message: Message) -> None:
        if isinstance(message, MagnetometerSample) and message.sequence not in self.deaf_to:
            self.waiting.append(message)
            self.most_waiting = max(self.most_waiting, len(self.waiting))

    def _poll(self, wait_s: float) -> list[Message]:
        due = [self.waiting.popleft() for _ in range(min(self.at_once, len(self.waiting)))]
        return [
            CalibratedVector(
                craft=sample.craft,
                source=sample.source,
                sequence=sample.sequence,
                time_ns=sample.time_ns,
                field_body_nt=sample.field_body_nt,
                covariance_nt2=(1.0, 0.0, 0.0, 1.0, 0.0, 1.0),
                verdict=Verdict.CONVERGING,
            )
            for sample in due
        ]

    def close(self) -> None:
        self.waiting.clear()


def test_no_more_samples_are_on_the_way_than_the_window() -> None:
    far = FarEnd()
    link = WindowedLink(far, 7, ignore)
    for sequence in range(50):
        link.send(sample(sequence))
    assert far.most_waiting == 7


def test_answers_are_handed_on_in_order_while_sending_waits() -> None:
    arrived: list[Message] = []
    link = WindowedLink(FarEnd(), 3, arrived.append)
    for sequence in range(20):
        link.send(sample(sequence))
    assert [message.sequence for message in arrived] == list(range(17))


def test_every_answered_sample_is_counted() -> None:
    link = WindowedLink(FarEnd(at_once=4), 10, ignore)
    for sequence in range(40):
        link.send(sample(sequence))
    link.wait_for_room()
    assert (link.counters["samples"], link.counters["answered"], len(link._on_the_way)) == (40, 40, 0)


def test_an_overtaken_sample_counts_as_unanswered_and_frees_its_place() -> None:
    link = WindowedLink(FarEnd(deaf_to=frozenset({2, 3, 11})), 5, ignore)
    for sequence in range(20):
        link.send(sample(sequence))
    link.wait_for_room()
    assert (link.counters["answered"], link.counters["unanswered"]) == (17, 3)


def test_a_far_end_that_never_answers_does_not_block_for_ever() -> None:
    link = WindowedLink(FarEnd(deaf_to=frozenset(range(9))), 4, ignore, patience_s=0.02)
    for sequence in range(9):
        link.send(sample(sequence))
    assert (link.counters["unanswered"], len(link._on_the_way)) == (8, 1)


def test_other_messages_do_not_wait_for_room() -> None:
    link = WindowedLink(FarEnd(), 1, ignore)
    link.send(sample(0))
    reference = ReferenceSample(craft="c", source="ref", sequence=0, time_ns=0, magnitude_nt=45000.0)
    for _ in range(5):
        link.send(reference)
    assert (link.counters["waits"], link.counters["sent"]) == (0, 6)


def test_waiting_ends_with_the_error_of_the_check() -> None:
    def gone() -> None:
        raise RuntimeError("the far end is gone")

    link = WindowedLink(FarEnd(deaf_to=frozenset({0})), 1, ignore, patience_s=60.0, check=gone)
    link.send(sample(0))
    with pytest.raises(RuntimeError, match="is gone"):
        link.send(sample(1))


def test_an_answer_to_a_foreign_sample_changes_nothing() -> None:
    far = FarEnd()
    link = WindowedLink(far, 5, ignore)
    link.send(sample(1))
    far.send(sample(77))
    link.wait_for_room()
    link.receive(0.0)
    assert (link.counters["answered"], link.counters["unanswered"]) == (1, 0)


def test_a_window_without_room_is_refused() -> None:
    with pytest.raises(ValueError, match="window is 0"):
        WindowedLink(FarEnd(), 0, ignore)
