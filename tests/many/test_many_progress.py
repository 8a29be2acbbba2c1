"""The line that says how far it is and when it ends."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from magcal_service.base.progress import Work, showing
from magcal_service.many import progress
from magcal_service.many.executor import Executor
from magcal_service.many.pieces import Piece
from magcal_service.many.progress import shown
from magcal_service.many.store import Store
from tests.many import work
from tests.many.here import Here


def test_a_log_gets_a_line_every_half_minute_and_not_more(monkeypatch: Any, capsys: Any) -> None:
    clock = iter([0.0, 10.0, 31.0, 40.0, 62.0])
    monkeypatch.setattr(progress.time, "monotonic", lambda: next(clock))
    count = Work("runs", 4, began_s=0.0)
    with shown(count) as show:
        for _ in range(4):
            count.done += 1
            show()
    told = [line.partition(",")[0] for line in capsys.readouterr().err.splitlines()]
    assert told == ["runs: 2 of 4 done", "runs: 4 of 4 done"]


def test_pieces_count_by_size_outcome_and_whether_they_were_kept(monkeypatch: Any, tmp_path: Path) -> None:
    seen: list[tuple[int, int, int]] = []

    def watched(count: Work) -> Any:
        return shown_with(lambda: seen.append((count.done, count.failed, count.kept)))

    monkeypatch.setattr("magcal_service.many.executor.shown", watched)
    executor = Executor(Here(), Store(tmp_path, reuse=True))
    list(executor.outcomes("x", [Piece("a", work.squared, 1, size=250)]))
    list(executor.outcomes("x", [Piece("a", work.squared, 1, size=250), Piece("b", work.divided, 0, size=4)]))
    assert seen == [(250, 0, 0), (250, 0, 250), (254, 4, 250)]


def test_quiet_silences_the_log_too(monkeypatch: Any, capsys: Any) -> None:
    clock = iter([0.0, 31.0])
    monkeypatch.setattr(progress.time, "monotonic", lambda: next(clock))
    with showing(quiet=True), shown(Work("runs", 4, began_s=0.0)) as show:
        show()
    assert capsys.readouterr().err == ""


def shown_with(show: Any) -> Any:
    """A context that gives this function."""
    from contextlib import nullcontext

    return nullcontext(show)
