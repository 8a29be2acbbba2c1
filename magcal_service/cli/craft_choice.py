"""The craft's configuration that a command is given beside a recording."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from magcal_service.base.errors import ConfigError, Fault
from magcal_service.cli.common import check_method

if TYPE_CHECKING:
    from magcal_service.config.settings import CraftConfig

CONFIG_HELP = "configuration of exactly one craft, or of --craft"


def craft_from(config: Path | None, name: str | None, what: str) -> CraftConfig | None:
    """The one craft of a configuration file, or the one of a name; None without a file.

    Parameters
    ----------
    config: TOML file of the daemon.
    name: of the craft, where the file has several.
    what: the command in words, for its refusal ("a replay").

    Raises ``ConfigError`` for a file that is refused, and where no single craft is meant.
    """
    from magcal_service.config.reader import load_config

    if config is None:
        return None
    crafts = load_config(config).crafts
    known = ", ".join(craft.name for craft in crafts)
    if len(crafts) > 1 and name is not None:
        crafts = tuple(craft for craft in crafts if craft.name == name)
        if not crafts:
            raise _unknown(name, config, known)
    if len(crafts) != 1:
        accepted = f"{what} takes exactly one [[craft]], or the one that --craft names; known: {known}"
        raise ConfigError([Fault(f"{config.name}: craft", len(crafts), accepted)])
    check_method(config, crafts[0].filter.method)
    return crafts[0]


def craft_to_read(recording: Path, config: Path | None, name: str | None) -> str | None:
    """Which craft to read: of a session the one that is named; rows have none to choose, but the configuration may.

    Raises ``ConfigError`` where rows are to be read and the configuration has no craft of the name.
    """
    from magcal_service.config.reader import load_config
    from magcal_service.recordings.reader import is_session

    if config is None or is_session(recording):
        return name
    known = [craft.name for craft in load_config(config).crafts]
    if name is not None and name not in known:
        raise _unknown(name, config, ", ".join(known))
    return None


def _unknown(name: str, config: Path, known: str) -> ConfigError:
    return ConfigError([Fault("--craft", name, f"a [[craft]] of {config.name} is accepted; known: {known}")])
