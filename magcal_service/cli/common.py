"""What several commands share: exit codes, help texts, the words of a verdict."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

from magcal_service.errors import ConfigError, Fault

DONE: Final = 0  # of the contract, as the other two
REFUSED: Final = 2  # what argparse ends with for a wrong argument
NOT_TRUSTED: Final = 3  # done, but the reason not to use the result is in the output
CRAFT_HELP: Final = "which craft of a session that holds several"


class Parser(argparse.ArgumentParser):
    """A command's parser; ``more`` gives the text below its options, worked out only when the help is asked for."""

    more: Callable[[], str] | None = None

    def format_help(self) -> str:
        """The help of argparse, and ``more``."""
        return super().format_help() + (self.more() if self.more is not None else "")


def methods_text() -> str:
    """Every method with its one line, for a command's help."""
    from magcal_service.estimators import methods

    width = max(len(method.name) for method in methods())
    return "\nmethods:\n" + "".join(f"  {method.name:<{width}}  {method.summary}\n" for method in methods())


def check_method(config: Path, name: str) -> None:
    """Refuse an unknown method by the file and field that name it, before anything is opened."""
    from magcal_service.estimators import find_method

    try:
        find_method(name)
    except ConfigError as error:
        fault = error.faults[0]
        raise ConfigError([Fault(f"{config.name}: craft.filter.method", fault.value, fault.accepted)]) from None


def verdict_text(verdict: str, reasons: Sequence[str], remedy: str, model: str) -> str:
    """The verdict with its reasons, what the model seems to leave out, and the remedy, a line each."""
    text = f"verdict: {verdict}"
    if reasons:
        text += f" ({', '.join(reasons)})"
    return "\n".join(filter(None, (text, model, remedy and f"remedy: {remedy}")))
