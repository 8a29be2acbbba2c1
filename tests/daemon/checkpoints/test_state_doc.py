"""docs/state.md names what the code does: every command and every event."""

from __future__ import annotations

import re
from pathlib import Path

from magcal_service.daemon.commands import COMMANDS as OF_THE_DAEMON
from magcal_service.daemon.pipeline import ALL_COMMANDS, COMMANDS

ROOT = Path(__file__).resolve().parents[3]
TEXT = (ROOT / "docs/state.md").read_text(encoding="utf-8")


def first_cells(section: str) -> list[str]:
    """The names in the first column of a section's table."""
    rows = TEXT.partition(f"\n## {section}\n")[2].partition("\n## ")[0].splitlines()
    return [name for row in rows if row.startswith("| `") for name in re.findall(r"`(\w+)`", row.split("|")[1])]


def test_every_command_is_listed_and_no_other() -> None:
    assert first_cells("Commands") == list(ALL_COMMANDS) == [*COMMANDS, *OF_THE_DAEMON]


def test_every_event_that_the_code_tells_is_listed_and_no_other() -> None:
    told = set()
    for file in sorted((ROOT / "magcal_service/daemon").rglob("*.py")):
        source = file.read_text(encoding="utf-8")
        for call in re.findall(r"\.(?:tell|event)\(([^,]+),", source):
            told |= set(re.findall(r'"(\w+)"', call))
    assert set(first_cells("Events")) == told
