"""What can be wrong: effects of the catalogue by the names it gives them, and disturbances that it has no name for.

A cause is made for one world.  Its ``change`` at a scale is what it does to the samples; its ``parameters`` at that
scale are the truth, in the product's names and units.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from tests.regimes.orbit import Floats
from tests.regimes.sensor import SUBSTEPS, Change, between_samples
from tests.regimes.world import World

_FULL_NT = 30000.0


@dataclass(frozen=True, slots=True, eq=False)
class Cause:
    """One thing that is wrong.

    Parameters
    ----------
    effect: its name in the catalogue, or, of what has none, a name of this package.
    change, parameters: by scale.
    limits: least and largest scale that are plausible.
    driver: recorded channels that it follows; empty where it needs none.
    is_inferable: whether the driver could be worked out from the rest, were it left out.
    """

    effect: str
    change: Callable[[float], Change]
    parameters: Callable[[float], dict[str, Any]]
    limits: tuple[float, float]
    driver: tuple[str, ...] = ()
    is_inferable: bool = True


Builder = Callable[[World, np.random.Generator], Cause]


def _direction(rng: np.random.Generator) -> Floats:
    value = rng.standard_normal(3)
    return value / np.linalg.norm(value)


def _limits(world: World, per_nt: float = 1.0) -> tuple[float, float]:
    """From a fiftieth of the noise to 20 times it, at most 2000 nT."""
    return 0.02 * world.noise_nt * per_nt, min(20.0 * world.noise_nt, 2000.0) * per_nt


def _unit_rms(shape: Floats) -> Floats:
    """The shape (n, 3) with the length of an rms of 1."""
    return shape / math.sqrt(float(np.mean((shape**2).sum(axis=1))))


def _follows(
    world: World, effect: str, signal: Floats, matrix: Floats, name: str, driver: str, *, inferable: bool
) -> Cause:
    """d = matrix signal: signals (n, k), a matrix (k, 3); ``name`` of the matrix per unit of the signal."""
    shape = signal @ matrix
    per = 1.0 / math.sqrt(float(np.mean((shape**2).sum(axis=1))))
    squeezed = matrix[0] if len(matrix) == 1 else matrix
    return Cause(
        effect,
        lambda s: Change(added=s * per * shape),
        lambda s: {name: (s * per * squeezed).tolist()},
        _limits(world),
        (driver,),
        inferable,
    )


def thermal_bias(world: World, rng: np.random.Generator) -> Cause:
    """A bias of so many nT per kelvin."""
    course = world.house.temperature - world.house.temperature.mean()
    made = _follows(
        world,
        "thermal_bias",
        course[:, None],
        _direction(rng)[None],
        "nt_per_k",
        "temperature",
        inferable=world.has_eclipses,
    )
    zero = float(world.house.temperature.mean())
    return Cause(
        made.effect,
        made.change,
        lambda s: made.parameters(s) | {"zero_degc": zero},
        made.limits,
        made.driver,
        made.is_inferable,
    )


def thermal_scale(world: World, rng: np.random.Generator) -> Cause:
    """A gain D(T) = D + diag(a) (T - T0)."""
    zero = float(world.house.temperature.mean())
    course = world.house.temperature - zero
    per_axis = rng.uniform(0.4, 1.0, 3) * (
        rng.choice([-1.0, 1.0]) if rng.uniform() < 0.5 else rng.choice([-1.0, 1.0], 3)
    )
    unit = per_axis / (float(np.std(course)) * _FULL_NT)
    return Cause(
        "thermal_scale",
        lambda s: Change(gain=s * course[:, None] * unit),
        lambda s: {"per_k": (s * unit).tolist(), "zero_degc": zero},
        _limits(world),
        ("temperature",),
        world.has_eclipses,
    )


def current_loop(world: World, rng: np.random.Generator) -> Cause:
    """The loop that the bus current makes."""
    return _follows(
        world,
        "current_loop",
        world.house.load_a[:, None],
        _direction(rng)[None],
        "nt_per_a",
        "bus_current",
        inferable=False,
    )


def panel_current(world: World, rng: np.random.Generator) -> Cause:
    """Loops of four panels, each with a direction of its own, in sunlight."""
    return _follows(
        world,
        "current_loop",
        world.house.panels_a,
        rng.standard_normal((4, 3)),
        "nt_per_a",
        "panel_current",
        inferable=world.motion_name != "tumbling" or world.regime.has_attitude,
    )


def torquer(world: World, rng: np.random.Generator) -> Cause:
    """Coils near the sensor: d = M m."""
    signal, matrix = world.house.moment_am2, rng.standard_normal((3, 3))
    made = _follows(world, "torquer", signal, matrix.T, "nt_per_am2", "torquer", inferable=world.house.is_duty_regular)

    def parameters(scale: float) -> dict[str, Any]:
        by_coil = np.array(made.parameters(scale)["nt_per_am2"])
        return {"nt_per_am2": by_coil.T.tolist()}

    return Cause(made.effect, made.change, parameters, made.limits, made.driver, made.is_inferable)


def time_offset(world: World, rng: np.random.Generator) -> Cause:
    """A clock of the reference that is off by a constant."""
    sign = float(rng.choice([-1.0, 1.0]))
    return Cause("time_offset", lambda s: Change(offset_s=s * sign), lambda s: {"offset_s": s * sign}, (0.02, 40.0))


def bias_step(world: World, rng: np.random.Generator) -> Cause:
    """The bias changes once."""
    at, way = rng.uniform(0.15, 0.85) * float(world.t[-1]), _direction(rng)
    after = (world.t >= at).astype(np.float64)
    return Cause(
        "bias_step",
        lambda s: Change(added=s * after[:, None] * way),
        lambda s: {"step_nt": (s * way).tolist(), "at_s": at},
        _limits(world),
    )


def bias_drift(world: World, rng: np.random.Generator) -> Cause:
    """The bias grows steadily, or relaxes towards an end."""
    way, span = _direction(rng), float(world.t[-1])
    if rng.uniform() < 0.6:
        return Cause(
            "bias_drift",
            lambda s: Change(added=s * np.outer(world.t / span, way)),
            lambda s: {"nt_per_s": (s * way / span).tolist()},
            _limits(world),
        )
    tau = rng.uniform(0.1, 0.4) * span
    course = -np.expm1(-world.t / tau)
    return Cause(
        "bias_drift",
        lambda s: Change(added=s * np.outer(course, way)),
        lambda s: {"nt_end": (s * way).tolist(), "time_constant_s": tau},
        _limits(world),
    )


def hysteresis(world: World, rng: np.random.Generator) -> Cause:
    """Rods along the body's axes that remember what they pass between the samples, too."""
    width, bend = rng.uniform(4000.0, 15000.0), rng.uniform(0.5, 1.5)
    share = rng.uniform(0.3, 1.0, 3)
    along = between_samples(world)[SUBSTEPS - 1 :]  # from the first sample on
    shape = np.stack([bouc_wen(along[:, axis], width, bend)[::SUBSTEPS] for axis in range(3)], axis=1)
    shape = _unit_rms(shape * share)
    return Cause(
        "hysteresis", lambda s: Change(added=s * shape), lambda s: {"rms_nt": s, "width_nt": width}, _limits(world)
    )


