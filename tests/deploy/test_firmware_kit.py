"""The C kit for boards reads and writes the same messages as the daemon, and counts the same refusals."""

from __future__ import annotations

import importlib
import math
import random
import re
import runpy
import shutil
import struct
import subprocess
import sys
from collections import Counter
from collections.abc import Mapping
from dataclasses import fields
from enum import StrEnum
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from magcal_service.base.errors import DecodeError
from magcal_service.wire.codec import decode, encode
from magcal_service.wire.framing import FrameEncoder, StreamDecoder, pack_frame
from magcal_service.wire.kinds import FIRST_RESULT, MAX_COUNTERS, kind_of
from magcal_service.wire.messages import (
    Clock,
    Command,
    CommandReply,
    Estimate,
    Message,
    Status,
    TelemetrySample,
    Verdict,
)
from magcal_service.wire.seal import SEALED, seal
from tests.fuzz.mutate import mutate

ROOT = Path(__file__).parents[2]
KIT = ROOT / "deploy" / "firmware"
sys.path.insert(0, str(ROOT / "tests" / "wire"))
cases = importlib.import_module("wire_cases")
CC = shutil.which("cc")
needs_cc = pytest.mark.skipif(CC is None, reason="no C compiler (cc) here")
STRICT = ["-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wshadow", "-Werror"]
WHOLE = 10290  # bytes that hold whatever is no oversize, as the daemon's own decoder does
KEY = bytes(range(32))
COUNTER = 1764547200


def built(folder: Path, *flags: str) -> Path:
    """The driver, with the compiler's own watch over addresses and arithmetic where it has its library."""
    program = folder / "kit"
    plain = [str(CC), *STRICT, *flags, f"-I{KIT}", str(Path(__file__).with_name("firmware_kit.c")), "-o", str(program)]
    watched = subprocess.run([*plain, "-fsanitize=address,undefined", "-fno-sanitize-recover"], capture_output=True)
    if watched.returncode:
        subprocess.run(plain, check=True, capture_output=True)
    return program


