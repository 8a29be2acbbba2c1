"""The C encoder for microcontrollers writes the same bytes as the project, and refuses the same samples."""

from __future__ import annotations

import dataclasses
import math
import random
import shutil
import struct
import subprocess
from pathlib import Path

import pytest
import wire_cases as cases

from magcal_service.base.errors import DecodeError
from magcal_service.wire.codec import decode, encode
from magcal_service.wire.framing import StreamDecoder, pack_frame
from magcal_service.wire.kinds import kind_of
from magcal_service.wire.messages import Clock, Frame, MagnetometerSample, Message, ReferenceSample

HERE = Path(__file__).parent
FIRMWARE = HERE.parents[1] / "deploy" / "firmware"
CC = shutil.which("cc")
STRICT = ["-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Werror"]
needs_cc = pytest.mark.skipif(CC is None, reason="no C compiler (cc) here")
pytestmark = needs_cc


@pytest.fixture(scope="module")
def double_driver(tmp_path_factory):
    return _built(tmp_path_factory.mktemp("double"), ["-O2", "-fsanitize=undefined", "-fno-sanitize-recover"])


@pytest.fixture(scope="module")
def single_driver(tmp_path_factory):
    return _built(tmp_path_factory.mktemp("single"), ["-Os", "-ffast-math", "-DMAGCAL_SINGLE_PRECISION"])


def _built(folder: Path, flags: list[str]) -> Path:
    program = folder / "driver"
    plain = [CC, *STRICT, f"-I{FIRMWARE}", str(HERE / "firmware_driver.c"), "-o", str(program)]
    result = subprocess.run([*plain, *flags], capture_output=True, text=True)
    if result.returncode and "-fsanitize" in " ".join(flags) and "ubsan" in result.stderr:
        result = subprocess.run(plain, capture_output=True, text=True)  # a compiler without the sanitizer's library
    assert result.returncode == 0, result.stderr
    return program


def _line(message: Message, frame_sequence: int) -> str:
    axes, values = 0, (0.0, 0.0, 0.0)
    if isinstance(message, MagnetometerSample):
        form, values = "M", message.field_body_nt
    elif isinstance(message, ReferenceSample) and message.field_nt is not None:
        form, values, axes = "V", message.field_nt, list(Frame).index(message.frame)
    else:
        form, values = "S", (message.magnitude_nt, 0.0, 0.0)
    clock = list(Clock).index(message.clock)
    numbers = " ".join(struct.pack(">d", value).hex() for value in values)
    origin = f"{message.craft} {message.source} {message.sequence} {message.time_ns} {clock}"
    return f"{form} {frame_sequence} {origin} {axes} {numbers}"


def _frames(program: Path, lines: list[str]) -> list[str]:
    run = subprocess.run([str(program)], input="\n".join(lines) + "\n", capture_output=True, text=True, timeout=60)
    assert run.returncode == 0, run.stderr
    frames = run.stdout.split()
    assert len(frames) == len(lines)
    return frames


def _random_messages(seed: int, count: int) -> list[Message]:
    rng = random.Random(seed)
    return [_random_message(rng) for _ in range(count)]


def _random_message(rng: random.Random) -> Message:
    alphabet = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789_-"
    common = {
        "craft": "".join(rng.choices(alphabet, k=rng.randint(1, 32))),
        "source": "".join(rng.choices(alphabet, k=rng.choice([1, 4, 31, 32]))),
        "sequence": rng.getrandbits(rng.randint(0, 32)),
        "time_ns": rng.getrandbits(rng.randint(0, 63)) * rng.choice([1, -1]),
        "clock": rng.choice(list(Clock)),
    }
    field = tuple(rng.choice([rng.uniform(-5e5, 5e5), 0.0, -0.0, 5e-324, float(rng.randint(-9, 9))]) for _ in range(3))
    form = rng.randrange(3)
    if form == 0:
        return MagnetometerSample(**common, field_body_nt=field)
    if form == 1:
        return ReferenceSample(**common, field_nt=field, frame=rng.choice(list(Frame)))
    return ReferenceSample(**common, magnitude_nt=abs(field[0]))


GOLDEN = [golden for golden in cases.GOLDEN if golden.kind in ("magnetometer", "reference") and golden.canonical]


def test_the_golden_frames_hold_both_messages_in_all_forms():
    assert {golden.name for golden in GOLDEN} >= {"magnetometer", "reference_vector", "reference_magnitude"}


@pytest.mark.parametrize("golden", GOLDEN, ids=lambda golden: golden.name)
def test_the_firmware_writes_the_golden_frame(double_driver, golden):
    assert _frames(double_driver, [_line(golden.message, golden.frame_sequence)]) == [golden.frame.hex()]


def test_the_firmware_writes_the_golden_frame_in_single_precision(single_driver):
    golden = next(golden for golden in cases.GOLDEN if golden.name == "magnetometer_single")
    assert _frames(single_driver, [_line(golden.message, golden.frame_sequence)]) == [golden.frame.hex()]


