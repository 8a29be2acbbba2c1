"""What goes on aboard and what is recorded of it: heat, currents, torquers, and channels beside the point."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tests.regimes.orbit import Floats

THERMOMETER_K = 0.3
"""Noise of every thermometer, 1 sigma [K]."""


@dataclass(frozen=True, slots=True, eq=False)
class Channel:
    """A column or several (n, k) as recorded, with unit and number of decimals."""

    name: str
    values: Floats
    unit: str
    decimals: int = 4


@dataclass(frozen=True, slots=True, eq=False)
class House:
    """What happens on board, free of the noise of telemetry.

    Parameters
    ----------
    temperature: (n,) of the magnetometer [degC].
    load_a: (n,) current on the bus [A].
    panels_a: (n, 4) currents of the panels +x, +y, -x, -y [A]; all zero on the ground.
    moment_am2: (n, 3) dipoles of the torquers [A m2].
    is_duty_regular: whether the torquers follow a duty or the field, so that it could be guessed.
    """

    temperature: Floats
    load_a: Floats
    panels_a: Floats
    moment_am2: Floats
    is_duty_regular: bool


def lagged(drive: Floats, tau_s: float, step_s: float, start: float | None = None) -> Floats:
    """Answer (n,) of a first-order lag to a drive (n,) that is held over each step."""
    kept = math.exp(-step_s / tau_s)
    level = float(drive[0]) if start is None else start
    found = []
    for value in drive.tolist():
        level = kept * level + (1.0 - kept) * value
        found.append(level)
    return np.array(found)


def heat(rng: np.random.Generator, light: Floats, step_s: float) -> Floats:
    """Temperature (n,) [degC]: light heats a panel, the panel the sensor's board; the start is anywhere between."""
    hot, cold = rng.uniform(12.0, 45.0), rng.uniform(-30.0, 2.0)
    skin = lagged(cold + (hot - cold) * light, rng.uniform(60.0, 300.0), step_s)
    return lagged(skin, rng.uniform(400.0, 2000.0), step_s, rng.uniform(cold, hot))


def room(rng: np.random.Generator, t: Floats) -> Floats:
    """Temperature (n,) [degC] of a chamber that is heated from a random moment on and swings a little."""
    begin, tau = rng.uniform(0.1, 0.4) * t[-1], rng.uniform(300.0, 1200.0)
    rise = rng.uniform(8.0, 25.0) * -np.expm1(-np.maximum(t - begin, 0.0) / tau)
    return 20.0 + rise + rng.uniform(0.5, 2.0) * np.sin(math.tau * t / rng.uniform(400.0, 1500.0))


def telegraph(rng: np.random.Generator, t: Floats, on_s: float, off_s: float) -> Floats:
    """1 and 0 (n,) by turns, each for an exponential time of the given mean."""
    at, state, edges, states = 0.0, int(rng.integers(0, 2)), [-1.0], []
    while at <= t[-1]:
        states.append(state)
        at += float(rng.exponential(on_s if state else off_s)) + 2.0
        edges.append(at)
        state = 1 - state
    return np.array(states, dtype=np.float64)[
        np.searchsorted(np.array(edges[1:]), t, side="right").clip(0, len(states) - 1)
    ]


def loads(rng: np.random.Generator, t: Floats) -> Floats:
    """Current on the bus (n,) [A]: a base, a payload that is switched, a transmitter now and then."""
    span = float(t[-1])
    payload = rng.uniform(0.2, 0.8) * telegraph(rng, t, span / 25.0, span / 18.0)
    radio = rng.uniform(0.1, 0.5) * telegraph(rng, t, span / 60.0, span / 8.0)
    return rng.uniform(0.1, 0.4) + payload + radio


def torquing(rng: np.random.Generator, t: Floats, field_body: Floats, pattern: str) -> Floats:
    """Dipoles (n, 3) [A m2]: ``regular`` one on a duty, ``bdot`` against dB/dt, ``steps`` anything for a while."""
    period = float(rng.choice([20.0, 60.0, 90.0, 150.0, 240.0]))
    on = np.mod(t / period + rng.uniform(), 1.0) < rng.uniform(0.25, 0.6)
    if pattern == "regular":
        moment = np.broadcast_to(rng.choice([-0.2, 0.2], 3) * rng.uniform(0.3, 1.0, 3), field_body.shape)
    elif pattern == "bdot":
        moment = -0.2 * np.sign(np.gradient(field_body, t, axis=0))
    else:
        block = (t / period).astype(np.intp)
        moment = rng.choice([-0.2, -0.1, 0.0, 0.1, 0.2], (int(block[-1]) + 1, 3))[block]
    return moment * on[:, None]


def thermometer(rng: np.random.Generator, temperature: Floats, step_s: float) -> Floats:
    """What a thermometer near the sensor shows (n,) [degC]: a little late, with noise."""
    return lagged(temperature, rng.uniform(5.0, 40.0), step_s) + THERMOMETER_K * rng.standard_normal(len(temperature))


def ammeter(rng: np.random.Generator, current: Floats) -> Floats:
    """What is recorded of currents (n, k) [A]: noise of one to three per cent of the largest."""
    size = max(float(np.abs(current).max()), 0.05)
    return current + size * rng.uniform(0.01, 0.03) * rng.standard_normal(current.shape)


def decoys(rng: np.random.Generator, count: int, t: Floats, light: Floats, house: House) -> list[Channel]:
    """Channels (count) that drive nothing and go along with those that may: other boards' heat, other rails."""
    step = float(np.median(np.diff(t)))
    found = []
    for index in range(count):
        kind = index % 4
        if kind == 0:
            values = 0.6 * house.temperature + 0.4 * heat(rng, light, step) + rng.uniform(-5.0, 5.0)
            values = values + THERMOMETER_K * rng.standard_normal(len(t))
            found.append(Channel(f"temp_{index}", values[:, None], "degC", 2))
        elif kind == 1:
            values = 0.3 * house.load_a + rng.uniform(0.0, 0.5) * light + 0.2 * telegraph(rng, t, 300.0, 500.0)
            found.append(Channel(f"rail_{index}", ammeter(rng, values[:, None]), "A"))
        elif kind == 2:
            charge = lagged(light - 0.6 * house.load_a, rng.uniform(1500.0, 5000.0), step)
            found.append(
                Channel(f"voltage_{index}", (7.6 + 0.5 * charge + 0.01 * rng.standard_normal(len(t)))[:, None], "V")
            )
        else:
            values = heat(rng, light, step) + THERMOMETER_K * rng.standard_normal(len(t))
            found.append(Channel(f"panel_temp_{index}", values[:, None], "degC", 2))
    return found
