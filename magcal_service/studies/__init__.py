"""Studies, one a file, found by its presence: Monte-Carlo ones, and of real recordings.

A file of this package that defines ``STUDY`` (a ``study.Study``) is a study; nothing has to be registered.
Imports any room but cli and views.
"""

from __future__ import annotations

import importlib
import json
import pkgutil
import shlex
import time
from dataclasses import replace
from functools import cache
from pathlib import Path

from magcal_service.base.errors import ConfigError, Fault
from magcal_service.base.typed_toml import nearest
from magcal_service.estimators import find_method
from magcal_service.plots import paper
from magcal_service.plots.of_study import of_study
from magcal_service.studies.report import Report, write
from magcal_service.studies.study import Request, Study

MOST_RUNS = 1_000_000
"""Runs of one study: a mean is known to a thousandth of a sigma then, after a week of a core with `spin`."""

SHORTEST_S, LONGEST_S = 300, 1_000_000
"""Flights [s]: a start takes minutes; eleven days are beyond what the orbits without drag are true for."""

LEAST_NOISE_NT, MOST_NOISE_NT = 1.0, 5000.0
"""Noise per axis [nT]: finer than any sensor on a small craft, and a tenth of the field."""


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

    Raises ConfigError for an unknown study or method, a number of runs that means nothing, or what the study does not
    take.
    """
    study = find_study(name)
    _refuse_strange(study, request)
    for method in request.methods:
        find_method(method)
    least = 1 if study.scenarios else 2
    if request.runs is not None and not least <= request.runs <= MOST_RUNS:
        why = "" if study.scenarios else ": one has no scatter"
        raise ConfigError([Fault("--runs", request.runs, f"{least} to {MOST_RUNS} runs are accepted{why}")])
    named = (("--scenarios", request.scenarios, study.scenarios), ("--motions", request.motions, study.motions))
    for option, asked, there in named:
        for one in asked:
            if one not in there:
                raise ConfigError([Fault(option, one, nearest(one, there))])
    for noise in request.noises_nt:
        if not LEAST_NOISE_NT <= noise <= MOST_NOISE_NT:
            accepted = f"{LEAST_NOISE_NT:g} to {MOST_NOISE_NT:g} nT are accepted"
            raise ConfigError([Fault("--noises", noise, accepted)])
    if request.seed < 0:
        raise ConfigError([Fault("--seed", request.seed, "a whole number from 0 on is accepted")])
    if request.duration_s is not None and not SHORTEST_S <= request.duration_s <= LONGEST_S:
        accepted = f"{SHORTEST_S} to {LONGEST_S} s are accepted"
        raise ConfigError([Fault("--duration-s", request.duration_s, accepted)])
    request = replace(request, runs=request.runs or study.runs)
    began = time.monotonic()
    findings = study.run(request)
    seconds = time.monotonic() - began
    seed = None if study.takes_recordings else request.seed
    return Report(name, study.summary, request.runs or None, seed, _command(study, request), seconds, findings)


def _refuse_strange(study: Study, request: Request) -> None:
    """Raise ``ConfigError`` for every argument that this kind of study has no use for."""
    faults: list[Fault] = []
    few = {
        "--scenarios": ",".join(request.scenarios) or None,
        "--noises": ",".join(f"{noise:g}" for noise in request.noises_nt) or None,
        "--motions": ",".join(request.motions) or None,
    }
    if not study.takes_recordings and not study.scenarios:
        takers = ", ".join(one.name for one in studies() if one.scenarios)
        accepted = f"the study {study.name} has no scenarios; leave it out, or take one that has: {takers}"
        faults = [Fault(option, value, accepted) for option, value in few.items() if value is not None]
    if study.takes_recordings:
        given = {
            "--runs": request.runs,
            "--methods": ",".join(request.methods) or None,
            "--duration-s": request.duration_s,
            **few,
        }
        accepted = f"the study {study.name} takes recordings and draws no flights; leave it out"
        faults = [Fault(option, value, accepted) for option, value in given.items() if value is not None]
    elif request.recordings:
        takers = ", ".join(one.name for one in studies() if one.takes_recordings)
        accepted = (
            f"the study {study.name} draws its flights itself; leave it out, or take a study of recordings: {takers}"
        )
        faults.append(Fault("--recordings", " ".join(map(str, request.recordings)), accepted))
    if faults:
        raise ConfigError(faults)


def save(report: Report, json_file: Path | None = None, directory: Path | None = None) -> None:
    """Write a report as JSON, and as page, JSON and picture (as ``magcal plot`` draws it) into a directory.

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
        paper.save(of_study(json.loads(report.as_json())), directory / picture)


def _command(study: Study, request: Request) -> str:
    """What to type to get the same numbers again."""
    parts = ["magcal", "study", study.name]
    if study.takes_recordings:
        return shlex.join([*parts, *(["--recordings", *map(str, request.recordings)] if request.recordings else [])])
    parts += ["--runs", str(request.runs), "--seed", str(request.seed)]
    if request.methods:
        parts += ["--methods", ",".join(request.methods)]
    if request.duration_s is not None:
        parts += ["--duration-s", str(request.duration_s)]
    if request.scenarios:
        parts += ["--scenarios", ",".join(request.scenarios)]
    if request.noises_nt:
        parts += ["--noises", ",".join(f"{noise:g}" for noise in request.noises_nt)]
    if request.motions:
        parts += ["--motions", ",".join(request.motions)]
    return " ".join(parts)
