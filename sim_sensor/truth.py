"""The truth of a run, written beside its recording and never sent: what an estimate has to find."""

from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path

from magcal_service.physics.apply.model_file import text_of
from magcal_service.recordings.timestamps import ns_to_iso8601
from sim_sensor.simulation import Simulation

TRUTH_NAME = "truth.json"
_VERSION = 1  # of the format of truth.json


def truth_record(simulation: Simulation) -> dict[str, object]:
    """Everything that was drawn or set, ready for JSON; keys carry the units."""
    truth = simulation.truth
    spin = dataclasses.asdict(truth.spin)
    spin["rate_rpm"] = truth.spin.rate_rad_s * 60.0 / math.tau
    return {
        "version": _VERSION,
        "scenario": truth.name,
        "seed": simulation.seed,
        "start": ns_to_iso8601(truth.start_ns),
        "duration_s": simulation.duration_s,
        "bias_nt": list(truth.sensor.bias_nt),
        "D": _matrix(truth.sensor.D),
        "noise_nt": list(truth.sensor.noise_nt),
        "steps": [
            {"at_s": step.at_s, "bias_nt": list(step.bias_nt), "D": _matrix(step.D)} for step in truth.effects.steps
        ],
        "sensor": dataclasses.asdict(truth.sensor),
        "spin": spin,
        "orbit": {"kind": type(truth.orbit).__name__, **dataclasses.asdict(truth.orbit)},
        "field": dataclasses.asdict(truth.field),
        "effects": dataclasses.asdict(truth.effects),
        "physics": None if simulation.model is None else text_of(simulation.model),
        **({"beside": [dataclasses.asdict(one) for one in truth.beside]} if truth.beside else {}),
        "faults": [dataclasses.asdict(fault) for fault in truth.faults],
    }


def write_truth(simulation: Simulation, directory: Path) -> Path:
    """Write ``truth.json`` into a folder that exists; returns its path."""
    path = directory / TRUTH_NAME
    path.write_text(json.dumps(truth_record(simulation), indent=2, allow_nan=False) + "\n", encoding="utf-8")
    return path


def _matrix(D: tuple[float, ...]) -> list[list[float]]:
    d11, d22, d33, d12, d13, d23 = D
    return [[d11, d12, d13], [d12, d22, d23], [d13, d23, d33]]
