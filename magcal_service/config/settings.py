"""A craft's configuration, and the whole file's, as frozen dataclasses: each setting with its default, unit and limits.

``daemon_settings`` has those of the daemon itself.  ``reader`` makes them of a TOML file by these declarations;
``docs/configuration.md`` explains the settings one by one.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Final

from magcal_service.base.errors import ConfigError, Fault
from magcal_service.base.typed_toml.keys import (
    choice,
    defaulted_section,
    flag,
    number,
    numbers,
    optional_numbers,
    optional_whole,
    section,
    special,
    text,
    whole,
)
from magcal_service.base.typed_toml.record import REQUIRED, Limits, Reading, read_record
from magcal_service.config import rules
from magcal_service.config.daemon_settings import (
    CommandsConfig,
    HealthConfig,
    OutputConfig,
    RecordConfig,
    StateConfig,
)
from magcal_service.config.physics_file import PhysicsConfig, physics_setting
from magcal_service.wire.fields import NAME
from magcal_service.wire.messages import Vector

__all__ = [
    "DEFAULT_LINK",
    "Config",
    "CraftConfig",
    "FilterConfig",
    "MagnetometerConfig",
    "PhysicsConfig",
    "ReferenceConfig",
    "ReferenceModel",
    "SensorConfig",
    "SpinConfig",
    "SpinWindow",
    "TickConfig",
    "TrustConfig",
    "default_craft",
]

DEFAULT_LINK = "zenoh:tcp/127.0.0.1:7447"

MAX_CRAFT = 10_000
"""Thirty times the craft that one process serves at 1 Hz; a larger number is a mistake."""

WINDOW_SAMPLES = Limits(2, 10_000)
"""Two samples make the shortest mean; ten thousand are hours of the slowest useful sampling."""


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

    noise_nt: float | None = number(None, 0.01, 100_000.0, unit="nT")
    stuck_samples: int = whole(10, 3, 100_000, unit="samples")
    range_nt: float | None = number(None, *rules.RANGE_NT, unit="nT")
    axis_stuck_s: float = number(60.0, 5.0, 86_400.0, unit="s")


def _window_samples(reading: Reading, name: str) -> int | None:
    table = reading.table
    if not table.has(name):
        return None
    if reading.values["window"] is not SpinWindow.MEAN:
        table.refuse(name, table.content[name], 'only window = "mean" uses it; remove it')
        return None
    least, most = map(int, WINDOW_SAMPLES)
    return table.integer(name, least, minimum=least, maximum=most)


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

    axis: Vector = special(rules.axis, (0.0, 0.0, 1.0))
    rate_rpm: float = number(REQUIRED, -3000.0, 3000.0, unit="rpm", fallback=7.5, check=rules.check_rate)
    window: SpinWindow = choice(SpinWindow, SpinWindow.HARMONIC)
    window_turns: int = whole(2, 1, 20, unit="turns")
    window_samples: int | None = special(_window_samples, None, limits=WINDOW_SAMPLES, unit="samples")
    fourth: bool = flag(False)

    @property
    def window_s(self) -> float:
        """Length of a window of whole turns [s]."""
        return self.window_turns * 60.0 / abs(self.rate_rpm)


DEFAULT_METHOD: Final = "ukf"
"""The estimator that runs where none is named."""


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
    gate_sigma: an innovation beyond this many sigmas is rejected [-]; right after a start fewer (``SampleGate``).
    adaptive: look for jumps of the errors and follow them by process noise at the jump alone.
    """

    method: str = text(DEFAULT_METHOD, check=rules.check_method)
    prior_bias_nt: float = number(30_000.0, 1.0, 200_000.0, unit="nT")
    prior_D: float = number(0.2, 1e-4, 1.0)
    process_noise_bias_nt: Vector = numbers(3, (0.0, 0.0, 0.0), 0.0, 1000.0, unit="nT/sqrt(s)")
    process_noise_D: tuple[float, float, float, float, float, float] = numbers(
        6, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0), 0.0, 0.01, unit="1/sqrt(s)"
    )
    start_s: float = number(120.0, 10.0, 86_400.0, unit="s")
    start_max_s: float = number(3600.0, 10.0, 604_800.0, unit="s", check=rules.check_start_max)
    start_inflation: float = number(4.0, 1.0, 1000.0)
    alpha: float = number(1.0, 1e-3, 2.0)
    beta: float = number(2.0, 0.0, 10.0)
    kappa: float = number(0.0, 0.0, 100.0)
    gate_sigma: float = number(6.0, 3.0, 1000.0)
    adaptive: bool = flag(False)


class ReferenceModel(StrEnum):
    """Where a craft's reference field comes from."""

    LINK = "link"
    IGRF = "igrf"


