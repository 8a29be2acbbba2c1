"""Spin windows: the paper's mean of N samples against harmonic fits, at a fast and at a slow spin."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from magcal_service.config.settings import FilterConfig, SpinConfig, SpinWindow
from magcal_service.estimators.interface import InformationSet
from magcal_service.studies.flights import FlightPlan
from magcal_service.studies.report import Cell, Findings, Line, Panel, Table
from magcal_service.studies.study import Request, Study
from magcal_service.studies.variants import COLUMNS, Measured, Variant, measure_all

RATES_RPM: Final = (7.5, 1.0)
"""The paper's spin, and one so slow that the field turns by 8 degrees in a turn."""

MEAN_TURNS: Final = (1, 2, 4)
"""Turns of the paper's mean: one is the paper's eight samples; longer ones let the field turn meanwhile."""

HARMONIC_TURNS: Final = (1, 2, 4, 8)
"""Turns of a harmonic fit: up to four times the default of two."""


def run(request: Request) -> Findings:
    """Every window at both rates."""
    duration_s = request.duration_s or FlightPlan().duration_s
    tables: list[Table] = []
    panels: list[Panel] = []
    figures: dict[str, Cell] = {}
    for rate in RATES_RPM:
        plan = FlightPlan(rate_rpm=rate, duration_s=duration_s)
        measured = measure_all(_variants(plan), request, f"window, {rate:g} rpm")
        rows = tuple((each.variant.label, *each.cells()) for each in measured)
        tables.append(Table(f"{rate:g} rpm: final estimate", ("window", *COLUMNS), rows))
        panels.append(_panel(rate, measured))
        consistent = [each for each in measured if each.consistent]
        if consistent:
            best = min(consistent, key=lambda each: float(each.end.spread[:2].max()))
            figures[f"{rate:g} rpm: smallest bx, by among the consistent"] = best.variant.label
    settings: dict[str, Cell] = {"duration [s]": duration_s, "noise [nT]": FlightPlan().noise_nt}
    return Findings(tuple(tables), figures, settings, _NOTES, tuple(panels))


def _variants(plan: FlightPlan) -> Iterator[Variant]:
    """None, the paper's mean of N samples, and harmonic fits, shortest first."""
    off = SpinConfig(window=SpinWindow.OFF)
    yield Variant("none", plan, plan.craft(FilterConfig(), off), InformationSet.SCALAR)
    for turns in MEAN_TURNS:
        samples = round(turns * 60.0 / plan.rate_rpm)
        spin = SpinConfig(window=SpinWindow.MEAN, window_samples=samples)
        yield Variant(f"mean, N = {samples}", plan, plan.craft(FilterConfig(), spin))
    for turns in HARMONIC_TURNS:
        spin = SpinConfig(window=SpinWindow.HARMONIC, window_turns=turns)
        yield Variant(f"harmonic, {turns} turns", plan, plan.craft(FilterConfig(), spin))


def _panel(rate: float, measured: list[Measured]) -> Panel:
    good = [each for each in measured if each.end.started >= 2]
    x = tuple(float(i) for i in range(len(good)))
    lines = (
        Line("over runs", x, tuple(3.0 * float(each.end.spread[:2].max()) for each in good)),
        Line("own", x, tuple(3.0 * float(each.end.formal[:2].max()) for each in good)),
        Line("bound", x, tuple(3.0 * float(each.bound[:2].max()) for each in good), limit=True),
    )
    return Panel(f"{rate:g} rpm: bx, by", "window (rows of the table)", "3 sigma [nT]", lines)


_NOTES: Final = (
    "`mean` is the paper's equation (6) with a window of N samples that moves on every second; overlap and the leak of "
    "the turning field are in its noise. `harmonic` takes the constant of a fit of {1, cos, sin, t cos, t sin}.",
    "The bound of the rows with windows is that of harmonic windows of two turns; longer ones may fall below it.",
)

STUDY = Study("window", "The paper's mean window against harmonic windows, at 7.5 and 1 rpm.", 50, run)
