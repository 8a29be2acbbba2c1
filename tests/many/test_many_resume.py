"""Finished pieces on disk: found again after a run was cut, done again where anything they depend on has changed."""

from __future__ import annotations

import os
import subprocess
import sys
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from magcal_service.base.errors import InputRefusedError
from magcal_service.many import identity
from magcal_service.many.executor import Executor
from magcal_service.many.identity import content_of, key_of
from magcal_service.many.pieces import Done, Piece, Refused, Task, perform
from magcal_service.many.pool import Pool
from magcal_service.many.store import Store
from tests.many import work
from tests.many.here import Here

ROOT = Path(__file__).resolve().parents[2]


def again(folder: Path) -> Executor:
    """An executor that goes on with what is in a folder."""
    return Executor(Here(), Store(folder, reuse=True))


def test_a_run_that_was_cut_goes_on_and_does_no_finished_piece_again(tmp_path: Path) -> None:
    jobs = [(tmp_path / "log", value) for value in range(5)]
    results = Executor(Here(), Store(tmp_path / "pieces", reuse=False)).map(work.noted, jobs)
    assert [next(results), next(results)] == [100, 101]
    results.close()
    assert list(again(tmp_path / "pieces").map(work.noted, jobs)) == [100, 101, 102, 103, 104]
    assert (tmp_path / "log").read_text().split() == ["0", "1", "2", "3", "4"]


def test_a_run_whose_process_was_killed_goes_on_in_another(tmp_path: Path) -> None:
    """What is kept is found under the same keys by another process, and by another engine."""
    jobs = [(tmp_path / "log", value) for value in range(3)]
    code = f"""
import os, signal
from pathlib import Path
from magcal_service.many.executor import Executor
from magcal_service.many.store import Store
from tests.many.here import Here
from tests.many.work import noted
results = Executor(Here(), Store(Path({str(tmp_path / "pieces")!r}), reuse=False)).map(
    noted, [(Path({str(tmp_path / "log")!r}), value) for value in range(3)])
next(results), next(results)
os.kill(os.getpid(), signal.SIGKILL)
"""
    assert subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=False).returncode == -9
    executor = Executor(Pool(1), Store(tmp_path / "pieces", reuse=True))
    assert list(executor.map(work.noted, jobs)) == [100, 101, 102]
    assert (tmp_path / "log").read_text().split() == ["0", "1", "2"]


def test_without_resume_all_is_done_anew(tmp_path: Path) -> None:
    jobs = [(tmp_path / "log", value) for value in range(2)]
    for _ in range(2):
        list(Executor(Here(), Store(tmp_path / "pieces", reuse=False)).map(work.noted, jobs))
    assert (tmp_path / "log").read_text().split() == ["0", "1", "0", "1"]


def test_more_jobs_extend_what_is_there(tmp_path: Path) -> None:
    for count in (2, 4):
        list(again(tmp_path / "pieces").map(work.noted, [(tmp_path / "log", value) for value in range(count)]))
    assert (tmp_path / "log").read_text().split() == ["0", "1", "2", "3"]


def test_a_changed_input_is_done_again_and_an_unchanged_one_is_not(tmp_path: Path) -> None:
    """The second file changes: its piece alone is new."""
    paths = [tmp_path / "a", tmp_path / "b"]
    for path in paths:
        path.write_bytes(b"1")
    pieces = [Piece(path.name, work.length, path, (path,)) for path in paths]
    executor = again(tmp_path / "pieces")
    assert list(executor.outcomes("lengths", pieces)) == [Done(1), Done(1)]
    paths[1].write_bytes(b"12")
    assert list(executor.outcomes("lengths", pieces)) == [Done(1), Done(2)]
    assert len(list((tmp_path / "pieces").iterdir())) == 3


def test_changed_code_is_another_piece(monkeypatch: Any) -> None:
    before = key_of(work.squared, 3, ())
    monkeypatch.setattr(identity, "_code", lambda module: "another")
    assert key_of(work.squared, 3, ()) != before


def test_the_code_is_that_of_the_functions_package_too(tmp_path: Path, monkeypatch: Any) -> None:
    (tmp_path / "elsewhere").mkdir()
    source = tmp_path / "elsewhere" / "__init__.py"
    source.write_text("def one(x): return 1\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    import elsewhere  # type: ignore[import-not-found]

    before = identity._code.__wrapped__("elsewhere")
    assert identity.code_of(elsewhere.one) == identity.code_of(partial(elsewhere.one)) == before
    source.write_text("def one(x): return 2\n")
    assert identity._code.__wrapped__("elsewhere") != before


def test_a_worker_with_other_code_or_another_file_does_not_answer(tmp_path: Path) -> None:
    path = tmp_path / "a"
    path.write_bytes(b"1")
    code = identity.code_of(work.length)
    assert perform(Task(work.length, path, ((path, content_of(path)),), code)) == Done(1)
    stale = perform(Task(work.length, path, ((path, content_of(path)),), "of yesterday"))
    assert isinstance(stale, Refused)
    assert "worker's code" in stale.text
    other = perform(Task(work.length, path, ((path, "of yesterday"),), code))
    assert isinstance(other, Refused)
    assert str(path) in other.text


@pytest.mark.parametrize("content", [b"", b"short", b"\0" * 100])
def test_a_damaged_piece_counts_as_none(content: bytes, tmp_path: Path) -> None:
    store = Store(tmp_path / "pieces", reuse=True)
    store.put("key", Done({"x": 1}))
    assert store.get("key") == Done({"x": 1})
    (kept,) = store.folder.iterdir()
    kept.write_bytes(content or kept.read_bytes()[:-1])
    assert store.get("key") is None


def test_a_folder_that_cannot_be_made_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputRefusedError, match="file"):
        Store(tmp_path / "file" / "pieces", reuse=False)


def test_results_that_cannot_be_kept_are_refused_by_file(tmp_path: Path, monkeypatch: Any) -> None:
    def full(source: Path, target: Path) -> None:
        raise OSError(28, "No space left on device")

    store = Store(tmp_path, reuse=True)
    monkeypatch.setattr(os, "replace", full)
    with pytest.raises(InputRefusedError, match=r"key\.piece: no space is left on the disk"):
        store.put("key", Done(1))
    assert list(tmp_path.iterdir()) == []
