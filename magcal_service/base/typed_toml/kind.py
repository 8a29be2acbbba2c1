"""The TOML files there are, told by the sections that one has and the others have not."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from pathlib import Path
from typing import Any

from magcal_service.base.errors import Fault, InputRefusedError, Lacking
from magcal_service.base.typed_toml.parse import open_toml
from magcal_service.base.typed_toml.table import Table


class TomlKind(StrEnum):
    """What a file is, in words."""

    RECORDING = "the descriptor of a log"
    MODEL = "a model of physics"
    CONFIG = "a configuration"
    SCENARIO = "a scenario of sim-sensor"

    @property
    def accepted(self) -> str:
        """That this one is wanted, with its usual name or its page."""
        return f"{self} is accepted, {_USUAL[self]}"


_USUAL = {
    TomlKind.RECORDING: "RECORDING.toml by its usual name; magcal describe LOG --out RECORDING.toml makes one",
    TomlKind.MODEL: "physics.toml as diagnose --out writes it (docs/physics-file.md)",
    TomlKind.CONFIG: "of the daemon (docs/configuration.md)",
    TomlKind.SCENARIO: "or the name of a shipped one (docs/simulator.md)",
}


def kind_of(content: Mapping[str, Any]) -> TomlKind | None:
    """The kind that a file's sections say; None where they say none."""
    if "samples" in content:
        return TomlKind.RECORDING
    if "errors" in content:
        return TomlKind.MODEL
    if isinstance(content.get("craft"), list):  # a scenario has its name there
        return TomlKind.CONFIG
    return TomlKind.SCENARIO if {"orbit", "description"} & content.keys() else None


def refuse_another(top: Table, own: TomlKind, error: type[InputRefusedError]) -> None:
    """Raise ``error`` where a file is of another kind or empty: one line, in place of one for each of its keys."""
    if not top.content:
        raise error([Lacking(top.file, "this file is empty", own.accepted)])
    found = kind_of(top.content)
    if found not in (None, own):
        raise error([Fault(top.file, str(found), own.accepted)])


def refuse_kinds(path: Path, own: TomlKind, more: str) -> None:
    """Raise ``InputRefusedError`` where a file is of another kind, with what is accepted beside its own.

    Parameters
    ----------
    path: of the file; what is too large, no TOML, or of no kind that is known, passes: whoever reads it says so.
    own: the kind that is taken.
    more: what else is accepted, or the next step.
    """
    try:
        found = kind_of(open_toml(path, InputRefusedError).content)
    except InputRefusedError:
        return
    if found not in (None, own):
        raise InputRefusedError([Fault(path.name, str(found), f"{own.accepted}; {more}")])
