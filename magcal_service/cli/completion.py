"""``magcal completion``: the script by which a shell completes the commands."""

from __future__ import annotations

import argparse
import sys
from functools import partial
from pathlib import Path
from typing import Final

from magcal_service.cli.common import DONE, Parser, subparsers

SHELLS: Final = ("bash", "zsh", "tcsh")

_WHERE: Final = """
bash: magcal completion bash >~/.local/share/bash-completion/completions/magcal
zsh:  magcal completion zsh >DIR/_magcal, where DIR is in $fpath
tcsh: magcal completion tcsh >~/.magcal.tcsh, and `source ~/.magcal.tcsh` in ~/.tcshrc
"""


def add_completion(parser: Parser, whole: Parser) -> None:
    """The arguments of ``magcal completion``; ``whole`` is what is completed."""
    parser.add_argument("shell", choices=SHELLS, help="which shell")
    parser.examples = ("magcal completion bash >~/.local/share/bash-completion/completions/magcal",)
    parser.more = lambda: _WHERE
    parser.set_defaults(command=partial(_completion, whole))


def _completion(whole: Parser, options: argparse.Namespace) -> int:
    from magcal_service.errors import ExtraMissingError

    try:
        import shtab
    except ImportError:
        raise ExtraMissingError("shtab", "completion", "shell completion") from None
    for command in subparsers(whole).values():
        for one in (command, *subparsers(command).values()):
            _complete(one, shtab.FILE)
    _offer_names(whole)
    sys.stdout.write(shtab.complete(whole, options.shell) + "\n")
    return DONE


def _complete(command: Parser, files: object) -> None:
    """Let every argument that is a path be completed by files."""
    for action in command._actions:
        if action.type is Path:
            action.complete = files  # type: ignore[attr-defined]  # what shtab reads


def _offer_names(whole: Parser) -> None:
    """Let the names of methods, studies and formats be completed; the commands themselves check them."""
    from magcal_service.estimators import methods
    from magcal_service.offline.exports import FORMS
    from magcal_service.studies import studies

    names = {
        ("calibrate", "method"): [method.name for method in methods()],
        ("study", "name"): [study.name for study in studies()],
        ("export", "format"): list(FORMS),
    }
    for (command, argument), choices in names.items():
        for action in subparsers(whole)[command]._actions:
            if action.dest == argument:
                action.choices = choices
