"""TOML tables of a scenario -> its records; every fault is collected in the table's own list."""

from __future__ import annotations

import math
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from magcal_service.errors import ConfigError, Fault, MagcalError
from magcal_service.typed_toml import Table, nearest, open_toml
from magcal_service.wire.fields import NAME
from magcal_service.wire.messages import Vector
from sim_sensor.attitude import Spin
from sim_sensor.disturbances import ZERO, Panel, Six, Step, Thermal, Torquer
from sim_sensor.faults import READS, FaultKind, LinkFault, Target
from sim_sensor.field import FieldModel
from sim_sensor.orbit import EARTH_RADIUS_KM, KeplerOrbit, Sgp4Orbit
from sim_sensor.scenario import (
    UNITS,
    Chance,
    Channel,
    Direction,
    PositionPlan,
    ReferenceForm,
    ReferencePlan,
    Scenario,
    TelemetryPlan,
)
from sim_sensor.sensor import Effects, Sensor, symmetric

RPM = math.tau / 60.0
SHIPPED = Path(__file__).parent / "scenarios"

_MAX_S = 366.0 * 86400.0
_MAX_NT = 1e6
_NO_D: Six = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
_IDENTITY = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
_AXES: dict[str, Vector] = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
_NAME = "1 to 32 characters of A-Z a-z 0-9 _ -"


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
    scenario = read_scenario(table, path.stem)
    if table.faults:
        raise ConfigError(table.faults)
    return scenario


def read_scenario(top: Table, name: str) -> Scenario:
    """The scenario of one file; meaningless where ``top.faults`` is not empty afterwards."""
    if top.integer("version", 0, minimum=1, maximum=1) != 1 and not top.faults:
        top.refuse("version", "missing", "required: version = 1")
    spin, direction = _spin(_section(top, "spin"))
    start_ns, duration_s = _start(top), top.real("duration_s", 18000.0, minimum=1.0, maximum=_MAX_S)
    scenario = Scenario(
        name=name,
        description=top.text("description", accepted="a paragraph on what the scenario shows"),
        craft=_craft(top),
        start_ns=start_ns,
        duration_s=duration_s,
        seed=top.integer("seed", 1, minimum=0, maximum=2**63 - 1),
        orbit=_orbit(_section(top, "orbit"), start_ns),
        field=_field(_section(top, "field")),
        sensor=_sensor(_section(top, "magnetometer")),
        spin=spin,
        direction=direction,
        reference=_reference(_section(top, "reference")),
        position=_position(_section(top, "position")),
        telemetry=_telemetry(_section(top, "telemetry")),
        effects=_effects(top),
        chance=_chance(_section(top, "random")),
        faults=tuple(_fault(table) for table in top.tables("fault")),
    )
    top.finish()
    if not top.faults:
        _check_together(top, scenario)
    return scenario


def _section(top: Table, key: str) -> Table:
    """The sub-table, or an empty one in its place so that defaults apply and required keys are named."""
    return top.table(key) or Table({}, top.file, key, top.faults)


def _craft(top: Table) -> str:
    craft = top.text("craft", "sat", accepted=_NAME)
    if not NAME.fullmatch(craft):
        top.refuse("craft", craft, f"{_NAME} are accepted")
    return craft


def _instant(table: Table, key: str, default: str) -> int:
    """A UTC time in whole seconds as ns since 1970, from ISO 8601 text or a TOML date-time."""
    accepted = 'a UTC time such as "2025-06-01T00:00:00Z" from 1950 to 2030 is accepted'
    value = table.content.get(key, default)
    table.has(key)
    try:
        moment = value if isinstance(value, datetime) else datetime.fromisoformat(str(value).replace("Z", "+00:00"))
    except ValueError:
        table.refuse(key, value, accepted)
        return 0
    if moment.tzinfo is None or moment.utcoffset() or not 1950 <= moment.year < 2030 or moment.microsecond:
        table.refuse(key, value, accepted)
        return 0
    return round(moment.astimezone(UTC).timestamp()) * 10**9


def _start(top: Table) -> int:
    return _instant(top, "start", "2025-06-01T00:00:00Z")


