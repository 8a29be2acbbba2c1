"""docs/state.md names what the code does: every command and every event."""

from __future__ import annotations

import re
from pathlib import Path

from magcal_service.daemon.command_table import COMMANDS, By
from magcal_service.daemon.commands import DAEMON_COMMANDS
from magcal_service.daemon.craft_commands import CRAFT_COMMANDS

ROOT = Path(__file__).resolve().parents[3]
TEXT = (ROOT / "docs/state.md").read_text(encoding="utf-8")


def first_cells(section: str) -> list[str]:
    """The names in the first column of a section's table."""
    rows = TEXT.partition(f"\n## {section}\n")[2].partition("\n## ")[0].splitlines()
    return [name for row in rows if row.startswith("| `") for name in re.findall(r"`(\w+)`", row.split("|")[1])]


def test_every_command_is_listed_and_no_other() -> None:
    assert first_cells("Commands") == list(COMMANDS)


def test_every_command_has_one_who_carries_it_out() -> None:
    assert {name for name, spec in COMMANDS.items() if spec.by is By.CRAFT} == set(CRAFT_COMMANDS)
    assert {name for name, spec in COMMANDS.items() if spec.by is By.DAEMON} == set(DAEMON_COMMANDS)


def test_the_page_says_what_each_command_does_in_the_tables_words() -> None:
    section = TEXT.partition("\n## Commands\n")[2].partition("\n## ")[0]
    for spec in COMMANDS.values():
        assert spec.does in section
        assert all(f"`{argument}`" in section for argument in spec.arguments)


def test_every_event_that_the_code_tells_is_listed_and_no_other() -> None:
    told = set()
    for file in sorted((ROOT / "magcal_service/daemon").rglob("*.py")):
        source = file.read_text(encoding="utf-8")
        for call in re.findall(r"\.(?:note|event)\(([^,]+),", source):
            told |= set(re.findall(r'"(\w+)"', call))
    assert set(first_cells("Events")) == told
