"""Monte-Carlo studies, one a file, found by its presence.

A file of this package that defines ``STUDY`` (a ``study.Study``) is a study; nothing has to be registered.
"""

from __future__ import annotations

import importlib
import pkgutil
import time
from dataclasses import replace
from functools import cache
from pathlib import Path

from magcal_service.errors import ConfigError, Fault
from magcal_service.estimators import find_method
from magcal_service.studies.plots import plot
from magcal_service.studies.report import Report, write
from magcal_service.studies.study import Request, Study
from magcal_service.typed_toml import nearest

MOST_RUNS = 1_000_000
"""Runs of one study: a mean is known to a thousandth of a sigma then, after a week of a core with `spin`."""

SHORTEST_S, LONGEST_S = 300, 1_000_000
"""Flights [s]: a start takes minutes; eleven days are beyond what the orbits without drag are true for."""


@cache
def studies() -> tuple[Study, ...]:
    """Every study there is, by name."""
    modules = (importlib.import_module(f"{__name__}.{entry.name}") for entry in pkgutil.iter_modules(__path__))
    found = [module.STUDY for module in modules if isinstance(getattr(module, "STUDY", None), Study)]
    return tuple(sorted(found, key=lambda study: study.name))


def find_study(name: str) -> Study:
    """The study of that name; ConfigError with the nearest name where there is none."""
    for study in studies():
        if study.name == name:
            return study
    raise ConfigError([Fault("study", name, nearest(name, (study.name for study in studies())))])


def run_study(name: str, request: Request) -> Report:
    """Run a study.

    Raises ConfigError for an unknown study or method, or a number of runs that means nothing.
    """
    study = find_study(name)
    for method in request.methods:
        find_method(method)
    if request.runs is not None and not 2 <= request.runs <= MOST_RUNS:
        raise ConfigError([Fault("--runs", request.runs, f"2 to {MOST_RUNS} runs are accepted: one has no scatter")])
    if request.seed < 0:
        raise ConfigError([Fault("--seed", request.seed, "a whole number from 0 on is accepted")])
    if request.duration_s is not None and not SHORTEST_S <= request.duration_s <= LONGEST_S:
        accepted = f"{SHORTEST_S} to {LONGEST_S} s are accepted"
        raise ConfigError([Fault("--duration-s", request.duration_s, accepted)])
    request = replace(request, runs=request.runs or study.runs)
    began = time.monotonic()
    findings = study.run(request)
    seconds = time.monotonic() - began
    return Report(
        name, study.summary, request.runs or study.runs, request.seed, _command(name, request), seconds, findings
    )


def save(report: Report, json_file: Path | None = None, directory: Path | None = None) -> None:
    """Write a report as JSON, and as page, JSON and picture into a directory.

    Raises InputRefusedError where a file can't be written, ExtraMissingError for a picture without matplotlib.
    """
    if json_file is not None:
        write(json_file, report.as_json())
    if directory is None:
        return
    write(directory / f"{report.study}.json", report.as_json())
    picture = f"{report.study}.png" if report.findings.panels else ""
    write(directory / f"{report.study}.md", report.markdown(picture))
    if picture:
        plot(report.findings.panels, report.summary, directory / picture)


def _command(name: str, request: Request) -> str:
    """What to type to get the same numbers again."""
    parts = ["magcal", "study", name, "--runs", str(request.runs), "--seed", str(request.seed)]
    if request.methods:
        parts += ["--methods", ",".join(request.methods)]
    if request.duration_s is not None:
        parts += ["--duration-s", str(request.duration_s)]
    return " ".join(parts)
