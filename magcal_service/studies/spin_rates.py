"""Spins from 0.5 to 30 rpm at one sample a second, those near aliasing among them."""

from __future__ import annotations

from typing import Final

from magcal_service.config.settings import DEFAULT_METHOD, FilterConfig
from magcal_service.estimators import find_method
from magcal_service.estimators.interface import InformationSet
from magcal_service.model import BIAS
from magcal_service.studies.bounds import bound_sigma
from magcal_service.studies.flights import FlightPlan, fly
from magcal_service.studies.montecarlo import seeds_of
from magcal_service.studies.report import Cell, Findings, Line, Panel, Table
from magcal_service.studies.study import Request, Study
from magcal_service.studies.variants import COLUMNS, Measured, Variant, measure_all
from magcal_service.trust.monitor import TrustMonitor
from magcal_service.trust.verdict import Trust

RATES_RPM: Final = (0.5, 1.0, 2.0, 4.0, 7.5, 12.0, 15.0, 20.0, 25.0, 28.0, 29.0, 29.7, 30.0)
"""At one sample a second 30 rpm is half a turn a sample: two directions across the axis, seen again and again."""


def run(request: Request) -> Findings:
    """The paper's flight at each rate, for each method asked for."""
    names = request.methods or (DEFAULT_METHOD,)
    duration_s = request.duration_s or FlightPlan().duration_s
    tables: list[Table] = []
    panels: list[Panel] = []
    figures: dict[str, Cell] = {}
    for name in names:
        plans = [FlightPlan(rate_rpm=rate, duration_s=duration_s) for rate in RATES_RPM]
        variants = [Variant(f"{p.rate_rpm:g} rpm", p, p.craft(FilterConfig(method=name))) for p in plans]
        measured = measure_all(variants, request, f"spin rates, {name}")
        verdicts = [_trust(each.variant, request.seed) for each in measured]
        rows = tuple(_row(each, trust) for each, trust in zip(measured, verdicts, strict=True))
        tables.append(Table(f"{name}: final estimate", ("spin [rpm]", *COLUMNS, "verdict", "reasons"), rows))
        inconsistent = [f"{each.variant.plan.rate_rpm:g}" for each in measured if not each.consistent]
        figures[f"{name}: rates whose covariance is not consistent [rpm]"] = ", ".join(inconsistent) or "none"
        panels.append(_panel(name, measured))
    settings: dict[str, Cell] = {"duration [s]": duration_s, "noise [nT]": FlightPlan().noise_nt, "samples [Hz]": 1}
    return Findings(tuple(tables), figures, settings, _NOTES, tuple(panels))


def _row(measured: Measured, trust: Trust) -> tuple[Cell, ...]:
    reasons = ", ".join(str(reason) for reason in trust.reasons)
    return (measured.variant.plan.rate_rpm, *measured.cells(), str(trust.verdict), reasons)


def _trust(variant: Variant, seed: int) -> Trust:
    """The verdict at the end of the first run, as the daemon would give it."""
    flown = fly(variant.plan)
    estimator = find_method(variant.config.filter.method).build(variant.config)
    monitor = TrustMonitor(variant.config)
    for tick in flown.ticks(flown.measured(seeds_of(seed, 1)[0])):
        outcome = estimator.handle(tick)
        monitor.observe(tick, outcome, estimator.estimate())
    return monitor.judge(estimator.estimate())


def _panel(name: str, measured: list[Measured]) -> Panel:
    good = [each for each in measured if each.end.started >= 2]
    x = tuple(each.variant.plan.rate_rpm for each in good)
    vector = [bound_sigma(fly(each.variant.plan).for_bounds(), InformationSet.VECTOR_SPIN) for each in good]
    lines = (
        Line("over runs", x, tuple(3.0 * float(each.end.spread[BIAS].max()) for each in good)),
        Line("own", x, tuple(3.0 * float(each.end.formal[BIAS].max()) for each in good)),
        Line(
            "bound, magnitude and windows", x, tuple(3.0 * float(each.bound[BIAS].max()) for each in good), limit=True
        ),
        Line("bound, vector and spin", x, tuple(3.0 * float(sigma[BIAS].max()) for sigma in vector), limit=True),
    )
    return Panel(f"{name}: worst bias axis", "spin [rpm]", "3 sigma [nT]", lines, log_x=True, log_y=True)


_NOTES: Final = (
    "Verdict and reasons are those at the end of the first run, from the daemon's own trust monitor.",
    "30 rpm at 1 Hz shows the sensor two directions across the axis alone, 29.7 rpm drifts through all in 200 s.",
)

STUDY = Study(
    "spin-rates", "0.5 to 30 rpm at 1 Hz, near aliasing included: accuracy, consistency and verdict.", 50, run
)
