"""Ticks and outcomes put into the trust's monitor by hand."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from magcal_service.config.settings import CraftConfig, SensorConfig
from magcal_service.estimators.interface import Phase, StateEstimate, TickOutcome
from magcal_service.ticks.assembler import Tick
from magcal_service.trust.monitor import TrustMonitor
from magcal_service.trust.reasons import Reason

NOISE_NT = 300.0
CONFIG = CraftConfig("c", SensorConfig(NOISE_NT))
SETTLED = StateEstimate(
    np.zeros(9), np.diag([1.0] * 3 + [1e-12] * 6), Phase.RUNNING, NOISE_NT, 1000, 0, 0, None, spin_given_up=False
)


def tick(
    index: int, magnitude_nt: float | None = None, times_s: Sequence[float] = (), *, after_gap: bool = False
) -> Tick:
    """A second of samples along x; |H| alternates by a tenth unless it is told."""
    times = np.array(times_s or (float(index),))
    strength = 40_000.0 * (1.0 + 0.1 * (-1.0) ** index) if magnitude_nt is None else magnitude_nt
    field = np.tile([[30_000.0, 0.0, 0.0]], (len(times), 1))
    return Tick(index, times, field, np.full(len(times), strength), after_gap=after_gap)


def outcome(
    residual_nt: Sequence[float] = (0.0,), rejected: int = 0, innovation: float = 1.0, degrees: int = 1
) -> TickOutcome:
    """Of a running filter."""
    return TickOutcome(Phase.RUNNING, np.array(residual_nt), len(residual_nt) - rejected, rejected, innovation, degrees)


def observed(
    outcomes: Iterable[TickOutcome], estimate: StateEstimate = SETTLED, config: CraftConfig = CONFIG
) -> TrustMonitor:
    monitor = TrustMonitor(config)
    for index, one in enumerate(outcomes):
        monitor.observe(tick(index), one, estimate)
    return monitor


def reasons(monitor: TrustMonitor, estimate: StateEstimate = SETTLED) -> set[Reason]:
    return set(monitor.judge(estimate).reasons)
