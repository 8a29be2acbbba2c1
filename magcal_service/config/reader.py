"""The daemon's configuration from its TOML file: every fault reported at once."""

from __future__ import annotations

import math
import re
from collections.abc import Collection
from dataclasses import Field, fields
from pathlib import Path
from typing import Any, TypeVar

from magcal_service.config.address import parse_address
from magcal_service.config.settings import (
    DEFAULT_LINK,
    MIN_RATE_RPM,
    NAME_ACCEPTED,
    Config,
    CraftConfig,
    FilterConfig,
    HealthConfig,
    Limits,
    OutputConfig,
    PhysicsConfig,
    RecordConfig,
    SensorConfig,
    SpinConfig,
    SpinWindow,
    StateConfig,
    TickConfig,
    TrustConfig,
)
from magcal_service.errors import ConfigError, InputRefusedError, LinkAddressError
from magcal_service.typed_toml import Table, nearest, open_toml
from magcal_service.wire.fields import NAME
from magcal_service.wire.messages import Vector

__all__ = ["load_config", "physics_of", "read_config"]

VERSION = 1
MAX_CRAFT = 10_000

_METHOD = re.compile(r"[a-z][a-z0-9-]{0,31}")
_LOOPBACK = re.compile(r"(127\.[0-9]{1,3}\.[0-9]{1,3}\.[0-9]{1,3}|localhost|\[::1\]):([0-9]{1,5})")
_AXES: dict[str, Vector] = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}

T = TypeVar("T", "SensorConfig", "FilterConfig", "TickConfig", "TrustConfig", "OutputConfig")


def load_config(path: Path, methods: Collection[str] = ()) -> Config:
    """Read and check a configuration file.

    Parameters
    ----------
    path: TOML file.
    methods: names of the estimators there are; empty: any well-formed ``filter.method`` is accepted.

    Raises ConfigError with every fault in the file: file, field, value, what is accepted.
    """
    return read_config(open_toml(path, ConfigError), methods)


def read_config(top: Table, methods: Collection[str] = ()) -> Config:
    """The same of a file that has been parsed already."""
    version = top.number("version", required=True)
    if version not in (None, VERSION):
        top.refuse("version", version, f"{VERSION} is accepted")
    link = top.text("link", DEFAULT_LINK)
    try:
        parse_address(link)
    except LinkAddressError as exc:
        top.refuse("link", link, str(exc))
    config = Config(
        link,
        _read_crafts(top, methods),
        _read_output(top.table("output")),
        _read_record(top.table("record")),
        _read_state(top.table("state")),
        _read_health(top.table("health")),
    )
    top.finish()
    if top.faults:
        raise ConfigError(top.faults)
    return config


def _read_crafts(top: Table, methods: Collection[str]) -> tuple[CraftConfig, ...]:
    tables = top.tables("craft")
    if not 1 <= len(tables) <= MAX_CRAFT:
        top.refuse("craft", len(tables), f"1 to {MAX_CRAFT} tables [[craft]] are accepted, each with its name")
        return ()
    seen: set[str] = set()
    return tuple(_read_craft(table, seen, methods) for table in tables)


def _read_craft(table: Table, seen: set[str], methods: Collection[str]) -> CraftConfig:
    name = table.text("name", accepted="the craft's name on the link")
    if name in seen:
        table.refuse("name", name, "each craft needs a name of its own")
    elif table.has("name") and not NAME.fullmatch(name):
        table.refuse("name", name, NAME_ACCEPTED)
    seen.add(name)
    craft = CraftConfig(
        name=name,
        physics=_read_physics(table),
        sensor=_read_plain(table.table("sensor"), SensorConfig),
        spin=_read_spin(table.table("spin")),
        filter=_read_filter(table.table("filter"), methods),
        ticks=_read_ticks(table.table("ticks")),
        trust=_read_plain(table.table("trust"), TrustConfig),
    )
    table.finish()
    return craft


