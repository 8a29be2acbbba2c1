"""Payloads: what goes in comes out, and nothing else gets in."""

from __future__ import annotations

import dataclasses
import math

import msgpack
import pytest
import wire_cases as cases
from hypothesis import given, settings
from hypothesis import strategies as st

from magcal_service.base.errors import DecodeError
from magcal_service.wire.codec import MAX_PAYLOAD_BYTES, decode, encode
from magcal_service.wire.kinds import KINDS, kind_of
from magcal_service.wire.messages import (
    REFUSALS,
    Clock,
    Command,
    Estimate,
    Frame,
    MagnetometerSample,
    Message,
    PositionSample,
    ReferenceSample,
    Status,
    Verdict,
)

CORPUS = cases.corpus("payload")
COMMON = {"craft": "c" * 32, "source": "s" * 32, "sequence": 2**32 - 1, "time_ns": -(2**63), "clock": Clock.ELAPSED}
SAMPLE = MagnetometerSample(craft="sat1", source="mag0", sequence=1, time_ns=2, field_body_nt=(1.0, 2.0, 3.0))


def refusal_of(payload: bytes) -> str | None:
    """The reason a payload is refused for, None where it is a message; anything but DecodeError ends the test."""
    try:
        decode(payload)
    except DecodeError as refused:
        reason = refused.reason
    else:
        return None
    assert reason in REFUSALS
    return reason


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_a_message_of_any_kind_survives_the_round_trip(kind):
    @settings(max_examples=60, deadline=None)
    @given(cases.BY_KIND[kind.name])
    def survives(message):
        payload = encode(message)
        back = decode(payload)
        assert back == message
        assert type(back) is kind.record
        assert len(payload) <= MAX_PAYLOAD_BYTES

    survives()


@given(st.binary(max_size=200))
@settings(max_examples=500, deadline=None)
def test_arbitrary_bytes_raise_nothing_but_the_documented_error(payload):
    refusal_of(payload)


_scalars = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-(2**63), 2**64 - 1),
    st.floats(),
    st.floats(width=32),
    st.text(max_size=40),
    st.binary(max_size=4),
    st.builds(msgpack.ExtType, st.integers(0, 127), st.binary(max_size=3)),
)
_values = st.recursive(
    _scalars,
    lambda inner: st.one_of(st.lists(inner, max_size=4), st.dictionaries(st.text(max_size=3), inner, max_size=3)),
    max_leaves=8,
)


@given(st.sampled_from(cases.GOLDEN), st.data())
@settings(max_examples=400, deadline=None)
def test_any_value_in_any_place_is_accepted_or_refused_and_what_is_accepted_can_be_sent_again(golden, data):
    values = msgpack.unpackb(golden.payload)
    values[data.draw(st.integers(0, len(values) - 1))] = data.draw(_values)
    payload = msgpack.packb(values)
    if refusal_of(payload) is None:
        message = decode(payload)
        assert decode(encode(message)) == message


@given(st.sampled_from(cases.GOLDEN), st.integers(0, 10**6), st.binary(max_size=6), st.integers(0, 6))
@settings(max_examples=500, deadline=None)
def test_a_golden_payload_cut_or_spliced_raises_nothing_but_the_documented_error(golden, at, inserted, removed):
    at %= len(golden.payload) + 1
    refusal_of(golden.payload[:at] + inserted + golden.payload[at + removed :])


@pytest.mark.parametrize("golden", cases.GOLDEN, ids=lambda golden: golden.name)
def test_every_changed_byte_of_a_golden_payload_is_refused_or_a_finite_message(golden):
    for at in range(len(golden.payload)):
        for value in (0x00, 0x7F, 0x80, 0x9F, 0xC0, 0xC1, 0xC3, 0xCF, 0xDD, 0xDF, 0xFF, golden.payload[at] ^ 1):
            changed = bytearray(golden.payload)
            changed[at] = value
            if refusal_of(bytes(changed)) is None:
                assert_finite(decode(bytes(changed)))


def assert_finite(message: Message) -> None:
    for field in dataclasses.fields(message):
        value = getattr(message, field.name)
        for number in value if isinstance(value, tuple) else (value,):
            assert not isinstance(number, float) or math.isfinite(number)


@pytest.mark.parametrize("golden", cases.GOLDEN, ids=lambda golden: golden.name)
def test_no_beginning_of_a_payload_is_a_message(golden):
    for size in range(len(golden.payload)):
        assert refusal_of(golden.payload[:size]) is not None


@pytest.mark.parametrize(("case", "reason"), [(case, case["reason"]) for _, case in CORPUS], ids=[n for n, _ in CORPUS])
def test_the_corpus_is_refused_for_the_reason_on_record(case, reason):
    assert refusal_of(case["bytes"]) in case.get("either", [reason])


def test_the_corpus_holds_every_reason():
    assert {case["reason"] for _, case in CORPUS} == set(REFUSALS)


def test_integers_are_taken_as_numbers():
    values = msgpack.unpackb(encode(SAMPLE))
    values[-1] = [1, 2, 3]
    message = decode(msgpack.packb(values))
    assert isinstance(message, MagnetometerSample)
    assert [type(component) for component in message.field_body_nt] == [float] * 3
    assert message == SAMPLE


