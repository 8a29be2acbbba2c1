"""What an earlier run has left in a folder of results: removed by name, and nothing else."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from magcal_service.base.errors import InputRefusedError
from magcal_service.offline.result_files import earlier_files, kept_line, remove, removed_line

OF_ONE = ("diagnosis.json", "physics.toml", "report.html")


def _result(folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for name in OF_ONE:
        (folder / name).write_text('{"verdict": "none"}', encoding="utf-8")


def _summary(folder: Path, *names: str) -> None:
    for name in names:
        _result(folder / name)
    rows = [{"folder": name} for name in names]
    content = {"question": "diagnose", "exit": 0, "recordings": rows}
    (folder / "summary.json").write_text(json.dumps(content), encoding="utf-8")


def _below(folder: Path, files: list[Path]) -> set[str]:
    return {str(path.relative_to(folder)) for path in files}


def test_of_one_run_its_three_files(tmp_path: Path) -> None:
    _result(tmp_path)
    (tmp_path / "notes.txt").write_text("mine")
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "physics.toml").write_text("mine")
    found = earlier_files(tmp_path)
    assert _below(tmp_path, found) == set(OF_ONE)
    remove(found)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["notes.txt", "other"]
    assert (tmp_path / "other" / "physics.toml").read_text() == "mine"


def test_of_many_the_summary_and_the_folders_that_it_names(tmp_path: Path) -> None:
    _summary(tmp_path, "A", "day/B")
    (tmp_path / "A" / "mine.csv").write_text("mine")
    found = earlier_files(tmp_path, ["C"])
    wanted = {f"{folder}/{name}" for folder in ("A", "day/B") for name in OF_ONE}
    assert _below(tmp_path, found) == {"summary.json", *wanted}
    _result(tmp_path / "C")
    assert _below(tmp_path, earlier_files(tmp_path, ["C"])) - wanted == {"summary.json", *(f"C/{n}" for n in OF_ONE)}


@pytest.mark.parametrize(
    "content", ["{", "[]", '{"recordings": [{"folder": "A"}]}', '{"question": "x", "recordings": 3}']
)
def test_a_summary_that_is_none_of_ours_names_nothing(tmp_path: Path, content: str) -> None:
    _result(tmp_path / "A")
    (tmp_path / "summary.json").write_text(content, encoding="utf-8")
    assert earlier_files(tmp_path) == []


def test_a_model_that_somebody_laid_there_is_no_result_of_a_run(tmp_path: Path) -> None:
    (tmp_path / "physics.toml").write_text("mine")
    (tmp_path / "diagnosis.json").write_text('{"patient": "mine"}')
    assert earlier_files(tmp_path) == []


def test_nothing_outside_the_folder_is_named_by_a_summary(tmp_path: Path) -> None:
    out = tmp_path / "out"
    _summary(out, "A")
    _result(tmp_path / "victim")
    os.symlink(tmp_path / "victim", out / "link")
    rows = [{"folder": name} for name in ("../victim", str(tmp_path / "victim"), "link", ".", 7)]
    (out / "summary.json").write_text(json.dumps({"question": "diagnose", "recordings": rows}))
    assert _below(out, earlier_files(out)) == {"summary.json"}


def test_what_is_written_anew_is_not_said_to_be_removed(tmp_path: Path) -> None:
    _result(tmp_path)
    files = earlier_files(tmp_path)
    written = [tmp_path / "diagnosis.json", tmp_path / "report.html"]
    assert removed_line(tmp_path, files, written) == [f"removed from {tmp_path}, of an earlier run: physics.toml"]
    assert removed_line(tmp_path, files, files) == []


def test_what_a_refused_run_leaves_is_said(tmp_path: Path) -> None:
    assert kept_line(tmp_path) == []
    _result(tmp_path)
    assert kept_line(tmp_path) == [f"{tmp_path} still has the files of an earlier run: {', '.join(OF_ONE)}"]


def test_a_file_that_cannot_be_removed_is_refused_by_name(tmp_path: Path) -> None:
    (tmp_path / "taken").mkdir()
    with pytest.raises(InputRefusedError, match="taken"):
        remove([tmp_path / "taken"])
