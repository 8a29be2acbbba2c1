"""A JSON that somebody gives as a result: what it is where it is none, and what to give in its place."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any, Final, NoReturn

from magcal_service.base.errors import InputRefusedError, Lacking

_OTHERS: Final = {
    frozenset({"usable", "findings"}): "these are findings of magcal inspect, which hold no numbers of a sensor",
    frozenset({"question", "recordings"}): (
        "this is the summary of many recordings; give the file in the folder of one of them"
    ),
    frozenset({"estimates", "counters"}): "this is a replay's last estimate; give its recording, or calibrate that",
    frozenset({"bias_nt", "D", "seed"}): "this is the truth of a simulation; give the RECORDING.toml beside it",
}
"""What else is written as JSON, by the keys that it has, and what to give in its place."""

_MOST_KEYS: Final = 6
"""Keys that are named of a JSON that is something else; choice: a line of a terminal."""


def parsed_json(raw: bytes, where: str, accepted: str) -> dict[str, Any]:
    """The object that a file holds; raises ``InputRefusedError`` with what the file is where it holds none."""
    try:
        content = json.loads(raw)
    except RecursionError:
        raise _refusal(where, "this JSON is nested too deeply", accepted) from None
    except ValueError as error:
        raise _refusal(where, _what(raw, error), accepted) from None
    if not isinstance(content, dict):
        kind = {list: "a list", str: "a text", type(None): "null"}.get(type(content), "a number")
        raise _refusal(where, f"this JSON is {kind}, and no result", accepted)
    return content


def refuse_others(content: Mapping[str, Any], where: str, accepted: str) -> None:
    """Raise ``InputRefusedError`` for a JSON that another command wrote."""
    for keys, words in _OTHERS.items():
        if keys <= content.keys():
            raise _refusal(where, words, accepted)


def refuse_strange(content: Mapping[str, Any], where: str, accepted: str) -> NoReturn:
    """Raise ``InputRefusedError`` for a JSON of something else, with the keys that it has."""
    keys = [*content][:_MOST_KEYS]
    more = f" and {len(content) - len(keys)} more" if len(content) > len(keys) else ""
    has = f"it has {', '.join(key[:40] for key in keys)}{more}" if keys else "it is empty"
    raise _refusal(where, f"this JSON is no result: {has}", accepted)


def _what(raw: bytes, error: ValueError) -> str:
    """What a file is that is no JSON."""
    text = raw.strip()
    if not text:
        return "this file is empty"
    if text.startswith(b"<"):
        return "this is a page of HTML or XML, no JSON"
    if isinstance(error, UnicodeDecodeError):
        return "this is no text"
    if not isinstance(error, json.JSONDecodeError) or text[:1] not in (b"{", b"["):
        return "this is no JSON"
    if error.pos >= len(error.doc.rstrip()):
        return f"this JSON breaks off in line {error.lineno}"
    return f"this is no JSON from line {error.lineno}, column {error.colno} on ({error.msg})"


def _refusal(where: str, what: str, accepted: str) -> InputRefusedError:
    return InputRefusedError([Lacking(where, what, accepted)])
