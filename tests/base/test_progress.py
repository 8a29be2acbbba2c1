"""The line of a terminal that says how far a command is and when it ends."""

from __future__ import annotations

import io
import re
import time
from contextlib import redirect_stderr

import pytest

from magcal_service.base import progress
from magcal_service.base.progress import Work, counted, duration, each, showing, steps


class Terminal(io.StringIO):
    """A stderr that is a terminal."""

    def isatty(self) -> bool:
        """It is."""
        return True

    def wait_for(self, text: str) -> None:
        """Return once it was written."""
        deadline_s = time.monotonic() + 10.0
        while text not in self.getvalue():
            assert time.monotonic() < deadline_s, self.getvalue()
            time.sleep(0.001)


@pytest.fixture
def terminal(monkeypatch: pytest.MonkeyPatch) -> Terminal:
    """It shows everything at once."""
    monkeypatch.delenv("NO_COLOR", raising=False)
    monkeypatch.setattr(progress, "AFTER_S", 0.0)
    monkeypatch.setattr(progress, "_AGAIN_S", 0.001)
    return Terminal()


def test_the_line_has_done_failed_elapsed_and_the_end() -> None:
    line = Work("diagnose", 200, done=50, failed=2).line(elapsed_s=600.0, now=0.0)
    assert re.fullmatch(r"diagnose: 50 of 200 done, 2 failed, 10 min, 30 min left, until \d\d:30", line)


def test_what_was_kept_says_nothing_of_the_pace() -> None:
    assert Work("x", 100, done=60, kept=50).left_s(10.0) == pytest.approx(40.0)
    assert Work("x", 100, done=50, kept=50).left_s(10.0) is None
    assert Work("x", 100, "s", done=50, kept=50).line(1.0, 0.0) == "x: 50 of 100 s done, 1 s"


def test_where_nobody_knows_the_end_none_is_claimed() -> None:
    assert Work("reading", done=5.0).line(3.0, 0.0) == "reading, 3 s"
    assert Work("searching", place=(3, 10)).line(15.0, 0.0) == "step 3 of at most 10, 15 s: searching"


class Told:
    """A forecast that knows the end at once."""

    def __init__(self) -> None:
        self.steps: list[str] = []

    def begin(self, step: str, now_s: float) -> None:
        """Keep it."""
        assert now_s > 0.0
        self.steps.append(step)

    def left_s(self, now_s: float) -> float | None:
        """All at 130 s."""
        return 130.0 - now_s


def test_a_forecast_is_told_what_begins_and_says_about_when_it_ends() -> None:
    told = Told()
    search = Work("searching", place=(3, 10), began_s=100.0, forecast=told)
    assert search.line(15.0, 0.0) == "step 3 of at most 10, 15 s, about 15 s left: searching"
    with steps(("first", "second"), told) as begin:
        begin("second")
    assert told.steps == ["second"]


@pytest.mark.parametrize(
    ("seconds", "text"), [(0.4, "0 s"), (99.0, "99 s"), (100.0, "1 min"), (5999.0, "99 min"), (6000.0, "1 h 40 min")]
)
def test_durations_read_as_people_say_them(seconds: float, text: str) -> None:
    assert duration(seconds) == text


def test_a_terminal_sees_the_outermost_end_and_an_empty_line_after_it(terminal: Terminal) -> None:
    with redirect_stderr(terminal), showing():
        with counted(Work("pieces", 4)) as pieces, counted(Work("rows of one", 9)):
            pieces.done = 3
            terminal.wait_for("pieces: 3 of 4 done")
        assert terminal.getvalue().endswith("\r\x1b[K")
        assert "rows of one" not in terminal.getvalue()
        with steps(("first", "second", "third")) as begin:
            terminal.wait_for("step 1 of at most 3, 0 s: first")
            begin("third")
            terminal.wait_for("step 3 of at most 3, 0 s: third")
            begin("second")
            terminal.wait_for("step 2 of at most 3, 0 s: second once more")


def test_what_ends_within_two_seconds_shows_nothing(terminal: Terminal, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(progress, "AFTER_S", 2.0)
    with redirect_stderr(terminal), showing(), counted(Work("quick", 1)):
        pass
    assert terminal.getvalue() == ""


@pytest.mark.parametrize("why", ["no terminal", "NO_COLOR", "--quiet"])
def test_it_is_silent_where_it_should_be(why: str, terminal: Terminal, monkeypatch: pytest.MonkeyPatch) -> None:
    if why == "no terminal":
        monkeypatch.setattr(terminal, "isatty", lambda: False)
    elif why == "NO_COLOR":
        monkeypatch.setenv("NO_COLOR", "1")
    with redirect_stderr(terminal), showing(quiet=why == "--quiet"):
        assert list(each([1, 2], "x", "items")) == [1, 2]
        time.sleep(0.01)
    assert terminal.getvalue() == ""
