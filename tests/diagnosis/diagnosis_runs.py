"""Short recordings to diagnose, made by the simulator, and the command run over them."""

from __future__ import annotations

import contextlib
import io
from dataclasses import dataclass
from pathlib import Path

from magcal_service.cli.__main__ import main
from sim_sensor.recorder import record_simulation
from sim_sensor.scenario_reader import load_scenario
from sim_sensor.simulation import Simulation


@dataclass(frozen=True)
class Done:
    """What a command ended with and said."""

    code: int
    out: str
    err: str


def diagnose(*arguments: object) -> Done:
    """Run ``magcal diagnose`` with these arguments in this process."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            code = main(["diagnose", *map(str, arguments)])
        except SystemExit as end:
            code = end.code if isinstance(end.code, int) else -1
    return Done(code, out.getvalue(), err.getvalue())


def recorded(scenario: str, seconds: float, folder: Path) -> Path:
    """The descriptor of a simulated recording."""
    return record_simulation(Simulation(load_scenario(scenario), 4, seconds), folder)
