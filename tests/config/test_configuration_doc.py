"""docs/configuration.md says what the code does: every key, its default, its limits; its examples load."""

from __future__ import annotations

import re
import tomllib
from dataclasses import fields
from pathlib import Path
from typing import Any

import pytest

from magcal_service.base.typed_toml.record import REQUIRED, Key, declared
from magcal_service.config.daemon_settings import CommandsConfig, HealthConfig, OutputConfig, RecordConfig, StateConfig
from magcal_service.config.reader import load_config
from magcal_service.config.settings import (
    Config,
    FilterConfig,
    MagnetometerConfig,
    ReferenceConfig,
    SensorConfig,
    SpinConfig,
    TickConfig,
    TrustConfig,
)

TEXT = (Path(__file__).resolve().parents[2] / "docs/configuration.md").read_text(encoding="utf-8")

TABLES: dict[str, Any] = {
    "[craft.sensor]": SensorConfig,
    "[[craft.magnetometer]]": MagnetometerConfig,
    "[craft.spin]": SpinConfig,
    "[craft.filter]": FilterConfig,
    "[craft.reference]": ReferenceConfig,
    "[craft.ticks]": TickConfig,
    "[craft.trust]": TrustConfig,
    "[output]": OutputConfig,
    "[record]": RecordConfig,
    "[state]": StateConfig,
    "[health]": HealthConfig,
    "[commands]": CommandsConfig,
}
SETTINGS = [(table, name, key) for table, kind in TABLES.items() for name, key in declared(kind).items()]
NAMES = [f"{table}-{name}" for table, name, _ in SETTINGS]
LIMITED = [one for one in SETTINGS if one[2].limits]


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
    assert list(rows(f"`{table}`")) == list(declared(TABLES[table]))


@pytest.mark.parametrize("kind", TABLES.values(), ids=TABLES)
def test_every_field_of_a_section_can_be_set(kind: Any) -> None:
    assert [one.name for one in fields(kind)] == list(declared(kind))


@pytest.mark.parametrize(("table", "name", "key"), SETTINGS, ids=NAMES)
def test_the_documented_default_is_the_codes(table: str, name: str, key: Key) -> None:
    documented = rows(f"`{table}`")[name][1]
    if name == "axis":
        assert documented == '`"z"`'
    elif key.default is REQUIRED:
        assert documented == "required"
    else:
        assert written(documented) == key.default


@pytest.mark.parametrize(("table", "name", "key"), SETTINGS, ids=NAMES)
def test_the_documented_unit_is_the_codes(table: str, name: str, key: Key) -> None:
    assert rows(f"`{table}`")[name][0] == (key.unit or "-")


@pytest.mark.parametrize(("table", "name", "key"), LIMITED, ids=[f"{table}-{name}" for table, name, _ in LIMITED])
def test_the_documented_limits_are_the_codes(table: str, name: str, key: Key) -> None:
    numbers = re.match(r"(\S+) to ([^\s,]+)", rows(f"`{table}`")[name][2])
    assert numbers is not None
    assert tuple(float(number) for number in numbers.groups()) == key.limits


@pytest.mark.parametrize(("table", "name"), [one[:2] for one in SETTINGS], ids=NAMES)
def test_each_key_is_explained_in_its_tables_docstring(table: str, name: str) -> None:
    assert re.search(rf"\b{name}\b", TABLES[table].__doc__)


def test_the_documented_link_is_the_codes() -> None:
    assert written(rows("Top of the file")["link"][1]) == Config().link


EXAMPLES = re.findall(r"```toml\n(.*?)```", TEXT, flags=re.DOTALL)


@pytest.mark.parametrize("example", EXAMPLES, ids=range(len(EXAMPLES)))
def test_the_documents_examples_load(tmp_path: Path, example: str) -> None:
    path = tmp_path / "example.toml"
    path.write_text(example, encoding="utf-8")
    assert load_config(path).crafts
