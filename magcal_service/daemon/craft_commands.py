"""Commands that a craft carries out itself: what each does to it, or why it is refused.

``command_table`` has them all; those of the daemon are in ``commands``.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, Protocol

from magcal_service.daemon.command_table import PROCESS_NOISE_LIMITS
from magcal_service.daemon.events import BY_COMMAND
from magcal_service.estimators import find_method
from magcal_service.estimators.interface import Estimator
from magcal_service.wire.messages import Command


class Commanded(Protocol):
    """What commands need of a craft."""

    estimator: Estimator

    def note(self, what: str, cause: str, source: str = ...) -> None:
        """Record an event."""

    def freeze(self, frozen: bool) -> None:
        """Learn no more, or again."""

    def reset(self) -> None:
        """Begin estimate and verdict anew."""

    def set_process_noise(self, bias_nt: float, d: float) -> None:
        """Change the random walk of bias [nT/sqrt(s)] and D [1/sqrt(s)]."""


def _status(_craft: Commanded, _command: Command) -> str:
    """The reply says it all."""
    return ""


def _freeze_or_resume(craft: Commanded, command: Command) -> str:
    frozen = command.name == "freeze"
    craft.freeze(frozen)
    craft.note("frozen" if frozen else "resumed", BY_COMMAND, command.source)
    return ""


def _reset(craft: Commanded, command: Command) -> str:
    craft.reset()
    craft.note("reset", BY_COMMAND, command.source)
    return ""


def _process_noise(craft: Commanded, command: Command) -> str:
    """Set the random walk by ``bias_nt`` and ``D``, 0 where not given."""
    given, limits = command.arguments, PROCESS_NOISE_LIMITS
    if not find_method(craft.estimator.name).has_process_noise:
        return f"method {craft.estimator.name} has no process noise"
    if not given or not set(given) <= set(limits):
        return f"arguments {dict(given)!r}: bias_nt (nT/sqrt(s)) and D (1/sqrt(s)) are accepted"
    for name, value in given.items():
        if isinstance(value, bool | str) or not 0.0 <= value <= limits[name]:
            return f"{name} is {value!r}; 0 to {limits[name]:g} is accepted"
    bias_nt, d = (float(given.get(name, 0.0)) for name in limits)
    craft.set_process_noise(bias_nt, d)
    craft.note("process_noise", f"bias {bias_nt:g} nT/sqrt(s), D {d:g} /sqrt(s)", command.source)
    return ""


CRAFT_COMMANDS: Final[dict[str, Callable[[Commanded, Command], str]]] = {
    "status": _status,
    "freeze": _freeze_or_resume,
    "resume": _freeze_or_resume,
    "reset": _reset,
    "process_noise": _process_noise,
}
"""Name -> what it does; it gives back why the command is refused, empty where it was carried out."""
