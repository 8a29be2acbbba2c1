"""The craft's configuration that a command is given beside a recording."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

from magcal_service.base.errors import ConfigError, Fault
from magcal_service.cli.common import check_method

if TYPE_CHECKING:
    from magcal_service.config.physics_file import PhysicsConfig
    from magcal_service.config.settings import CraftConfig
    from magcal_service.recordings.recording import Recording

CONFIG_HELP = "configuration of exactly one craft, or of --craft"


def craft_from(
    recording: Path, config: Path | None, name: str | None, what: str
) -> tuple[CraftConfig | None, str | None]:
    """The one craft of a configuration file, or the one of a name, None without a file; and which craft to read: of a
    session the one that is named, while rows have none to choose.

    Parameters
    ----------
    recording: what is to be read beside it.
    config: TOML file of the daemon.
    name: of the craft, where the file or the recording has several.
    what: the command in words, for its refusal ("a replay").

    Raises ``ConfigError`` for a file that is refused, where no single craft is meant, and where rows are to be read and
    the file has no craft of the name.
    """
    from magcal_service.config.reader import load_config
    from magcal_service.recordings.reader import is_session

    if config is None:
        return None, name
    crafts = load_config(config).crafts
    known = ", ".join(craft.name for craft in crafts)
    refusal = ConfigError([Fault("--craft", name, f"a [[craft]] of {config.name} is accepted; known: {known}")])
    named = tuple(craft for craft in crafts if craft.name == name)
    if len(crafts) > 1 and name is not None:
        crafts = named
        if not crafts:
            raise refusal
    if len(crafts) != 1:
        accepted = f"{what} takes exactly one [[craft]], or the one that --craft names; known: {known}"
        raise ConfigError([Fault(f"{config.name}: craft", len(crafts), accepted)])
    check_method(config, crafts[0].filter.method)
    if is_session(recording):
        return crafts[0], name
    if name is not None and not named:
        raise refusal
    return crafts[0], None


def say_undriven(physics: PhysicsConfig | None, recording: Recording) -> None:
    """Say on stderr, before the work is done, which effects of a ``physics.toml`` the recording cannot drive."""
    from magcal_service.physics.apply.lacking import undriven_lines
    from magcal_service.physics.apply.model_file import parse_model

    if physics is None:
        return
    for line in undriven_lines(physics.name, parse_model(physics.text.encode(), physics.name), recording.driving):
        print(line, file=sys.stderr)
