"""The rooms can be taken in at a glance, and each says what lives there and what it may import."""

from __future__ import annotations

import ast
from pathlib import Path

PACKAGE = Path(__file__).resolve().parents[2] / "magcal_service"
MOST_ENTRIES = 24  # files and folders directly in the package: a list that is read in one look


def test_the_package_is_a_short_list_of_rooms() -> None:
    entries = [path.name for path in PACKAGE.iterdir() if path.name != "__pycache__"]
    assert len(entries) <= MOST_ENTRIES


def test_every_room_says_what_it_may_import() -> None:
    rooms = [path for path in sorted(PACKAGE.rglob("__init__.py")) if path.parent != PACKAGE]
    assert len(rooms) > 20
    words = {path.parent.name: ast.get_docstring(ast.parse(path.read_text("utf-8"))) or "" for path in rooms}
    assert [name for name, said in words.items() if "mports" not in said] == []