def _orbit(table: Table, start_ns: int) -> KeplerOrbit | Sgp4Orbit:
    if table.has("tle"):
        lines = table.texts("tle", 2, required=True) or ("", "")
        table.finish()
        return _sgp4(table, lines[0], lines[1], start_ns)
    altitude_km = table.real("altitude_km", 612.0, minimum=150.0, maximum=40000.0)
    orbit = KeplerOrbit(
        epoch_utc_ns=start_ns,
        semi_major_km=EARTH_RADIUS_KM + altitude_km,
        eccentricity=table.real("eccentricity", 0.0, minimum=0.0, maximum=0.9),
        inclination_rad=math.radians(table.real("inclination_deg", 74.0, minimum=0.0, maximum=180.0)),
        raan_rad=math.radians(table.real("raan_deg", 0.0, minimum=-360.0, maximum=360.0)),
        argument_of_perigee_rad=math.radians(table.real("argument_of_perigee_deg", 0.0, minimum=-360.0, maximum=360.0)),
        mean_anomaly_rad=math.radians(table.real("mean_anomaly_deg", 0.0, minimum=-360.0, maximum=360.0)),
        j2=table.flag("j2", False),
    )
    perigee_km = orbit.semi_major_km * (1.0 - orbit.eccentricity) - EARTH_RADIUS_KM
    if perigee_km < 100.0:
        table.refuse("eccentricity", orbit.eccentricity, f"it puts the perigee at {perigee_km:.0f} km; at least 100 km")
    table.finish()
    return orbit


def _sgp4(table: Table, line1: str, line2: str, start_ns: int) -> Sgp4Orbit:
    orbit = Sgp4Orbit(line1, line2)
    for line, begins in ((line1, "1 "), (line2, "2 ")):
        if not (line.startswith(begins) and len(line) == 69 and line.isascii() and _checksum(line) == line[68]):
            table.refuse("tle", line, f"an element line of 69 characters that begins {begins!r}, checksum right")
            return orbit
    try:
        radius_km = float(np.linalg.norm(orbit.position_eci_km(np.array([start_ns], dtype=np.int64))))
    except MagcalError as error:
        table.refuse("tle", line1, str(error))
        return orbit
    if not radius_km > EARTH_RADIUS_KM:
        table.refuse(
            "tle", line1, f"at the start it is {radius_km:.0f} km from the centre; use elements near the start"
        )
    return orbit


def _checksum(line: str) -> str:
    return str(sum(int(c) if c.isdigit() else c == "-" for c in line[:68]) % 10)


def _field(table: Table) -> FieldModel:
    field = FieldModel(
        ring_current_nt=table.real("ring_current_nt", 0.0, minimum=-2000.0, maximum=2000.0),
        reference_time_offset_s=table.real("reference_time_offset_s", 0.0, minimum=-3600.0, maximum=3600.0),
        reference_along_track_km=table.real("reference_along_track_km", 0.0, minimum=-2000.0, maximum=2000.0),
        reference_radial_km=table.real("reference_radial_km", 0.0, minimum=-100.0, maximum=1000.0),
        reference_epoch_ns=_instant(table, "reference_epoch", "") if table.has("reference_epoch") else None,
    )
    table.finish()
    return field


def _unit(table: Table, key: str, default: str | None) -> Vector:
    """A direction: ``"x"``, ``"y"``, ``"z"`` or a vector, returned as a unit vector."""
    value = table.content.get(key, default)
    table.has(key)
    if isinstance(value, str) and value in _AXES:
        return _AXES[value]
    if isinstance(value, str) or value is None:
        table.refuse(key, "missing" if value is None else value, '"x", "y", "z" or an array of 3 numbers is accepted')
        return _AXES["z"]
    x, y, z = table.numbers(key, 3, _AXES["z"]) or _AXES["z"]
    length = math.sqrt(x * x + y * y + z * z)
    if not 1e-6 <= length <= 1e6:
        table.refuse(key, value, "a vector that is not zero is accepted")
        return _AXES["z"]
    return x / length, y / length, z / length


def _spin(table: Table) -> tuple[Spin, Direction | None]:
    named = table.content.get("direction", Direction.RANDOM.value)
    direction, direction_eci = None, _AXES["z"]
    if isinstance(named, str):
        direction = table.choice("direction", Direction, Direction.RANDOM)
    else:
        direction_eci = _unit(table, "direction", None)
    spin = Spin(
        axis_body=_unit(table, "axis", "z"),
        direction_eci=direction_eci,
        rate_rad_s=table.real("rate_rpm", 7.5, minimum=-60.0, maximum=60.0) * RPM,
        phase_rad=math.radians(table.real("phase_deg", 0.0, minimum=-360.0, maximum=360.0)),
        acceleration_rad_s2=table.real("spin_up_rpm_per_hour", 0.0, minimum=-60.0, maximum=60.0) * RPM / 3600.0,
        nutation_rad=math.radians(table.real("nutation_deg", 0.0, minimum=0.0, maximum=80.0)),
        inertia_ratio=table.real("inertia_ratio", 1.0, minimum=0.01, maximum=2.0),
    )
    if spin.nutation_rad and spin.acceleration_rad_s2:
        table.refuse("spin_up_rpm_per_hour", spin.acceleration_rad_s2, "0 with nutation_deg: coning is free of torque")
    table.finish()
    return spin, direction


