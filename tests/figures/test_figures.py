"""No table of figures is written by hand: each stands as its results give it."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from tests.benchmarks import results
from tests.figures.pages import ROOT, blocks, pages, written
from tests.figures.tables import TABLES, study_table

PLACEHOLDER = re.compile(r"\bTBD\b|\b[A-Z]{4,}[0-9]+ROW\b|\bFIXME\b|\bXXX\b")


@pytest.mark.parametrize("page", pages(), ids=lambda page: page.name)
def test_every_table_of_figures_stands_as_its_results_give_it(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert written(text, TABLES) == text, "run: make docs-figures"


def test_every_table_is_in_some_page() -> None:
    assert set().union(*(blocks(page.read_text(encoding="utf-8")) for page in pages())) == set(TABLES)


def test_a_number_changed_by_hand_is_seen() -> None:
    page = ROOT / "docs/recordings.md"
    text = page.read_text(encoding="utf-8")
    name, table = next(iter(blocks(text).items()))
    spoiled = text.replace(table, re.sub(r"\d", "7", table))
    assert blocks(spoiled)[name] != table
    assert written(spoiled, TABLES) == text


@pytest.mark.parametrize("page", pages(), ids=lambda page: page.name)
def test_no_page_holds_a_placeholder(page: Path) -> None:
    assert not PLACEHOLDER.findall(page.read_text(encoding="utf-8"))


@pytest.mark.parametrize("page", pages(), ids=lambda page: page.name)
def test_every_picture_of_a_page_is_there_and_small(page: Path) -> None:
    shown = re.findall(r"\]\((?!https?:)([^)\s]+\.(?:webp|png|svg))\)", page.read_text(encoding="utf-8"))
    sizes = {name: (page.parent / name).stat().st_size for name in shown}
    assert {name: size for name, size in sizes.items() if name.endswith(".webp") and size > 100_000} == {}


def test_a_study_s_table_is_written_as_its_json_has_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    columns = ["recording", "held out [nT]", "false name", "processor [s]"]
    rows = [["one", 1234.5, "no", 2.5], ["two", None, "torquer", None]]
    tables = [{"title": "Others", "columns": [], "rows": []}, {"title": "Every one", "columns": columns, "rows": rows}]
    (tmp_path / "made-up.json").write_text(json.dumps({"tables": tables}), encoding="utf-8")
    monkeypatch.setattr(results, "FOLDER", tmp_path)
    assert study_table("made-up", "Every").splitlines() == [
        "| recording | held out [nT] | false name | processor [s] |",
        "|---|---:|---|---:|",
        "| one | 1234 | no | 2.5 |",
        "| two | - | torquer | - |",
    ]
