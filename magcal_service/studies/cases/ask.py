"""What the diagnosis says of a case."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from magcal_service.many.pieces import Done, Outcome, Refused

UNKNOWN: Final = "unknown"
NO_ANSWER: Final = ("refused", "failed")
"""What stands for a verdict where there is none."""


@dataclass(frozen=True, slots=True)
class Named:
    """One name of a diagnosis, with its claimed probability, its class, and parameters as value, sigma and unit."""

    effect: str
    probability: float
    members: tuple[str, ...]
    parameters: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Said:
    """What a diagnosis said of a case; ``trusted``: the command would have ended with 0.

    ``verdict`` is ``refused`` or ``failed`` where there is none, with the text in ``reasons`` and no ``processor_s``.
    """

    verdict: str
    trusted: bool
    reasons: tuple[str, ...]
    named: tuple[Named, ...] = ()
    processor_s: float | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """Effects that were named, in order."""
        return tuple(entry.effect for entry in self.named if entry.effect != UNKNOWN)


def ask(path: Path) -> Said:
    """Diagnose as the command would; raises what reading refuses, and where no calibration is possible."""
    from magcal_service.diagnosis.answer import diagnose

    began = time.process_time()
    content = diagnose(path).to_dict()
    named = tuple(
        Named(entry["effect"], entry["probability"], tuple(entry["class"]), entry["parameters"])
        for entry in content["effects"]
    )
    used = time.process_time() - began
    return Said(content["verdict"], content["trusted"], tuple(content["reasons"]), named, used)


def said_of(outcome: Outcome, path: Path) -> Said:
    """The answer of a piece; a refusal and a fault of the diagnosis are answers, too, without the case's place."""
    if isinstance(outcome, Done):
        said: Said = outcome.value
        return said
    text = outcome.text.partition("\n")[0].replace(f"{path.parent}/", "")
    return Said("refused" if isinstance(outcome, Refused) else "failed", False, (text,))
