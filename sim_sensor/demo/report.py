"""Inputs of the demo, its outcome, and the files it writes."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

import numpy as np

from magcal_service.base.errors import MagcalError
from magcal_service.wire.messages import CalibratedVector, Estimate, Message, Status, Verdict
from sim_sensor.beside import is_own
from sim_sensor.demo.before_after import before_after
from sim_sensor.recorder import record_simulation
from sim_sensor.sensor import errors_at
from sim_sensor.simulation import Simulation
from sim_sensor.truth import TRUTH_NAME
from sim_sensor.view.history import History
from sim_sensor.view.summary import Summary

__all__ = ["DemoError", "Outcome", "Plan", "Session", "Wire", "objections", "write_results"]

_FILES = {"summary": "summary.txt", "estimates": "estimates.csv", "errors": "errors.png", "residual": "residual.png"}


class DemoError(MagcalError):
    """The demo could not show what it is there to show; the text says why."""

    exit_code = 1


class Wire(StrEnum):
    """What joins the two processes."""

    ZENOH = "zenoh"
    SERIAL = "serial"


@dataclass(frozen=True)
class Plan:
    """What to run and where to leave the results.

    Parameters
    ----------
    scenario: name of a shipped scenario, or a file.
    speed: sample seconds per wall second, 0 as fast as the daemon answers.
    seed, duration_s: the scenario's own where None.
    out: folder for the results.
    daemon: command that takes ``--config FILE``; this installation's ``magcal run`` where None.
    port: of the live page on 127.0.0.1, 0 for one that is free; None: no page.
    stay: whether the page stays at the end, until Ctrl-C.
    """

    wire: Wire
    scenario: str
    speed: float
    seed: int | None
    out: Path
    duration_s: float | None = None
    daemon: tuple[str, ...] | None = None
    port: int | None = None
    stay: bool = False


@dataclass(frozen=True)
class Outcome:
    """How the exchange went: counts of samples, the daemon's exit code, wall time [s], whether it was interrupted."""

    counts: Mapping[str, int]
    daemon_code: int
    wall_s: float
    interrupted: bool

    def text(self) -> str:
        """One line."""
        shown = ", ".join(f"{count} {name}" for name, count in self.counts.items())
        return f"samples: {shown}; wall time {self.wall_s:.1f} s; the daemon's exit code: {self.daemon_code}"


class Session:
    """What came back from the daemon, compared with the truth that only this process knows.

    Parameters
    ----------
    simulation: the run; its true errors may change with time (steps).
    watcher: is given everything that is sent and that comes back.
    """

    def __init__(self, simulation: Simulation, watcher: Callable[[Message], None] = lambda _: None) -> None:
        self.simulation = simulation
        self.watcher = watcher
        self.history = History(simulation.truth.start_ns)
        self.estimate: Estimate | None = None
        self.time_s = 0.0
        self.truth = self.truth_at(0.0)
        self.statuses = 0
        self.last_result_s = -math.inf

    def truth_at(self, time_s: float) -> tuple[float, ...]:
        """The nine true errors at a sample time since the start [nT and -]."""
        scenario = self.simulation.truth
        bias_nt, D = errors_at(scenario.sensor, scenario.effects.steps, np.array([time_s]))
        return (*bias_nt[0].tolist(), *D[0].tolist())

    def take(self, message: Message) -> None:
        """Note one message of the daemon."""
        self.watcher(message)
        if isinstance(message, Status):
            self.statuses += 1
        if isinstance(message, Estimate | CalibratedVector):
            self.last_result_s = time.monotonic()
        if isinstance(message, Estimate) and is_own(message):
            self.estimate = message
            self.time_s = (message.time_ns - self.simulation.truth.start_ns) * 1e-9
            self.truth = self.truth_at(self.time_s)
            self.history.add(message, self.truth)

    def gain_text(self) -> str:
        """How wrong the vector was and is, over what was flown; empty before the filter has started."""
        if self.estimate is None or self.estimate.verdict is Verdict.NOT_STARTED:
            return ""
        flown = self.simulation.arrays()
        until = int(np.searchsorted(flown.times_ns, self.estimate.time_ns, side="right"))
        return before_after(flown.first(max(until, 1)), self.estimate).text()


def objections(summary: Summary) -> list[str]:
    """Why the run is no success; empty where all nine errors are inside 3 sigma and trusted."""
    outside = [row.parameter.name for row in summary.rows if not row.inside]
    found = [f"outside 3 sigma: {', '.join(outside)}"] if outside else []
    if not summary.rows:
        found.append("the filter never started")
    if summary.verdict is not Verdict.TRUSTED:
        found.append("; ".join([f"the daemon's verdict is {summary.verdict.value}", *summary.reasons]))
    return found


def write_results(plan: Plan, session: Session, text: str, recording: bool) -> dict[str, Path]:
    """Leave summary, estimates, plots and, where wanted, the recording in ``plan.out``; what each is, and its path.

    The recording is the simulation's: the same seed gives the same samples as were sent.
    """
    from sim_sensor.view.plots import plot_errors, plot_residual

    files = {name: plan.out / file for name, file in _FILES.items()}
    files["summary"].write_text(text + "\n")
    session.history.write_csv(files["estimates"])
    if len(session.history):
        title = f"{plan.scenario}, seed {session.simulation.seed}, over {plan.wire.value}"
        plot_errors(session.history, files["errors"], title)
        plot_residual(session.history, files["residual"], title)
    if recording:
        files["recording"] = record_simulation(session.simulation, plan.out)
        files["truth"] = plan.out / TRUTH_NAME
    files["ticks"], files["log"] = plan.out / "ticks.csv", plan.out / "daemon.log"
    return {name: path for name, path in files.items() if path.exists()}