def bouc_wen(along: Floats, width: float, bend: float) -> Floats:
    """z' = (h' - b |h'| z) / w (n,) from rest, for h along a rod (n,) [nT]; exact while h goes one way in each step."""
    state, before, found = 0.0, float(along[0]), []
    for now in along.tolist():
        step = (now - before) / width
        end = math.copysign(1.0 / bend, step)
        state = end + (state - end) * math.exp(-bend * abs(step))
        before = now
        found.append(state)
    return np.array(found)


def cubic_response(world: World, rng: np.random.Generator) -> Cause:
    """d_i = c_i B_i^3, with B the samples as they would be without it."""
    clean = np.linalg.solve(np.eye(3) + world.scale, (world.field_body + world.bias_nt).T).T
    each = rng.uniform(0.3, 1.0, 3) * rng.choice([-1.0, 1.0], 3)
    shape = each * clean**3
    per = 1.0 / math.sqrt(float(np.mean((shape**2).sum(axis=1))))
    return Cause(
        "cubic_response",
        lambda s: Change(added=s * per * shape),
        lambda s: {"per_nt2": (s * per * each).tolist()},
        _limits(world),
    )


def quantisation(world: World, rng: np.random.Generator) -> Cause:
    """A coarse converter."""
    return Cause(
        "quantisation",
        lambda s: Change(lsb_nt=s),
        lambda s: {"lsb_nt": s},
        (0.5 * world.noise_nt, 4.0 * world.noise_nt),
    )


