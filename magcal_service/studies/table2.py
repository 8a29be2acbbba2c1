"""The paper's Table 2: every method on the paper's experiment, beside the paper's figures and the Cramer-Rao bound."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from magcal_service.base.errors import ConfigError
from magcal_service.config.settings import FilterConfig
from magcal_service.estimators import find_method, methods
from magcal_service.estimators.interface import InformationSet
from magcal_service.model import BIAS, STATE_NAMES, Array
from magcal_service.studies.bounds import bound_over_time
from magcal_service.studies.flights import FlightPlan, fly
from magcal_service.studies.montecarlo import Ensemble, Statistics, in_batch, seeds_of, simulate, statistics
from magcal_service.studies.report import Cell, Findings, Line, Panel, Table
from magcal_service.studies.study import Request, Study

PAPER_MEAN: Final = {
    "two-step": (4998.5067, 2999.1426, 4009.5559, 0.0496, 0.0996, 0.0495, 0.0499, 0.0499, 0.0499),
    "ukf": (4998.8961, 2998.9754, 4012.1788, 0.0498, 0.0997, 0.0494, 0.0499, 0.0499, 0.0499),
}
PAPER_3_SIGMA: Final = {
    "two-step": (15.5661, 15.8386, 11.8367, 7e-4, 8e-4, 5e-4, 6e-4, 5e-4, 5e-4),
    "ukf": (9.6920, 10.1059, 11.7200, 7e-4, 8e-4, 5e-4, 6e-4, 4e-4, 4e-4),
}
"""Cetin, Soken, Tekinalp 2020, Table 2, 1000 runs; the spin axis they used is not known."""

RUNS_ALONE: Final = 50
"""Runs of a method that goes one run at a time, unless the method is asked for by name."""

_TIMES: Final = 14
"""Moments of the curves, evenly by their logarithm: a factor of 1.37 apart from a sixtieth of the flight to its end."""


@dataclass(frozen=True, slots=True)
class Case:
    """One direction of the spin axis and its flight."""

    name: str
    plan: FlightPlan


@dataclass(frozen=True, slots=True)
class Outcome:
    """One method on one case: what came out, and the bound (k, 9) for what the method knows."""

    case: Case
    method: str
    ensemble: Ensemble
    bound: Array
    end: Statistics


def cases(duration_s: int | None) -> tuple[Case, ...]:
    """Both directions of the spin axis: (1, 1, 1), and the orbit normal, along which bz is badly observed."""
    plan = FlightPlan() if duration_s is None else FlightPlan(duration_s=duration_s)
    return Case("(1, 1, 1)", plan), Case("orbit normal", replace(plan, spin_eci=plan.orbit_normal()))


def run(request: Request) -> Findings:
    """Every method on both cases."""
    names = request.methods or tuple(method.name for method in methods())
    outcomes, notes = [], list(_NOTES)
    for name in names:
        reason = _refusal(name)
        if reason:
            notes.append(f"`{name}` was not run: {reason}")
            continue
        outcomes += [_outcome(case, name, request) for case in cases(request.duration_s)]
    plan = cases(request.duration_s)[0].plan
    return Findings(
        tables=(*_summaries(outcomes), *(_nine(outcome) for outcome in outcomes)),
        figures=_figures(outcomes),
        settings={
            "noise [nT]": plan.noise_nt,
            "spin [rpm]": plan.rate_rpm,
            "duration [s]": plan.duration_s,
            "altitude [km]": plan.altitude_km,
            "inclination [deg]": plan.inclination_deg,
            "node [deg]": plan.node_deg,
            "start": str(np.datetime64(plan.start_utc_ns, "ns").astype("datetime64[s]")),
        },
        notes=tuple(notes),
        panels=_panels(outcomes),
    )


def _refusal(name: str) -> str:
    """Why a method can't fly this experiment, empty where it can."""
    method = find_method(name)
    if method.needs:
        return f"it needs a channel of {method.needs}, which the experiment has not"
    try:
        method.build(FlightPlan().craft(FilterConfig(method=name)))
    except ConfigError as error:
        return str(error)
    return ""


def _outcome(case: Case, name: str, request: Request) -> Outcome:
    plan, runs = case.plan, request.runs or STUDY.runs
    config = plan.craft(FilterConfig(method=name))
    if not (request.methods or in_batch(config)):
        runs = min(runs, RUNS_ALONE)
    at_s = np.geomspace(plan.duration_s / 60.0, plan.duration_s - 1.0, _TIMES)
    seeds = seeds_of(request.seed, runs)
    ensemble = simulate(plan, config, seeds, request.executor, at_s.tolist(), f"{name}, {case.name}")
    bound = bound_over_time(fly(plan).for_bounds(), find_method(name).bound, at_s)
    return Outcome(case, name, ensemble, bound, statistics(ensemble))


def _summaries(outcomes: list[Outcome]) -> list[Table]:
    """Per case one row per method: 3 sigma over the runs, and how consistent the method is."""
    columns = ("method", "runs", "with estimate", "NEES", *STATE_NAMES, "worst / bound", "worst mean error [sigma]")
    tables = []
    for case in dict.fromkeys(outcome.case for outcome in outcomes):
        own = [outcome for outcome in outcomes if outcome.case == case]
        rows: list[tuple[Cell, ...]] = []
        for name, values in PAPER_3_SIGMA.items():
            rows.append((f"paper's {name}", 1000, None, None, *values, None, None))
        for known, outcome in _bounds_of(own).items():
            rows.append((f"bound: {known}", None, None, None, *_floats(3.0 * outcome.bound[-1]), None, None))
        rows += [_summary(outcome) for outcome in own]
        title = f"Spin axis {case.name}: 3 sigma of the final estimate over the runs [nT, -]"
        tables.append(Table(title, columns, tuple(rows)))
    return tables