def _vector(table: Table, key: str, default: Vector = ZERO, limit: float = math.inf) -> Vector:
    x, y, z = table.numbers(key, 3, default) or default
    if max(abs(x), abs(y), abs(z)) > limit:
        table.refuse(key, [x, y, z], f"each number from {-limit:g} to {limit:g} is accepted")
    return x, y, z


def _axes(table: Table, key: str, limit: float) -> Vector:
    """One number for all three axes, or three; none negative."""
    if isinstance(table.content.get(key), list):
        values = _vector(table, key, ZERO, limit)
        if min(values) < 0.0:
            table.refuse(key, list(values), "numbers from 0 are accepted")
        return values
    value = table.real(key, 0.0, minimum=0.0, maximum=limit)
    return value, value, value


def _six(table: Table, key: str) -> Six:
    a, b, c, d, e, f = table.numbers(key, 6, _NO_D) or _NO_D
    return a, b, c, d, e, f


def _sensor(table: Table) -> Sensor:
    sensor = Sensor(
        rate_hz=table.real("rate_hz", 1.0, minimum=0.02, maximum=50.0),
        bias_nt=_vector(table, "bias_nt", limit=5e5),
        D=_six(table, "D"),
        noise_nt=_axes(table, "noise_nt", 1e5),
        lag_s=table.real("lag_s", 0.0, minimum=0.0, maximum=10.0),
        lsb_nt=table.real("lsb_nt", 0.0, minimum=0.0, maximum=1e5),
        full_scale_nt=table.real("full_scale_nt", 0.0, minimum=0.0, maximum=_MAX_NT),
    )
    table.finish()
    return sensor


def _reference(table: Table) -> ReferencePlan:
    plan = ReferencePlan(
        rate_hz=table.real("rate_hz", 1.0, minimum=0.001, maximum=50.0),
        offset_s=table.real("offset_s", 0.0, minimum=0.0, maximum=3600.0),
        form=table.choice("form", ReferenceForm, ReferenceForm.VECTOR),
        noise_nt=table.real("noise_nt", 0.0, minimum=0.0, maximum=1e5),
    )
    table.finish()
    return plan


def _position(table: Table) -> PositionPlan:
    plan = PositionPlan(
        rate_hz=table.real("rate_hz", 0.0, minimum=0.0, maximum=50.0),
        noise_km=table.real("noise_km", 0.0, minimum=0.0, maximum=100.0),
    )
    table.finish()
    return plan


def _telemetry(table: Table) -> TelemetryPlan:
    known = [channel.value for channel in Channel]
    names = table.texts("channels") or ()
    for name in names:
        if name not in known:
            table.refuse("channels", name, nearest(name, known))
    channels = tuple(channel for channel in Channel if channel.value in names)
    rate_hz = table.real("rate_hz", 1.0, minimum=0.001, maximum=50.0)
    keys = {channel: f"{channel.value}_noise" for channel in UNITS}
    noise = {channel: table.real(key, 0.0, minimum=0.0, maximum=1e6) for channel, key in keys.items()}
    table.finish()
    return TelemetryPlan(channels, rate_hz, tuple(noise[channel] for channel in channels))


def _effects(top: Table) -> Effects:
    thermal, torquer = top.table("thermal"), top.table("torquer")
    return Effects(
        thermal=None if thermal is None else _thermal(thermal),
        panels=tuple(_panel(table) for table in top.tables("panel")),
        torquer=None if torquer is None else _torquer(torquer),
        steps=tuple(_step(table) for table in top.tables("step")),
    )


