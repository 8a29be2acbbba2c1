"""``serial:DEVICE``: framed messages both ways over one serial line, or a pseudo-terminal.

One thread, no blocking call but the wait for the first byte: ``receive`` sleeps in ``poll``, ``send`` queues whole
frames and writes what the line takes.  A line that dies is opened again with back-off from within either.
"""

from __future__ import annotations

import errno
import logging
import os
import select
import termios
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import serial

from magcal_service.base.errors import DecodeError, why_not
from magcal_service.config.address import LinkAddress
from magcal_service.links.base import Link, Role
from magcal_service.links.line_seal import open_coders
from magcal_service.links.line_text import TextWatch
from magcal_service.links.states import BackOff, LinkEvent
from magcal_service.wire.fields import fitting
from magcal_service.wire.keys import group_of
from magcal_service.wire.kinds import kind_of
from magcal_service.wire.messages import Command, CommandReply, Message

_log = logging.getLogger("magcal.links.serial")

_READ_BYTES = 65536  # taken from the line at once: all that a pseudo-terminal or a serial driver of Linux holds (4 kB)
_CLOSE_WAIT_S = 1.0  # how long close lets the line take what is still queued [s]
_PARITY = {"none": serial.PARITY_NONE, "even": serial.PARITY_EVEN, "odd": serial.PARITY_ODD}
_HELD: Final = (errno.EAGAIN, errno.EBUSY)  # how a device that another process has refuses to be opened
_REFUSING_SOURCE: Final = "magcal-line"  # source of the answers to commands that the line itself refuses
_RECEIVED_GROUPS = {Role.SERVICE: ("sample", "command")}  # the rest is an echo of what this end sends


@dataclass(frozen=True, slots=True, kw_only=True)
class SerialSettings:
    """A ``serial:`` address, read and checked.

    Parameters
    ----------
    device: path of the device.
    baud: bits per second.
    parity: ``"none"``, ``"even"`` or ``"odd"``.
    stop_bits: 1 or 2.
    flow_control: hardware flow control (RTS/CTS).
    dtr: raise DTR on opening; many boards restart when it rises.
    backlog_bytes: bytes held at most for a line that doesn't take them.
    backlog_s: age at which held frames are dropped [s].
    key: file with the key that commands are sealed with; where None, they are not.
    counter: file that keeps the last counter of a sealed command; only with ``key``.
    """

    device: str
    baud: int
    parity: str
    stop_bits: int
    flow_control: bool
    dtr: bool
    backlog_bytes: int
    backlog_s: float
    key: Path | None
    counter: Path

    @classmethod
    def read(cls, address: LinkAddress) -> SerialSettings:
        """Read the address; ``LinkAddressError`` where a part of it is refused."""
        if not address.rest:
            address.lack("device", "a device such as /dev/ttyUSB0 is required")
        key, counter = address.text_of("key", ""), address.text_of("counter", "")
        if bool(key) != bool(counter):
            address.lack("key" if counter else "counter", "key=FILE and counter=FILE go together")
        settings = cls(
            device=address.rest,
            baud=address.integer("baud", 115200, 50, 12_000_000),
            parity=address.choice("parity", tuple(_PARITY), "none"),
            stop_bits=address.integer("stop_bits", 1, 1, 2),
            flow_control=address.flag("flow_control", False),
            dtr=address.flag("dtr", True),
            backlog_bytes=address.integer("backlog_bytes", 262_144, 16_384, 16_777_216),
            backlog_s=address.real("backlog_s", 5.0, 0.01, 3600.0),
            key=Path(key) if key else None,
            counter=Path(counter),
        )
        address.finish()
        return settings

    def open(self) -> serial.Serial:
        """The opened device, for this process alone; ``OSError``, ``ValueError`` or ``termios.error`` otherwise."""
        port = serial.Serial(
            baudrate=self.baud,
            parity=_PARITY[self.parity],
            stopbits=self.stop_bits,
            rtscts=self.flow_control,
            timeout=0,
            write_timeout=0,
            exclusive=True,
        )
        port.port, port.dtr = self.device, self.dtr
        port.open()
        return port


