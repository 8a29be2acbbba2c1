"""``magcal diagnose --separately``: many recordings of different craft, each by itself."""

from __future__ import annotations

import json
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from magcal_service.diagnosis.command import Request, make
from magcal_service.diagnosis.report.frame import check_packages
from magcal_service.diagnosis.result import held_out_rms
from magcal_service.diagnosis.simulation import simulation_errors, simulation_file
from magcal_service.many.executor import Executor
from magcal_service.offline.each import Answer, Asked, ask_each
from magcal_service.offline.result_files import DIAGNOSIS


def diagnose_each(
    paths: Sequence[Path], simulation: str | None, craft: str | None, out: Path, executor: Executor
) -> Asked:
    """The diagnosis of each recording, its files in a folder of each under ``out``.

    ``diagnosis.json`` there has no ``seconds``, which is in the summary: the files are the same wherever they are made.
    Raises as ``ask_each``, ``ConfigError`` for the scenario, ``ExtraMissingError`` without what reports are drawn with.
    """
    check_packages()
    scenario = None
    if simulation is not None:
        simulation_errors(simulation)
        scenario = simulation_file(simulation).absolute()
    question = partial(_answered, None if scenario is None else str(scenario), craft)
    return ask_each("diagnose", question, paths, out, executor, *([] if scenario is None else [scenario]))


def _answered(simulation: str | None, craft: str | None, path: Path) -> Answer:
    own = Path(path.stem)  # of the command in the report, which is the same wherever the results go
    made = make(Request(path, own, simulation, craft), progress=lambda step: None)
    diagnosis = made.diagnosis
    content = json.loads(made.contents[DIAGNOSIS])
    seconds = content.pop("seconds")
    names = ", ".join(f"{entry.effect} {entry.probability:.3f}" for entry in made.found)
    reasons = [str(reason) for reason in diagnosis.reasons]
    return Answer(
        trusted=diagnosis.trusted,
        verdict=str(diagnosis.verdict),
        says="; ".join(filter(None, (names, ", ".join(reasons)))),
        files={**made.contents, DIAGNOSIS: json.dumps(content, indent=2, allow_nan=False) + "\n"},
        more={
            "sentence": content["sentence"],
            "effects": [entry.effect for entry in made.found],
            "reasons": reasons,
            "held_out_rms_nt": held_out_rms(diagnosis),
            "seconds": seconds,
        },
    )
