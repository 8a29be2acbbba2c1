"""``magcal completion`` and ``sim-sensor completion``: the script by which a shell completes the commands."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Final

from magcal_service.cli.common import DONE, Parser, subparsers

SHELLS: Final = ("bash", "zsh", "tcsh")

_WHERE: Final = """
bash: {0} completion bash >~/.local/share/bash-completion/completions/{0}
zsh:  {0} completion zsh >DIR/_{0}, where DIR is in $fpath
tcsh: {0} completion tcsh >~/.{0}.tcsh, and `source ~/.{0}.tcsh` in ~/.tcshrc
"""

Names = Mapping[tuple[str, str], Sequence[str]]
"""What an argument of a command is one of, by the names of both; the command itself checks it."""


def add_completion(parser: Parser, whole: Parser, names: Callable[[], Names]) -> None:
    """The arguments of a ``completion`` command.

    Parameters
    ----------
    whole: what is completed.
    names: is asked only when the script is made.
    """
    parser.add_argument("shell", choices=SHELLS, help="which shell")
    parser.examples = (f"{whole.prog} completion bash >~/.local/share/bash-completion/completions/{whole.prog}",)
    parser.more = lambda: _WHERE.format(whole.prog)
    parser.set_defaults(command=partial(_completion, whole, names))


def magcal_names() -> Names:
    """Methods, studies, figures and formats."""
    from magcal_service.estimators import methods
    from magcal_service.offline.exports import FORMS
    from magcal_service.plots.of_recording import FIGURES
    from magcal_service.studies import studies

    return {
        ("calibrate", "method"): [method.name for method in methods()],
        ("study", "name"): [study.name for study in studies()],
        ("export", "format"): list(FORMS),
        ("plot", "figure"): list(FIGURES),
    }


def _completion(whole: Parser, names: Callable[[], Names], options: argparse.Namespace) -> int:
    from magcal_service.base.errors import ExtraMissingError

    try:
        import shtab
    except ImportError:
        raise ExtraMissingError("shtab", "completion", "shell completion") from None
    for command in subparsers(whole).values():
        for one in (command, *subparsers(command).values()):
            _complete(one, shtab.FILE)
    functions = {"bash": "", "zsh": "", "tcsh": ""}
    for (command_name, argument), choices in names().items():
        for action in subparsers(whole)[command_name]._actions:
            if action.dest == argument and "FILE" in str(action.metavar):
                function = f"_{whole.prog.replace('-', '_')}_{command_name}_{argument}"
                action.complete = {"bash": function, "zsh": function, "tcsh": "f"}  # type: ignore[attr-defined]
                functions["bash"] += _BASH.format(function, " ".join(choices))
                functions["zsh"] += _ZSH.format(function, argument, " ".join(choices))
            elif action.dest == argument:
                action.choices = choices
    sys.stdout.write(shtab.complete(whole, options.shell, preamble=functions[options.shell]) + "\n")
    return DONE


_BASH: Final = '{0}() {{\n  compgen -W "{1}" -- "$1"\n  compgen -f -- "$1"\n}}\n'
_ZSH: Final = "{0}() {{\n  _alternative 'names:{1}:({2})' 'files:file:_files'\n}}\n"


def _complete(command: Parser, files: object) -> None:
    """Let every argument that is a path be completed by files."""
    for action in command._actions:
        if action.type is Path:
            action.complete = files  # type: ignore[attr-defined]  # what shtab reads