class SerialLink(Link):
    """One end of a serial line; options in ``SerialSettings`` and ``docs/links.md``.

    Counts besides those of every link: ``frames``, ``frames_lost``, ``frame_restarts`` (see ``wire.framing``) and
    ``refused.wrong_direction`` (an echo of what only this end sends).  With a key, a service takes sealed commands
    only and answers the others itself; every other end seals the commands it sends.

    Raises
    ------
    LinkAddressError: an option is refused.
    ConfigError: the key's file is no key or can be read by others, or everybody can write where the counter is kept.
    """

    def __init__(self, address: LinkAddress, role: Role, crafts: Sequence[str] = ()) -> None:
        super().__init__(address.text, crafts)
        self._settings = SerialSettings.read(address)
        self._received_groups = _RECEIVED_GROUPS.get(role, ("result", "reply"))
        self._answers = 0  # to commands that the line itself has refused
        self._encoder, self._decoder = open_coders(
            role, self._settings.key, self._settings.counter, self.counters, self._refuse_command
        )
        self._text = TextWatch()
        self._port: serial.Serial | None = None
        self._unopened = ""  # why the newest attempt to open has failed
        self._back_off = BackOff()
        self._next_attempt_s = 0.0  # not before this on the monotonic clock [s]
        self._backlog: deque[tuple[float, bytes]] = deque()  # (deadline [s], frame), the first may be partly written
        self._backlog_bytes = 0
        self._written = 0  # bytes of the first frame that the line has taken
        self._ensure_open()

    @property
    def alone(self) -> str:
        """Why nobody can be at the other end now: the line is not open."""
        return "" if self._port is not None else f"{self._settings.device} cannot be opened{self._unopened}"

    # Receiving

    def _poll(self, wait_s: float) -> list[Message]:
        deadline = time.monotonic() + wait_s
        if not self._ensure_open():
            pause_s = wait_s if self._life.is_closed else min(wait_s, max(0.0, self._next_attempt_s - time.monotonic()))
            time.sleep(pause_s)
            if not self._ensure_open():
                return []
        return self._read(max(0.0, deadline - time.monotonic()))

    def _read(self, wait_s: float) -> list[Message]:
        port = self._port
        if port is None:
            return []
        try:
            readable = self._wait(port, wait_s)
            if not readable:
                return []
            data = os.read(port.fileno(), _READ_BYTES)
        except BlockingIOError:
            return []
        except OSError as error:
            self._died(error)
            return []
        if not data:
            self._died(OSError("the device is gone"))
        messages = [message for message in self._decoder.feed(data) if self._for_us(message)]
        if self._text.feed(data, self.counters["frames"]):
            _log.warning("%s: %s", self.address, self._text.warning)
        self.warnings = (self._text.warning,) if self._text.warning else ()
        return messages

    def _wait(self, port: serial.Serial, wait_s: float) -> bool:
        """Sleep until bytes are there, or the line takes more of the backlog; say whether to read."""
        waiter = select.poll()
        waiter.register(port.fileno(), select.POLLIN | (select.POLLOUT if self._backlog else 0))
        events = dict(waiter.poll(wait_s * 1000.0)).get(port.fileno(), 0)
        if events & select.POLLOUT:
            self._write()
        return bool(events & ~select.POLLOUT)

    def _for_us(self, message: Message) -> bool:
        if group_of(kind_of(message)) in self._received_groups:
            return True
        self.counters["refused.wrong_direction"] += 1
        return False

    def _refuse_command(self, command: Command, error: DecodeError) -> None:
        """Answer a command that does not pass the line, where it is for a craft that is served here."""
        if self.crafts and command.craft not in self.crafts:
            return
        if not self._answers:
            _log.warning("%s: a command %r of %r is refused: %s", self.address, command.name, command.source, error)
        self._answers += 1
        self.send(
            CommandReply(
                craft=command.craft,
                source=_REFUSING_SOURCE,
                sequence=(self._answers - 1) % (1 << 32),
                time_ns=command.time_ns,
                clock=command.clock,
                name=command.name,
                command_source=command.source,
                command_sequence=command.sequence,
                accepted=False,
                text=fitting(str(error)),
            )
        )

    # Sending

    def send(self, message: Message) -> None:
        """Queue one frame and write what the line takes now; the oldest frames give way where it takes too little."""
        if not self._ensure_open():
            self.counters["dropped"] += 1
            return
        try:
            frame = self._encoder.encode(message)
        except DecodeError as error:
            self._unsendable(message, error)
            self.counters["dropped"] += 1
            return
        self._backlog.append((time.monotonic() + self._settings.backlog_s, frame))
        self._backlog_bytes += len(frame)
        self._write()
        self._shed()

    def _write(self) -> None:
        self._shed()
        try:
            while self._backlog and self._port is not None:
                frame = self._backlog[0][1]
                self._written += os.write(self._port.fileno(), frame[self._written :])
                if self._written < len(frame):
                    return
                self._forget(0)
                self._written = 0
                self.counters["sent"] += 1
        except BlockingIOError:
            return
        except OSError as error:
            self._died(error)

    def _shed(self) -> None:
        """Drop the oldest frames that are not begun, while there are too many bytes or they are too old."""
        now_s = time.monotonic()
        first = 1 if self._written else 0
        while len(self._backlog) > first and (
            self._backlog_bytes > self._settings.backlog_bytes or self._backlog[first][0] < now_s
        ):
            self._forget(first)
            self.counters["dropped"] += 1

    def _forget(self, index: int) -> None:
        self._backlog_bytes -= len(self._backlog[index][1])
        del self._backlog[index]

    # The line

    def _ensure_open(self) -> bool:
        if self._port is not None:
            return True
        if self._life.is_closed or time.monotonic() < self._next_attempt_s:
            return False
        try:
            self._port = self._settings.open()
        except (OSError, ValueError, termios.error) as error:
            words = _words_of(error)
            self._unopened = f": {words}"
            if self._life.happens(LinkEvent.FAILED).logged:
                _log.warning("%s: cannot be opened (%s); it is tried again", self.address, words)
            self._next_attempt_s = time.monotonic() + self._back_off.next_s()
            return False
        self._life.happens(LinkEvent.OPENED)
        self._back_off.reset()
        return True

    def _died(self, error: OSError) -> None:
        if self._life.happens(LinkEvent.DIED).logged:
            _log.warning("%s: the line died (%s); opening it again", self.address, error)
        self._release()
        self._unopened = ""
        self._next_attempt_s = time.monotonic() + self._back_off.next_s()

    def _release(self) -> None:
        port, self._port = self._port, None
        if port is None:
            return
        self.counters["dropped"] += len(self._backlog)
        self._backlog.clear()
        self._backlog_bytes = self._written = 0
        try:
            port.close()
        except (OSError, termios.error) as error:
            _log.debug("%s: closing a dead line: %s", self.address, error)

    def close(self) -> None:
        """Let the line take what is queued for at most a second, then release the device."""
        deadline_s = time.monotonic() + _CLOSE_WAIT_S
        while self._port is not None and self._backlog and (left_s := deadline_s - time.monotonic()) > 0.0:
            waiter = select.poll()
            waiter.register(self._port.fileno(), select.POLLOUT)
            waiter.poll(left_s * 1000.0)
            self._write()
        self._life.happens(LinkEvent.CLOSE)
        self._release()


def _words_of(error: Exception) -> str:
    """Why a device does not open, in words for people."""
    number = error.errno if isinstance(error, OSError) else None
    if number in _HELD:
        return "another process has it"
    return why_not(OSError(*error.args) if isinstance(error, termios.error) else error)