@pytest.fixture(scope="module")
def kit(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return built(tmp_path_factory.mktemp("kit"))


def run(program: Path, line: bytes, capacity: int = WHOLE) -> tuple[dict[str, list[str]], Counter[str]]:
    """What the driver prints for the bytes of a line, by its first word, and its counts."""
    command = [str(program), str(capacity), KEY.hex(), str(COUNTER)]
    result = subprocess.run(command, input=line, capture_output=True, timeout=60)
    assert result.returncode == 0, result.stderr.decode()
    told: dict[str, list[str]] = {"message": [], "frame": [], "sealed": [], "refused": [], "count": []}
    for row in result.stdout.decode().splitlines():
        what, _, rest = row.partition(" ")
        told[what].append(rest)
    counts = (row.split() for row in told["count"])
    return told, Counter({name: int(value) for name, value in counts})


def shown(message: Message) -> str:
    """A message as the driver prints it: of the kinds that boards send only what all kinds share."""
    kind = kind_of(message)
    common, own = ("craft", "source", "sequence", "time_ns", "clock"), [field.name for field in kind.own]
    names = (*common, *own) if kind.code >= FIRST_RESULT and not isinstance(message, Command) else common
    assert {field.name for field in fields(message)} >= set(names)
    return " ".join([str(kind.code), *(word for name in names for word in _words(getattr(message, name)))])


def _words(value: Any) -> list[str]:
    if value is None:
        return ["-"]
    if isinstance(value, StrEnum):
        return [str(list(type(value)).index(value))]
    if isinstance(value, str):
        return ["'" + value.encode().hex()]
    if isinstance(value, float):
        return [struct.pack(">d", value).hex()]
    if isinstance(value, Mapping):
        return [str(len(value)), *(word for pair in value.items() for one in pair for word in _words(one))]
    if isinstance(value, tuple):
        counted = [str(len(value))] if all(isinstance(item, str) for item in value) else []
        return counted + [word for item in value for word in _words(item)]
    return [str(int(value))]


def test_the_generated_header_is_what_the_wire_s_tables_give():
    generator = runpy.run_path(str(KIT / "make_wire_header.py"))
    assert generator["header"]() == (KIT / "magcal_wire.h").read_text(encoding="utf-8")


@needs_cc
def test_the_kit_reads_every_golden_frame(kit):
    line = b"".join(golden.frame for golden in cases.GOLDEN)
    told, counts = run(kit, line)
    assert told["message"] == [shown(golden.message) for golden in cases.GOLDEN]
    assert told["refused"] == []
    assert counts["frames"] == len(cases.GOLDEN)


@needs_cc
def test_the_kit_refuses_the_corpus_of_lines_as_the_daemon_does(kit):
    for _, case in cases.corpus("stream"):
        decoder = StreamDecoder()
        messages = decoder.feed(case["bytes"])
        told, counts = run(kit, case["bytes"])
        assert (case["why"], counts) == (case["why"], decoder.counters)
        assert told["message"] == [shown(message) for message in messages]


@needs_cc
def test_the_kit_refuses_the_corpus_of_payloads_for_the_daemon_s_reasons(kit):
    corpus = [case for _, case in cases.corpus("payload") if case.get("reason") and len(case["bytes"]) <= 10240]
    told, _ = run(kit, b"".join(pack_frame(1, case["bytes"], 0) for case in corpus))
    expected = {case["why"]: case["reason"] for case in corpus}
    assert dict(zip(expected, told["refused"], strict=True)) == expected
    assert {"not_finite", "bad_text", "unknown_choice", "too_deep"} <= set(expected.values())


def _answer(payload: bytes) -> int | str:
    """The kind of a payload that the daemon accepts, or why it does not."""
    try:
        return kind_of(decode(payload)).code
    except DecodeError as error:
        return error.reason


@needs_cc
def test_the_kit_accepts_a_changed_payload_where_the_daemon_does(kit):
    rng, pool = random.Random(1), [golden.payload for golden in cases.GOLDEN]
    payloads = [mutate(rng, pool, [b"\xc0", b"\xcb", b"\xd9", b"\xdc"])[:10240] for _ in range(3000)]
    answers = [_answer(payload) for payload in payloads]
    kinds = [answer if isinstance(answer, int) else 1 for answer in answers]
    told, _ = run(kit, b"".join(map(pack_frame, kinds, payloads, range(3000))))
    accepted = [str(answer) for answer in answers if isinstance(answer, int)]
    assert len(accepted) > 100
    assert [row.split()[0] for row in told["message"]] == accepted
    refused = [answer for answer in answers if isinstance(answer, str)]
    alike = sum(here == there for here, there in zip(told["refused"], refused, strict=True))
    assert alike > 0.98 * len(refused)  # of two faults in one payload either may be found first


ascii_text = st.text(st.characters(min_codepoint=32, max_codepoint=126), max_size=256)
_sent_as_is = [strategy for name, strategy in cases.BY_KIND.items() if name not in ("telemetry", "command")]
_telemetry = st.builds(
    TelemetrySample,
    **cases._common,
    channel=cases.names,
    unit=ascii_text.map(lambda text: text[:32]),
    values=st.lists(cases.reals(1e18), min_size=1, max_size=16).map(tuple),
)
_arguments = st.one_of(st.booleans(), st.integers(-(2**63), 2**63 - 1), cases.reals(1e300), ascii_text)
_command = st.builds(
    Command, **cases._common, name=cases.names, arguments=st.dictionaries(cases.names, _arguments, max_size=8)
)


@needs_cc
@settings(max_examples=25, deadline=None, suppress_health_check=list(HealthCheck))
@given(messages=st.lists(st.one_of(*_sent_as_is, _telemetry, _command), min_size=10, max_size=30))
def test_the_kit_reads_all_messages_and_writes_what_a_board_sends(kit, messages):
    frames = [pack_frame(kind_of(message).code, encode(message), i) for i, message in enumerate(messages)]
    told, counts = run(kit, b"".join(frames))
    assert counts == {"frames": len(messages)}
    assert told["message"] == [shown(message) for message in messages]
    sent = [
        (i, message) for i, message in enumerate(messages) if kind_of(message).code < 16 or type(message) is Command
    ]
    assert told["frame"] == [frames[i].hex() for i, _ in sent]
    commands = [(i, encode(message)) for i, message in sent if isinstance(message, Command)]
    sealed = [pack_frame(32 | SEALED, seal(KEY, COUNTER, payload), i).hex() for i, payload in commands]
    assert told["sealed"] == sealed


def _noisy(line: bytes, rng: random.Random) -> bytes:
    """A line with bits flipped, bytes lost and rubbish between."""
    out = bytearray()
    for byte in line:
        chance = rng.random()
        if chance < 0.001:
            continue
        if chance < 0.002:
            out += rng.randbytes(rng.randint(1, 40))
        out.append(byte ^ (1 << rng.randrange(8)) if chance > 0.998 else byte)
    return bytes(out)


def _answers(count: int) -> list[Message]:
    chosen = [g.message for g in cases.GOLDEN if g.kind in ("calibrated", "estimate", "status", "reply")]
    return [chosen[i % len(chosen)] for i in range(count)]


@needs_cc
@pytest.mark.parametrize("seed", [1, 2])
def test_noise_costs_frames_and_is_counted_as_the_daemon_counts_it(kit, seed):
    encoder, messages = FrameEncoder(), _answers(1500)
    line = _noisy(b"".join(encoder.encode(message) for message in messages), random.Random(seed))
    decoder = StreamDecoder()
    expected = decoder.feed(line)
    told, counts = run(kit, line)
    assert told["message"] == [shown(message) for message in expected]
    assert 500 < len(expected) < 1400
    assert counts == decoder.counters


@needs_cc
def test_a_small_board_skips_a_long_status_and_reads_what_follows(kit):
    common = {"craft": "c", "source": "magcal", "time_ns": 0, "clock": Clock.UTC}
    long = Status(
        **common, sequence=1, uptime_s=1.0, verdict=Verdict.TRUSTED, counters={f"n{i}": i for i in range(MAX_COUNTERS)}
    )
    after = Status(**common, sequence=2, uptime_s=2.0, verdict=Verdict.TRUSTED)
    encoder = FrameEncoder()
    told, counts = run(kit, encoder.encode(long) + encoder.encode(after), capacity=200)
    assert told["message"] == [shown(after)]
    assert counts == {"frames": 2, "skipped": 1}


def test_the_decoder_s_usual_size_holds_the_longest_estimate_and_reply():
    name, text = "n" * 32, "t" * 512
    common = {"craft": name, "source": name, "sequence": 2**32 - 1, "time_ns": -(2**63), "clock": Clock.UTC}
    most = {"tick": 2**53 - 1, "samples_used": 2**53 - 1, "protection_nt": 0.1, "protection_by": name, "remedy": text}
    numbers = {"bias_nt": (0.1,) * 3, "D": (0.1,) * 6, "covariance": (0.1,) * 45}
    estimate = Estimate(**common, method=name, verdict=Verdict.DOUBTFUL, reasons=(name,) * 16, **numbers, **most)
    reply = CommandReply(**common, name=name, command_source=name, command_sequence=2**32 - 1, accepted=True, text=text)
    held = int(re.findall(r"#define MAGCAL_DECODER_BYTES (\d+)", (KIT / "magcal_decode.h").read_text())[0])
    assert max(len(encode(estimate)), len(encode(reply))) + 10 <= held


@needs_cc
def test_the_kit_in_single_precision_reads_float_64_to_its_own_resolution(tmp_path):
    program = built(tmp_path, "-DMAGCAL_SINGLE_PRECISION", "-ffast-math")
    golden = next(golden for golden in cases.GOLDEN if golden.name == "estimate")
    told, _ = run(program, golden.frame)
    assert isinstance(golden.message, Estimate)
    words = told["message"][0].split()
    bias = [struct.unpack(">d", bytes.fromhex(word))[0] for word in words[8:11]]
    assert bias == [_single(value) for value in golden.message.bias_nt]
    extremes = [1e-300, -1e-300, 0.1, -1e30, 3.0, 1.0 + 2.0**-24, 1.0 + 3 * 2.0**-24]
    sample = TelemetrySample(
        craft="c", source="s", sequence=0, time_ns=0, channel="x", unit="A", values=tuple(v / 1e13 for v in extremes)
    )
    told, _ = run(program, pack_frame(4, encode(sample), 0))
    back = StreamDecoder().feed(bytes.fromhex(told["frame"][0]))[0]
    assert back.values == tuple(_single(value) for value in sample.values)


def _single(value: float) -> float:
    return struct.unpack(">f", struct.pack(">f", value))[0] if abs(value) > 1e-37 else math.copysign(0.0, value)


@needs_cc
def test_the_kit_does_not_send_a_text_that_it_cannot_check(kit):
    common = {"craft": "c", "source": "s", "sequence": 0, "time_ns": 0}
    told, _ = run(kit, pack_frame(4, encode(TelemetrySample(**common, channel="t", unit="°C", values=(1.0,))), 0))
    assert told["frame"] == [""]
    told, _ = run(kit, pack_frame(32, encode(Command(**common, name="x", arguments={"note": "5°"})), 0))
    assert told["frame"] == [""] == told["sealed"]
