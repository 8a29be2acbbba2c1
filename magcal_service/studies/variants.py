"""The same question asked of several variants of a flight or a configuration: what ``noise``, ``window`` and
``spin_rates`` have in common."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

import numpy as np

from magcal_service.config.settings import CraftConfig
from magcal_service.estimators.interface import InformationSet
from magcal_service.model import BIAS, Array
from magcal_service.studies.bounds import bound_sigma
from magcal_service.studies.flights import FlightPlan, fly
from magcal_service.studies.montecarlo import Ensemble, Statistics, seeds_of, simulate, statistics
from magcal_service.studies.report import Cell
from magcal_service.studies.study import Request

COLUMNS: Final = (
    "3 sigma bx [nT]", "by [nT]", "bz [nT]", "largest sigma / bound", "own sigma / sigma, least", "most",
    "worst mean error [sigma]", "NEES", "with estimate", "restarts",
)  # fmt: skip
"""Heads of ``Measured.cells``."""


@dataclass(frozen=True, slots=True)
class Variant:
    """A flight with a configuration, a label for rows, and what its bound is computed from."""

    label: str
    plan: FlightPlan
    config: CraftConfig
    known: InformationSet = InformationSet.SCALAR_SPIN


@dataclass(frozen=True, slots=True)
class Measured:
    """A variant with what its runs gave: the ensemble, its statistics at the end, and the bound (9,), 1 sigma."""

    variant: Variant
    ensemble: Ensemble
    end: Statistics
    bound: Array

    @property
    def consistent(self) -> bool:
        """Whether NEES is 9 within 10 % or within three times its sampling error, whichever is more."""
        return bool(abs(self.end.nees - 9.0) <= max(0.9, 3.0 * (18.0 / max(self.end.started, 1)) ** 0.5))

    def cells(self) -> tuple[Cell, ...]:
        """One cell for each of ``COLUMNS``."""
        end, restarts = self.end, int(self.ensemble.restarts.sum())
        if end.started < 2:
            return (*([None] * 8), end.started, restarts)
        ratio = end.formal / end.spread
        return (
            *(float(value) for value in 3.0 * end.spread[BIAS]),
            float((end.spread / self.bound).max()),
            float(ratio.min()),
            float(ratio.max()),
            float(np.abs(end.mean_error_sigmas).max()),
            end.nees,
            end.started,
            restarts,
        )


def measure_all(variants: Iterable[Variant], request: Request, study: str) -> list[Measured]:
    """Every variant over the same runs: run i has the same noise, up to its size, in each."""
    seeds = seeds_of(request.seed, request.runs or 2)
    measured = []
    for variant in variants:
        label = f"{study}, {variant.label}"
        ensemble = simulate(variant.plan, variant.config, seeds, request.executor, label=label)
        bound = bound_sigma(fly(variant.plan).for_bounds(), variant.known)
        measured.append(Measured(variant, ensemble, statistics(ensemble), bound))
    return measured
