"""Short recordings to diagnose, made by the simulator, and the command run over them."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
from matplotlib.figure import Figure

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


@contextlib.contextmanager
def undrawn() -> Iterator[None]:
    """Reports have all their figures, as empty images: to draw them takes longer than a short recording's diagnosis.

    They are drawn in ``test_diagnose_report``, ``test_report_figures`` and wherever the command runs as a process.
    """

    def empty(_figure: Figure, target: io.StringIO, **_options: object) -> None:
        target.write("<svg><style></style></svg>")

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Figure, "savefig", empty)
        yield


def diagnose(*arguments: object, drawn: bool = False) -> Done:
    """Run ``magcal diagnose`` with these arguments in this process."""
    out, err = io.StringIO(), io.StringIO()
    pictures = contextlib.nullcontext() if drawn else undrawn()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err), pictures:
        try:
            code = main(["diagnose", *map(str, arguments)])
        except SystemExit as end:
            code = end.code if isinstance(end.code, int) else -1
    return Done(code, out.getvalue(), err.getvalue())


def recorded(scenario: str, seconds: float, folder: Path) -> Path:
    """The descriptor of a simulated recording."""
    return record_simulation(Simulation(load_scenario(scenario), 4, seconds), folder)
