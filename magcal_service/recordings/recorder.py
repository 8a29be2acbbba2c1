"""The session recorder: everything that comes in and goes out, on disk, without ever holding the service up.

The service puts messages into a bounded queue; a thread of its own packs and writes them.  Where the disk is slow the
queue fills and messages are dropped; where it is full, or fails, recording stops and is tried again later.  Both are
counted, logged and reported in the status, and neither touches the calibration.  ``docs/recorder.md`` has the rest.
"""

from __future__ import annotations

import logging
import os
import queue
import threading
import time
import uuid
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Final, NamedTuple, Self

from magcal_service.base.errors import DecodeError, Fault, FileFault, InputRefusedError, why_not
from magcal_service.base.version import __version__
from magcal_service.config.daemon_settings import RecordConfig
from magcal_service.config.settings import CraftConfig
from magcal_service.config.text import digest
from magcal_service.recordings.session_file import SessionFile
from magcal_service.recordings.session_files import SessionFolder, recover_in_place
from magcal_service.recordings.state_text import state_as_text
from magcal_service.wire.messages import SCHEMA_VERSION, Message

_log = logging.getLogger("magcal.recorder")

MOST_WAITING: Final = 8192
"""Messages in the queue at most: half an hour of one craft at 1 Hz, and 20 MB where all are estimates."""

PATIENCE_S: Final = 5.0
"""How long the end of the service waits for the disk to take what is in the queue: half of what systemd waits."""

_TO_BEGIN: Final = 1.1
"""To begin, ``min_free_mb`` times this has to be free, so that a disk at its limit is not filled with short files."""

_MB: Final = 1_000_000  # bytes: sizes of the configuration are decimal, as disks are sold


class _Entry(NamedTuple):
    """A message in the queue: when it came [ns], and how many before it found no room."""

    now_ns: int
    message: Message
    missed: int


