"""A case from its seed: world, causes at a strength that can be found, telemetry, and the answer."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tests.regimes import telemetry
from tests.regimes.attitude import quaternions
from tests.regimes.causes import DRIVEN, EFFECTS, OUTSIDE, TOGETHER, Cause, possible
from tests.regimes.orbit import Floats
from tests.regimes.sensor import Change, Measured, detectability, measure
from tests.regimes.telemetry import Channel
from tests.regimes.world import REGIMES, World, draw_world, kept_rows

LEAST_DETECTABILITY = 12.0
_WANTED = (16.0, 120.0)
_ATTEMPTS = 40
_CLEAN, _OUTSIDE, _CONCEALED = 0.2, 0.12, 0.35
"""Shares: of cases with nothing wrong, with something in no catalogue; of driven effects, with the driver left out."""

FLAWS = ("none", "outliers", "fine lattice", "heavy tails")
"""What may be wrong with samples without being an effect."""


@dataclass(frozen=True, slots=True, eq=False)
class Case:
    """One case.

    Parameters
    ----------
    samples: (n, 3) what the sensor reads [nT], (n, 3) ``reference`` as recorded, at all tags of the world's grid.
    changed, twin: the same without noise, with and without what is wrong; their difference is what can be found.
    reference_form: ``eci``, ``ecef``, ``igrf`` (left to the reader), ``magnitude`` or ``room``.
    channels: as recorded.
    states_noise: whether the descriptor states the noise.
    answer: what is true.
    """

    world: World
    samples: Floats
    reference: Floats
    changed: Measured
    twin: Measured
    reference_form: str
    channels: tuple[Channel, ...]
    states_noise: bool
    answer: dict[str, Any]


@dataclass(frozen=True, slots=True, eq=False)
class _Acting:
    """A cause at its scale, with the detectability that this gives it alone."""

    cause: Cause
    scale: float
    detectability: float

    @property
    def change(self) -> Change:
        return self.cause.change(self.scale)


def draw_case(seed: int, index: int, *, clean: bool = False) -> Case:
    """Case ``index`` of a seed; with ``clean`` nothing is wrong in it.

    Raises ``RuntimeError`` where no world of the regime lets anything be found, which no seed has shown.
    """
    regime = list(REGIMES)[index % len(REGIMES)]
    plan = np.random.default_rng([seed, index])
    kind = "clean" if clean else _kind(plan, regime)
    concealed = bool(plan.uniform() < _CONCEALED)
    for attempt in range(_ATTEMPTS):
        rng = np.random.default_rng([seed, index, attempt])
        world = draw_world(regime, rng)
        names = _names(kind, world, rng)
        noise = _noise(world, rng, heavy=False)
        acting = [_tuned(world, name, rng, noise) for name in names]
        if all(one.detectability >= LEAST_DETECTABILITY for one in acting):
            return _case(world, kind, names, acting, noise, rng, concealed=concealed)
    raise RuntimeError(f"no case of the regime {regime} can be found")


def _kind(plan: np.random.Generator, regime: str) -> str:
    chance = plan.uniform()
    if chance < _CLEAN:
        return "clean"
    if chance < _CLEAN + _OUTSIDE:
        return "outside"
    return "several" if REGIMES[regime].effects > 1 else "effect"


def _names(kind: str, world: World, rng: np.random.Generator) -> list[str]:
    if kind == "clean":
        return []
    if kind == "outside":
        return [str(rng.choice(list(OUTSIDE)))]
    pool = [name for name in (TOGETHER if kind == "several" else EFFECTS) if possible(name, world)]
    return [str(name) for name in rng.choice(pool, world.regime.effects, replace=False)]


def _noise(world: World, rng: np.random.Generator, *, heavy: bool) -> Floats:
    """(n, 3) [nT] of the world's sigma; with heavy tails Student's t of five degrees of freedom."""
    if heavy:
        return world.noise_nt * math.sqrt(3.0 / 5.0) * rng.standard_t(5.0, (len(world.t), 3))
    return world.noise_nt * rng.standard_normal((len(world.t), 3))


def _tuned(world: World, name: str, rng: np.random.Generator, noise: Floats) -> _Acting:
    """The cause of that name, as strong as a detectability drawn evenly in its logarithm asks, within its limits."""
    cause = {**EFFECTS, **OUTSIDE}[name](world, rng)
    wanted = float(np.exp(rng.uniform(*np.log(_WANTED))))
    least, most = cause.limits
    scale, found = math.sqrt(least * most), 0.0
    for _ in range(6):
        found = _alone(world, cause.change(scale), noise)
        if abs(math.log(wanted / max(found, 1e-9))) < 0.05:
            break
        better = float(np.clip(scale * wanted / max(found, 1e-9), least, most))
        better = float(np.clip(better, scale / 30.0, scale * 30.0))
        if better == scale:
            break
        scale = better
    return _Acting(cause, scale, _alone(world, cause.change(scale), noise))


def _alone(world: World, change: Change, noise: Floats) -> float:
    """Detectability of one change; rounding acts on samples with their noise, everything else is compared without."""
    beside = noise if change.lsb_nt else 0.0
    return detectability(world, measure(world, (change,), beside), measure(world, (), beside))


def _case(
    world: World,
    kind: str,
    names: Sequence[str],
    acting: list[_Acting],
    noise: Floats,
    rng: np.random.Generator,
    *,
    concealed: bool,
) -> Case:
    concealed = concealed and any(name in DRIVEN for name in names) and world.name not in ("decoys", "three_effects")
    changes = tuple(one.change for one in acting)
    rounded = any(change.lsb_nt for change in changes)
    flaw = str(rng.choice(FLAWS[1:])) if kind == "clean" and rng.uniform() < 0.75 else "none"
    if flaw == "heavy tails":
        noise = _noise(world, rng, heavy=True)
    measured = measure(world, changes, noise)
    samples = _flawed(world, measured.samples, flaw, rng)
    beside = noise if rounded else 0.0
    changed, twin = measure(world, changes, beside), measure(world, (), beside)
    form = _reference_form(world, rng, has_offset=any(change.offset_s for change in changes))
    channels = _channels(world, acting, rng, concealed=concealed)
    answer = _answer(world, kind, acting, channels, concealed=concealed)
    answer |= {"flaw": flaw, "reference_form": form}
    return Case(world, samples, measured.reference, changed, twin, form, channels, bool(rng.uniform() < 0.5), answer)


def _flawed(world: World, samples: Floats, flaw: str, rng: np.random.Generator) -> Floats:
    if flaw == "outliers":
        struck = rng.uniform(size=len(samples)) < rng.uniform(0.001, 0.006)
        size = world.noise_nt * rng.uniform(15.0, 60.0, (len(samples), 3)) * rng.choice([-1.0, 1.0], (len(samples), 3))
        return samples + struck[:, None] * size
    if flaw == "fine lattice":
        lsb = world.noise_nt * rng.uniform(0.05, 0.25)
        return lsb * np.round(samples / lsb)
    return samples


def _reference_form(world: World, rng: np.random.Generator, *, has_offset: bool) -> str:
    if world.regime.on_ground:
        return "room"
    if has_offset or world.regime.has_attitude:
        return str(rng.choice(["eci", "ecef"]))
    return str(rng.choice(["eci", "ecef", "igrf", "magnitude"], p=[0.45, 0.2, 0.2, 0.15]))


def _channels(world: World, acting: list[_Acting], rng: np.random.Generator, *, concealed: bool) -> tuple[Channel, ...]:
    """What is recorded beside the samples, in an order that tells nothing; a driver left out takes its kind with it."""
    house, step = world.house, world.regime.period_s
    wanted = {driver for one in acting for driver in one.cause.driver}
    hidden = wanted if concealed else set()
    found = [
        Channel("temperature", telemetry.thermometer(rng, house.temperature, step)[:, None], "degC", 3),
        Channel("bus_current", telemetry.ammeter(rng, house.load_a[:, None]), "A", 5),
    ]
    if not world.regime.on_ground and (rng.uniform() < 0.4 or "panel_current" in wanted):
        found.append(Channel("panel_current", telemetry.ammeter(rng, house.panels_a), "A", 5))
    if rng.uniform() < 0.3 or "torquer" in wanted:
        found.append(Channel("torquer", house.moment_am2, "A m2", 5))
    kinds = {"temperature": "degC", "bus_current": "A", "panel_current": "A", "torquer": "A m2"}
    left_out = {kinds[name] for name in hidden}
    found += telemetry.decoys(rng, world.regime.decoys, world.t, world.light, house)
    found = [channel for channel in found if channel.unit not in left_out]
    if world.regime.has_gaps:
        found = [_with_lost_cells(channel, rng) for channel in found]
    if world.regime.has_attitude:
        found.append(_attitude(world, rng))
    return tuple(found[row] for row in rng.permutation(len(found)))


def _with_lost_cells(channel: Channel, rng: np.random.Generator) -> Channel:
    values = np.array(channel.values)
    values[rng.uniform(size=len(values)) < 0.01] = np.nan
    return Channel(channel.name, values, channel.unit, channel.decimals)


def _attitude(world: World, rng: np.random.Generator) -> Channel:
    """Quaternions as a star tracker or an encoder gives them, with noise of a fiftieth of a degree."""
    q = quaternions(world.body) + 0.5 * math.radians(0.02) * rng.standard_normal((len(world.t), 4))
    return Channel("attitude", q / np.linalg.norm(q, axis=1)[:, None], "", 8)


def _answer(
    world: World, kind: str, acting: list[_Acting], channels: tuple[Channel, ...], *, concealed: bool
) -> dict[str, Any]:
    recorded = {channel.name for channel in channels}
    effects = [
        {
            "effect": one.cause.effect,
            "parameters": one.cause.parameters(one.scale),
            "driver": list(one.cause.driver),
            "driver_concealed": bool(set(one.cause.driver) - recorded),
            "is_inferable": one.cause.is_inferable,
            "detectability": one.detectability,
        }
        for one in acting
    ]
    answer: dict[str, Any] = {
        "regime": world.name,
        "kind": kind,
        "effects": effects,
        "driver_concealed": concealed,
        "detectability": min((one.detectability for one in acting), default=0.0),
        "also": _also(world),
        "noise_nt": world.noise_nt,
        "bias_nt": world.bias_nt.tolist(),
        "D": world.scale.tolist(),
        "motion": world.motion_name,
        "rows": int(world.kept.sum()),
        "model_parts_nt": world.model_parts_nt,
        "model_detectability": 0.0,
    }
    if world.model_parts_nt:
        right = measure(world, ())
        answer["model_detectability"] = detectability(world, right, Measured(right.samples, world.true_field))
    return answer


def _also(world: World) -> list[str]:
    """Names that are true beside what was put in: a free body nutates, and a storm that the model lacks is external."""
    names = ["nutation", "spin_rate"] if world.motion_name == "tumbling" else []
    return [*names, "external_field"] if world.model_parts_nt else names


def rows(case: Case, values: Floats) -> Floats:
    """The rows of values (n, ...) that the case records."""
    return kept_rows(case.world, values)
