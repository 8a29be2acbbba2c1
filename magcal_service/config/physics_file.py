"""The ``physics.toml`` that a configuration names: read and checked with it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from magcal_service.errors import InputRefusedError
from magcal_service.typed_toml.record import Reading


@dataclass(frozen=True, slots=True)
class PhysicsConfig:
    """A ``physics.toml`` that is compensated live: where it is, and what it said when it was read."""

    path: Path
    text: str


def physics_of(path: Path) -> PhysicsConfig:
    """Read a ``physics.toml``; raises InputRefusedError with every fault in it."""
    from magcal_service.physics.apply.model_file import (  # the catalogue is loaded where it is asked for
        read_model,
        text_of,
    )

    return PhysicsConfig(path, text_of(read_model(path)))


def physics_setting(reading: Reading, name: str) -> PhysicsConfig | None:
    """The file that ``name`` names; its faults become the configuration's."""
    table = reading.table
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
