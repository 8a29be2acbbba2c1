"""The craft that the rules drive: every method, set usually and at the limits of its settings, at rest and flown."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any, Final

from magcal_service.base.errors import ConfigError
from magcal_service.config.settings import (
    CraftConfig,
    FilterConfig,
    PhysicsConfig,
    ReferenceConfig,
    ReferenceModel,
    SensorConfig,
    SpinConfig,
    SpinWindow,
    TickConfig,
)
from magcal_service.daemon.pipeline import Pipeline
from magcal_service.estimators import find_method, methods
from magcal_service.wire.messages import (
    Frame,
    MagnetometerSample,
    Message,
    PositionSample,
    ReferenceSample,
    TelemetrySample,
)
from sim_sensor.scenario_reader import load_scenario
from sim_sensor.simulation import Simulation
from tests.fuzz.inputs import ROOT

METHODS: Final = tuple(method.name for method in methods())
WILD, OTHER, CALM = "wild", "other", "calm"
"""Names of the craft: the one that is driven, one that is driven less, one that only flies."""

SECOND_NS: Final = 1_000_000_000
START_NS: Final = 1_750_000_000 * SECOND_NS
SHORT_S: Final = (0, 100, 400)
"""How long a craft has flown when it is first driven [s]: at rest, collecting or just started, running."""

LONG_S: Final = (0, 400, 1750)
"""The same for a long run: the watch over the model has evidence to weigh."""

_PAPER: Final = SpinConfig(rate_rpm=7.5)
_GREATEST: Final = CraftConfig(
    WILD,
    SensorConfig(noise_nt=1e5, stuck_samples=100_000, axis_stuck_s=86_400.0),
    SpinConfig(rate_rpm=-3000.0, window=SpinWindow.MEAN, window_samples=2, fourth=True),
    FilterConfig(
        prior_bias_nt=200_000.0,
        prior_D=1.0,
        process_noise_bias_nt=(1000.0,) * 3,
        process_noise_D=(0.01,) * 6,
        start_s=10.0,
        start_max_s=20.0,
        start_inflation=1000.0,
        alpha=2.0,
        beta=10.0,
        kappa=100.0,
        gate_sigma=1000.0,
        adaptive=True,
    ),
    TickConfig(reference_max_gap_s=600.0, hold_s=60.0, late_s=600.0, gap_s=3600.0, step_confirm_s=604_800.0),
)
_LEAST: Final = CraftConfig(
    WILD,
    SensorConfig(noise_nt=0.01, stuck_samples=3, range_nt=1000.0, axis_stuck_s=5.0),
    SpinConfig(rate_rpm=0.01, window_turns=1, fourth=True),
    FilterConfig(
        prior_bias_nt=1.0, prior_D=1e-4, start_s=10.0, start_max_s=10.0, start_inflation=1.0, alpha=1e-3, beta=0.0
    ),
    TickConfig(reference_max_gap_s=0.1, hold_s=0.0, late_s=0.0, gap_s=2.0, step_confirm_s=10.0),
)


def physics_text() -> str:
    """The ``physics.toml`` of the documentation: a temperature, a current."""
    page = (ROOT / "docs/physics-file.md").read_text().split("```toml\n")[1]
    return page.split("```")[0]


@cache
def crafts(method: str) -> tuple[CraftConfig, ...]:
    """The configurations of one method that are driven."""
    quick = FilterConfig(start_s=10.0, start_max_s=60.0)
    usual = CraftConfig(WILD, SensorConfig(noise_nt=300.0), _PAPER, quick)
    every = (
        usual,
        replace(usual, spin=None),
        CraftConfig(WILD, SensorConfig(), _PAPER, replace(quick, adaptive=True)),
        replace(usual, physics=PhysicsConfig(Path("physics.toml"), physics_text())),
        replace(usual, reference=ReferenceConfig(ReferenceModel.IGRF)),
        _GREATEST,
        _LEAST,
    )
    named = tuple(replace(one, filter=replace(one.filter, method=method)) for one in every)
    return tuple(one for one in named if _can_be_built(one))


def _can_be_built(craft: CraftConfig) -> bool:
    try:
        find_method(craft.filter.method).build(craft)
    except ConfigError:
        return False
    return True


def calm() -> CraftConfig:
    """The craft that is never driven."""
    return CraftConfig(CALM, SensorConfig(noise_nt=300.0), _PAPER, FilterConfig(start_s=10.0))


@cache
def _seconds(seed: int) -> tuple[tuple[ReferenceSample, MagnetometerSample], ...]:
    sent = [
        one
        for one in Simulation(load_scenario("paper"), seed, 2000.0).messages()
        if isinstance(one, ReferenceSample | MagnetometerSample)
    ]
    references = [one for one in sent if isinstance(one, ReferenceSample)]
    samples = [one for one in sent if isinstance(one, MagnetometerSample)]
    return tuple(zip(references, samples, strict=True))


def flight(craft: str, first_ns: int, second: int, count: int) -> Iterator[Message]:
    """What a sound craft sends in so many seconds of its flight, from a source time [ns] on."""
    parts = _seconds(1 + len(craft) % 2)
    for number in range(count):
        reference, sample = parts[(second + number) % len(parts)]
        time_ns = first_ns + number * SECOND_NS
        at: dict[str, Any] = {"craft": craft, "sequence": (second + number) % (1 << 32), "time_ns": time_ns}
        phase = 1e-3 * (second + number)
        place = (7000.0 * math.cos(phase), 7000.0 * math.sin(phase), 100.0)
        if number % 4 == 0:
            yield PositionSample(**at, source="gps", position_km=place, frame=Frame.ECI)
            warm = (20.0 + 5.0 * math.sin(phase),)
            yield TelemetrySample(**at, source="bus", channel="temperature", unit="degC", values=warm)
        yield TelemetrySample(**at, source="bus", channel="gyro", unit="rad/s", values=(0.0, 0.001, 0.785))
        yield replace(reference, **at)
        yield replace(sample, **at)


@cache
def flown(craft: CraftConfig, seconds: int) -> dict[str, Any]:
    """State of a craft after so many seconds of sound flight."""
    pipeline = Pipeline(craft)
    for message in flight(craft.name, START_NS, 0, seconds):
        pipeline.handle(message)
    return pipeline.export_state()
