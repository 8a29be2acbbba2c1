"""A byte stream: the same messages for any split, and never a wrong one."""

from __future__ import annotations

import itertools
import random
from collections import Counter

import pytest
import wire_cases as cases
from hypothesis import given, settings
from hypothesis import strategies as st

from magcal_service.base.errors import DecodeError
from magcal_service.wire.framing import (
    FRAME_REFUSALS,
    MAX_ENCODED_BYTES,
    FrameDecoder,
    FrameEncoder,
    ReceivedFrame,
    StreamDecoder,
    pack_frame,
)
from magcal_service.wire.messages import REFUSALS, MagnetometerSample, Message

CORPUS = cases.corpus("stream")


def decoded(data: bytes) -> tuple[list[Message], Counter[str]]:
    decoder = StreamDecoder()
    return decoder.feed(data), decoder.counters


def decoded_in_pieces(data: bytes, cuts: list[int]) -> tuple[list[Message], Counter[str]]:
    decoder, messages = StreamDecoder(), []
    edges = [0, *sorted(cut % (len(data) + 1) for cut in cuts), len(data)]
    for begin, end in itertools.pairwise(edges):
        messages += decoder.feed(data[begin:end])
    return messages, decoder.counters


_pieces = st.one_of(
    st.sampled_from([golden.frame for golden in cases.GOLDEN]),
    st.sampled_from([case["bytes"] for _, case in CORPUS]),
    st.binary(max_size=30),
)


@given(st.lists(_pieces, max_size=6).map(b"".join), st.lists(st.integers(0, 10**6), max_size=30))
@settings(max_examples=150, deadline=None)
def test_any_split_gives_the_same_messages_and_counts(data, cuts):
    assert decoded_in_pieces(data, cuts) == decoded(data)


@pytest.mark.parametrize("name", [name for name, _ in CORPUS])
def test_byte_by_byte_gives_what_one_piece_gives(name):
    data = dict(CORPUS)[name]["bytes"]
    assert decoded_in_pieces(data, list(range(len(data)))) == decoded(data)


@pytest.mark.parametrize("name", [name for name, _ in CORPUS])
def test_the_stream_corpus_gives_the_messages_and_counts_on_record(name):
    case = dict(CORPUS)[name]
    messages, counters = decoded(case["bytes"])
    assert (len(messages), dict(counters)) == (case["messages"], case["counters"])


def test_the_stream_corpus_holds_every_reason_of_a_frame():
    seen = {name.removeprefix("refused.") for _, case in CORPUS for name in case["counters"]}
    assert set(FRAME_REFUSALS) <= seen


def test_the_reasons_of_frames_and_payloads_do_not_overlap():
    assert not set(FRAME_REFUSALS) & set(REFUSALS)


@given(st.lists(cases.messages, max_size=5))
@settings(max_examples=50, deadline=None)
def test_what_is_sent_arrives_in_order(messages):
    encoder = FrameEncoder()
    received, counters = decoded(b"".join(encoder.encode(message) for message in messages))
    assert received == messages
    assert sum(counters.values()) == counters["frames"] == len(messages)


@pytest.mark.parametrize("golden", cases.GOLDEN, ids=lambda golden: golden.name)
def test_no_flipped_bit_gives_a_wrong_message(golden):
    for bit in range(8 * len(golden.frame)):
        flipped = bytearray(golden.frame)
        flipped[bit // 8] ^= 1 << (bit % 8)
        messages, _ = decoded(bytes(flipped) + b"\0")
        assert messages in ([], [golden.message])


def test_no_flipped_bit_between_two_frames_gives_a_wrong_message_or_costs_more_than_one():
    first, second = cases.GOLDEN[0], cases.SAMPLE
    stream = first.frame + second.frame
    for bit in range(8 * len(stream)):
        flipped = bytearray(stream)
        flipped[bit // 8] ^= 1 << (bit % 8)
        messages, _ = decoded(bytes(flipped) + b"\0")
        assert messages in ([first.message], [second.message], [first.message, second.message])


def test_two_flipped_bits_never_give_a_wrong_message():
    rng = random.Random(20260)
    frame = cases.SAMPLE.frame
    for _ in range(4000):
        flipped = bytearray(frame)
        for bit in rng.sample(range(8 * len(frame)), 2):
            flipped[bit // 8] ^= 1 << (bit % 8)
        messages, _ = decoded(bytes(flipped) + b"\0")
        assert messages in ([], [cases.SAMPLE.message])


def test_a_dropped_byte_never_gives_a_wrong_message():
    frame = cases.SAMPLE.frame
    for at in range(len(frame)):
        messages, _ = decoded(frame[:at] + frame[at + 1 :] + b"\0")
        assert messages in ([], [cases.SAMPLE.message])


@given(st.binary(max_size=2000))
@settings(max_examples=200, deadline=None)
def test_after_any_noise_the_frame_behind_it_arrives(noise):
    messages, _ = decoded(noise + cases.SAMPLE.frame)
    assert messages == [cases.SAMPLE.message]


def test_the_buffer_stays_bounded_on_a_line_without_delimiters():
    decoder = FrameDecoder()
    for _ in range(300):
        decoder.feed(b"U" * 1000)
        assert len(decoder._run) <= MAX_ENCODED_BYTES
    assert decoder.counters == {"refused.oversize": 1}


def test_the_longest_frame_is_not_oversize():
    payload = bytes(i % 255 + 1 for i in range(10240))
    (event,) = FrameDecoder().feed(pack_frame(7, payload, 0))
    assert event == ReceivedFrame(7, 0, payload)


def test_a_payload_beyond_the_limit_is_not_packed():
    with pytest.raises(ValueError, match=r"10241 bytes; up to 10240"):
        pack_frame(1, bytes(10241), 0)


def test_the_frame_sequence_wraps_without_a_loss():
    encoder, decoder = FrameEncoder(), StreamDecoder()
    encoder._sequence = 65534
    for _ in range(4):
        assert decoder.feed(encoder.encode(cases.SAMPLE.message))
    assert decoder.counters == {"frames": 4}


def test_a_refused_message_uses_no_frame_number():
    encoder = FrameEncoder()
    bad = MagnetometerSample(craft="c", source="s", sequence=0, time_ns=0, field_body_nt=(2e6, 0.0, 0.0))
    with pytest.raises(DecodeError, match="out_of_range"):
        encoder.encode(bad)
    assert encoder.encode(cases.SAMPLE.message) == cases.SAMPLE.frame


@pytest.mark.parametrize(
    ("gap", "counted"), [(1, {"frames_lost": 1}), (1024, {"frames_lost": 1024}), (1025, {"frame_restarts": 1})]
)
def test_a_gap_is_so_many_lost_frames_up_to_the_longest_and_beyond_it_a_restart(gap, counted):
    decoder = FrameDecoder()
    decoder.feed(pack_frame(1, b"x", 7) + pack_frame(1, b"x", 8 + gap))
    assert decoder.counters == {"frames": 2, **counted}


def test_the_first_frame_of_a_line_is_no_gap_whatever_its_number():
    decoder = FrameDecoder()
    decoder.feed(pack_frame(1, b"x", 500))
    assert decoder.counters == {"frames": 1}