def _bounds_of(outcomes: list[Outcome]) -> dict[InformationSet, Outcome]:
    """One outcome for each information set, of which it has the bound."""
    return {find_method(outcome.method).bound: outcome for outcome in outcomes}


def _summary(outcome: Outcome) -> tuple[Cell, ...]:
    end, part = outcome.end, _meaningful(outcome.method)
    ratio = float((end.spread / outcome.bound[-1])[part].max())
    error = float(np.abs(end.mean_error_sigmas[part]).max())
    three_sigma: list[Cell] = [float(value) for value in 3.0 * end.spread]
    if not find_method(outcome.method).estimates_matrix:
        three_sigma[BIAS.stop :] = [None] * 6
    return outcome.method, end.runs, end.started, end.nees, *three_sigma, ratio, error


def _meaningful(method: str) -> slice:
    return slice(None) if find_method(method).estimates_matrix else BIAS


def _nine(outcome: Outcome) -> Table:
    """The nine parameters of one method on one case."""
    end, truth, bound = outcome.end, outcome.ensemble.truth[-1], outcome.bound[-1]
    paper_mean, paper_sigma = PAPER_MEAN.get(outcome.method), PAPER_3_SIGMA.get(outcome.method)
    rows: list[tuple[Cell, ...]] = []
    for i, name in enumerate(STATE_NAMES):
        digits = 2 if i < BIAS.stop else 5
        row: tuple[Cell, ...] = (name, float(truth[i]), f"{end.mean[i]:.{digits}f} ± {3.0 * end.spread[i]:.{digits}f}")
        row += (3.0 * float(end.formal[i]), 3.0 * float(bound[i]), float(end.spread[i] / bound[i]))
        published = f"{paper_mean[i]:g} ± {paper_sigma[i]:g}" if paper_mean and paper_sigma else None
        rows.append((*row, float(end.mean_error_sigmas[i]), published))
    columns = ("parameter", "truth", "mean ± 3 sigma over runs", "own 3 sigma", "bound 3 sigma", "sigma / bound")
    title = f"{outcome.method}, spin axis {outcome.case.name}, {end.runs} runs, NEES {end.nees:.2f}"
    return Table(title, (*columns, "mean error [sigma]", "paper"), tuple(rows))


def _figures(outcomes: list[Outcome]) -> dict[str, Cell]:
    figures: dict[str, Cell] = {}
    for outcome in outcomes:
        of = f"{outcome.method}, {outcome.case.name}"
        figures[f"{of}: NEES"] = outcome.end.nees
        figures[f"{of}: sampling error of NEES"] = (18.0 / max(outcome.end.started, 1)) ** 0.5
        figures[f"{of}: runs without an estimate"] = outcome.end.runs - outcome.end.started
        figures[f"{of}: restarts"] = int(outcome.ensemble.restarts.sum())
    return figures


def _panels(outcomes: list[Outcome]) -> tuple[Panel, ...]:
    """3 sigma over the runs against time for bx, bz and D33, on both cases, with the bounds."""
    panels = []
    for case in dict.fromkeys(outcome.case for outcome in outcomes):
        own = [outcome for outcome in outcomes if outcome.case == case]
        for index in (0, 2, 5):
            shown = own if index < BIAS.stop else [each for each in own if find_method(each.method).estimates_matrix]
            lines = [_line(outcome, index) for outcome in shown]
            lines += [
                Line(f"bound: {known}", _floats(each.ensemble.at_s), _floats(3.0 * each.bound[:, index]), limit=True)
                for known, each in _bounds_of(own).items()
            ]
            unit = "[nT]" if index < BIAS.stop else "[-]"
            title = f"{STATE_NAMES[index]}, spin axis {case.name}"
            panels.append(Panel(title, "time [s]", f"3 sigma over runs {unit}", tuple(lines), log_x=True, log_y=True))
    return tuple(panels)


def _line(outcome: Outcome, index: int) -> Line:
    ensemble = outcome.ensemble
    columns = [column for column in range(len(ensemble.at_s)) if ensemble.started[:, column].all()]
    spread = [3.0 * float(ensemble.x[:, column, index].std(ddof=1)) for column in columns]
    return Line(outcome.method, _floats(ensemble.at_s[columns]), tuple(spread))


def _floats(values: Array) -> tuple[float, ...]:
    return tuple(float(value) for value in values)


_NOTES: Final = (
    "Every method sees the same runs: run i draws from the same child seed for each.",
    f"Methods that go one run at a time have at most {RUNS_ALONE} runs unless they are named with --methods; the table "
    "says how many. n runs leave 1 / sqrt(2 n) of sampling error in a sigma and 1 / sqrt(n) in a mean error.",
    "The bound beside a method is the one for what it uses: the magnitude; with the spin windows (ukf); the vector and "
    "a steady spin of unknown direction, phase and rate about a known body axis (spin).",
    "The methods that estimate the bias alone (plkf) take D as zero, which it is not here: their mean is far off.",
    "The paper gives neither date, node nor spin axis; `flights.py` says why these were taken.",
)

STUDY = Study(
    "table2", "All methods on the paper's experiment, against its Table 2 and the Cramer-Rao bound.", 1000, run
)
