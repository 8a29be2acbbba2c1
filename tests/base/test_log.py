"""Log lines never hold the process up, whoever reads them or does not."""

from __future__ import annotations

import errno
import json
import logging
import os
import time
from collections.abc import Iterator
from contextlib import suppress

import pytest

from magcal_service.base.log import JsonLines, UnheldLines


class Pipe:
    """A pipe with a handler at its one end and a reader that reads when it is told to."""

    def __init__(self) -> None:
        self.reading, self.writing = os.pipe()
        os.set_blocking(self.reading, False)
        self.handler = UnheldLines(self.writing)
        self.handler.setFormatter(JsonLines())

    def say(self, text: str) -> None:
        self.handler.emit(logging.makeLogRecord({"name": "magcal", "levelname": "INFO", "msg": text}))

    def read(self) -> str:
        found = b""
        with suppress(BlockingIOError):
            while part := os.read(self.reading, 65536):
                found += part
        return found.decode()


@pytest.fixture
def pipe() -> Iterator[Pipe]:
    pipe = Pipe()
    yield pipe
    for file in (pipe.reading, pipe.writing):
        with suppress(OSError):
            os.close(file)


def texts(lines: str) -> list[str]:
    return [json.loads(line)["text"] for line in lines.splitlines()]


def test_a_pipe_that_nobody_reads_costs_one_short_wait_and_the_lines_are_counted(pipe: Pipe) -> None:
    began_s = time.monotonic()
    for number in range(2000):
        pipe.say(f"{number} {100 * 'x'}")
    assert time.monotonic() - began_s < 5.0
    before = pipe.read()
    whole, _, torn = before.rpartition("\n")
    numbers = [int(text.split()[0]) for text in texts(whole)]
    assert numbers == list(range(len(numbers)))
    pipe.say("again")
    after = pipe.read()
    assert after.startswith("\n" if torn else "{")
    assert texts(after.lstrip()) == [f"{2000 - len(numbers)} log lines are lost: nobody read them", "again"]
    pipe.say("and on")
    assert texts(pipe.read()) == ["and on"]


def test_a_line_longer_than_the_pipe_is_torn_and_the_next_begins_on_a_line_of_its_own(pipe: Pipe) -> None:
    pipe.say(200_000 * "y")
    torn = pipe.read()
    assert len(torn) >= 4096
    pipe.say("next")
    assert texts(pipe.read().removeprefix("\n")) == ["1 log lines are lost: nobody read them", "next"]


def test_a_reader_that_is_gone_and_a_full_disk_are_no_errors(
    pipe: Pipe, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    os.close(pipe.reading)
    pipe.say("nobody is there")
    with monkeypatch.context() as changed:
        changed.setattr(os, "write", lambda *_: (_ for _ in ()).throw(OSError(errno.ENOSPC, "full")))
        pipe.say("full")
    assert capsys.readouterr().err == ""
