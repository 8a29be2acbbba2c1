"""A scenario's TOML file into its records: found by name or path, every fault reported at once."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from magcal_service.base.errors import ConfigError, Fault
from magcal_service.base.typed_toml import Table, TomlKind, nearest, open_toml, refuse_another
from magcal_service.base.typed_toml.record import read_record
from sim_sensor.scenario import Channel, Scenario
from sim_sensor.sensor import Effects, symmetric

SHIPPED = Path(__file__).parent / "scenarios"

_LARGEST_TURN_RAD = 1.0
"""Lag times spin rate up to which the quadrature of ``sensor.lagged`` is right to 1e-4."""

_LEAST_EIGENVALUE = 0.1
"""Of I + D: the sensor's model divides by it, and below no real sensor is described."""


def shipped_scenarios() -> dict[str, Path]:
    """Names and files of the scenarios that come with the package."""
    return {path.stem: path for path in sorted(SHIPPED.glob("*.toml"))}


def load_scenario(name_or_file: str | Path) -> Scenario:
    """Read a scenario by file, or by name if it is a shipped one; raises ConfigError with every fault."""
    path, known = Path(name_or_file), shipped_scenarios()
    if str(name_or_file) in known and not path.is_file():
        path = known[str(name_or_file)]
    elif path.suffix != ".toml":
        accepted = f"give a file ending in .toml or a shipped scenario; {nearest(str(name_or_file), known)}"
        raise ConfigError([Fault("scenario", str(name_or_file), accepted)])
    table = open_toml(path, ConfigError)
    refuse_another(table, TomlKind.SCENARIO, ConfigError)
    scenario = read_scenario(table, path.stem)
    if table.faults:
        raise ConfigError(table.faults)
    return scenario


def read_scenario(top: Table, name: str) -> Scenario:
    """The scenario of one file; meaningless where ``top.faults`` is not empty afterwards."""
    if top.integer("version", 0, minimum=1, maximum=1) != 1 and not top.faults:
        top.lack("version", "required: version = 1")
    scenario = read_record(top, Scenario, {"name": name})
    if not top.faults:
        _check_lag(top, scenario)
        _check_errors(top, scenario)
        _check_channels(top, scenario)
    return scenario


def _check_lag(top: Table, scenario: Scenario) -> None:
    turn_rad = scenario.sensor.lag_s * scenario.spin.fastest_rad_s(scenario.duration_s)
    if turn_rad > _LARGEST_TURN_RAD:
        top.refuse("magnetometer.lag_s", scenario.sensor.lag_s, f"lag times spin rate is {turn_rad:.2f} rad; at most 1")


def _check_errors(top: Table, scenario: Scenario) -> None:
    """I + D can be inverted at all times."""
    matrices = [np.array(scenario.sensor.D)]
    for step in sorted(scenario.effects.steps, key=lambda step: step.at_s):
        matrices.append(matrices[-1] + np.array(step.D))
    if min(np.linalg.eigvalsh(np.eye(3) + symmetric(D))[0] for D in matrices) < _LEAST_EIGENVALUE:
        top.refuse("magnetometer.D", list(scenario.sensor.D), "I + D, steps included, with eigenvalues above 0.1")


_NEEDS: list[tuple[Channel, Callable[[Effects], object], str]] = [
    (Channel.TEMPERATURE, lambda effects: effects.thermal, "[thermal]"),
    (Channel.CURRENT, lambda effects: effects.panels, "[[panel]]"),
    (Channel.TORQUER, lambda effects: effects.torquer, "[torquer]"),
]
"""Telemetry, the effect that it reports, and that effect's section."""


def _check_channels(top: Table, scenario: Scenario) -> None:
    for channel, part, section in _NEEDS:
        if channel in scenario.telemetry.channels and not part(scenario.effects):
            top.refuse("telemetry.channels", channel.value, f"this channel needs the section {section}")
