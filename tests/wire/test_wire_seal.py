"""A sealed command passes once, unaltered, and never again."""

from __future__ import annotations

import json
import re
import runpy
import shutil
import subprocess
from pathlib import Path

import pytest
import wire_cases as cases
from hypothesis import given
from hypothesis import strategies as st

from magcal_service.base.errors import DecodeError
from magcal_service.wire.codec import encode
from magcal_service.wire.framing import FRAME_REFUSALS, FrameEncoder, StreamDecoder, pack_frame
from magcal_service.wire.messages import REFUSALS, Command
from magcal_service.wire.seal import SEAL_REFUSALS, SEALED, SealGate, seal, split

HERE = Path(__file__).parent
SPECIFICATION = (HERE.parents[1] / "docs" / "wire.md").read_text(encoding="utf-8")
GOLDEN = json.loads((HERE / "golden/sealed/command_sealed.json").read_text(encoding="utf-8"))
KEY, COUNTER = bytes.fromhex(GOLDEN["key_hex"]), GOLDEN["counter"]
FRAME, CONTENT = bytes.fromhex(GOLDEN["frame_hex"]), bytes.fromhex(GOLDEN["content_hex"])
COMMAND = next(golden.message for golden in cases.GOLDEN if golden.name == "command")
PAYLOAD = encode(COMMAND)


class Line:
    """A receiving end with a key; ``kept`` holds each counter that it stored."""

    def __init__(self, last: int | None = 0, *, disk_full: bool = False) -> None:
        self.kept: list[int] = []
        self.refused: list[tuple[Command, str]] = []
        self._disk_full = disk_full
        gate = SealGate(KEY, last, self._keep)
        self.decoder = StreamDecoder(None, gate, lambda command, error: self.refused.append((command, error.reason)))

    def _keep(self, counter: int) -> None:
        if self._disk_full:
            raise OSError(28, "No space left on device")
        self.kept.append(counter)

    def takes(self, counter: int, key: bytes = KEY, payload: bytes = PAYLOAD) -> bool:
        return bool(self.decoder.feed(pack_frame(32 | SEALED, seal(key, counter, payload), 0)))


def test_the_golden_frame_is_what_the_encoder_makes():
    """Sealing the golden command gives the golden bytes."""
    encoder = FrameEncoder(lambda payload: seal(KEY, COUNTER, payload))
    for _ in range(GOLDEN["frame_sequence"]):
        encoder.encode(cases.SAMPLE.message)
    assert encoder.encode(COMMAND) == FRAME


def test_the_golden_frame_gives_its_command_once():
    """The golden frame passes, and the same bytes again do not."""
    line = Line()
    assert line.decoder.feed(FRAME) == [COMMAND]
    assert line.decoder.feed(FRAME) == []
    assert (line.kept, line.refused) == ([COUNTER], [(COMMAND, "replayed")])


def test_the_script_makes_the_golden_frame():
    """The second road, which knows nothing of the project, gives the same file."""
    made = runpy.run_path(str(HERE / "golden" / "make_golden.py"))["all_sealed"]()
    assert made == {"command_sealed": GOLDEN}


@pytest.mark.skipif(shutil.which("openssl") is None, reason="openssl is not installed")
def test_against_the_hmac_of_openssl():
    """OpenSSL gives the same tag."""
    command = ["openssl", "dgst", "-sha256", "-mac", "HMAC", "-macopt", f"hexkey:{KEY.hex()}", "-binary"]
    data = b"magcal sealed command 1\0" + CONTENT[:-16]
    assert subprocess.run(command, input=data, capture_output=True, check=True, timeout=30).stdout[:16] == CONTENT[-16:]


def test_the_specification_prints_the_golden_frame():
    """docs/wire.md has the bytes."""
    section = SPECIFICATION.split("\n### `command_sealed`\n")[1]
    for block, data in (("content", CONTENT), ("frame", FRAME)):
        assert bytes.fromhex(section.split(f"```{block}\n")[1].split("```")[0]) == data


