"""The daemon's configuration as frozen dataclasses; ``config_reader`` makes them of a TOML file.

Each setting stands beside its default and its limits; ``docs/configuration.md`` explains them one by one.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import NamedTuple

from magcal_service.errors import ConfigError, Fault
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
]

DEFAULT_LINK = "zenoh:tcp/127.0.0.1:7447"
MIN_RATE_RPM = 0.01  # slower turns are longer than an orbit
NAME_ACCEPTED = "1 to 32 characters of A-Z a-z 0-9 _ - are accepted"


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

    axis: Vector = (0.0, 0.0, 1.0)
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
        raise ConfigError([Fault("craft name", name, NAME_ACCEPTED)])
    return CraftConfig(name)
