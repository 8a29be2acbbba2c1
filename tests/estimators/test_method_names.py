"""One owner for each method: its name stands as a text in its own file alone, and its file offers what is run."""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import pytest

from magcal_service import estimators
from magcal_service.base.errors import MagcalError
from magcal_service.cli.__main__ import main
from magcal_service.estimators import find_method, methods
from magcal_service.estimators.interface import Method

ROOT = Path(__file__).resolve().parents[2]
HOME = Path(estimators.__file__).parent
NAMES = {method.name for method in methods()}

ANOTHER_MEANING = {
    ("magcal_service/config/settings.py", "ukf"),  # the default
    ("magcal_service/studies/table2.py", "ukf"),  # rows of the paper's own table
    ("magcal_service/studies/table2.py", "two-step"),
    ("magcal_service/estimators/plkf.py", "spin"),  # the section that it needs
    ("magcal_service/studies/unseen/motion.py", "spin"),  # how a craft turns
    ("magcal_service/studies/unseen/flight.py", "spin"),  # the section of its configuration
}
ALSO_A_WORD = "spin"
RUNNING = ("estimators", "daemon", "offline", "studies", "cli")
"""Rooms that run methods; elsewhere ``spin`` is a key or a kind, and no method."""


def texts(tree: ast.AST) -> Iterator[ast.Constant]:
    """String literals, of which a docstring is never a name."""
    return (node for node in ast.walk(tree) if isinstance(node, ast.Constant) and isinstance(node.value, str))


def strangers(path: Path) -> list[str]:
    """Names of methods that a file holds and does not own."""
    place = path.relative_to(ROOT).as_posix()
    own = {path.stem.replace("_", "-")} if path.parent == HOME else set()
    names = NAMES - own if place.split("/")[1] in RUNNING else NAMES - {ALSO_A_WORD}
    source = path.read_text(encoding="utf-8")
    if not any(name in source for name in names):  # most files, and reading them as Python takes the time
        return []
    return [
        f"{place}:{node.lineno}: {node.value}"
        for node in texts(ast.parse(source))
        if node.value in names and (place, node.value) not in ANOTHER_MEANING
    ]


def test_no_method_is_named_outside_its_own_file() -> None:
    """What a room has to know of a method is a field of ``Method``; docs and tests may name it."""
    files = [path for room in ("magcal_service", "sim_sensor") for path in (ROOT / room).rglob("*.py")]
    assert len(files) > 200
    assert [found for path in files for found in strangers(path)] == []


def test_a_name_in_another_file_is_seen(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(globals(), "ROOT", tmp_path)
    for room in ("daemon", "recordings"):
        path = tmp_path / "magcal_service" / room / "stray.py"
        path.parent.mkdir(parents=True)
        path.write_text('"""ukf"""\nx = ["two-step", "spin"]\n', encoding="utf-8")
    found = {room: strangers(tmp_path / "magcal_service" / room / "stray.py") for room in ("daemon", "recordings")}
    place = "magcal_service/{}/stray.py:2: {}"
    assert found["daemon"][-2:] == [place.format("daemon", name) for name in ("two-step", "spin")]
    assert place.format("recordings", "spin") not in found["recordings"]
    assert place.format("recordings", "two-step") in found["recordings"]


def with_method(monkeypatch: pytest.MonkeyPatch, file: str, method: Method) -> None:
    """A method's file as the registry finds it."""
    module = ModuleType(f"{estimators.__name__}.{file}")
    module.METHOD = method  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, module.__name__, module)


class Half:
    """An estimator that lacks what a checkpoint needs."""

    name = "ukf"

    def reset(self) -> None: ...
    def handle(self, tick: object) -> None: ...
    def estimate(self) -> None: ...


def test_a_class_that_is_no_estimator_is_refused(monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    """By all that is missing and where that is defined, before anything is read or run."""
    with_method(monkeypatch, "ukf", replace(find_method("ukf"), build=Half))  # type: ignore[arg-type]
    with pytest.raises(MagcalError) as refused:
        find_method("ukf")
    text = "method ukf: export_state, restore_state is missing (estimators/interface.py)"
    assert str(refused.value) == text
    assert main(["calibrate", "no-such-file.toml", "--method", "ukf"]) == 2
    assert capsys.readouterr().err == f"{text}\n"


def test_a_method_in_a_file_of_another_name_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """It would be listed, and found by no name."""
    with_method(monkeypatch, "two_step", replace(find_method("two-step"), name="three-step"))
    with pytest.raises(MagcalError, match=r"method three-step: its file is named two_step\.py, not as the method"):
        find_method("two-step")


def test_every_method_that_is_found_has_all_members() -> None:
    assert {method.name: method.missing() for method in methods()} == dict.fromkeys(NAMES, ())
