"""Commands that act on more than one craft's estimate: its checkpoints, and the end of the daemon.

``command_table`` has them all; those of the craft are answered by its pipeline.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Final

from magcal_service.base.errors import InputRefusedError
from magcal_service.config.private_files import check_input
from magcal_service.config.reader import physics_of
from magcal_service.daemon.checkpoints.store import Checkpoints
from magcal_service.daemon.pipeline import Pipeline
from magcal_service.wire.messages import Command, CommandReply

_FILE: Final = re.compile(r"[A-Za-z0-9_-]{1,64}\.toml")


class Commander:
    """Carries out the daemon's commands.

    Parameters
    ----------
    checkpoints: of the daemon; None where the configuration has no ``[state]``.
    shut_down: requests the end of the daemon.
    """

    def __init__(self, checkpoints: Checkpoints | None, shut_down: Callable[[], None]) -> None:
        self._checkpoints = checkpoints
        self._shut_down = shut_down

    def carry_out(self, command: Command, pipeline: Pipeline) -> CommandReply | None:
        """The answer to a command of ``DAEMON_COMMANDS``, carried out; None for any other."""
        work = DAEMON_COMMANDS.get(command.name)
        if work is None:
            return None
        before = pipeline.events_waiting
        refusal = work(self, command, pipeline)
        return pipeline.reply(command, refusal, before)

    def _checkpoint(self, command: Command, pipeline: Pipeline) -> str:
        name, refusal = self._named(command)
        if self._checkpoints is None or refusal:
            return refusal
        refusal = self._checkpoints.save_named(pipeline, name)
        if not refusal:
            pipeline.note("checkpoint", f"{name!r} written", command.source)
        return refusal

    def _rollback(self, command: Command, pipeline: Pipeline) -> str:
        name, refusal = self._named(command)
        if self._checkpoints is None or refusal:
            return refusal
        refusal = self._checkpoints.restore_estimate(pipeline, name)
        if not refusal:
            pipeline.note("rolled_back", f"to checkpoint {name!r}", command.source)
        return refusal

    def _load_physics(self, command: Command, pipeline: Pipeline) -> str:
        """Only files beside the configured one are read: a command names a file, never a folder."""
        configured = pipeline.config.physics
        if configured is None:
            return 'no physics file is configured; give physics = "physics.toml" in [[craft]]'
        name, given = command.arguments.get("name", configured.path.name), dict(command.arguments)
        if not isinstance(name, str) or not _FILE.fullmatch(name) or set(given) - {"name"}:
            return (
                f"arguments {given!r}: nothing, or name = a file ending in .toml beside {configured.path}, is accepted"
            )
        try:
            path = configured.path.with_name(name)
            check_input(path)
            loaded = physics_of(path)
        except InputRefusedError as error:
            return str(error)
        model = pipeline.load_physics(loaded.text, name)
        effects = ", ".join(f"{term.effect} by {term.driver}" for term in model.terms) or "no effect"
        pipeline.note("physics_loaded", f"{name}: {effects}", command.source)
        return ""

    def _shutdown(self, command: Command, pipeline: Pipeline) -> str:
        pipeline.note("shutdown", "command", command.source)
        self._shut_down()
        return ""

    def _named(self, command: Command) -> tuple[str, str]:
        """The argument ``name``, and why it is refused, empty where it is not."""
        if self._checkpoints is None:
            return "", "no checkpoints are kept; give [state] in the configuration"
        name = command.arguments.get("name")
        if not isinstance(name, str) or set(command.arguments) != {"name"}:
            return "", f"arguments {dict(command.arguments)!r}: name = a text is accepted"
        return name, ""


DAEMON_COMMANDS: Final[dict[str, Callable[[Commander, Command, Pipeline], str]]] = {
    "checkpoint": Commander._checkpoint,
    "rollback": Commander._rollback,
    "load_physics": Commander._load_physics,
    "shutdown": Commander._shutdown,
}
"""Name -> what it does; it gives back why the command is refused, empty where it was carried out."""
