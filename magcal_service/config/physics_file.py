"""The ``physics.toml`` that a configuration names: read and checked with it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from magcal_service.base.errors import InputRefusedError
from magcal_service.base.typed_toml import Table
from magcal_service.base.typed_toml.record import Reading
from magcal_service.physics.apply.advice import doubts_of


@dataclass(frozen=True, slots=True)
class PhysicsConfig:
    """A ``physics.toml`` that is compensated live: where it is, and what it said when it was read."""

    path: Path
    text: str

    @property
    def name(self) -> str:
        """Of the file."""
        return self.path.name

    @property
    def doubts(self) -> list[str]:
        """What the file says against acting on it, a line each."""
        from magcal_service.physics.apply.model_file import parse_model

        return doubts_of(parse_model(self.text.encode(), self.name).doubts)


def physics_of(path: Path) -> PhysicsConfig:
    """Read a ``physics.toml``; raises InputRefusedError with every fault in it."""
    from magcal_service.physics.apply.model_file import (  # the catalogue is loaded where it is asked for
        read_model,
        text_of,
    )

    return PhysicsConfig(path, text_of(read_model(path)))


def physics_setting(reading: Reading, name: str) -> PhysicsConfig | None:
    """The file that ``name`` names; its faults become the configuration's.

    A recorded session holds a table instead, with the file's ``path`` and ``text``, for the file may be gone.
    """
    table = reading.table
    content = table.content.get(name)
    if isinstance(content, dict) and set(content) == {"path", "text"}:
        table.has(name)
        return _recorded(table, str(content["path"]), str(content["text"]))
    text = table.text(name, "", accepted="a file written by magcal diagnose")
    if not text.strip():
        if isinstance(table.content.get(name), str):
            table.refuse(name, text, "a file written by magcal diagnose is accepted; leave it out for none")
        return None
    try:
        return physics_of(Path(text))
    except InputRefusedError as error:
        table.faults.extend(error.faults)
        return None


def _recorded(table: Table, path: str, text: str) -> PhysicsConfig | None:
    from magcal_service.physics.apply.model_file import parse_model, text_of

    try:
        return PhysicsConfig(Path(path), text_of(parse_model(text.encode(), path)))
    except InputRefusedError as error:
        table.faults.extend(error.faults)
        return None