def test_whole_numbers_in_a_record_are_sent_as_doubles():
    assert encode(dataclasses.replace(SAMPLE, field_body_nt=(1, 2, 3))) == encode(SAMPLE)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"field_body_nt": (math.nan, 0.0, 0.0)}, "not_finite"),
        ({"field_body_nt": (1e6, 1e6, 0.0)}, "out_of_range"),
        ({"field_body_nt": (10**400, 0.0, 0.0)}, "out_of_range"),
        ({"field_body_nt": (1.0, 2.0)}, "wrong_shape"),
        ({"field_body_nt": None}, "wrong_type"),
        ({"craft": "two words"}, "bad_name"),
        ({"craft": "\ud800"}, "bad_name"),
        ({"sequence": 2**32}, "out_of_range"),
        ({"sequence": True}, "wrong_type"),
        ({"time_ns": 10**30}, "out_of_range"),
        ({"time_ns": 1.0}, "wrong_type"),
        ({"clock": "gps"}, "wrong_type"),
        ({"clock": 1}, "wrong_type"),
        ({"clock": []}, "wrong_type"),
    ],
    ids=str,
)
def test_what_a_receiver_would_refuse_cannot_be_sent(changes, reason):
    with pytest.raises(DecodeError) as caught:
        encode(dataclasses.replace(SAMPLE, **changes))
    assert caught.value.reason == reason


@pytest.mark.parametrize(
    ("message", "reason"),
    [
        (ReferenceSample(craft="c", source="s", sequence=0, time_ns=0), "wrong_shape"),
        (PositionSample(craft="c", source="s", sequence=0, time_ns=0, position_km=(1, 2, 3), frame=Frame.NED), None),
        (Status(**COMMON, uptime_s=1.0, verdict=Verdict.TRUSTED, counters={f"n{i}": i for i in range(129)}), None),
        (Status(**COMMON, uptime_s=1.0, verdict=Verdict.TRUSTED, counters={"a": -1}), "out_of_range"),
        (Status(**COMMON, uptime_s=1.0, verdict=Verdict.TRUSTED, text="\ud800"), "bad_text"),
        (Command(**COMMON, name="reset", arguments={"when": b"now"}), "wrong_type"),
        (Command(**COMMON, name="reset", arguments={1: 2}), "wrong_type"),
        (Message(**COMMON), "unknown_kind"),
        ("a text", "unknown_kind"),
    ],
    ids=lambda value: type(value).__name__,
)
def test_no_kind_sends_what_its_receiver_would_refuse(message, reason):
    expected = reason or {"PositionSample": "unknown_choice", "Status": "wrong_shape"}[type(message).__name__]
    with pytest.raises(DecodeError) as caught:
        encode(message)
    assert caught.value.reason == expected


def test_the_largest_status_fills_the_payload_and_no_more():
    counters = {f"{'n' * 61}{i:03d}": 2**53 - 1 for i in range(128)}
    largest = Status(**COMMON, uptime_s=1e12, verdict=Verdict.DOUBTFUL, counters=counters, text="t" * 512)
    assert 10000 < len(encode(largest)) <= MAX_PAYLOAD_BYTES


@pytest.mark.parametrize(("size", "too_large"), [(MAX_PAYLOAD_BYTES, False), (MAX_PAYLOAD_BYTES + 1, True)])
def test_a_payload_is_refused_for_its_size_from_one_byte_beyond_the_largest_on(size, too_large):
    assert MAX_PAYLOAD_BYTES == 10240
    assert (refusal_of(b"\xc1" * size) == "too_large") is too_large


def test_the_largest_estimate_fits():
    largest = Estimate(
        **COMMON,
        method="m" * 32,
        tick=2**53 - 1,
        bias_nt=(1.0, 2.0, 3.0),
        D=(1.0,) * 6,
        covariance=(1.0,) * 45,
        verdict=Verdict.DOUBTFUL,
        reasons=("r" * 32,) * 16,
        remedy="t" * 512,
        samples_used=2**53 - 1,
    )
    assert decode(encode(largest)) == largest


def test_the_largest_command_fits():
    largest = Command(**COMMON, name="n" * 32, arguments={f"{'a' * 31}{i}": "t" * 256 for i in range(8)})
    assert decode(encode(largest)) == largest


def test_a_refusal_names_the_field_the_value_and_what_is_accepted():
    with pytest.raises(DecodeError, match=r"out_of_range: sequence is -1; a whole number from 0 to 4294967295"):
        encode(dataclasses.replace(SAMPLE, sequence=-1))


@given(cases.messages)
@settings(max_examples=50, deadline=None)
def test_the_kind_of_a_message_is_the_second_value_of_its_payload(message):
    assert msgpack.unpackb(encode(message))[1] == kind_of(message).code


@pytest.mark.parametrize("name", ["calibrated", "estimate"])
def test_a_protection_level_is_appended_and_what_has_none_is_what_older_senders_send(name):
    golden = next(one for one in cases.GOLDEN if one.name == name)
    assert (golden.message.protection_nt, golden.message.protection_by) == (None, None)
    protected = dataclasses.replace(golden.message, protection_nt=80.5, protection_by="bias_step")
    values = [*msgpack.unpackb(golden.payload), 80.5, "bias_step"]
    assert msgpack.unpackb(encode(protected)) == values
    assert decode(msgpack.packb([*values[:-2], None, None])) == golden.message
    assert refusal_of(msgpack.packb(values[:-1])) == "wrong_shape"
    assert refusal_of(msgpack.packb([*values, None])) == "wrong_shape"