def test_the_firmware_writes_what_the_project_writes_for_random_samples(double_driver):
    messages = _random_messages(seed=1, count=2000)
    lines = [_line(message, i) for i, message in enumerate(messages)]
    expected = [pack_frame(kind_of(m).code, encode(m), i).hex() for i, m in enumerate(messages)]
    assert _frames(double_driver, lines) == expected


WIDTH_EDGES = [
    edge for bits in (5, 7, 8, 15, 16, 31, 32) for edge in (2**bits - 1, 2**bits, -(2**bits), -(2**bits) - 1)
]


@pytest.mark.parametrize("time_ns", [0, 2**63 - 1, -(2**63), *WIDTH_EDGES])
def test_the_firmware_writes_integers_at_the_edges_of_their_widths(double_driver, time_ns):
    message = dataclasses.replace(BASE, time_ns=time_ns, sequence=time_ns & 0xFFFFFFFF)
    expected = pack_frame(1, encode(message), time_ns & 0xFFFF).hex()
    assert _frames(double_driver, [_line(message, time_ns & 0xFFFF)]) == [expected]


def test_the_daemon_reads_random_single_precision_frames(single_driver):
    messages = _random_messages(seed=2, count=500)
    frames = _frames(single_driver, [_line(message, i) for i, message in enumerate(messages)])
    decoder = StreamDecoder()
    received = decoder.feed(b"".join(bytes.fromhex(frame) for frame in frames))
    assert decoder.counters == {"frames": 500}
    assert received == [_in_single_precision(message) for message in messages]


def _in_single_precision(message: Message) -> Message:
    def rounded(value: float) -> float:
        return struct.unpack(">f", struct.pack(">f", value))[0] if abs(value) > 1e-40 else math.copysign(0.0, value)

    changes = {}
    for name in ("field_body_nt", "field_nt", "magnitude_nt"):
        value = getattr(message, name, None)
        if value is not None:
            changes[name] = tuple(map(rounded, value)) if isinstance(value, tuple) else rounded(value)
    return dataclasses.replace(message, **changes)


BASE = MagnetometerSample(craft="sat1", source="mag0", sequence=1, time_ns=5, field_body_nt=(1.0, 2.0, 3.0))
SCALAR = ReferenceSample(craft="sat1", source="mag0", sequence=1, time_ns=5, magnitude_nt=1.0)
REFUSED = [
    dataclasses.replace(BASE, craft="c" * 33),
    dataclasses.replace(BASE, source="a/b"),
    dataclasses.replace(BASE, source="ä"),
    dataclasses.replace(BASE, field_body_nt=(math.nan, 0.0, 0.0)),
    dataclasses.replace(BASE, field_body_nt=(0.0, math.inf, 0.0)),
    dataclasses.replace(BASE, field_body_nt=(0.0, 0.0, -math.inf)),
    dataclasses.replace(BASE, field_body_nt=(1000001.0, 0.0, 0.0)),
    dataclasses.replace(BASE, field_body_nt=(6e5, 6e5, 6e5)),
    dataclasses.replace(SCALAR, magnitude_nt=-1.0),
    dataclasses.replace(SCALAR, magnitude_nt=math.nan),
    dataclasses.replace(SCALAR, magnitude_nt=1000001.0),
]


@pytest.mark.parametrize("driver", ["double_driver", "single_driver"])
@pytest.mark.parametrize("message", REFUSED, ids=[f"case{i}" for i in range(len(REFUSED))])
def test_the_firmware_refuses_what_the_project_refuses(request, driver, message):
    with pytest.raises(DecodeError):
        encode(message)
    assert _frames(request.getfixturevalue(driver), [_line(message, 0)]) == ["-"]


@pytest.mark.parametrize("fields", ["M 0 sat1 mag0 1 5 2 0", "V 0 sat1 mag0 1 5 0 3", "V 0 sat1 mag0 1 5 0 -1"])
def test_the_firmware_refuses_a_clock_or_axes_that_do_not_exist(double_driver, fields):
    assert _frames(double_driver, [f"{fields} 0 0 0"]) == ["-"]


def test_the_readme_s_main_loop_compiles(tmp_path):
    readme = (FIRMWARE / "README.md").read_text(encoding="utf-8")
    source = tmp_path / "main.c"
    source.write_text(readme.split("```c\n")[1].split("```")[0], encoding="utf-8")
    command = [CC, *STRICT, f"-I{FIRMWARE}", "-c", str(source), "-o", str(tmp_path / "main.o")]
    result = subprocess.run(command, capture_output=True, text=True)
    assert result.returncode == 0, result.stderr


def test_the_limit_itself_is_accepted_on_both_sides(double_driver):
    message = dataclasses.replace(BASE, field_body_nt=(-1e6, 0.0, 0.0))
    assert decode(encode(message)) == message
    assert _frames(double_driver, [_line(message, 0)]) != ["-"]
