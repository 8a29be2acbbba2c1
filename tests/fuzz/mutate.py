"""Inputs from inputs: small and large changes of bytes and of what the bytes mean, all from one random stream."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from random import Random

from tests.fuzz.limits import LONGEST

Operation = Callable[[Random, bytes], bytes]

_NUMBER = re.compile(rb"-?\d+(?:\.\d+)?(?:[eE][+-]?\d+)?")
_NUMBERS = (
    b"0", b"-0.0", b"-1", b"1", b"2", b"1e-320", b"1e308", b"-1e308", b"1e400", b"nan", b"inf", b"-inf", b"NaN",
    b"Infinity", b"9223372036854775807", b"9223372036854775808", b"-9223372036854775809", b"18446744073709551616",
    b"4294967296", b"1" * 400, b"0x10", b"1_000", b"1e", b"0.1.2", b"", b"true", b'"1"', b"[1]",
)  # fmt: skip
_BYTES = (0, 1, 0x7F, 0x80, 0xFF, 0xC0, 0xC1, 0xCB, 0x90, 0x9F, 0xDC, 0xDD, ord('"'), ord("\n"), ord(","), ord("["))
_TEXTS = (
    b"\0", b"\xff\xfe", b"\xf0\x9f\x9b\xb0", b"\xed\xa0\x80", b"\xe2\x80\xae", b'"', b"'''", b'"""', b"\n", b"\r\n",
    b"#", b"=", b"[", b"]", b"[[", b"{", b"}", b",", b".", b"\\", b"\\u0000", b"\\ud800", b"../", b"/dev/zero", b"%s",
    b"\x1b[2J",
)  # fmt: skip


def mutate(rng: Random, pool: Sequence[bytes], tokens: Sequence[bytes], own: Sequence[Operation] = ()) -> bytes:
    """One new input.

    Parameters
    ----------
    pool: inputs to begin with.
    tokens: words that the reader knows.
    own: further operations, which keep what a reader checks first (lengths, checksums) right.
    """
    data = rng.choice(pool)
    for _ in range(1 if rng.random() < 0.5 else 2 + min(int(rng.expovariate(0.5)), 16)):
        choice = rng.random()
        if own and choice < 0.4:
            data = rng.choice(own)(rng, data)
        elif tokens and choice < 0.5:
            data = _insert(rng, data, rng.choice(tokens))
        elif choice < 0.55 and len(pool) > 1:
            data = _splice(rng, data, rng.choice(pool))
        else:
            data = rng.choice(OPERATIONS)(rng, data)
    return data[:LONGEST]


def _place(rng: Random, data: bytes) -> tuple[int, int]:
    """A slice, mostly a short one."""
    begin = rng.randrange(len(data) + 1)
    longest = rng.choice((1, 4, 16, 256, len(data)))
    return begin, min(len(data), begin + rng.randint(0, max(1, longest)))


def _insert(rng: Random, data: bytes, part: bytes) -> bytes:
    begin, end = _place(rng, data)
    return data[:begin] + part + data[end if rng.random() < 0.5 else begin :]


def _splice(rng: Random, data: bytes, other: bytes) -> bytes:
    begin, end = _place(rng, other)
    return _insert(rng, data, other[begin:end])


def _flip(rng: Random, data: bytes) -> bytes:
    if not data:
        return data
    changed = bytearray(data)
    changed[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    return bytes(changed)


def _set_byte(rng: Random, data: bytes) -> bytes:
    if not data:
        return data
    changed = bytearray(data)
    changed[rng.randrange(len(data))] = rng.choice(_BYTES) if rng.random() < 0.5 else rng.randrange(256)
    return bytes(changed)


def _delete(rng: Random, data: bytes) -> bytes:
    begin, end = _place(rng, data)
    return data[:begin] + data[end:]


def _repeat(rng: Random, data: bytes) -> bytes:
    begin, end = _place(rng, data)
    times = rng.choice((1, 1, 2, 8, 100, 5000))
    part = data[begin:end]
    return data[:end] + part[: LONGEST // max(1, times)] * times + data[end:]


def _cut(rng: Random, data: bytes) -> bytes:
    return data[: rng.randrange(len(data) + 1)]


def _noise(rng: Random, data: bytes) -> bytes:
    return _insert(rng, data, rng.randbytes(rng.choice((1, 2, 8, 64))))


def _text(rng: Random, data: bytes) -> bytes:
    return _insert(rng, data, rng.choice(_TEXTS))


def _number(rng: Random, data: bytes) -> bytes:
    """Another number, or something that is none, where a text has a number."""
    found = list(_NUMBER.finditer(data[:LONGEST]))
    if not found:
        return data
    at = rng.choice(found)
    return data[: at.start()] + rng.choice(_NUMBERS) + data[at.end() :]


def _lines(rng: Random, data: bytes) -> bytes:
    """A line of a text moved, doubled or dropped."""
    lines = data.split(b"\n")
    line = lines.pop(rng.randrange(len(lines)))
    for _ in range(rng.randrange(3)):
        lines.insert(rng.randrange(len(lines) + 1), line)
    return b"\n".join(lines)


def _word(rng: Random, data: bytes) -> bytes:
    """A 2, 4 or 8 byte number, either way round, at an edge of its range."""
    size = rng.choice((2, 4, 8))
    value = rng.choice((0, 1, 1 << 15, 1 << 24, 1 << 31, (1 << 63) - 1, (1 << 64) - 1)) % (1 << 8 * size)
    begin = rng.randrange(len(data) + 1)
    return data[:begin] + value.to_bytes(size, rng.choice(("little", "big"))) + data[begin + size :]


OPERATIONS: tuple[Operation, ...] = (
    _flip, _flip, _set_byte, _set_byte, _delete, _delete, _repeat, _cut, _noise, _text, _number, _number, _lines, _word,
)  # fmt: skip
