"""What was probably meant by a misspelt option or command."""

from __future__ import annotations

import argparse
import difflib
from collections.abc import Collection, Iterator, Mapping, Sequence
from itertools import takewhile

_MOST_COMMANDS = 4
"""Commands that are named as those that have an option; choice: more have it in common, and say little."""


def options_of(parser: argparse.ArgumentParser) -> list[str]:
    """The long options of a parser."""
    return [name for action in parser._actions for name in action.option_strings if name.startswith("--")]


def hints(
    parser: argparse.ArgumentParser, given: Sequence[str], others: Mapping[str, argparse.ArgumentParser]
) -> Iterator[str]:
    """A sentence for each option among what was given that a parser does not have.

    Parameters
    ----------
    parser: that was given them; of one with commands, what stands before the command is its own.
    given: words of the command line.
    others: commands of the same program, by name.
    """
    known = {name for action in parser._actions for name in action.option_strings}
    has_commands = any(isinstance(action, argparse._SubParsersAction) for action in parser._actions)
    words = takewhile(lambda word: word.startswith("-"), given) if has_commands else given
    for word in takewhile(lambda word: word != "--", words):
        name = word.partition("=")[0]
        if name in known or not name.startswith("-") or not name.strip("-")[:1].isalpha():
            continue
        if name.startswith("--") and any(one.startswith(name) for one in known):
            continue  # argparse takes a beginning that belongs to one option
        if not name.startswith("--") and name[:2] in known:
            continue  # a short option with its value
        yield f"{name}: {_meant(name.strip('-'), options_of(parser), others, parser)}"


def _meant(
    name: str,
    options: Collection[str],
    others: Mapping[str, argparse.ArgumentParser],
    parser: argparse.ArgumentParser,
) -> str:
    close = difflib.get_close_matches(name.lower(), [one.strip("-") for one in options], n=1)
    if f"--{name}" in options:
        return f"did you mean --{name}?"
    if name in others:
        return f"{name} is a command of its own: {others[name].prog} --help"
    if close:
        return f"did you mean --{close[0]}?"
    having = [one.prog for one in others.values() if f"--{name}" in options_of(one)]
    if 0 < len(having) <= _MOST_COMMANDS:
        return f"this is an option of {', '.join(having)}"
    return f"no such option; {parser.prog} --help lists them"
