"""The daemon's configuration: one TOML file -> frozen dataclasses, every fault reported at once.

Each setting stands beside its default and its limits; ``docs/configuration.md`` explains them one by one.
"""

from __future__ import annotations

import math
import re
from collections.abc import Collection
from dataclasses import Field, dataclass, field, fields
from enum import StrEnum
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from magcal_service.errors import ConfigError, Fault, InputRefusedError, LinkAddressError
from magcal_service.links import check_address
from magcal_service.typed_toml import Table, nearest, open_toml
from magcal_service.wire.fields import NAME
from magcal_service.wire.messages import Vector

__all__ = [
    "DEFAULT_LINK",
    "Config",
    "CraftConfig",
    "FilterConfig",
    "HealthConfig",
    "OutputConfig",
    "PhysicsConfig",
    "RecordConfig",
    "SensorConfig",
    "SpinConfig",
    "SpinWindow",
    "StateConfig",
    "TickConfig",
    "TrustConfig",
    "default_craft",
    "load_config",
    "physics_of",
]

VERSION = 1
DEFAULT_LINK = "zenoh:tcp/127.0.0.1:7447"
MAX_CRAFT = 10_000
MIN_RATE_RPM = 0.01  # slower turns are longer than an orbit

_METHOD = re.compile(r"[a-z][a-z0-9-]{0,31}")
_LOOPBACK = re.compile(r"(127\.[0-9]{1,3}\.[0-9]{1,3}\.[0-9]{1,3}|localhost|\[::1\]):([0-9]{1,5})")
_AXES: dict[str, Vector] = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}

T = TypeVar("T", "SensorConfig", "FilterConfig", "TickConfig", "TrustConfig", "OutputConfig")


class Limits(NamedTuple):
    """Smallest and largest accepted value of a setting, of each element where it is an array."""

    minimum: float
    maximum: float


def _within(minimum: float, maximum: float) -> dict[str, Limits]:
    return {"limits": Limits(minimum, maximum)}


class SpinWindow(StrEnum):
    """How the field measured over a spin window becomes a pseudo-measurement of the bias across the axis, eq. (6)."""

    HARMONIC = "harmonic"
    MEAN = "mean"
    OFF = "off"


@dataclass(frozen=True, slots=True)
class SensorConfig:
    """The magnetometer.

    Parameters
    ----------
    noise_nt: white noise, 1 sigma per axis [nT]; None: estimated from the samples.
    stuck_samples: from this many identical vectors in a row on, they are refused until they change [samples].
    range_nt: full scale of each axis [nT]; a component that reaches it is refused as saturated; None: not known.
    axis_stuck_s: an axis may keep one value for so long while the others move [s]; then samples are refused.
    """

    noise_nt: float | None = field(default=None, metadata=_within(0.01, 100_000.0))
    stuck_samples: int = field(default=10, metadata=_within(3, 100_000))
    range_nt: float | None = field(default=None, metadata=_within(1000.0, 1e6))
    axis_stuck_s: float = field(default=60.0, metadata=_within(5.0, 86_400.0))


@dataclass(frozen=True, slots=True)
class SpinConfig:
    """The spin that the pseudo-measurements (6) and (8) rest on.

    Parameters
    ----------
    axis: unit vector in the body frame.
    rate_rpm: rate about +axis [rpm]; the file has to state it.
    window: how a window is evaluated.
    window_turns: length of a window [turns].
    window_samples: length of a ``mean`` window [samples]; None: ``window_turns`` turns.
    fourth: use equation (8), which the paper rejects, as well.
    """

    axis: Vector = _AXES["z"]
    rate_rpm: float = field(default=7.5, metadata=_within(-3000.0, 3000.0))
    window: SpinWindow = SpinWindow.HARMONIC
    window_turns: int = field(default=2, metadata=_within(1, 20))
    window_samples: int | None = field(default=None, metadata=_within(2, 10_000))
    fourth: bool = False


