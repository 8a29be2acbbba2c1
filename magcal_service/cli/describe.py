"""``magcal describe``: a descriptor from a raw log."""

from __future__ import annotations

import argparse
import sys
import textwrap
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING

from magcal_service.base.errors import ConfigError, Fault, InputRefusedError
from magcal_service.cli.common import DONE, NOT_TRUSTED, Parser, refuse_unwritable, write_text

if TYPE_CHECKING:
    from magcal_service.recordings.describe.describe import Described


def add_describe(parser: Parser) -> None:
    """The arguments of ``magcal describe``."""
    parser.add_argument("log", type=Path, metavar="LOG", help="a text file of rows, as it was logged")
    parser.add_argument("--out", type=Path, metavar="RECORDING.toml", help="write it here; printed where absent")
    parser.add_argument(
        "--answer", action="append", default=[], metavar="KEY=VALUE", help="the answer to a question; may be repeated"
    )
    parser.more = _keys_text
    parser.examples = ("magcal describe log.csv --answer magnetometer.unit=uT --out RECORDING.toml",)
    parser.set_defaults(command=_describe)


def _keys_text() -> str:
    """Every key of an answer, for the command's help."""
    from magcal_service.recordings.describe.draft import KEYS

    keys = textwrap.fill(" ".join((*KEYS, "channels.NAME.KEY")), 78, initial_indent="  ", subsequent_indent="  ")
    return f"\nkeys of --answer:\n{keys}\n"


def _describe(options: argparse.Namespace) -> int:
    from magcal_service.base.progress import Work, counted
    from magcal_service.recordings.describe.describe import describe

    refuse_unwritable(options.out, options.log)
    answers = _answers(options.answer)
    beside = None if options.out is None else options.out.parent
    with counted(Work(f"reading {options.log.name}")):
        described = describe(options.log, answers, beside)
    while described.needed and _asks():
        print("\n".join(described.lines()))
        given = _ask(described)
        try:
            described = describe(options.log, answers | given, beside)
            answers |= given
        except InputRefusedError as error:
            print(error)
    print("\n".join(described.lines()))
    if described.text is None:
        open_keys = ", ".join(question.key for question in described.needed)
        print(f"# not written: answer first: {open_keys}")
        return NOT_TRUSTED
    _write(options.out, described.text, described.lines())
    return DONE


def _answers(given: list[str]) -> dict[str, str]:
    answers: dict[str, str] = {}
    faults = []
    for one in given:
        key, sign, value = one.partition("=")
        if not sign or key in answers:
            accepted = "each key is answered once" if sign else "KEY=VALUE is accepted"
            faults.append(Fault("--answer", one, accepted))
        answers[key.strip()] = value.strip()
    if faults:
        raise ConfigError(faults)
    return answers


def _asks() -> bool:
    """Whether somebody is there who can be asked."""
    return sys.stdin.isatty() and sys.stdout.isatty()


def _ask(described: Described) -> dict[str, str]:
    """An answer to each question that needs one; an empty line takes the likeliest candidate where there is one."""
    answers = {}
    for question in described.needed:
        likeliest = next((value for value, _ in question.candidates if value == question.form), "")
        answer = ""
        while not answer:
            print(f"{question.key} [{likeliest}] = ", end="", flush=True)
            line = sys.stdin.readline()
            if not line:
                raise KeyboardInterrupt
            answer = line.strip() or likeliest
        answers[question.key] = answer
    return answers


def _write(out: Path | None, text: str, evidence: list[str]) -> None:
    if out is None:
        write_text(None, text)
        return
    write_text(out, "\n".join(evidence) + "\n\n" + text)
    name = quote(str(out))
    print(f"# written: {out}; next: magcal inspect {name}, magcal calibrate {name}")
