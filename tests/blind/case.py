"""A concealed case: what the recording holds, and, apart from it, the answer."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Literal

from tests.blind.cause import Telemetry
from tests.blind.vectors import Floats

Verdict = Literal["none", "named", "unknown"]


@dataclass(frozen=True, slots=True)
class EffectTruth:
    """One effect that was put in.

    Parameters
    ----------
    effect: its name in the catalogue; for a kind outside of it, a name of this package's own.
    parameters: true values by name, with the unit in the name; see README.md for conventions.
    driver: names of the recorded channels that drive it; empty where they were left out or it needs none.
    scalar: the magnitude shows it; otherwise detectability has a meaning of its own (``strength.py``).
    strength: rms in sigmas of the noise.
    detectability: norm of its scalar signature over sigma; for an effect of a pair, beside the other's signature too.
    alone: the same without regard to another effect.
    """

    effect: str
    parameters: Mapping[str, Any]
    driver: tuple[str, ...]
    scalar: bool
    strength: float
    detectability: float
    alone: float


@dataclass(frozen=True, slots=True)
class Answer:
    """What is true of a case, to be kept from whoever diagnoses it.

    Parameters
    ----------
    seed, kind, attempt: how to draw it again.
    verdict: what a diagnosis ought to say.
    effects: what was put in; for the verdict ``unknown`` one entry whose name is in no catalogue, for ``none`` nothing
        or something that the calibration absorbs.
    also: names of effects that are true beside those, which nobody should count as false.
    driver_recorded: whether the channels that drive the effects are in the recording.
    decoys: names of the channels that have nothing to do with it.
    noise_nt: 1 sigma of the noise per axis.
    bias_nt, scale: b (3) and D (3 x 3) of the sensor.
    spin_rpm, spin_axis: true spin at the first sample, about a body axis.
    orbit: altitudes [km], inclination [deg], share of the recording in sunlight.
    """

    seed: int
    kind: str
    attempt: int
    verdict: Verdict
    effects: tuple[EffectTruth, ...]
    also: tuple[str, ...]
    driver_recorded: bool
    decoys: tuple[str, ...]
    noise_nt: float
    bias_nt: tuple[float, ...]
    scale: tuple[tuple[float, ...], ...]
    spin_rpm: float
    spin_axis: tuple[float, ...]
    orbit: Mapping[str, float]

    def to_json(self) -> str:
        """The answer as JSON text."""
        return json.dumps(asdict(self), indent=1, sort_keys=True) + "\n"


@dataclass(frozen=True, slots=True, eq=False)
class Case:
    """What a recording holds.

    Parameters
    ----------
    time_s: (n,) tags since the first sample [s].
    start_unix_s: UTC of the first sample, or None where only elapsed time is recorded.
    field_nt: (n, 3) B in the sensor's axes.
    reference_nt: (n, 3) H in ``reference_frame``, or (n,) its magnitude where that is None.
    reference_frame: "eci", "ned" or None.
    position: (n, 3) latitude, longitude [deg] and altitude [km], geodetic, or (n, 3) ECEF [km], or None.
    position_form: "geodetic", "ecef" or None.
    channels: telemetry, drivers and decoys in an order that tells nothing.
    spin_axis, spin_rpm: what the descriptor says of the spin; None where it says nothing.
    stated_noise_nt: what it says of the noise; None where it says nothing.
    answer: what is true of it; ``write_case`` leaves it out.
    """

    time_s: Floats
    start_unix_s: float | None
    field_nt: Floats
    reference_nt: Floats
    reference_frame: Literal["eci", "ned"] | None
    position: Floats | None
    position_form: Literal["geodetic", "ecef"] | None
    channels: tuple[Telemetry, ...]
    spin_axis: tuple[float, ...] | None
    spin_rpm: float | None
    stated_noise_nt: float | None
    answer: Answer
