"""``magcal study``: many simulated flights, or real recordings, asked one question."""

from __future__ import annotations

import argparse
from pathlib import Path

from magcal_service.base.errors import ConfigError, Fault
from magcal_service.cli.common import (
    DONE,
    STDOUT,
    Parser,
    add_executor,
    beside_json,
    executor_of,
    methods_text,
    write_json,
)


def add_study(parser: Parser) -> None:
    """The arguments of ``magcal study``."""
    parser.add_argument(
        "name",
        metavar="NAME",
        help="one of those below",
    )
    parser.add_argument("--runs", type=int, metavar="N", help="Monte-Carlo runs (default: the study's own)")
    parser.add_argument("--seed", type=int, default=1, metavar="S", help="of the whole study (default: 1)")
    parser.add_argument(
        "--json", type=Path, metavar="FILE", help="write tables, figures and curves here; - is standard output"
    )
    parser.add_argument("--out", type=Path, metavar="DIR", help="write NAME.md, NAME.json and NAME.png here")
    parser.add_argument("--methods", default="", metavar="A,B", help="of those below (default: the study's own)")
    parser.more = lambda: studies_text() + methods_text()
    parser.add_argument("--duration-s", type=int, metavar="S", help="length of a flight [s] (default: the study's own)")
    parser.add_argument("--scenarios", default="", metavar="A,B", help="of integrity, only these (default: all)")
    parser.add_argument(
        "--noises", default="", metavar="NT,NT", help="of integrity, nT per axis (default: the study's own)"
    )
    parser.add_argument(
        "--motions", default="", metavar="A,B", help="of integrity, how the craft turn (default: every way)"
    )
    folders = (
        "of recordings' descriptors, for reality (default: ../shared/data; to one alone, `cases` beside it), or of "
        "concealed cases, for concealed"
    )
    parser.add_argument("--recordings", "--data", type=Path, nargs="+", default=[], metavar="FOLDER", help=folders)
    add_executor(parser)
    parser.examples = ("magcal study noise --runs 20 --out output/noise",)
    parser.set_defaults(command=_study)


def studies_text() -> str:
    """Every study with its one line and its usual number of runs, for the command's help."""
    from magcal_service.studies import studies

    width = max(len(study.name) for study in studies())
    lines = (
        f"  {study.name:<{width}}  {study.summary} "
        + ("(takes recordings)" if study.takes_recordings else f"(default: {study.runs} runs)")
        for study in studies()
    )
    return "\nstudies:\n" + "\n".join(lines) + "\n"


def _numbers(option: str, text: str) -> tuple[float, ...]:
    """Numbers with commas between; raises ConfigError for what is none."""
    try:
        return tuple(float(one) for one in text.split(",") if one)
    except ValueError:
        raise ConfigError([Fault(option, text, "numbers with commas between are accepted, such as 100,300")]) from None


def _study(options: argparse.Namespace) -> int:
    from magcal_service.studies import run_study, save
    from magcal_service.studies.study import Request

    methods = tuple(name for name in options.methods.split(",") if name)
    folders = tuple(options.recordings)
    scenarios = tuple(name for name in options.scenarios.split(",") if name)
    noises = _numbers("--noises", options.noises)
    motions = tuple(name for name in options.motions.split(",") if name)
    executor = executor_of(options)
    request = Request(
        options.runs, options.seed, executor, methods, options.duration_s, folders, scenarios, noises, motions
    )
    report = run_study(options.name, request)
    with beside_json(options.json):
        print(report.markdown(), end="")
    if options.json == STDOUT:
        write_json(options.json, report.as_json())
    save(report, None if options.json == STDOUT else options.json, options.out)
    return DONE
