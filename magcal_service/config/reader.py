"""The daemon's configuration from its TOML file: every fault reported at once."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

from magcal_service.base.errors import ConfigError
from magcal_service.base.typed_toml import Table, TomlKind, open_toml, refuse_another
from magcal_service.base.typed_toml.record import read_record
from magcal_service.config.physics_file import physics_of
from magcal_service.config.settings import Config

__all__ = ["load_config", "physics_of", "read_config"]

VERSION = 1
"""Of the file format: another one may give known keys another meaning, so it is refused."""


def load_config(path: Path, methods: Collection[str] = ()) -> Config:
    """Read and check a configuration file.

    Parameters
    ----------
    path: TOML file.
    methods: names of the estimators there are; empty: any well-formed ``filter.method`` is accepted.

    Raises ConfigError with every fault in the file: file, field, value, what is accepted.
    """
    return read_config(open_toml(path, ConfigError), methods)


def _list_sensors(top: Table) -> None:
    """``[[craft.sensor]]``, each with its source, are the craft's magnetometers; ``[craft.sensor]`` what they share."""
    crafts = top.content.get("craft")
    for craft in crafts if isinstance(crafts, list) else ():
        listed = craft.get("sensor") if isinstance(craft, dict) else None
        if isinstance(listed, list) and "magnetometer" not in craft:
            craft["magnetometer"] = craft.pop("sensor")


def read_config(top: Table, methods: Collection[str] = ()) -> Config:
    """Build a ``Config`` from a parsed file; parameters and errors as for ``load_config``."""
    refuse_another(top, TomlKind.CONFIG, ConfigError)
    version = top.number("version", required=True)
    if version not in (None, VERSION):
        top.refuse("version", version, f"{VERSION} is accepted")
    _list_sensors(top)
    config = read_record(top, Config, context={"methods": methods, "names": set()})
    if top.faults:
        raise ConfigError(top.faults)
    return config
