"""The text of a log: UTF-8, and what is none of it as spreadsheets of western Europe write it."""

from __future__ import annotations

from typing import Final

_ESCAPED: Final = {0xDC00 + byte: bytes([byte]).decode("cp1252", errors="replace") for byte in range(0x80, 0x100)}
"""What ``surrogateescape`` makes of a byte that is no UTF-8, and its sign in Windows-1252: µ, ä, ° and the like."""


def log_text(raw: bytes | bytearray, *, begins: bool = True) -> str:
    """Decode a log, or a piece of one; a mark of UTF-8 is taken off where it ``begins`` there.

    A byte that is no UTF-8 is read as Windows-1252, so that a name such as ``Länge`` or a unit such as ``µT`` is known.
    """
    text = raw.decode("utf-8-sig" if begins else "utf-8", errors="surrogateescape")
    return text if text.isascii() else text.translate(_ESCAPED)