@dataclass(frozen=True, slots=True)
class FilterConfig:
    """The estimator.

    Parameters
    ----------
    method: name of the estimator, a file in ``estimators/``.
    prior_bias_nt, prior_D: 1 sigma per state before the first sample [nT], [-].
    process_noise_bias_nt: random walk of bx, by, bz [nT/sqrt(s)].
    process_noise_D: random walk of D11, D22, D33, D12, D13, D23 [1/sqrt(s)].
    start_s: the batch start first tries after this much sample time [s].
    start_max_s: after this much [s], when no solution fits ``noise_nt``, the noise is taken from the residual instead.
    start_inflation: factor on the batch's sigmas at the handover to the filter [-].
    alpha, beta, kappa: spread and weights of the UKF's sigma points [-].
    gate_sigma: an innovation beyond this many sigmas is rejected [-].
    adaptive: look for jumps of the errors and follow them by process noise at the jump alone.
    """

    method: str = "ukf"
    prior_bias_nt: float = field(default=30_000.0, metadata=_within(1.0, 200_000.0))
    prior_D: float = field(default=0.2, metadata=_within(1e-4, 1.0))
    process_noise_bias_nt: Vector = field(default=(0.0, 0.0, 0.0), metadata=_within(0.0, 1000.0))
    process_noise_D: tuple[float, float, float, float, float, float] = field(
        default=(0.0, 0.0, 0.0, 0.0, 0.0, 0.0), metadata=_within(0.0, 0.01)
    )
    start_s: float = field(default=120.0, metadata=_within(10.0, 86_400.0))
    start_max_s: float = field(default=3600.0, metadata=_within(10.0, 604_800.0))
    start_inflation: float = field(default=4.0, metadata=_within(1.0, 1000.0))
    alpha: float = field(default=1.0, metadata=_within(1e-3, 2.0))
    beta: float = field(default=2.0, metadata=_within(0.0, 10.0))
    kappa: float = field(default=0.0, metadata=_within(0.0, 100.0))
    gate_sigma: float = field(default=6.0, metadata=_within(3.0, 1000.0))
    adaptive: bool = False


@dataclass(frozen=True, slots=True)
class TickConfig:
    """Samples in, 1 s ticks out; all times are sample time [s].

    Parameters
    ----------
    reference_max_gap_s: two reference samples further apart than this are not interpolated between.
    hold_s: how long after the reference was due a tick still waits for it, before it closes without.
    late_s: a sample further behind the newest than this is a clock step, believed when those after it agree.
    gap_s: a pause longer than this is a gap: nothing is carried over it, spin windows start anew.
    step_confirm_s: a jump ahead by more than this is believed only when the samples after it agree.
    """

    reference_max_gap_s: float = field(default=10.0, metadata=_within(0.1, 600.0))
    hold_s: float = field(default=3.0, metadata=_within(0.0, 60.0))
    late_s: float = field(default=30.0, metadata=_within(0.0, 600.0))
    gap_s: float = field(default=60.0, metadata=_within(2.0, 3600.0))
    step_confirm_s: float = field(default=600.0, metadata=_within(10.0, 604_800.0))


@dataclass(frozen=True, slots=True)
class TrustConfig:
    """When an estimate may be called trusted.

    Parameters
    ----------
    min_ticks: ticks used since the filter (re)started [ticks].
    sigma_bias_nt: largest 1-sigma of any bias [nT].
    sigma_D: largest 1-sigma of any element of D [-].
    residual_ratio: largest rms residual, in units of the sensor's noise [-].
    watch: whether the residual is watched for physics that is left out (``model_watch``).
    """

    min_ticks: int = field(default=300, metadata=_within(10, 1_000_000))
    sigma_bias_nt: float = field(default=100.0, metadata=_within(0.1, 10_000.0))
    sigma_D: float = field(default=0.005, metadata=_within(1e-6, 0.5))
    residual_ratio: float = field(default=1.5, metadata=_within(1.0, 100.0))
    watch: bool = True


@dataclass(frozen=True, slots=True)
class OutputConfig:
    """What the daemon writes beside what it publishes.

    Parameters
    ----------
    csv: one row per tick into this file, relative to the working directory; None: no file.
    status_period_s: time between two status messages [s].
    """

    csv: Path | None = None
    status_period_s: float = field(default=10.0, metadata=_within(1.0, 3600.0))


@dataclass(frozen=True, slots=True)
class RecordConfig:
    """Sessions recorded as MCAP files; needs the extra ``record``.

    Parameters
    ----------
    directory: where the files go, relative to the working directory; made where absent.
    flush_s: what was recorded is on the disk after this much time [s].
    file_mb: a file that has this size is ended and the next begun [MB].
    file_h: the same by age [h].
    total_mb: the oldest files are deleted beyond this size of them all [MB]; None: nothing is deleted.
    min_free_mb: recording stops where the disk has less room than this left for others [MB].
    retry_s: time between two attempts to record again [s].
    """

    directory: Path
    flush_s: float = field(default=5.0, metadata=_within(0.1, 60.0))
    file_mb: float = field(default=64.0, metadata=_within(0.01, 4096.0))
    file_h: float = field(default=6.0, metadata=_within(0.001, 720.0))
    total_mb: float | None = field(default=None, metadata=_within(0.02, 1e7))
    min_free_mb: float = field(default=64.0, metadata=_within(0.0, 1e6))
    retry_s: float = field(default=60.0, metadata=_within(0.1, 3600.0))


