"""Who was refused at zenoh's door, and why: read from zenoh's own log, the only place where it says so.

A failed TLS handshake, a wrong password and a message that an access rule denies reach no callback and no counter of
zenoh 1.10; each is a line of its log.  The daemon's command, which has no use for standard output, takes that log in
through a pipe (``magcal_service.daemon.log``); any other process leaves it alone and counts none of this.
"""

from __future__ import annotations

import logging
import os
import re
import threading
import time
from collections import Counter
from collections.abc import Callable
from typing import Final

import zenoh

from magcal_service.base import log
from magcal_service.wire.keys import ROOT

_log = logging.getLogger("magcal.links.zenoh")

DENIALS: Final = (
    "no_certificate",
    "wrong_certificate",
    "expired_certificate",
    "password",
    "handshake",
    "no_role",
    "sample",
    "result",
    "command",
    "reply",
    "other",
)
"""Counted as ``denied.<name>``: five failures to connect, no role in the rules, then what a rule denied.

``other`` is a declaration, a query, a put on another key, or what one without a role put: zenoh says no more of it, but
for samples of a publisher.
"""

_FILTER: Final = "warn,zenoh_transport::unicast::establishment=debug"
_FILTER_ACL: Final = ",zenoh::net::routing::interceptor=trace"  # a line for each message: only where there are rules
_PAUSE_S: Final = 0.05  # between two looks at the pipe, so that a flood is read in large pieces
_READ_BYTES: Final = 1 << 20  # all that the pipe can hold (``log.stdout_as_pipe``)
_LONGEST_LINE: Final = 1 << 16  # bytes; zenoh's denials have some hundreds, and a line without end must take no memory
_MAX_THREADS: Final = 1024  # whose verdict is awaited: bounds the memory, far above the threads that zenoh starts

_LINE = re.compile(rb"\S+Z +[A-Z]+ .*?(ThreadId\(\d+\)) (\S+): (.*)")
_CONNECT_FAILURES: Final = (  # what zenoh_link_tls and the authentication say, the first that fits
    (b"peer sent no certificates", "no_certificate"),
    (b"certificate expired", "expired_certificate"),
    (b"certificate chain expired", "expired_certificate"),
    (b"invalid peer certificate", "wrong_certificate"),
    (b"UsrPwd extension - Recv", "password"),
)
_TLS: Final = (b"zenoh_link_tls", b"zenoh_link_commons::tls", b"zenoh_link_quic")
_RULED = re.compile(rb"(\S+) (?:on (.*) )?is unauthorized to (.*) \((ingress|egress)\) on (\S+)")
_PART = re.compile(rf"{ROOT}/[^/]+/(sample|result|command|reply)(?:/.*)?".encode())


class DenialReader:
    """Bytes of zenoh's log in, denials out, for any split of the bytes.

    A rule's verdict is logged whenever it is worked out, also for no message at all; only where the same thread says
    next that it has intercepted one was there a message.
    """

    def __init__(self) -> None:
        self._rest = b""
        self._ruled: dict[bytes, tuple[str, str] | None] = {}

    def feed(self, data: bytes) -> list[tuple[str, str]]:
        """What ``data`` completes: the name in ``DENIALS``, and zenoh's words."""
        *lines, self._rest = (self._rest + data).split(b"\n")
        if len(self._rest) > _LONGEST_LINE:
            self._rest = b""
        found = (self._line(line) for line in lines)
        return [denial for denial in found if denial is not None]

    def _line(self, line: bytes) -> tuple[str, str] | None:
        match = _LINE.match(line)
        if match is None:
            return None
        thread, origin, text = match.groups()
        if b"::interceptor" in origin:
            return self._rule(thread, text)
        for phrase, name in _CONNECT_FAILURES:
            if phrase in text:
                return name, _shown(text)
        return ("handshake", _shown(text)) if origin.startswith(_TLS) else None

    def _rule(self, thread: bytes, text: bytes) -> tuple[str, str] | None:
        if text.startswith(b"Msg intercepted"):
            return self._ruled.pop(thread, ("other", _shown(text)))
        if b"did not match any configured ACL subject" in text:
            return "no_role", _shown(text)
        ruled = _RULED.search(text)
        if ruled is None:
            self._ruled.pop(thread, None)
        elif len(self._ruled) < _MAX_THREADS:
            part = _PART.fullmatch(ruled[5]) if ruled[3] == b"Put" else None
            name = part[1].decode() if part else "other"
            self._ruled[thread] = (
                (name, _shown(text)) if ruled[4] == b"ingress" else None
            )  # egress: sent by this process
        return None


def _shown(text: bytes) -> str:
    """zenoh's words on one line, without a hint of it that misleads here."""
    words = text.decode(errors="replace").partition(". Hint: increase the system open file limit")[0]
    return "".join(letter if letter.isprintable() else "?" for letter in words)[:300]


def watch(count: Callable[[str], None], address: str, rules: bool) -> None:
    """Count denials from now on, in a process that has given its standard output away for this: in the daemon.

    To be called before the session is opened.

    Parameters
    ----------
    count: called with ``denied.<name>`` for each, from a thread of its own.
    address: the link's, for the log: the first denial of a kind is a line there, then each tenth, hundredth and so on.
    rules: whether there are access rules; their verdicts cost zenoh a line of log for each message.
    """
    pipe = log.stdout_as_pipe()
    if pipe is None:
        return
    os.environ["NO_COLOR"] = "1"
    zenoh.init_log_from_env_or(_FILTER + (_FILTER_ACL if rules else ""))
    threading.Thread(target=_read, args=(pipe, count, address), name="magcal-zenoh-log", daemon=True).start()


def _read(pipe: int, count: Callable[[str], None], address: str) -> None:
    reader, seen = DenialReader(), Counter[str]()
    while data := os.read(pipe, _READ_BYTES):
        for name, words in reader.feed(data):
            count(f"denied.{name}")
            seen[name] += 1
            if 10 ** (len(str(seen[name])) - 1) == seen[name]:
                _log.warning("%s: denied (%s, %d so far): %s", address, name, seen[name], words)
        time.sleep(_PAUSE_S)
