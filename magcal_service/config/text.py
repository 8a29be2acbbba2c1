"""A craft's configuration as TOML text and back: what a recorded session says about how it was made."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

from magcal_service.base.errors import ConfigError, Fault
from magcal_service.base.typed_toml import parse_toml
from magcal_service.base.typed_toml.record import declared
from magcal_service.config.reader import read_config
from magcal_service.config.settings import CraftConfig


def craft_as_toml(craft: CraftConfig) -> str:
    """A whole configuration file of one craft, with every setting that has a value; ``craft_from_toml`` reads it."""
    return "version = 1\n\n[[craft]]\n" + _settings(craft, "craft")


def _settings(record: Any, name: str) -> str:
    """Plain settings first, then a table for each record within."""
    keys = {name: key.name or name for name, key in declared(type(record)).items()}
    keys = keys or {one.name: one.name for one in fields(record)}
    values = [(key, getattr(record, name)) for name, key in keys.items()]
    plain = [f"{key} = {_value(value)}\n" for key, value in values if value is not None and not _is_table(value)]
    tables = [f"\n[{name}.{key}]\n{_settings(value, f'{name}.{key}')}" for key, value in values if is_dataclass(value)]
    arrays = [
        f"\n[[{name}.{key}]]\n{_settings(each, f'{name}.{key}')}"
        for key, value in values
        if _is_table(value) and not is_dataclass(value)
        for each in value
    ]
    return "".join(plain + tables + arrays)


def _is_table(value: Any) -> bool:
    """Whether a value is a table, or an array of tables."""
    return is_dataclass(value) or value == () or (isinstance(value, tuple) and is_dataclass(value[0]))


def _value(value: Any) -> str:
    """JSON writes texts, numbers, booleans and arrays as TOML reads them, numbers to the last bit."""
    return json.dumps(str(value) if isinstance(value, Path) else value, ensure_ascii=False)


def craft_from_toml(text: str, file: str) -> CraftConfig:
    """The craft of such a text; raises ``ConfigError``, which names ``file``, where it is none."""
    crafts = read_config(parse_toml(text.encode(errors="replace"), file, file, ConfigError)).crafts
    if len(crafts) != 1:
        raise ConfigError([Fault(f"{file}: craft", len(crafts), "one [[craft]] is accepted")])
    return crafts[0]


def digest(crafts: Iterable[CraftConfig]) -> str:
    """SHA-256 of the crafts' configurations, in hexadecimal: equal where every setting is."""
    return hashlib.sha256("".join(map(craft_as_toml, crafts)).encode()).hexdigest()
