"""Recognises text on a line that should carry frames: a sensor that prints its readings, or a console."""

from __future__ import annotations

from typing import Final

_ENOUGH_BYTES: Final = 200
"""Without a frame among them, before the line is judged: some lines of text, and longer than most frames."""

_TEXT_SHARE: Final = 0.97
"""Of bytes that are printable or end lines; of frames, which are binary, well below a half are."""

_TEXT: Final = frozenset(range(0x20, 0x7F)) | frozenset(b"\t\r\n")
_SHOWN: Final = 60  # characters of a line


class TextWatch:
    """Bytes of a line in, what is wrong with them out.

    ``warning`` quotes a line of the text that comes instead of frames; empty where none does.
    """

    def __init__(self) -> None:
        self.warning = ""
        self._frames = self._bytes = self._text = 0
        self._newest = b""

    def feed(self, data: bytes, frames: int) -> bool:
        """Take what was read, and how many frames were found so far; whether ``warning`` is new."""
        if frames != self._frames:
            self._frames, self._bytes, self._text, self._newest, self.warning = frames, 0, 0, b"", ""
            return False
        self._bytes += len(data)
        self._text += sum(byte in _TEXT for byte in data)
        self._newest = (self._newest + data)[-_ENOUGH_BYTES:]
        lines = self._newest.replace(b"\r", b"\n").split(b"\n")
        if self.warning or self._bytes < _ENOUGH_BYTES or len(lines) < 2 or self._text < _TEXT_SHARE * self._bytes:
            return False
        shown = max(lines, key=len)[:_SHOWN].decode("ascii", "replace")
        self.warning = (
            f"text comes instead of frames, such as {shown!r}: a node has to send frames, which the header in "
            "deploy/firmware makes; nothing of it is used"
        )
        return True
