"""The answers of many cases in one file, in the form of ``tests/regimes``, which ``magcal study concealed`` reads."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from tests.blind.case import Answer, EffectTruth
from tests.blind.catalogue import DRIVEN

ANSWERS: Final = "answers.json"

COMMON: Final = frozenset(
    {
        "nt_per_k",
        "per_k",
        "offset_s",
        "drift_ppm",
        "years",
        "radial_km",
        "along_km",
        "cross_km",
        "step_nt",
        "at_s",
        "step",
        "nt_per_s",
        "per_s",
        "frequency_hz",
        "amplitude_nt",
        "lsb_nt",
        "tau_s",
        "rate_rpm",
        "rate_rpm_per_s",
        "angle_deg",
    }
)
"""Numbers with one convention, here and wherever they are looked for; README.md has those of the others.

The others are in no such file: a number of another convention would be compared and found wrong.
"""

_KINDS: Final = {"none": "clean", "unknown": "outside"}


def common_form(answer: Answer, *, driver_concealed: bool) -> dict[str, Any]:
    """An answer as JSON data; ``driver_concealed``: the case was drawn without the channels of what can be driven.

    What drives these craft can be guessed from where they are, how they turn and when, so all of it is inferable.
    """
    kind = _KINDS.get(answer.verdict, "effect" if len(answer.effects) == 1 else "several")
    effects = [_effect(effect, driver_concealed=driver_concealed) for effect in answer.effects]
    return {
        "regime": "blind",
        "kind": kind,
        "effects": effects,
        "driver_concealed": any(effect["driver_concealed"] for effect in effects),
        "detectability": min((effect.detectability for effect in answer.effects), default=0.0),
        "also": list(answer.also),
        "noise_nt": answer.noise_nt,
        "bias_nt": list(answer.bias_nt),
        "D": [list(row) for row in answer.scale],
        "model_detectability": 0.0,
        "seed": answer.seed,
        "drawn_as": answer.kind,
    }


def _effect(truth: EffectTruth, *, driver_concealed: bool) -> dict[str, Any]:
    return {
        "effect": truth.effect,
        "parameters": {name: value for name, value in truth.parameters.items() if name in COMMON},
        "driver": list(truth.driver),
        "driver_concealed": driver_concealed and truth.effect in DRIVEN,
        "is_inferable": True,
        "detectability": truth.detectability,
    }


def write_answers(answers: Mapping[str, Mapping[str, Any]], folder: Path) -> Path:
    """Write the answers of all cases, by the names of their folders, beside these."""
    path = folder / ANSWERS
    path.write_text(json.dumps(answers, indent=1) + "\n", encoding="utf-8")
    return path
