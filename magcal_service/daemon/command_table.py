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


class By(StrEnum):
    """Who carries a command out: the craft's pipeline, or the daemon, which has disk and life cycle."""

    CRAFT = "craft"
    DAEMON = "daemon"


@dataclass(frozen=True, slots=True)
class CommandSpec:
    """One command.

    Parameters
    ----------
    by: who carries it out.
    does: what it does, in a few words.
    arguments: by name: what is accepted.
    """

    by: By
    does: str
    arguments: Mapping[str, str] = field(default_factory=dict)


COMMANDS: Final[Mapping[str, CommandSpec]] = {
    "status": CommandSpec(By.CRAFT, "answers with verdict, reasons and ticks"),
    "freeze": CommandSpec(By.CRAFT, "nothing is learned any more; vectors and estimates go on"),
    "resume": CommandSpec(By.CRAFT, "learns again; what lies before counts as before a gap"),
    "reset": CommandSpec(By.CRAFT, "estimate and verdict begin anew; samples and counters stay"),
    "process_noise": CommandSpec(
        By.CRAFT,
        "random walk from now on, 0 where not given; kept in checkpoints",
        {name: f"0 to {limit:g}" for name, limit in PROCESS_NOISE_LIMITS.items()},
    ),
    "checkpoint": CommandSpec(
        By.DAEMON, "writes a named checkpoint, which stays until it is replaced", {"name": "a text"}
    ),
    "rollback": CommandSpec(
        By.DAEMON, "estimate and verdict of a named checkpoint; samples and counters stay", {"name": "a text"}
    ),
    "load_physics": CommandSpec(
        By.DAEMON,
        "compensates by it from now on; estimate and verdict begin anew; kept in checkpoints",
        {"name": "a file ending in .toml beside the configured one"},
    ),
    "shutdown": CommandSpec(By.DAEMON, "the daemon writes its checkpoints and ends with exit code 0"),
}
"""In the order in which they are listed to people."""


def unknown(name: str) -> str:
    """The refusal of a command that is not in the table."""
    return f"{name!r} is not known; known: {', '.join(COMMANDS)}"
