"""The seal of one serial line: its key, its counter, and what packs and unpacks its frames."""

from __future__ import annotations

import logging
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path

from magcal_service.base.errors import DecodeError, why_not
from magcal_service.config.private_files import check_state_directory, read_key
from magcal_service.links.base import Role
from magcal_service.links.counter_file import CounterFile
from magcal_service.wire.framing import FrameEncoder, StreamDecoder
from magcal_service.wire.messages import Command
from magcal_service.wire.seal import SealGate, seal

_log = logging.getLogger("magcal.links.serial")

_NS_PER_US = 1000  # nanoseconds in a microsecond


def open_coders(
    role: Role,
    key: Path | None,
    counter: Path,
    counters: Counter[str],
    refused: Callable[[Command, DecodeError], None],
) -> tuple[FrameEncoder, StreamDecoder]:
    """What packs and unpacks the frames of one end of a line.

    Parameters
    ----------
    role: with a key, a service takes sealed commands only, and every other end seals those it sends.
    key, counter: files of the key and of the last counter; no seal where ``key`` is None.
    counters: where the decoder counts.
    refused: called for each command that a service refuses for its seal.

    Raises ``ConfigError`` where the key is none or can be read by others, or everybody can write beside the counter.
    """
    notify = refused if role is Role.SERVICE else None
    if key is None:
        return FrameEncoder(), StreamDecoder(counters, None, notify)
    secret = check_seal(key, counter)
    kept = CounterFile(counter)
    if kept.last is None:
        _log.error("%s is damaged: no command passes; take a new key and remove it", counter)
    if role is not Role.SERVICE:
        return FrameEncoder(lambda payload: _sealed(secret, kept, payload)), StreamDecoder(counters)
    if kept.last == 0:
        _log.warning("no counter in %s yet: right for a new key, otherwise old commands would pass again", counter)
    return FrameEncoder(), StreamDecoder(counters, SealGate(secret, kept.last, kept.keep), notify)


def check_seal(key: Path, counter: Path) -> bytes:
    """The key in its file; ``ConfigError`` as of ``open_coders``."""
    secret = read_key(key)
    check_state_directory(counter.absolute().parent)
    return secret


def _sealed(key: bytes, counter: CounterFile, payload: bytes) -> bytes:
    """A payload with the next counter, stored before it is used.

    It is at least the UNIX time [us], so that neither an end that has lost its file nor one of two operators that take
    turns within a second is shut out; the file is read anew, for another process may have used it since.
    """
    last = counter.read()
    if last is None:
        raise DecodeError("not_kept", f"{counter.path} is damaged; remove it")
    value = max(last + 1, time.time_ns() // _NS_PER_US)
    try:
        counter.keep(value)
    except OSError as error:
        raise DecodeError("not_kept", f"{counter.path}: {why_not(error)}") from None
    return seal(key, value, payload)
