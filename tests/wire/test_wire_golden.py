"""The golden frames, the specification that prints them, and the code agree byte for byte."""

from __future__ import annotations

import json
import re
import runpy
import zlib
from pathlib import Path

import msgpack
import pytest
import wire_cases as cases
from cobs import cobs

from magcal_service.wire.codec import MAX_PAYLOAD_BYTES, decode, encode
from magcal_service.wire.framing import FRAME_REFUSALS, MAX_ENCODED_BYTES, StreamDecoder, pack_frame
from magcal_service.wire.keys import encoding_of, key_of
from magcal_service.wire.kinds import KINDS, kind_of
from magcal_service.wire.messages import REFUSALS

HERE = Path(__file__).parent
SPECIFICATION = (HERE.parents[1] / "docs" / "wire.md").read_text(encoding="utf-8")
CANONICAL = [golden for golden in cases.GOLDEN if golden.canonical]


MAKER = runpy.run_path(str(HERE / "golden" / "make_golden.py"))


def by_name(golden: cases.Golden) -> str:
    return golden.name


@pytest.mark.parametrize("golden", cases.GOLDEN, ids=by_name)
def test_a_golden_payload_decodes_to_its_message(golden):
    assert decode(golden.payload) == golden.message


@pytest.mark.parametrize("golden", CANONICAL, ids=by_name)
def test_a_golden_message_encodes_to_its_payload(golden):
    assert encode(golden.message) == golden.payload


@pytest.mark.parametrize("golden", cases.GOLDEN, ids=by_name)
def test_a_golden_payload_packs_into_its_frame(golden):
    assert pack_frame(kind_of(golden.message).code, golden.payload, golden.frame_sequence) == golden.frame


@pytest.mark.parametrize("golden", cases.GOLDEN, ids=by_name)
def test_a_golden_frame_gives_its_message(golden):
    assert StreamDecoder().feed(golden.frame) == [golden.message]


def test_every_kind_has_a_golden_frame():
    assert {golden.kind for golden in CANONICAL} == {kind.name for kind in KINDS}


@pytest.mark.parametrize("size", [0, 1, 253, 254, 255, 507, 508, 509, 762])
@pytest.mark.parametrize("ending", [b"", b"\0", b"\0\0", b"\0x"])
def test_against_the_cobs_library_around_its_block_size(size, ending):
    data = b"\xaa" * size + ending
    assert MAKER["cobs"](data) == cobs.encode(data)


def test_the_checksum_is_the_one_that_the_specification_names():
    assert MAKER["crc32"](b"123456789") == 0xCBF43926
    assert zlib.crc32(b"123456789") == 0xCBF43926


def test_the_script_beside_the_golden_frames_makes_them():
    made = MAKER["all_golden"]()
    kept = {path.stem: json.loads(path.read_text(encoding="utf-8")) for path in (HERE / "golden").glob("*.json")}
    assert made == kept


def printed(name: str, block: str) -> bytes:
    section = SPECIFICATION.split(f"\n### `{name}`\n")[1].split("\n### ")[0]
    return bytes.fromhex(section.split(f"```{block}\n")[1].split("```")[0])


@pytest.mark.parametrize("golden", cases.GOLDEN, ids=by_name)
def test_the_specification_prints_the_golden_frames(golden):
    assert printed(golden.name, "payload") == golden.payload
    assert printed(golden.name, "frame") == golden.frame


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_the_specification_lists_the_fields_of_each_kind_at_their_index(kind):
    section = SPECIFICATION.split(f"\n### {kind.code} {kind.name}\n")[1].split("\n### ")[0].split("\n## ")[0]
    common = SPECIFICATION.split("\n## Payload\n")[1].split("\n### ")[0]
    rows = re.findall(r"^\| (\d+) \| (\w+) \|", common + section, re.MULTILINE)
    names = ["schema_version", "kind", *(field.name for field in kind.fields)]
    assert rows == [(str(index), name) for index, name in enumerate(names)]


def test_the_specification_lists_every_refusal_in_the_order_of_the_code():
    section = SPECIFICATION.split("\n## Refusals\n")[1].split("\n## ")[0]
    assert re.findall(r"^\| `(\w+)` \|", section, re.MULTILINE) == [*REFUSALS, *FRAME_REFUSALS]


def test_the_sizes_in_the_specification_are_those_of_the_golden_frames():
    sizes = {golden.name: (len(golden.payload), len(golden.frame)) for golden in cases.GOLDEN}
    rows = re.findall(r"^\| `(\w+)` \| (\d+) \| (\d+) \| (\d+) \|$", SPECIFICATION, re.MULTILINE)
    assert len(rows) >= 9
    for name, payload, frame, rate in rows:
        assert (int(payload), int(frame)) == sizes[name]
        assert int(rate) == 11520 // int(frame)


def test_the_specification_states_the_limits_of_the_code():
    assert f"at most {MAX_PAYLOAD_BYTES} bytes" in SPECIFICATION
    assert f"holds at most {MAX_ENCODED_BYTES} bytes" in SPECIFICATION


@pytest.mark.parametrize("golden", cases.GOLDEN, ids=by_name)
def test_the_key_of_a_message_has_the_form_that_the_specification_gives_its_kind(golden):
    forms = re.findall(r"^\| `(magcal/v1/[^`]+)` \| (.+) \|$", SPECIFICATION, re.MULTILINE)
    (form,) = [form for form, carried in forms if f"`{golden.kind}`" in carried]
    craft, source = golden.message.craft, golden.message.source
    expected = form.replace("<craft>", craft).replace("<kind>", golden.kind).replace("<source>", source)
    assert key_of(golden.message) == expected


def test_the_encoding_names_the_kind():
    assert {encoding_of(kind) for kind in KINDS} == {f"application/msgpack;magcal.v1.{kind.name}" for kind in KINDS}


@pytest.mark.parametrize("golden", CANONICAL, ids=by_name)
def test_against_the_msgpack_library(golden):
    assert msgpack.packb(msgpack.unpackb(golden.payload)) == golden.payload