@dataclass(frozen=True, slots=True)
class StateConfig:
    """Checkpoints: the whole state of each craft on disk, taken up again by a restarted daemon.

    Parameters
    ----------
    directory: where they go, a folder for each craft, relative to the working directory; made where absent.
    period_s: time between two checkpoints of a craft [s]; its least value bounds the wear on flash.
    keep: checkpoints of a craft that are kept, so that a damaged one has another before it.
    """

    directory: Path
    period_s: float = field(default=60.0, metadata=_within(10.0, 86_400.0))
    keep: int = field(default=3, metadata=_within(2, 100))


@dataclass(frozen=True, slots=True)
class HealthConfig:
    """What the daemon tells about itself beside its status.

    Parameters
    ----------
    metrics: loopback address and port of the Prometheus text; None: not served.
    summary_s: time between two summaries in the log [s].
    """

    metrics: str | None = None
    summary_s: float = field(default=300.0, metadata=_within(1.0, 86_400.0))


@dataclass(frozen=True, slots=True)
class PhysicsConfig:
    """A ``physics.toml`` that is compensated live: where it is, and what it said when it was read."""

    path: Path
    text: str


@dataclass(frozen=True, slots=True)
class CraftConfig:
    """One craft: its name on the link and how its magnetometer is calibrated; ``spin`` is None where it doesn't."""

    name: str
    sensor: SensorConfig = SensorConfig()
    spin: SpinConfig | None = None
    filter: FilterConfig = FilterConfig()
    ticks: TickConfig = TickConfig()
    trust: TrustConfig = TrustConfig()
    physics: PhysicsConfig | None = None


@dataclass(frozen=True, slots=True)
class Config:
    """A whole file: the link's address, one ``CraftConfig`` per ``[[craft]]`` in order, and what is written."""

    link: str = DEFAULT_LINK
    crafts: tuple[CraftConfig, ...] = ()
    output: OutputConfig = OutputConfig()
    record: RecordConfig | None = None
    state: StateConfig | None = None
    health: HealthConfig = HealthConfig()


def default_craft(name: str) -> CraftConfig:
    """All defaults for the craft ``name`` (no spin); raises ConfigError where the name is not accepted."""
    if not NAME.fullmatch(name):
        raise ConfigError([Fault("craft name", name, _NAME_ACCEPTED)])
    return CraftConfig(name)


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
        check_address(link)
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


_NAME_ACCEPTED = "1 to 32 characters of A-Z a-z 0-9 _ - are accepted"


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
        table.refuse("name", name, _NAME_ACCEPTED)
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
    from magcal_service.physics.model_file import read_model, text_of  # the catalogue is loaded where it is asked for

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


def _read_record(table: Table | None) -> RecordConfig | None:
    if table is None:
        return None
    text = table.text("directory", accepted="the folder that recordings go to")
    if not text.strip() and isinstance(table.content.get("directory"), str):
        table.refuse("directory", text, "the folder that recordings go to is accepted; leave [record] out for none")
    values = {setting.name: _read_setting(table, setting) for setting in fields(RecordConfig) if setting.metadata}
    if values["total_mb"] is not None and values["total_mb"] < 2.0 * values["file_mb"]:
        table.refuse("total_mb", values["total_mb"], f"at least twice file_mb = {values['file_mb']:g} is accepted")
    table.finish()
    return RecordConfig(directory=Path(text), **values)


def _read_state(table: Table | None) -> StateConfig | None:
    if table is None:
        return None
    text = table.text("directory", accepted="the folder that checkpoints go to")
    if not text.strip() and isinstance(table.content.get("directory"), str):
        table.refuse("directory", text, "the folder that checkpoints go to is accepted; leave [state] out for none")
    values = {setting.name: _read_setting(table, setting) for setting in fields(StateConfig) if setting.metadata}
    table.finish()
    return StateConfig(directory=Path(text), **values)


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