def _read_physics(table: Table) -> PhysicsConfig | None:
    """The model is read and checked with the configuration; its faults are the configuration's."""
    text = table.text("physics", "", accepted="a file written by magcal diagnose")
    if not text.strip():
        if isinstance(table.content.get("physics"), str):
            table.refuse("physics", text, "a file written by magcal diagnose is accepted; leave it out for none")
        return None
    try:
        return physics_of(Path(text))
    except InputRefusedError as error:
        table.faults.extend(error.faults)
        return None


def physics_of(path: Path) -> PhysicsConfig:
    """Read a ``physics.toml``; raises InputRefusedError with every fault in it."""
    from magcal_service.physics.apply.model_file import (  # the catalogue is loaded where it is asked for
        read_model,
        text_of,
    )

    return PhysicsConfig(path, text_of(read_model(path)))


def _read_plain(table: Table | None, kind: type[T]) -> T:
    """A table whose settings are all numbers with limits and defaults, or switches."""
    if table is None:
        return kind()
    values = {
        setting.name: _read_setting(table, setting)
        for setting in fields(kind)
        if setting.metadata or isinstance(setting.default, bool)
    }
    table.finish()
    return kind(**values)


def _read_setting(table: Table, setting: Field[Any]) -> Any:
    """One number, whole number, switch or array of numbers, told apart by the setting's default."""
    if isinstance(setting.default, bool):
        return table.flag(setting.name, setting.default)
    limits: Limits = setting.metadata["limits"]
    default: Any = setting.default
    if isinstance(default, tuple):
        return _read_array(table, setting.name, default, limits)
    if isinstance(default, int):
        return table.integer(setting.name, default, minimum=int(limits.minimum), maximum=int(limits.maximum))
    return table.number(setting.name, default, minimum=limits.minimum, maximum=limits.maximum)


def _read_array(table: Table, key: str, default: tuple[float, ...], limits: Limits) -> tuple[float, ...]:
    values = table.numbers(key, len(default), default) or default
    if not all(limits.minimum <= value <= limits.maximum for value in values):
        table.refuse(key, list(values), f"numbers from {limits.minimum:g} to {limits.maximum:g} are accepted")
    return values


def _read_spin(table: Table | None) -> SpinConfig | None:
    if table is None:
        return None
    settings = {setting.name: setting for setting in fields(SpinConfig)}
    window = table.choice("window", SpinWindow, SpinConfig().window)
    spin = SpinConfig(
        axis=_read_axis(table),
        rate_rpm=_read_rate(table, settings["rate_rpm"].metadata["limits"]),
        window=window,
        window_turns=_read_setting(table, settings["window_turns"]),
        window_samples=_read_window_samples(table, window, settings["window_samples"].metadata["limits"]),
        fourth=table.flag("fourth", False),
    )
    table.finish()
    return spin


def _read_rate(table: Table, limits: Limits) -> float:
    """Required: a guessed rate would be a wrong window."""
    rate_rpm = table.number("rate_rpm", required=True, minimum=limits.minimum, maximum=limits.maximum)
    if rate_rpm is None:
        return SpinConfig().rate_rpm
    if abs(rate_rpm) < MIN_RATE_RPM:
        table.refuse("rate_rpm", rate_rpm, f"at least {MIN_RATE_RPM} either way; leave [craft.spin] out for no spin")
    return rate_rpm


def _read_axis(table: Table) -> Vector:
    """``"x"``, ``"y"``, ``"z"`` or a body vector of any length; a unit vector comes back."""
    if not isinstance(table.content.get("axis"), list):
        name = table.text("axis", "z")
        if name not in _AXES:
            table.refuse("axis", name, 'a body vector such as [-0.20, -0.98, -0.03] or "x", "y", "z" is accepted')
        return _AXES.get(name, _AXES["z"])
    x, y, z = table.numbers("axis", 3) or _AXES["z"]
    length = math.hypot(x, y, z)
    if not 1e-6 <= length <= 1e6:
        table.refuse("axis", [x, y, z], "a vector of length 1e-6 to 1e6 is accepted (its length does not matter)")
        return _AXES["z"]
    if abs(length - 1.0) < 1e-12:  # a unit vector stays as it was written, bit for bit
        return (x, y, z)
    return (x / length, y / length, z / length)