@dataclass(frozen=True, slots=True)
class ReferenceConfig:
    """The reference field H.

    Parameters
    ----------
    model: ``link``: as reference messages say; ``igrf``: the main field at the craft's positions, computed here.
    """

    model: ReferenceModel = choice(ReferenceModel, ReferenceModel.LINK)


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

    reference_max_gap_s: float = number(10.0, 0.1, 600.0, unit="s")
    hold_s: float = number(3.0, 0.0, 60.0, unit="s")
    late_s: float = number(30.0, 0.0, 600.0, unit="s", check=rules.check_late)
    gap_s: float = number(60.0, 2.0, 3600.0, unit="s")
    step_confirm_s: float = number(600.0, 10.0, 604_800.0, unit="s", check=rules.check_step_confirm)


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
    protection: whether protection levels are worked out, published and asked for (``trust.protector``).
    protection_nt: largest protection level [nT].
    disturbance_nt: largest field of the craft's own that may step, or follow orbit or spin, without being told [nT].
    """

    min_ticks: int = whole(300, 10, 1_000_000, unit="ticks")
    sigma_bias_nt: float = number(100.0, 0.1, 10_000.0, unit="nT")
    sigma_D: float = number(0.005, 1e-6, 0.5)
    residual_ratio: float = number(1.5, 1.0, 100.0)
    watch: bool = flag(True)
    protection: bool = flag(True)
    protection_nt: float = number(500.0, 0.1, 100_000.0, unit="nT")
    disturbance_nt: float = number(200.0, 0.1, 100_000.0, unit="nT", check=rules.check_disturbance)


@dataclass(frozen=True, slots=True)
class MagnetometerConfig:
    """One of several magnetometers of a craft; what is None is as the craft has it.

    Parameters
    ----------
    source: the source of its samples.
    noise_nt, range_nt, axis_stuck_s, stuck_samples: as in ``SensorConfig``.
    prior_bias_nt, prior_D, process_noise_bias_nt, process_noise_D: as in ``FilterConfig``.
    spin: in this sensor's own axes; None: the craft's where it is the first that is listed, else none.
    physics: compensated live for this one; None: the craft's where it is the first that is listed, else none.
    """

    source: str = text(accepted="the source of its samples", check=rules.check_source)
    noise_nt: float | None = number(None, 0.01, 100_000.0, unit="nT")
    range_nt: float | None = number(None, *rules.RANGE_NT, unit="nT")
    axis_stuck_s: float | None = number(None, 5.0, 86_400.0, unit="s")
    stuck_samples: int | None = optional_whole(3, 100_000, unit="samples")
    prior_bias_nt: float | None = number(None, 1.0, 200_000.0, unit="nT")
    prior_D: float | None = number(None, 1e-4, 1.0)
    process_noise_bias_nt: Vector | None = optional_numbers(3, 0.0, 1000.0, unit="nT/sqrt(s)")
    process_noise_D: tuple[float, float, float, float, float, float] | None = optional_numbers(
        6, 0.0, 0.01, unit="1/sqrt(s)"
    )
    spin: SpinConfig | None = section(SpinConfig, None)
    physics: PhysicsConfig | None = special(physics_setting, None)


MOST_SOURCES: Final = 16
"""Magnetometers of one craft that may be configured at the most: each costs what a craft costs."""


def _magnetometers(reading: Reading, name: str) -> tuple[MagnetometerConfig, ...]:
    tables = reading.table.tables(name)
    most = reading.values["max_sources"]
    if len(tables) > most:
        reading.table.refuse(name, len(tables), f"at most max_sources = {most} tables are accepted; raise max_sources")
        return ()
    context = {**reading.context, "sources": set[str]()}
    return tuple(read_record(table, MagnetometerConfig, context=context) for table in tables)


@dataclass(frozen=True, slots=True)
class CraftConfig:
    """One craft: its name on the link and how its magnetometers are calibrated.

    Parameters
    ----------
    spin: None where it doesn't.
    max_sources: magnetometers that are served, by the source of their samples.
    magnetometers: those that are listed, the first one the craft's own.
    hears, source: of one magnetometer's pipeline, see ``config.magnetometers``: whose samples it takes (empty: of the
        first that is heard), and its results' source (empty: the daemon's).  Not read from a file.
    """

    name: str = text(accepted="the craft's name on the link", check=rules.check_craft_name)
    sensor: SensorConfig = defaulted_section(SensorConfig)
    spin: SpinConfig | None = section(SpinConfig, None)
    filter: FilterConfig = defaulted_section(FilterConfig)
    ticks: TickConfig = defaulted_section(TickConfig)
    trust: TrustConfig = defaulted_section(TrustConfig)
    physics: PhysicsConfig | None = special(physics_setting, None)
    reference: ReferenceConfig = defaulted_section(ReferenceConfig)
    max_sources: int = whole(8, 1, MOST_SOURCES, unit="sources")
    magnetometers: tuple[MagnetometerConfig, ...] = special(_magnetometers, (), name="magnetometer")
    hears: str = ""
    source: str = ""


def _crafts(reading: Reading, name: str) -> tuple[CraftConfig, ...]:
    tables = reading.table.tables(name)
    if not 1 <= len(tables) <= MAX_CRAFT:
        accepted = f"1 to {MAX_CRAFT} tables [[craft]] are accepted, each with its name"
        reading.table.refuse(name, len(tables), accepted)
        return ()
    return tuple(read_record(table, CraftConfig, context=reading.context) for table in tables)


@dataclass(frozen=True, slots=True)
class Config:
    """A whole file: the link's address, one ``CraftConfig`` per ``[[craft]]`` in order, and what is written."""

    link: str = text(DEFAULT_LINK, check=rules.check_link)
    crafts: tuple[CraftConfig, ...] = special(_crafts, (), name="craft")
    output: OutputConfig = defaulted_section(OutputConfig)
    record: RecordConfig | None = section(RecordConfig, None)
    state: StateConfig | None = section(StateConfig, None)
    health: HealthConfig = defaulted_section(HealthConfig)
    commands: CommandsConfig = defaulted_section(CommandsConfig)


def default_craft(name: str) -> CraftConfig:
    """All defaults for the craft ``name`` (no spin); raises ConfigError where the name is not accepted."""
    if not NAME.fullmatch(name):
        raise ConfigError([Fault("craft name", name, rules.NAME_ACCEPTED)])
    return CraftConfig(name)
