"""What the craft does to its own magnetometer: temperature, currents, torquers, and errors that step.

Each is the ``d`` of B = (I+D)^-1 (A H + b + d + eps), or changes D; each is a function of elapsed time alone, so that
the way a run is cut into pieces never changes a number.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from magcal_service.base.typed_toml.keys import flag, number, numbers, special
from magcal_service.base.typed_toml.record import Reading
from magcal_service.wire.messages import Vector
from sim_sensor.declarations import LONGEST_S, Six, direction, six, vector

Floats = npt.NDArray[np.float64]

_IDENTITY = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)  # row by row: 1 nT per A m^2 along each axis
_DRIVEN_SHARE = 0.5  # of a torquer's period where on_s is not given
_LARGEST_DECAY = 0.2
"""Of the undriven part of a period: then exp(-5), under 1 %, of a drive is left when the next one starts."""


def _start_degc(reading: Reading, name: str) -> float:
    """Halfway between hot and cold where it is not given."""
    middle = (reading.values["hot_degc"] + reading.values["cold_degc"]) / 2.0
    return reading.table.real(name, middle, minimum=-200.0, maximum=200.0)


@dataclass(frozen=True)
class Thermal:
    """Sensor temperature with one time constant, and what it does to bias and scale.

    dT/dt = (T_eq - T) / tau, T_eq between ``cold_degc`` in eclipse and ``hot_degc`` in light;
    d = k (T - T0), D(T) = D + diag(a) (T - T0).

    Parameters
    ----------
    hot_degc, cold_degc: equilibrium in light and in eclipse [degC].
    time_constant_s: tau [s]; 300 to 3600 for electronics inside a small craft.
    start_degc: temperature at elapsed time 0 [degC].
    zero_degc: T0, where the errors are those of the scenario [degC].
    bias_nt_per_k: k [nT/K]; fluxgate 0.1-1, MEMS and AMR 5-50.
    scale_per_k: a [1/K]; AMR about 3e-3 open loop, fluxgate 1e-5 to 5e-5.
    """

    hot_degc: float = number(40.0, -200.0, 200.0, unit="degC", file_only=True)
    cold_degc: float = number(-10.0, -200.0, 200.0, unit="degC", file_only=True)
    time_constant_s: float = number(1200.0, 10.0, 1e6, unit="s", file_only=True)
    start_degc: float = special(_start_degc, unit="degC")
    zero_degc: float = number(20.0, -200.0, 200.0, unit="degC", file_only=True)
    bias_nt_per_k: Vector = vector(1e4, unit="nT/K")
    scale_per_k: Vector = vector(0.01, unit="1/K")

    def history_degc(self, lit: Floats, step_s: float) -> Floats:
        """Temperatures (n,) at steps of ``step_s`` from the lit fraction (n,), which is held over each step."""
        kept = math.exp(-step_s / self.time_constant_s)
        equilibrium = self.cold_degc + (self.hot_degc - self.cold_degc) * lit
        history = [self.start_degc]
        for target in equilibrium[:-1].tolist():
            history.append(target + (history[-1] - target) * kept)
        return np.array(history)


@dataclass(frozen=True)
class Panel:
    """A solar array's current, by light and Sun angle, and the field of its loop: d = c I.

    Parameters
    ----------
    normal_body: outward normal, unit.
    max_a: current at normal incidence [A].
    field_nt_per_a: c [nT/A]; 200 for 10 cm2 at 10 cm (mu0 A / 2 pi r^3), 1-5 on a clean platform.
    """

    normal_body: Vector = direction(name="normal")
    max_a: float = number(0.5, 0.0, 100.0, unit="A", file_only=True)
    field_nt_per_a: Vector = vector(1e5, unit="nT/A", file_only=True)

    def current_a(self, sun_body: Floats, lit: Floats) -> Floats:
        """Current (n,) [A] for Sun directions (n, 3) in the body and lit fractions (n,)."""
        return np.asarray(self.max_a * lit * np.maximum(0.0, sun_body @ np.array(self.normal_body)))


def _on_s(reading: Reading, name: str) -> float:
    """At most the whole period; half of it where it is not given."""
    period_s: float = reading.values["period_s"]
    return reading.table.real(name, period_s * _DRIVEN_SHARE, minimum=0.0, maximum=period_s)


def _check_decay(reading: Reading, name: str, decay_s: float) -> None:
    if decay_s > _LARGEST_DECAY * (reading.values["period_s"] - reading.values["on_s"]):
        reading.table.refuse(name, decay_s, "at most a fifth of the undriven part of a period is accepted")


@dataclass(frozen=True)
class Torquer:
    """Coils driven in a fixed pattern, their decay, and the magnetism that each command leaves behind.

    Each period starts with ``on_s`` of the dipole, its sign alternating from period to period where ``alternate``.
    d = M m(t) + remanence * (sign of the last command); m follows a command with the coil's time constant L/R.

    Parameters
    ----------
    dipole_am2: commanded dipole [A m^2]; 0.2 is usual for a 3U CubeSat.
    period_s, on_s: length of a period and of its driven part [s].
    field_nt_per_am2: M, row by row [nT/(A m^2)]; 1e5 at 10 cm on the coil's axis (mu0 / 2 pi r^3 is 2e5).
    decay_s: L/R [s], 0.001 to 0.1.
    remanence_nt: field after a positive command [nT], 10-500.
    alternate: whether every second period has the opposite sign.
    """

    dipole_am2: Vector = vector(100.0, unit="A m^2", file_only=True)
    period_s: float = number(60.0, 0.1, 1e5, unit="s", file_only=True)
    on_s: float = special(_on_s, unit="s")
    field_nt_per_am2: tuple[float, ...] = numbers(9, _IDENTITY, unit="nT/(A m^2)", file_only=True)
    decay_s: float = number(0.01, 1e-4, 10.0, unit="s", check=_check_decay)
    remanence_nt: Vector = vector(1e5, unit="nT")
    alternate: bool = flag(True)

    def _sign(self, period: Floats) -> Floats:
        sign = 1.0 - 2.0 * np.mod(period, 2.0) if self.alternate else np.ones_like(period)
        return np.where(period < 0.0, 0.0, sign)

    def commanded_am2(self, elapsed_s: Floats) -> Floats:
        """Dipole on command (n, 3) [A m^2]: what telemetry reports."""
        period = np.floor(elapsed_s / self.period_s)
        driven = (elapsed_s - period * self.period_s < self.on_s) * self._sign(period)
        return np.outer(driven, self.dipole_am2)

    def field_nt(self, elapsed_s: Floats) -> Floats:
        """Field at the sensor (n, 3) [nT]."""
        period = np.floor(elapsed_s / self.period_s)
        within = elapsed_s - period * self.period_s
        sign = self._sign(period)
        before = self._sign(period - 1.0)
        matrix = np.array(self.field_nt_per_am2).reshape(3, 3)
        # what is left of the last period's drive at the start of this one is below exp(-(period - on) / decay)
        left = before * math.exp(-(self.period_s - self.on_s) / self.decay_s)
        rising = sign + (left - sign) * np.exp(-within / self.decay_s)
        at_off = sign + (left - sign) * math.exp(-self.on_s / self.decay_s)
        falling = at_off * np.exp(-np.maximum(0.0, within - self.on_s) / self.decay_s)
        drive = np.where(within < self.on_s, rising, falling)
        return np.asarray(np.outer(drive, matrix @ np.array(self.dipole_am2)) + np.outer(sign, self.remanence_nt))


@dataclass(frozen=True)
class Step:
    """A lasting change of the nine errors at one time.

    Parameters
    ----------
    at_s: elapsed time [s].
    bias_nt: added to b [nT]; 10 to 5000 after a deployment or a relay.
    D: added to D11 D22 D33 D12 D13 D23 [-].
    """

    at_s: float = number(minimum=0.0, maximum=LONGEST_S, unit="s")
    bias_nt: Vector = vector(5e5, unit="nT")
    D: Six = six()


class Craft(Protocol):
    """What a disturbance may ask of the craft, at elapsed times (n,) [s]."""

    def temperature_degc(self, elapsed_s: Floats) -> Floats:
        """Sensor temperature (n,) [degC]."""
        ...

    def sun_body(self, elapsed_s: Floats) -> Floats:
        """Unit direction of the Sun in body axes (n, 3)."""
        ...

    def lit(self, elapsed_s: Floats) -> Floats:
        """Lit fraction (n,)."""
        ...