class Recorder:
    """Records the messages of a session into files until it is closed.

    Parameters
    ----------
    config: the ``[record]`` section.
    crafts: configurations of the craft that are served.

    ``counters``: ``record.written`` (on the disk), ``record.dropped`` (lost: queue full, disk full, or no JSON),
    ``record.files``, ``record.deleted`` (oldest files), ``record.stopped`` (times that recording had to stop),
    ``record.recovered`` (records of half-written files).  ``trouble`` says why nothing is recorded, empty where all
    is well.
    """

    def __init__(self, config: RecordConfig, crafts: Sequence[CraftConfig]) -> None:
        self.config = config
        self.trouble = ""
        names = ("written", "dropped", "files", "deleted", "stopped", "recovered")
        self.counters: Counter[str] = Counter({f"record.{name}": 0 for name in names})
        self._crafts = {craft.name: craft for craft in crafts}
        self._states: dict[str, dict[str, str]] = {}
        self._about = {
            "session": uuid.uuid4().hex,
            "magcal": __version__,
            "wire_schema": str(SCHEMA_VERSION),
            "configuration_sha256": digest(crafts),
        }
        self._folder = SessionFolder(config.directory)
        self._file: SessionFile | None = None
        self._queue: queue.SimpleQueue[_Entry | None] = queue.SimpleQueue()
        self._missed = 0  # messages that found the queue full since the last one that did not; the service's thread
        self._hole = 0  # messages dropped since the last one that was written; the recorder's thread
        self._dropping = threading.Lock()
        self._flush_s = self._retry_s = time.monotonic()
        self._thread = threading.Thread(target=self._run, name="recorder", daemon=True)
        self._thread.start()

    @property
    def path(self) -> Path | None:
        """The file that is being written; None while there is none."""
        file = self._file
        return None if file is None else file.path

    def begin_with(self, craft: str, source: str, state: dict[str, Any]) -> None:
        """Note the state that a magnetometer begins with where it is not nothing; before the craft's first message.

        ``source`` is empty for the craft's own magnetometer.
        """
        self._states.setdefault(craft, {})[source] = state_as_text(state)

    def add(self, message: Message) -> None:
        """Queue one message; never waits, never raises.  Counted as dropped where the queue is full."""
        if self._queue.qsize() >= MOST_WAITING:
            self._missed += 1
            self._count_dropped(1)
        else:
            self._queue.put(_Entry(time.time_ns(), message, self._missed))
            self._missed = 0

    def _count_dropped(self, count: int) -> None:
        with self._dropping:
            self.counters["record.dropped"] += count

    def _drop(self, count: int) -> None:
        self._hole += count
        self._states.clear()  # what is recorded from now on does not begin with it
        self._count_dropped(count)

    def close(self) -> None:
        """Write the queue and finish the file; waits at most ``PATIENCE_S`` for a disk that does not answer."""
        self._queue.put(None)
        self._thread.join(PATIENCE_S)
        if self._thread.is_alive():
            _log.error("the disk does not take the end of the recording: %d messages lost", self._queue.qsize())

    def _run(self) -> None:
        """The thread: whatever goes wrong here ends a file, never the thread and never the service."""
        ended = False
        while not ended:
            try:
                ended = self._step()
            except OSError as error:
                self._stop(why_not(error))
            except Exception as error:  # a defect must not silence the recorder for good
                _log.exception("the recorder failed")
                self._stop(f"a defect of the recorder, {type(error).__name__}")
        self._end_file()

    def _step(self) -> bool:
        """Take one message from the queue, or find that it is time to flush; whether the end has come."""
        if self._file is None and time.monotonic() >= self._retry_s:
            self._begin()
        due_s = self._flush_s if self._file is not None else self._retry_s
        try:
            entry = self._queue.get(timeout=max(0.0, due_s - time.monotonic()))
        except queue.Empty:
            entry = None
        else:
            if entry is None:
                return True
        if entry is not None:
            self._write(entry)
        if self._file is not None and (time.monotonic() >= self._flush_s or self._file.full):
            self._flush(self._file)
        return False

    def _write(self, entry: _Entry) -> None:
        self._hole += entry.missed
        if self._file is None:
            self._drop(1)
            return
        if self._hole:
            self._file.note_dropped(self._hole)
            self._hole = 0
        try:
            self._file.add(entry.now_ns, entry.message)
        except DecodeError as error:
            self._drop(1)
            _log.warning("a message is not recorded: %s", error)

    def _begin(self) -> None:
        """Open the next file of the session, and recover files that an earlier session left half-written."""
        self._folder.path.mkdir(parents=True, exist_ok=True)
        self._make_room(None)
        self._mend()
        now_ns = time.time_ns()
        path, file = self._folder.create(now_ns)
        about = self._about | {"part": str(self.counters["record.files"] + 1), "started_ns": str(now_ns)}
        try:
            self._file = SessionFile(path, file, about, self._crafts, self._states)
        except OSError:
            file.close()
            path.unlink()
            raise
        self.counters["record.files"] += 1
        self._flush_s = time.monotonic() + self.config.flush_s
        if self.trouble:
            _log.info("recording again")
        self.trouble = ""
        _log.info("recording into %s", path)

    def _mend(self) -> None:
        try:
            for path in self._folder.unfinished():
                recovered = recover_in_place(path)
                self.counters["record.recovered"] += recovered.messages
                _log.warning("%s", recovered)
        except OSError as error:  # it is tried again with the next file, and must not keep this one from being written
            _log.warning("a half-written recording could not be made sound: %s", error)

    def _make_room(self, current: Path | None) -> None:
        """Delete what is beyond ``total_mb``; ``OSError`` where others need the rest of the disk."""
        if self.config.total_mb is not None:
            deleted = self._folder.delete_oldest(self.config.total_mb * _MB, current)
            self.counters["record.deleted"] += len(deleted)
        needed = self.config.min_free_mb * _MB * (1.0 if current is not None else _TO_BEGIN)
        if self._folder.free_bytes() < needed:
            raise OSError(None, f"the disk has less than min_free_mb = {self.config.min_free_mb:g} MB left")

    def _flush(self, file: SessionFile) -> None:
        """Write the chunk to the disk, keep its limits, and begin the next file where this one is full or old."""
        self._flush_s = time.monotonic() + self.config.flush_s
        self.counters["record.written"] += file.flush()
        self._make_room(file.path)
        old = time.monotonic() - file.opened_s >= self.config.file_h * 3600.0
        if file.full or file.size >= self.config.file_mb * _MB or (old and file.taken):
            self._end_file()
            self._begin()

    def _end_file(self) -> None:
        if self._file is None:
            return
        try:
            self.counters["record.written"] += self._file.close()
        except OSError as error:
            self._abandon()
            _log.error("the end of the recording in %s is lost: %s", self.config.directory, why_not(error))
        self._file = None

    def _abandon(self) -> None:
        if self._file is not None:
            kept, lost = self._file.abandon()
            self.counters["record.written"] += kept
            self._drop(lost)
            self._file = None

    def _stop(self, reason: str) -> None:
        """Stop recording for ``retry_s``; messages of the open chunk are lost and counted as dropped."""
        self._abandon()
        self._retry_s = time.monotonic() + self.config.retry_s
        self.counters["record.stopped"] += 1
        if self.trouble != reason:
            text = "not recording in %s: %s; calibration goes on, next attempt in %g s"
            _log.error(text, self.config.directory, reason, self.config.retry_s)
        self.trouble = reason

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        self.close()


def open_recorder(config: RecordConfig, crafts: Sequence[CraftConfig]) -> Recorder:
    """A recorder whose folder is there; ``InputRefusedError`` where it can't be made or written to at all.

    A disk without room is no such reason: it may have some later.
    """
    try:
        config.directory.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        accepted = "a folder that can be made is accepted"
        raise InputRefusedError([FileFault(f"record.directory: {config.directory}", error, accepted)]) from None
    if not os.access(config.directory, os.W_OK | os.X_OK):
        raise InputRefusedError(
            [Fault("record.directory", str(config.directory), "a folder that can be written to is accepted")]
        )
    return Recorder(config, crafts)