def _read_window_samples(table: Table, window: SpinWindow, limits: Limits) -> int | None:
    if not table.has("window_samples"):
        return None
    if window is not SpinWindow.MEAN:
        table.refuse("window_samples", table.content["window_samples"], 'only window = "mean" uses it; remove it')
        return None
    return table.integer("window_samples", 8, minimum=int(limits.minimum), maximum=int(limits.maximum))


def _read_filter(table: Table | None, methods: Collection[str]) -> FilterConfig:
    if table is None:
        return FilterConfig()
    method = table.text("method", FilterConfig().method)
    if methods and method not in methods:
        table.refuse("method", method, nearest(method, methods))
    elif not _METHOD.fullmatch(method):
        table.refuse("method", method, "the name of an estimator such as 'ukf' is accepted")
    values = {setting.name: _read_setting(table, setting) for setting in fields(FilterConfig) if setting.metadata}
    if values["start_max_s"] < values["start_s"]:
        table.refuse("start_max_s", values["start_max_s"], f"at least start_s = {values['start_s']:g} is accepted")
    adaptive = table.flag("adaptive", FilterConfig().adaptive)
    table.finish()
    return FilterConfig(method=method, adaptive=adaptive, **values)


def _read_ticks(table: Table | None) -> TickConfig:
    ticks = _read_plain(table, TickConfig)
    if table is not None:
        if ticks.late_s < ticks.hold_s:
            table.refuse("late_s", ticks.late_s, f"at least hold_s = {ticks.hold_s:g} is accepted")
        if ticks.step_confirm_s < ticks.gap_s:
            table.refuse("step_confirm_s", ticks.step_confirm_s, f"at least gap_s = {ticks.gap_s:g} is accepted")
    return ticks


def _read_output(table: Table | None) -> OutputConfig:
    if table is None:
        return OutputConfig()
    text = table.text("csv", "", accepted="a file name")
    if table.has("csv") and isinstance(table.content["csv"], str) and not text.strip():
        table.refuse("csv", text, "a file name is accepted; leave it out for no file")
    values = {setting.name: _read_setting(table, setting) for setting in fields(OutputConfig) if setting.metadata}
    table.finish()
    return OutputConfig(csv=Path(text) if text else None, **values)


def _directory(table: Table, accepted: str, section: str) -> Path:
    """A section's folder, which may not be empty."""
    text = table.text("directory", accepted=accepted)
    if not text.strip() and isinstance(table.content.get("directory"), str):
        table.refuse("directory", text, f"{accepted} is accepted; leave {section} out for none")
    return Path(text)


def _read_record(table: Table | None) -> RecordConfig | None:
    if table is None:
        return None
    directory = _directory(table, "the folder that recordings go to", "[record]")
    values = {setting.name: _read_setting(table, setting) for setting in fields(RecordConfig) if setting.metadata}
    if values["total_mb"] is not None and values["total_mb"] < 2.0 * values["file_mb"]:
        table.refuse("total_mb", values["total_mb"], f"at least twice file_mb = {values['file_mb']:g} is accepted")
    table.finish()
    return RecordConfig(directory=directory, **values)


def _read_state(table: Table | None) -> StateConfig | None:
    if table is None:
        return None
    directory = _directory(table, "the folder that checkpoints go to", "[state]")
    values = {setting.name: _read_setting(table, setting) for setting in fields(StateConfig) if setting.metadata}
    table.finish()
    return StateConfig(directory=directory, **values)


def _read_health(table: Table | None) -> HealthConfig:
    if table is None:
        return HealthConfig()
    text = table.text("metrics", "", accepted="a loopback address and port such as '127.0.0.1:9464'")
    match = _LOOPBACK.fullmatch(text)
    if isinstance(table.content.get("metrics"), str) and (match is None or int(match[2]) > 65_535):
        table.refuse("metrics", text, "a loopback address and port such as '127.0.0.1:9464' is accepted")
    summary_s = _read_setting(table, next(one for one in fields(HealthConfig) if one.metadata))
    table.finish()
    return HealthConfig(text or None, summary_s)
