"""Every option of every command is on the page of its command, or in a table of options that many commands have."""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from magcal_service.cli.__main__ import whole_parser
from magcal_service.cli.common import subparsers
from sim_sensor.cli import _parser as sim_parser

DOCS = Path(__file__).resolve().parents[2] / "docs"

PAGES = {
    "run": "deploy",
    "replay": "recorder",
    "calibrate": "methods",
    "diagnose": "diagnosis",
    "describe": "describe",
    "inspect": "inspect",
    "apply": "ways-out",
    "export": "ways-out",
    "plot": "plot",
    "study": "studies",
    "status": "watch",
    "reference": "reference",
    "send": "state",
    "view": "view",
    "watch": "watch",
    "record": "recorder",
    "xtce": "mission-control",
    "completion": "index",
    "sim-sensor": "simulator",
}
"""Where each command is told."""

TABLED = ("diagnose", "study")
"""Commands whose page has a table of their options: each is a row of it."""

SHARED = ("index", "many")
"""Pages with a table of options that many commands have."""

OPTION = re.compile(r"(?<![\w-])--[a-z][a-z-]*")


def commands(parser: argparse.ArgumentParser, name: str) -> Iterator[tuple[str, set[str]]]:
    """Each command that ends a chain of sub-commands, with its long options."""
    below = subparsers(parser)
    for word, one in below.items():
        yield from commands(one, f"{name} {word}".strip())
    if not below:
        options = {text for action in parser._actions for text in action.option_strings if text.startswith("--")}
        yield name, options - {"--help"}


OPTIONS = dict([*commands(whole_parser(), ""), *commands(sim_parser(), "sim-sensor")])


def page(name: str) -> str:
    return (DOCS / f"{name}.md").read_text(encoding="utf-8")


def in_table(name: str) -> set[str]:
    """Options that begin a row in a page's tables of options."""
    rows = re.findall(r"^\| option \|.*\n\|[-| ]+\n((?:\|.*\n)+)", page(name), re.M)
    return {option for table in rows for row in table.splitlines() for option in OPTION.findall(row.split(" | ")[0])}


@pytest.mark.parametrize("command", OPTIONS)
def test_every_option_of_a_command_is_told(command: str) -> None:
    word = command.split()[0]
    own = in_table(PAGES[word]) if word in TABLED else set(OPTION.findall(page(PAGES[word])))
    shared = set() if word in TABLED else {option for name in SHARED for option in in_table(name)}
    assert OPTIONS[command] - own - shared == set()


@pytest.mark.parametrize("command", TABLED)
def test_a_table_of_options_has_no_other(command: str) -> None:
    assert in_table(PAGES[command]) - OPTIONS[command] == set()


def test_every_command_is_there() -> None:
    assert {"diagnose", "record info", "sim-sensor record"} <= OPTIONS.keys()
    assert {command.split()[0] for command in OPTIONS} == PAGES.keys()
    assert {"--config", "--craft", "--source", "--json", "--quiet"} <= in_table("index")
