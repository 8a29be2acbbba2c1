"""Tables in the pages, between marks, written from results; what stands between the marks is never edited by hand.

A block is ``<!-- figures: NAME -->``, the table, ``<!-- end of figures -->``.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).resolve().parents[2]
_BLOCK: Final = re.compile(r"(<!-- figures: ([a-z0-9-]+) -->\n)(.*?)(<!-- end of figures -->)", re.DOTALL)


def pages() -> list[Path]:
    """Every page that may hold a block."""
    return [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]


def blocks(text: str) -> dict[str, str]:
    """The tables of a page as they stand, by name."""
    return {match[2]: match[3] for match in _BLOCK.finditer(text)}


def written(text: str, tables: Mapping[str, Callable[[], str]]) -> str:
    """The page with every block written anew; KeyError for a name that no table has."""
    return _BLOCK.sub(lambda match: f"{match[1]}{tables[match[2]]().rstrip()}\n{match[4]}", text)
