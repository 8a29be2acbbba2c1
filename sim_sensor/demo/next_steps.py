"""What to do with the session just flown: command lines that work as they stand in this environment."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path
from typing import Final

from sim_sensor.demo.report import Plan

__all__ = ["AND_THEN", "next_steps", "shown"]

AND_THEN: Final = "A sensor or a log of your own: docs/index.md."

_OTHER = 2  # seed of another flight; any but the scenario's own


def next_steps(plan: Plan, recording: Path) -> dict[str, str]:
    """What each does, and its command line, for the folder that this process works in.

    Parameters
    ----------
    recording: the descriptor of the session just flown, in ``plan.out``.
    """
    magcal, python, log = _program(), shown(Path(sys.executable)), shown(recording)

    def left(name: str) -> str:
        return shown(plan.out / name)

    return {
        "look at the flight again, in a browser": f"{magcal} view {log}",
        "send it through the daemon's own path once more": (
            f"{magcal} replay {log} --config {left('magcal.toml')} --out {left('again.csv')}"
        ),
        "ask what physics its simulation leaves out": f"{magcal} diagnose {log} --out {left('diagnosis')}",
        "draw before and after, for a paper": f"{magcal} plot {log} --out {left('before-after.svg')}",
        "fly another draw": f"{python} -m sim_sensor.demo --link {plan.wire.value} --seed {_OTHER}",
    }


def _program() -> str:
    """How this environment's ``magcal`` is called."""
    beside = Path(sys.executable).with_name("magcal")
    return shown(beside) if beside.exists() else f"{shown(Path(sys.executable))} -m magcal_service.cli"


def shown(path: Path) -> str:
    """A path as a shell takes it, from the working folder where it lies below that."""
    here = Path.cwd()
    return shlex.quote(str(path.relative_to(here) if path.is_relative_to(here) else path))
