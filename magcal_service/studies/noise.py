"""From 50 to 2000 nT of noise: where does the covariance stop being consistent?"""

from __future__ import annotations

from typing import Final

from magcal_service.config.settings import DEFAULT_METHOD, FilterConfig
from magcal_service.model import BIAS
from magcal_service.studies.flights import FlightPlan
from magcal_service.studies.report import Cell, Findings, Line, Panel, Table
from magcal_service.studies.study import Request, Study
from magcal_service.studies.variants import COLUMNS, Measured, Variant, measure_all

LEVELS_NT: Final = (50.0, 100.0, 200.0, 300.0, 500.0, 1000.0, 2000.0)
"""Noise per axis [nT], about twice as much each; the paper's 300 among them, 2000 is 5 % of the field in orbit."""


def run(request: Request) -> Findings:
    """The paper's flight at each level, for each method asked for."""
    names = request.methods or (DEFAULT_METHOD,)
    duration_s = request.duration_s or FlightPlan().duration_s
    tables: list[Table] = []
    panels: list[Panel] = []
    figures: dict[str, Cell] = {}
    for name in names:
        plans = [FlightPlan(noise_nt=level, duration_s=duration_s) for level in LEVELS_NT]
        variants = (Variant(f"{p.noise_nt:g} nT", p, p.craft(FilterConfig(method=name))) for p in plans)
        measured = measure_all(variants, request, f"noise, {name}")
        rows = tuple((each.variant.plan.noise_nt, *each.cells(), each.consistent) for each in measured)
        tables.append(Table(f"{name}: final estimate", ("noise [nT]", *COLUMNS, "consistent"), rows))
        figures[f"{name}: consistent up to [nT]"] = _consistent_up_to(measured)
        panels += _panels(name, measured)
    settings: dict[str, Cell] = {"duration [s]": duration_s, "spin axis": "(1, 1, 1)", "noise": "known to the craft"}
    return Findings(tuple(tables), figures, settings, _NOTES, tuple(panels))


def _consistent_up_to(measured: list[Measured]) -> float | None:
    """Highest level up to which every level is consistent; None where the lowest is not."""
    highest = None
    for each in measured:
        if not each.consistent:
            break
        highest = each.variant.plan.noise_nt
    return highest


def _panels(name: str, measured: list[Measured]) -> tuple[Panel, Panel]:
    good = [each for each in measured if each.end.started >= 2]
    x = tuple(each.variant.plan.noise_nt for each in good)
    sigma = Panel(
        f"{name}: worst bias axis",
        "noise [nT]",
        "3 sigma [nT]",
        (
            Line("over runs", x, tuple(3.0 * float(each.end.spread[BIAS].max()) for each in good)),
            Line("own", x, tuple(3.0 * float(each.end.formal[BIAS].max()) for each in good)),
            Line("bound", x, tuple(3.0 * float(each.bound[BIAS].max()) for each in good), limit=True),
        ),
        log_x=True,
        log_y=True,
    )
    nees = (Line("NEES", x, tuple(each.end.nees for each in good)), Line("9", x, (9.0,) * len(x), limit=True))
    return sigma, Panel(f"{name}: consistency", "noise [nT]", "mean NEES", nees, log_x=True)


_NOTES: Final = (
    "Consistent: the mean NEES is 9 within 10 %, or within three of its own sampling errors sqrt(18 / runs).",
    "The bound leaves out what the noise's own size tells, of order (noise / field)^2.",
)

STUDY = Study("noise", "50 to 2000 nT of noise: where the covariance stops being consistent.", 100, run)
