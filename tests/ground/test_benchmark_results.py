"""What benchmarks leave in ``docs/results``: figures with a command that any machine can run."""

from __future__ import annotations

import json

import pytest

from tests.benchmarks import results


@pytest.mark.parametrize("name", sorted(path.stem for path in results.FOLDER.glob("*.json")))
def test_a_command_has_no_path_of_one_machine(name: str) -> None:
    content = json.loads((results.FOLDER / f"{name}.json").read_text(encoding="utf-8"))
    assert not [word for word in content.get("command", "").split() if word.startswith("/")]


def test_a_path_is_written_as_seen_from_the_project() -> None:
    beside = results.FOLDER.parents[2] / "data"
    assert results._of_any_machine(str(beside)) == "../data"
    assert results._of_any_machine("--data") == "--data"
    assert results._of_any_machine("docs/results") == "docs/results"
