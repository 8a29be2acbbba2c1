"""docs/configuration.md says what the code does: every key, its default, its limits; its examples load."""

from __future__ import annotations

import re
import tomllib
from dataclasses import fields
from pathlib import Path
from typing import Any

import pytest

from magcal_service.config.reader import load_config
from magcal_service.config.settings import (
    Config,
    FilterConfig,
    HealthConfig,
    OutputConfig,
    RecordConfig,
    SensorConfig,
    SpinConfig,
    StateConfig,
    TickConfig,
    TrustConfig,
)

TEXT = (Path(__file__).resolve().parents[2] / "docs/configuration.md").read_text(encoding="utf-8")

TABLES: dict[str, Any] = {
    "[craft.sensor]": SensorConfig,
    "[craft.spin]": SpinConfig,
    "[craft.filter]": FilterConfig,
    "[craft.ticks]": TickConfig,
    "[craft.trust]": TrustConfig,
    "[output]": OutputConfig,
    "[record]": RecordConfig,
    "[state]": StateConfig,
    "[health]": HealthConfig,
}
SETTINGS = [(table, setting) for table, kind in TABLES.items() for setting in fields(kind)]


def rows(section: str) -> dict[str, list[str]]:
    """The rows of a section's table by key: unit, default, accepted, meaning."""
    _, _, rest = TEXT.partition(f"\n## {section}\n")
    cells = [
        [cell.strip() for cell in line.strip("|").split("|")]
        for line in rest.partition("\n## ")[0].splitlines()
        if line.startswith("| `")
    ]
    return {row[0].strip("`"): row[1:] for row in cells}


def written(text: str) -> object:
    """A default as the document writes it, in the code's terms."""
    if text in ("none", "estimated"):
        return None
    value = tomllib.loads(f"value = {text.strip('`')}")["value"]
    return tuple(value) if isinstance(value, list) else value


@pytest.mark.parametrize("table", TABLES)
def test_the_document_lists_exactly_the_keys_there_are(table: str) -> None:
    assert list(rows(f"`{table}`")) == [setting.name for setting in fields(TABLES[table])]


@pytest.mark.parametrize(("table", "setting"), SETTINGS, ids=lambda value: getattr(value, "name", value))
def test_the_documented_default_is_the_codes(table: str, setting: Any) -> None:
    documented = rows(f"`{table}`")[setting.name][1]
    special = {"axis": '`"z"`', "rate_rpm": "required", "directory": "required"}
    if setting.name in special:
        assert documented == special[setting.name]
    else:
        assert written(documented) == setting.default


@pytest.mark.parametrize(
    ("table", "setting"),
    [pair for pair in SETTINGS if pair[1].metadata],
    ids=lambda value: getattr(value, "name", value),
)
def test_the_documented_limits_are_the_codes(table: str, setting: Any) -> None:
    numbers = re.match(r"(\S+) to ([^\s,]+)", rows(f"`{table}`")[setting.name][2])
    assert numbers is not None
    assert tuple(float(number) for number in numbers.groups()) == tuple(setting.metadata["limits"])


@pytest.mark.parametrize(("table", "setting"), SETTINGS, ids=lambda value: getattr(value, "name", value))
def test_each_key_is_explained_in_its_tables_docstring(table: str, setting: Any) -> None:
    assert re.search(rf"\b{setting.name}\b", TABLES[table].__doc__)


def test_the_documented_link_is_the_codes() -> None:
    assert written(rows("Top of the file")["link"][1]) == Config().link


EXAMPLES = re.findall(r"```toml\n(.*?)```", TEXT, flags=re.DOTALL)


@pytest.mark.parametrize("example", EXAMPLES, ids=range(len(EXAMPLES)))
def test_the_documents_examples_load(tmp_path: Path, example: str) -> None:
    path = tmp_path / "example.toml"
    path.write_text(example, encoding="utf-8")
    assert load_config(path).crafts
