"""The line that says how far it is and when it ends."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

from magcal_service.many import progress
from magcal_service.many.executor import Executor
from magcal_service.many.pieces import Piece
from magcal_service.many.progress import Count, duration, shown
from magcal_service.many.store import Store
from tests.many import work
from tests.many.here import HERE, Here


def test_the_line_has_done_failed_elapsed_and_the_end() -> None:
    count = Count("diagnose", 200, done=50, failed=2)
    line = count.line(elapsed_s=600.0, now=0.0)
    assert re.fullmatch(r"diagnose: 50 of 200 done, 2 failed, 10 min, 30 min left, until \d\d:30", line)


def test_what_was_kept_says_nothing_of_the_pace() -> None:
    assert Count("x", 100, done=60, kept=50).left_s(10.0) == pytest.approx(40.0)
    assert Count("x", 100, done=50, kept=50).left_s(10.0) is None
    assert Count("x", 100, done=50, kept=50).line(1.0, 0.0) == "x: 50 of 100 done, 0 failed, 1 s"


@pytest.mark.parametrize(
    ("seconds", "text"), [(0.4, "0 s"), (99.0, "99 s"), (100.0, "1 min"), (5999.0, "99 min"), (6000.0, "1 h 40 min")]
)
def test_durations_read_as_people_say_them(seconds: float, text: str) -> None:
    assert duration(seconds) == text


def test_a_log_gets_a_line_every_half_minute_and_not_more(monkeypatch: Any, capsys: Any) -> None:
    clock = iter([0.0, 10.0, 31.0, 40.0, 62.0])
    monkeypatch.setattr(progress.time, "monotonic", lambda: next(clock))
    count = Count("runs", 4)
    with shown(count) as show:
        for _ in range(4):
            count.done += 1
            show()
    told = [line.partition(",")[0] for line in capsys.readouterr().err.splitlines()]
    assert told == ["runs: 2 of 4 done", "runs: 4 of 4 done"]


def test_pieces_count_by_size_outcome_and_whether_they_were_kept(monkeypatch: Any, tmp_path: Path) -> None:
    seen: list[tuple[int, int, int]] = []

    def watched(count: Count) -> Any:
        return shown_with(lambda: seen.append((count.done, count.failed, count.kept)))

    monkeypatch.setattr("magcal_service.many.executor.shown", watched)
    executor = Executor(Here(), Store(tmp_path, reuse=True))
    list(executor.outcomes("x", [Piece("a", work.squared, 1, size=250)]))
    list(executor.outcomes("x", [Piece("a", work.squared, 1, size=250), Piece("b", work.divided, 0, size=4)]))
    assert seen == [(250, 0, 0), (250, 0, 250), (254, 4, 250)]


def test_a_terminal_gets_a_bar_with_what_is_done(monkeypatch: Any, capsys: Any) -> None:
    pytest.importorskip("rich")
    monkeypatch.setattr("sys.stderr.isatty", lambda: True, raising=False)
    monkeypatch.setenv("FORCE_COLOR", "1")
    assert list(HERE.map(work.squared, [1, 2], "squares")) == [1, 4]
    assert re.search(r"squares.*2/2", capsys.readouterr().err)


def shown_with(show: Any) -> Any:
    """A context that gives this function."""
    from contextlib import nullcontext

    return nullcontext(show)
