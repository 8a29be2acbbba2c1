"""A session file is what the MCAP format's own readers, and the JSON schemas in it, say it is."""

from __future__ import annotations

import io
import json
import tracemalloc
from collections import Counter
from pathlib import Path

import jsonschema
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.reader import SeekingReader, make_reader
from mcap.records import SummaryOffset
from mcap.stream_reader import StreamReader

from magcal_service.base.errors import DecodeError
from magcal_service.recordings.json_form import from_json, schema_name, schema_of, to_json
from magcal_service.recordings.mcap import RawMessage, Topic
from magcal_service.recordings.mcap_reader import McapReader
from magcal_service.recordings.mcap_writer import McapWriter
from magcal_service.wire.kinds import KINDS, kind_of
from magcal_service.wire.messages import Message
from tests.recordings.sessions import command, record, stream
from tests.wire.wire_cases import messages


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Every kind that a service receives or sends, in several chunks."""
    first, *rest = stream(120, "hot-electronics", "paper")
    (file,) = record(tmp_path_factory.mktemp("rec"), [first, command("status"), *rest], flush_s=0.0005)
    return file


def test_the_formats_own_seeking_reader_finds_every_message(session: Path) -> None:
    with session.open("rb") as file:
        own = Counter(raw.topic.name for raw in McapReader(file, "session").messages())
    with session.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        assert isinstance(reader, SeekingReader)
        found = Counter(channel.topic for _, channel, _ in reader.iter_messages())
        summary = reader.get_summary()
    assert found == own
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == own.total()
    assert summary.statistics.chunk_count > 1
    assert {f"/magcal/paper/{name}" for name in ("magnetometer", "reference", "telemetry", "command")} <= set(own)
    assert {f"/magcal/paper/{name}" for name in ("calibrated", "estimate", "status", "reply")} <= set(own)


def test_the_formats_own_reader_confirms_every_checksum(session: Path) -> None:
    with session.open("rb") as file:
        assert sum(1 for _ in StreamReader(file, validate_crcs=True).records) > 0


def test_summary_offsets_span_the_records_of_their_kind_and_no_others(session: Path) -> None:
    """Each group is whole records of its opcode: one byte of opcode and eight of length before the content."""
    content = session.read_bytes()
    with session.open("rb") as file:
        offsets = [one for one in StreamReader(file).records if isinstance(one, SummaryOffset)]
    assert len(offsets) >= 4
    for offset in offsets:
        at, end = offset.group_start, offset.group_start + offset.group_length
        while at < end:
            assert content[at] == offset.group_opcode
            at += 9 + int.from_bytes(content[at + 1 : at + 9], "little")
        assert at == end
        assert content[end] != offset.group_opcode


def test_every_message_is_valid_by_the_schema_beside_it(session: Path) -> None:
    with session.open("rb") as file:
        found = list(make_reader(file).iter_messages())
    schemas = {schema.name: schema for schema, _, _ in found if schema is not None}
    validators = {name: jsonschema.Draft202012Validator(json.loads(schema.data)) for name, schema in schemas.items()}
    for schema, channel, message in found:
        assert schema is not None
        assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
        validators[schema.name].validate(json.loads(message.data))


def test_log_time_is_the_order_of_recording(session: Path) -> None:
    with session.open("rb") as file:
        times = [raw.log_time_ns for raw in McapReader(file, "session").messages()]
    assert times == sorted(times)


def test_publish_time_is_the_source_time_where_that_is_utc(session: Path) -> None:
    sent = [message.time_ns for message in stream(120, "hot-electronics", "paper")]
    with session.open("rb") as file:
        raws = [
            raw for raw in McapReader(file, "session").messages() if raw.topic.kind in ("magnetometer", "reference")
        ]
    assert {raw.publish_time_ns for raw in raws} <= set(sent)


def test_the_file_says_what_made_it(session: Path) -> None:
    with session.open("rb") as file:
        reader = make_reader(file)
        metadata = {entry.name: entry.metadata for entry in reader.iter_metadata()}
    assert set(metadata) == {"magcal.session", "magcal.craft"}
    assert {"session", "part", "magcal", "wire_schema", "configuration_sha256"} <= set(metadata["magcal.session"])
    assert 'name = "paper"' in metadata["magcal.craft"]["configuration"]


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_each_kinds_schema_is_a_schema(kind) -> None:  # type: ignore[no-untyped-def]
    jsonschema.Draft202012Validator.check_schema(schema_of(kind))


@settings(max_examples=200, suppress_health_check=[HealthCheck.too_slow])
@given(messages)
def test_any_message_comes_back_from_json_bit_for_bit(message: Message) -> None:
    data = to_json(message)
    assert repr(from_json(kind_of(message), data)) == repr(message)  # repr tells -0.0 from 0.0
    jsonschema.validate(json.loads(data), schema_of(kind_of(message)))


def test_a_day_of_chunks_is_remembered_in_three_megabytes() -> None:
    kinds = [kind_of(message) for message in stream(2)[:2]]
    topics = [Topic(name, kind.name, schema_name(kind), b"{}") for kind in kinds for name in "ab"]
    with open("/dev/null", "wb", buffering=0) as file:
        writer = McapWriter(file, "test")
        tracemalloc.start()
        for number in range(2000):
            for topic in topics:
                writer.add(RawMessage(topic, number, number, number, b"{}"))
            writer.end_chunk()
        held, _ = tracemalloc.get_traced_memory()
        tracemalloc.stop()
    assert held / 2000 * 86_400 / 5 < 3e6


GOOD = {
    "timestamp": {"sec": 1, "nsec": 2},
    "clock": "utc",
    "craft": "a",
    "source": "m",
    "sequence": 3,
    "field_body_nt": [1.0, 2.0, 3.0],
}
BAD = {
    "no JSON": (b"{", "not_json"),
    "no UTF-8": (b"\xff", "not_json"),
    "no object": (b"[]", "wrong_shape"),
    "nested without end": (b"[" * 100_000, "not_json"),
    "missing": (json.dumps({k: v for k, v in GOOD.items() if k != "sequence"}).encode(), "wrong_shape"),
    "unknown": (json.dumps(GOOD | {"more": 1}).encode(), "wrong_shape"),
    "not finite": (json.dumps(GOOD | {"field_body_nt": [float("nan"), 0, 0]}).encode(), "not_finite"),
    "too large": (json.dumps(GOOD | {"field_body_nt": [2e6, 0, 0]}).encode(), "out_of_range"),
    "unknown clock": (json.dumps(GOOD | {"clock": "gps"}).encode(), "wrong_type"),
    "time a text": (json.dumps(GOOD | {"timestamp": "now"}).encode(), "wrong_shape"),
    "time beyond": (json.dumps(GOOD | {"timestamp": {"sec": 1 << 40, "nsec": 0}}).encode(), "out_of_range"),
    "nsec beyond": (json.dumps(GOOD | {"timestamp": {"sec": 1, "nsec": 1 << 31}}).encode(), "wrong_shape"),
}


@pytest.mark.parametrize(("data", "reason"), BAD.values(), ids=BAD)
def test_what_is_no_message_is_refused_with_its_reason(data: bytes, reason: str) -> None:
    with pytest.raises(DecodeError) as refusal:
        from_json(KINDS[0], data)
    assert refusal.value.reason == reason


def packed(kinds: list[Message]) -> bytes:
    file = io.BytesIO()
    writer = McapWriter(file, "test")
    for message in kinds:
        kind = kind_of(message)
        topic = Topic(message.craft, kind.name, schema_name(kind), b"{}")
        writer.add(RawMessage(topic, message.sequence, 5, 6, to_json(message)))
    writer.finish()
    return file.getvalue()


@settings(max_examples=30, suppress_health_check=[HealthCheck.too_slow])
@given(st.lists(messages, min_size=1, max_size=5))
def test_any_messages_come_back_from_a_file_in_order(given_messages: list[Message]) -> None:
    reader = McapReader(io.BytesIO(packed(given_messages)), "file")
    assert [raw.data for raw in reader.messages()] == [to_json(message) for message in given_messages]
    assert reader.sound
