"""The text of a TOML file into a ``Table``; refuses what would cost Python unbounded time, memory or recursion."""

from __future__ import annotations

import itertools
import re
import tomllib
from pathlib import Path

from magcal_service.base.errors import Fault, FileFault, InputRefusedError, Lacking
from magcal_service.base.typed_toml.table import Table

_MAX_FILE_BYTES = 1 << 20
"""1 MiB: thousands of craft fit in, and a log given by mistake is refused before it is parsed."""

_MAX_INTEGER_BITS = 1024  # a little more than a float holds: smaller ones are refused by the limits of their field

_MAX_LEVELS = 32
"""No file of ours nests more than six levels; Python's own recursion limit is some hundreds of frames away."""

_MAX_DOTS = 500
"""In one key: tomllib takes time that grows with their square, and no key of ours has more than two."""

_TOO_LARGE = f"a file of at most {_MAX_FILE_BYTES} bytes is accepted"

_AT = re.compile(r" \(at line (\d+), column (\d+)\)$")
_SHOWN = 80  # characters of a line that is no TOML

_HINTS = {
    re.compile(r'(?<!")""(?=[^"\s,\]}#])|[^"=\s,\[{]""(?!")'): "a text stands between one pair of quotes",
    re.compile("[\u201c\u201d]"): "a text stands between straight quotes",
}
"""What is mostly wrong with a line that is no TOML, by what stands in it; ``""`` alone is an empty text."""

_FEW_LEVELS = "valid TOML of a few levels is accepted"


def open_toml(path: Path, error: type[InputRefusedError]) -> Table:
    """Read a TOML file of at most 1 MiB into a ``Table``; raise ``error`` where it cannot be read or parsed."""
    try:
        with path.open("rb") as file:
            raw = file.read(_MAX_FILE_BYTES + 1)
            size = max(len(raw), path.stat().st_size)
    except OSError as exc:
        raise error([FileFault(str(path), exc, "give a readable TOML file")]) from None
    if size > _MAX_FILE_BYTES:
        raise error([Fault(str(path), f"{size} bytes", _TOO_LARGE)])
    return parse_toml(raw, str(path), path.name, error)


def parse_toml(raw: bytes, where: str, file: str, error: type[InputRefusedError]) -> Table:
    """Parse a file's content into a ``Table``; raise ``error`` where it is not TOML.

    Parameters
    ----------
    raw: the content.
    where: where it is from, for faults of the whole file.
    file: the file's name, for faults of its keys.
    """
    if len(raw) > _MAX_FILE_BYTES:
        raise error([Fault(where, f"{len(raw)} bytes", _TOO_LARGE)])
    if _has_endless_key(raw):
        raise error([Fault(where, "nested too deeply", _FEW_LEVELS)])
    try:
        content = tomllib.loads(raw.decode("utf-8"))
    except RecursionError:
        raise error([Fault(where, "nested too deeply", _FEW_LEVELS)]) from None
    except ValueError as exc:  # not TOML, not UTF-8, or an integer too long to be one
        raise error([_no_toml(where, raw, exc)]) from None
    excess = _excess(content)
    if excess:
        raise error([Fault(where, *excess)])
    return Table(content, file, "", [])


def _no_toml(where: str, raw: bytes, exc: ValueError) -> Lacking:
    """The fault of a file that is no TOML: from where on, the line, and what is mostly wrong with such a line."""
    if isinstance(exc, UnicodeDecodeError):
        return Lacking(where, "this is no text in UTF-8", "valid TOML in UTF-8 is accepted")
    said, found = str(exc), _AT.search(str(exc))
    if found is None:
        return Lacking(where, f"this is no TOML ({said})", "valid TOML in UTF-8 is accepted")
    line = raw.decode("utf-8").split("\n")[int(found[1]) - 1].strip()
    what = f"this is no TOML from line {found[1]}, column {found[2]} on ({said[: found.start()]}): {line[:_SHOWN]}"
    hint = next((f"; {hint}" for wrong, hint in _HINTS.items() if wrong.search(line)), "")
    return Lacking(where, what, f"valid TOML in UTF-8 is accepted{hint}")


def _has_endless_key(raw: bytes) -> bool:
    """Whether a key has hundreds of dots: the time to parse it grows with their square."""
    for line in raw.split(b"\n"):
        parts = line.split(b"=")
        keys = parts if line.lstrip().startswith(b"[") else parts[:-1]
        if any(key.count(b".") > _MAX_DOTS for key in keys):
            return True
    return False


def _excess(content: object) -> tuple[str, str] | None:
    """An integer too long or nesting too deep for any file of ours: what it is, and what is accepted."""
    level, depth = [content], 0
    while level:
        if any(isinstance(value, int) and value.bit_length() > _MAX_INTEGER_BITS for value in level):
            return "an integer of hundreds of digits", "an integer of at most 64 bits is accepted"
        lists = [
            value.values() if isinstance(value, dict) else value for value in level if isinstance(value, dict | list)
        ]
        level, depth = list(itertools.chain.from_iterable(lists)), depth + 1
        if depth > _MAX_LEVELS:
            return "nested too deeply", _FEW_LEVELS
    return None
