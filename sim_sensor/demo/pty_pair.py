"""A null-modem cable without hardware: two pseudo-terminals whose far ends are joined (Linux and macOS)."""

from __future__ import annotations

import contextlib
import os
import selectors
import threading
import tty
from types import TracebackType
from typing import Self

__all__ = ["PtyPair"]

_CHUNK = 4096  # bytes in one read, the size of a line buffer of the kernel
_MAX_PENDING = 1 << 16  # bytes held for a reader that is behind; beyond it the writer has to wait, as on a real line


class PtyPair:
    """Two serial devices, ``paths``, such that what is written to one can be read from the other.

    Each end can be opened and closed any number of times while the pair lives.  Bytes are not paced: a
    pseudo-terminal has no baud rate.  Use it as a context, or call ``close``.  OSError where the system has no
    pseudo-terminal left.
    """

    def __init__(self) -> None:
        self._files: list[int] = []
        masters, slaves = [], []
        for _ in range(2):
            master, slave = os.openpty()
            self._files += [master, slave]
            tty.setraw(slave)  # the slave stays open here, so that a master never sees a hang-up
            os.set_blocking(master, False)
            masters.append(master)
            slaves.append(slave)
        self.paths: tuple[str, str] = (os.ttyname(slaves[0]), os.ttyname(slaves[1]))
        self._wake_read, self._wake_write = os.pipe()
        self._files += [self._wake_read, self._wake_write]
        self._thread = threading.Thread(target=self._pump, args=(masters[0], masters[1]), name="pty-pair", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the pump and give the devices back; may be called twice."""
        if self._files:
            os.write(self._wake_write, b"x")
            self._thread.join()
            for file in self._files:
                os.close(file)
            self._files = []

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        self.close()

    def _pump(self, first: int, second: int) -> None:
        other = {first: second, second: first}
        pending = {first: bytearray(), second: bytearray()}  # bytes still to be written to that master
        with selectors.DefaultSelector() as selector:
            selector.register(self._wake_read, selectors.EVENT_READ)
            for master in other:
                selector.register(master, selectors.EVENT_READ)
            while True:
                for key, mask in selector.select():
                    if key.fd == self._wake_read:
                        return
                    if mask & selectors.EVENT_READ:
                        pending[other[key.fd]] += os.read(key.fd, _CHUNK)
                    if mask & selectors.EVENT_WRITE:
                        _write_some(key.fd, pending[key.fd])
                for master in other:
                    wanted = selectors.EVENT_READ if len(pending[other[master]]) < _MAX_PENDING else 0
                    wanted |= selectors.EVENT_WRITE if pending[master] else 0
                    _want(selector, master, wanted)


def _write_some(master: int, pending: bytearray) -> None:
    with contextlib.suppress(BlockingIOError):  # select and write can disagree about the last bytes of room
        del pending[: os.write(master, pending)]


def _want(selector: selectors.BaseSelector, master: int, wanted: int) -> None:
    """Watch a master for these events; a selector refuses to watch for none, so it is taken out then."""
    known = selector.get_map()
    if wanted and master in known:
        if known[master].events != wanted:
            selector.modify(master, wanted)
    elif wanted:
        selector.register(master, wanted)
    elif master in known:
        selector.unregister(master)