def _thermal(table: Table) -> Thermal:
    hot = table.real("hot_degc", 40.0, minimum=-200.0, maximum=200.0)
    cold = table.real("cold_degc", -10.0, minimum=-200.0, maximum=200.0)
    thermal = Thermal(
        hot_degc=hot,
        cold_degc=cold,
        time_constant_s=table.real("time_constant_s", 1200.0, minimum=10.0, maximum=1e6),
        start_degc=table.real("start_degc", (hot + cold) / 2.0, minimum=-200.0, maximum=200.0),
        zero_degc=table.real("zero_degc", 20.0, minimum=-200.0, maximum=200.0),
        bias_nt_per_k=_vector(table, "bias_nt_per_k", limit=1e4),
        scale_per_k=_vector(table, "scale_per_k", limit=0.01),
    )
    table.finish()
    return thermal


def _panel(table: Table) -> Panel:
    panel = Panel(
        normal_body=_unit(table, "normal", None),
        max_a=table.real("max_a", 0.5, minimum=0.0, maximum=100.0),
        field_nt_per_a=_vector(table, "field_nt_per_a", limit=1e5),
    )
    table.finish()
    return panel


def _torquer(table: Table) -> Torquer:
    period_s = table.real("period_s", 60.0, minimum=0.1, maximum=1e5)
    torquer = Torquer(
        dipole_am2=_vector(table, "dipole_am2", limit=100.0),
        period_s=period_s,
        on_s=table.real("on_s", period_s / 2.0, minimum=0.0, maximum=period_s),
        field_nt_per_am2=table.numbers("field_nt_per_am2", 9, _IDENTITY) or _IDENTITY,
        decay_s=table.real("decay_s", 0.01, minimum=1e-4, maximum=10.0),
        remanence_nt=_vector(table, "remanence_nt", limit=1e5),
        alternate=table.flag("alternate", True),
    )
    if torquer.decay_s > 0.2 * (period_s - torquer.on_s):
        table.refuse("decay_s", torquer.decay_s, "at most a fifth of the undriven part of a period is accepted")
    table.finish()
    return torquer


def _step(table: Table) -> Step:
    at_s = table.number("at_s", required=True, minimum=0.0, maximum=_MAX_S) or 0.0
    step = Step(at_s, _vector(table, "bias_nt", limit=5e5), _six(table, "D"))
    table.finish()
    return step


def _chance(table: Table) -> Chance:
    chance = Chance(
        bias_nt=table.real("bias_nt", 0.0, minimum=0.0, maximum=1e5),
        D=table.real("D", 0.0, minimum=0.0, maximum=0.5),
        phase=table.flag("phase", False),
    )
    table.finish()
    return chance


def _fault(table: Table) -> LinkFault:
    before = len(table.faults)
    kind = table.choice("kind", FaultKind)
    if len(table.faults) > before:
        return LinkFault(kind)  # what else it needs depends on the kind, so one fault is enough
    target = table.choice("target", Target, Target.MAGNETOMETER)
    limits = {"probability": (0.0, 1.0), "ppm": (-1e5, 1e5), "step_s": (-_MAX_S, _MAX_S)}
    numbers = {}
    for key in READS[kind]:
        low, high = limits.get(key, (0.0, _MAX_S))
        numbers[key] = table.number(key, required=True, minimum=low, maximum=high) or 0.0
    table.finish()
    return LinkFault(kind, target, **numbers)


def _check_together(top: Table, scenario: Scenario) -> None:
    """Faults that need two parts of the file to be seen."""
    turn = scenario.sensor.lag_s * scenario.spin.fastest_rad_s(scenario.duration_s)
    if turn > 1.0:
        top.refuse("magnetometer.lag_s", scenario.sensor.lag_s, f"lag times spin rate is {turn:.2f} rad; at most 1")
    matrices = [np.array(scenario.sensor.D)]
    for step in sorted(scenario.effects.steps, key=lambda step: step.at_s):
        matrices.append(matrices[-1] + np.array(step.D))
    if min(np.linalg.eigvalsh(np.eye(3) + symmetric(D))[0] for D in matrices) < 0.1:
        top.refuse("magnetometer.D", list(scenario.sensor.D), "I + D, steps included, with eigenvalues above 0.1")
    needs: list[tuple[Channel, Callable[[Effects], object], str]] = [
        (Channel.TEMPERATURE, lambda effects: effects.thermal, "[thermal]"),
        (Channel.CURRENT, lambda effects: effects.panels, "[[panel]]"),
        (Channel.TORQUER, lambda effects: effects.torquer, "[torquer]"),
    ]
    for channel, part, section in needs:
        if channel in scenario.telemetry.channels and not part(scenario.effects):
            top.refuse("telemetry.channels", channel.value, f"this channel needs the section {section}")
