"""Lines of a log without reading all of it: its head, its tail and some between; what is no text is refused."""

from __future__ import annotations

import gzip
import io
import re
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, Final

from magcal_service.base.errors import Fault, FileFault, Lacking, RecordingError
from magcal_service.recordings.describe.foreign import of_binary
from magcal_service.recordings.log_text import log_text

_WHOLE_BYTES: Final = 1 << 21
"""2 MiB: up to here a log is read whole, in well under a second."""

_HEAD_BYTES: Final = 1 << 19  # some thousand rows that follow on each other
_BETWEEN_BYTES: Final = 1 << 16  # some hundred rows
_BETWEEN: Final = 14  # stretches between head and tail, evenly
_LONGEST_LINE: Final = 1 << 16  # characters; a row of a thousand columns has a fifth of that
_SHOWN: Final = 16  # bytes of a binary log: enough to know its maker by
_LONGEST_FIELD: Final = 80  # characters of a line that are shown
_CONTROL: Final = re.compile(r"[\x00-\x08\x0e-\x1a\x1c-\x1f]")
_MAX_CONTROL: Final = 0.01  # share of control characters in a text: a serial line's noise, but not a binary file
_DESCRIBED: Final = (".toml", ".mcap")


@dataclass(frozen=True, slots=True)
class Stretch:
    """Consecutive lines of a log; ``first`` is the number of the first, from 1, or 0 where it is not known."""

    first: int
    lines: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Sample:
    """What was read of a log.

    Parameters
    ----------
    path: the log.
    size: bytes of the file as it lies on the disk.
    whole: whether every line is here.
    stretches: the head first, then what was read further on, in the file's order.
    """

    path: Path
    size: int
    whole: bool
    stretches: tuple[Stretch, ...]

    @property
    def head(self) -> tuple[str, ...]:
        """The log's first lines."""
        return self.stretches[0].lines


def read_sample(path: Path) -> Sample:
    """Read a log's head, its tail and stretches between; raises ``RecordingError`` for what is no text in lines."""
    if path.is_dir():
        raise RecordingError([FileFault.of_folder(str(path), "give the log itself, a text file of rows")])
    if path.suffix.lower() in _DESCRIBED:
        raise _refused(
            path,
            path.suffix,
            "a raw log is described; magcal calibrate takes a session, or the descriptor of a log, as it is",
        )
    try:
        size = path.stat().st_size
        if not path.is_file():
            raise _refused(path, "no plain file", "give the log itself, a text file of rows")
        pieces, whole = _pieces(path, size)
    except OSError as exc:
        raise RecordingError([FileFault(str(path), exc, "give a readable log")]) from None
    except (EOFError, zlib.error) as exc:
        raise _refused(path, str(exc), "give a readable log") from None
    if not any(piece.strip() for piece in pieces):
        raise RecordingError([Lacking(str(path), "this file is empty", "a log with a row a line is accepted")])
    for piece in pieces:
        _refuse_binary(path, piece)
    return Sample(path, size, whole, _stretches(path, pieces, whole))


def _refused(path: Path, value: str, accepted: str) -> RecordingError:
    return RecordingError([Fault(str(path), value, accepted)])


def _pieces(path: Path, size: int) -> tuple[list[bytes], bool]:
    """Bytes of the head and of what follows, and whether they are all; of a packed log only the head."""
    if path.suffix.lower() == ".gz":
        with gzip.open(path) as packed:
            head = packed.read(_WHOLE_BYTES + 1)
        return [head], len(head) <= _WHOLE_BYTES
    with path.open("rb") as stream:
        if size <= _WHOLE_BYTES:
            return [stream.read(_WHOLE_BYTES)], True
        return _samples(stream, size), False


def _samples(stream: BinaryIO, size: int) -> list[bytes]:
    pieces = [stream.read(_HEAD_BYTES)]
    room = size - _HEAD_BYTES - _BETWEEN_BYTES
    for number in range(1, _BETWEEN + 2):  # the last one is the tail
        stream.seek(_HEAD_BYTES + room * number // (_BETWEEN + 1), io.SEEK_SET)
        pieces.append(stream.read(_BETWEEN_BYTES))
    return pieces


def _refuse_binary(path: Path, piece: bytes) -> None:
    if piece.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise _refused(
            path,
            "UTF-16 text",
            "UTF-8 is accepted; save the log as UTF-8 (or plain CSV), as by iconv -f UTF-16 -t UTF-8",
        )
    at = piece.find(b"\x00")
    if at >= 0:
        raise _refused(path, f"a NUL byte after {piece[:_SHOWN]!r}" if at else "a NUL byte", of_binary(path, piece))
    text = piece.decode("utf-8", errors="replace")
    if len(_CONTROL.findall(text)) + text.count("\ufffd") > _MAX_CONTROL * len(text) + 8:
        raise _refused(path, f"binary data {piece[:_SHOWN]!r}", of_binary(path, piece))


def _stretches(path: Path, pieces: list[bytes], whole: bool) -> tuple[Stretch, ...]:
    stretches = []
    for number, piece in enumerate(pieces):
        text = log_text(piece, begins=number == 0)
        lines = re.split("\r*\n|\r", text)
        if max(map(len, lines)) > _LONGEST_LINE:
            longest = next(line for line in lines if len(line) > _LONGEST_LINE)
            value = f"a line of more than {_LONGEST_LINE} characters: {longest[:_LONGEST_FIELD]!r} ..."
            raise _refused(path, value, "text with a row a line is accepted")
        if number > 0:
            lines = lines[1:]  # begins somewhere within
        if not whole:
            lines = lines[:-1]  # ends somewhere within
        stretches.append(Stretch(1 if number == 0 else 0, tuple(lines)))
    if sum(1 for stretch in stretches for line in stretch.lines if line.strip()) < 2:
        accepted = "a log with a row a line, two rows at least, is accepted"
        raise _refused(path, "one line", accepted)
    return tuple(stretches)