def response_lag(world: World, rng: np.random.Generator) -> Cause:
    """A sensor that answers late; where the turn is steady the nine errors take it up, and no such case is drawn."""
    return Cause("response_lag", lambda s: Change(lag_s=s), lambda s: {"tau_s": s}, (0.02, 6.0))


def field_product(world: World, rng: np.random.Generator) -> Cause:
    """Outside: a field in a fixed direction that grows with the product of two components."""
    a, b = rng.choice(3, 2, replace=False)
    return _outside(
        world, "field_product", (world.field_body[:, a] * world.field_body[:, b])[:, None] * _direction(rng)
    )


def staircase(world: World, rng: np.random.Generator) -> Cause:
    """Outside: five levels of unequal length, over and over with an odd period, in directions that differ."""
    period = float(rng.choice([137.0, 311.0, 523.0, 947.0, 1301.0])) * min(1.0, float(world.t[-1]) / 6000.0)
    edges = np.sort(rng.uniform(0.05, 0.95, 4))
    levels = rng.standard_normal((5, 3))
    phase = np.mod(world.t / period + rng.uniform(), 1.0)
    return _outside(world, "staircase", levels[np.searchsorted(edges, phase)])


def rectified_rate(world: World, rng: np.random.Generator) -> Cause:
    """Outside: a field in a fixed direction as large as the change of two components, whatever its sign."""
    slope = np.abs(np.gradient(world.field_body, world.t, axis=0))
    a, b = rng.choice(3, 2, replace=False)
    return _outside(world, "rectified_rate", (slope[:, a] - 0.5 * slope[:, b])[:, None] * _direction(rng))


def bursts(world: World, rng: np.random.Generator) -> Cause:
    """Outside: bursts that swell and fade at irregular times, each with a direction of its own."""
    span = float(world.t[-1])
    shape = np.zeros((len(world.t), 3))
    for _ in range(int(rng.integers(6, 14))):
        middle, width = rng.uniform(0.0, span), span * rng.uniform(0.005, 0.03)
        shape += np.exp(-(((world.t - middle) / width) ** 2))[:, None] * rng.standard_normal(3)
    return _outside(world, "bursts", shape)


def _outside(world: World, name: str, shape: Floats) -> Cause:
    unit = _unit_rms(shape)
    return Cause(name, lambda s: Change(added=s * unit), lambda s: {"rms_nt": s}, _limits(world))


EFFECTS: dict[str, Builder] = {
    "thermal_bias": thermal_bias,
    "thermal_scale": thermal_scale,
    "current_loop": current_loop,
    "panel_current": panel_current,
    "torquer": torquer,
    "time_offset": time_offset,
    "bias_step": bias_step,
    "bias_drift": bias_drift,
    "hysteresis": hysteresis,
    "cubic_response": cubic_response,
    "quantisation": quantisation,
    "response_lag": response_lag,
}
"""What the catalogue has a name for; ``panel_current`` is its ``current_loop``, too."""

OUTSIDE: dict[str, Builder] = {
    "field_product": field_product,
    "staircase": staircase,
    "rectified_rate": rectified_rate,
    "bursts": bursts,
}
"""What is in no catalogue."""

DRIVEN = frozenset({"thermal_bias", "thermal_scale", "current_loop", "panel_current", "torquer"})
"""Effects with a driver that can be recorded or left out."""

TOGETHER = ("thermal_bias", "current_loop", "torquer", "time_offset", "bias_step", "bias_drift", "cubic_response")
"""Effects of which three may act at once."""

STEADY = frozenset({"fast", "slow", "turning", "inertial"})
"""Motions whose rate is steady, where a lag cannot be seen."""


def possible(effect: str, world: World) -> bool:
    """Whether a world has what an effect needs."""
    if world.regime.on_ground:
        return effect not in ("time_offset", "panel_current")
    if effect == "response_lag":
        return world.motion_name not in STEADY
    if effect in ("panel_current", "thermal_bias", "thermal_scale"):
        return world.has_eclipses
    return True