def test_the_specification_lists_the_reasons_in_the_order_of_the_code():
    """Each reason stands once, among the seal's."""
    section = SPECIFICATION.split("\n## Sealed commands\n")[1].split("\n## ")[0]
    assert tuple(re.findall(r"^\| `(\w+)` \|", section, re.MULTILINE)) == SEAL_REFUSALS
    assert not set(SEAL_REFUSALS) & {*FRAME_REFUSALS, *REFUSALS}


@given(st.integers(0, 8 * len(CONTENT) - 1))
def test_one_flipped_bit_breaks_the_seal(bit):
    """Counter, payload and tag: a change of any bit, with the frame's checksum made right again, is refused."""
    altered = bytearray(CONTENT)
    altered[bit // 8] ^= 1 << bit % 8
    line = Line()
    assert line.decoder.feed(pack_frame(32 | SEALED, bytes(altered), 0)) == []
    assert line.kept == []
    assert sum(line.decoder.counters[f"refused.{reason}"] for reason in (*SEAL_REFUSALS, *REFUSALS)) == 1


@given(st.lists(st.integers(1, 20), max_size=30))
def test_a_counter_passes_exactly_when_it_is_above_all_before(counters):
    """Whatever the order, the accepted counters rise, and none passes that could not."""
    line, highest = Line(), 0
    for counter in counters:
        assert line.takes(counter) == (counter > highest)
        highest = max(highest, counter)
    assert line.kept == sorted(set(line.kept))


@pytest.mark.parametrize(
    ("line", "counter", "key", "reason"),
    [
        (Line(), 1, KEY[:-1] + b"x", "bad_seal"),
        (Line(last=57), 57, KEY, "replayed"),
        (Line(last=None), 1, KEY, "not_kept"),
        (Line(disk_full=True), 1, KEY, "not_kept"),
    ],
)
def test_a_refused_command_is_counted_and_told(line, counter, key, reason):
    """Another key, an old counter, and a counter that cannot be known or stored each have their reason."""
    assert not line.takes(counter, key)
    assert line.refused == [(COMMAND, reason)]
    assert line.decoder.counters[f"refused.{reason}"] == 1


def test_a_command_that_could_not_be_stored_may_come_again():
    """A full disk refuses a command and does not use its counter up."""
    line = Line(disk_full=True)
    assert not line.takes(5)
    line._disk_full = False
    assert line.takes(5)


def test_with_a_key_an_unsealed_command_is_refused():
    """Leaving the seal away is no way in."""
    line = Line()
    assert line.decoder.feed(pack_frame(32, PAYLOAD, 0)) == []
    assert line.refused == [(COMMAND, "unsealed")]


def test_without_a_key_a_sealed_command_is_refused_and_told():
    """An end that cannot check a seal does not act on it."""
    refused: list[str] = []
    decoder = StreamDecoder(None, None, lambda _, error: refused.append(error.reason))
    assert decoder.feed(FRAME) == []
    assert refused == ["no_key"]


def test_with_a_key_samples_pass_as_ever():
    """Only commands are sealed."""
    assert Line().decoder.feed(cases.SAMPLE.frame) == [cases.SAMPLE.message]


def test_a_sealed_sample_is_no_frame_of_ours():
    """A seal around anything but a command is refused."""
    line = Line()
    assert line.decoder.feed(pack_frame(1 | SEALED, seal(KEY, 1, cases.SAMPLE.payload), 0)) == []
    assert line.decoder.counters["refused.wrong_kind"] == 1


def test_the_header_cannot_pass_a_sealed_command_off_as_another_kind():
    """The kind in the header has to be the payload's."""
    line = Line()
    assert line.decoder.feed(pack_frame(33 | SEALED, seal(KEY, 1, PAYLOAD), 0)) == []
    assert (line.kept, line.decoder.counters["refused.wrong_kind"]) == ([], 1)


@given(st.binary(max_size=23))
def test_what_is_too_short_for_a_seal_is_refused(content):
    """No counter and tag, no seal."""
    with pytest.raises(DecodeError, match="bad_seal"):
        split(content)


@given(st.binary(max_size=200))
def test_no_bytes_under_a_seal_stop_the_decoder(content):
    """Whatever a sealed frame holds, the next good one passes."""
    line = Line()
    assert line.decoder.feed(pack_frame(32 | SEALED, content, 0)) == []
    assert line.decoder.feed(FRAME) == [COMMAND]
