"""Every command that may come over a link: its arguments, who carries it out, and what it does.

The single definition: the pipeline and the commander find handlers by these names, an unknown command is
refused with them, and a test compares the table of docs/state.md with them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Final

PROCESS_NOISE_LIMITS: Final = {"bias_nt": 1000.0, "D": 0.01}
"""Largest random walk [nT/sqrt(s)], [1/sqrt(s)]: as ``[craft.filter]`` accepts it."""

PROCESS_NOISE_UNITS: Final = {"bias_nt": "nT/sqrt(s)", "D": "/sqrt(s)"}


class By(StrEnum):
    """Who carries a command out: the craft's pipeline, or the daemon, which has disk and life cycle."""

    CRAFT = "craft"
    DAEMON = "daemon"


@dataclass(frozen=True, slots=True)
class Argument:
    """One argument of a command.

    Parameters
    ----------
    accepted: its values, in words.
    is_number: whether it is a number; a text where not.
    is_needed: whether the command is refused without it.
    """

    accepted: str
    is_number: bool = False
    is_needed: bool = False


@dataclass(frozen=True, slots=True)
class CommandSpec:
    """One command.

    Parameters
    ----------
    by: who carries it out.
    does: what it does, in a few words.
    arguments: by name.
    """

    by: By
    does: str
    arguments: Mapping[str, Argument] = field(default_factory=dict)


_NAME: Final = Argument("1 to 32 of A-Z a-z 0-9 _ -", is_needed=True)

WHICH: Final = "source"
"""An argument that every command takes as well: which magnetometer alone it is for."""

COMMANDS: Final[Mapping[str, CommandSpec]] = {
    "status": CommandSpec(By.CRAFT, "answers with verdict, reasons and ticks"),
    "freeze": CommandSpec(By.CRAFT, "nothing is learned any more; vectors and estimates go on"),
    "resume": CommandSpec(By.CRAFT, "learns again; what lies before counts as before a gap"),
    "reset": CommandSpec(By.CRAFT, "estimate and verdict begin anew; samples and counters stay"),
    "process_noise": CommandSpec(
        By.CRAFT,
        "random walk from now on, 0 where not given; kept in checkpoints; no protection level until the filter's next "
        "start without it",
        {
            name: Argument(f"0 to {limit:g} {PROCESS_NOISE_UNITS[name]}", is_number=True)
            for name, limit in PROCESS_NOISE_LIMITS.items()
        },
    ),
    "checkpoint": CommandSpec(
        By.DAEMON, "writes a named checkpoint, which stays until it is replaced", {"name": _NAME}
    ),
    "rollback": CommandSpec(
        By.DAEMON, "estimate and verdict of a named checkpoint; samples and counters stay", {"name": _NAME}
    ),
    "load_physics": CommandSpec(
        By.DAEMON,
        "compensates by it from now on; estimate and verdict begin anew; kept in checkpoints",
        {"name": Argument("a file ending in .toml beside the configured one (default: that one again)")},
    ),
    "shutdown": CommandSpec(By.DAEMON, "the daemon writes its checkpoints and ends with exit code 0"),
}
"""In the order in which they are listed to people."""


def unknown(name: str) -> str:
    """The refusal of a command that is not in the table."""
    return f"{name!r} is not known; known: {', '.join(COMMANDS)}"
