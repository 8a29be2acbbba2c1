"""The regimes: how a craft turns, how often and how well it is sampled, and what is recorded with it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tests.regimes import attitude
from tests.regimes.attitude import Motion
from tests.regimes.field import along_track, model_error
from tests.regimes.orbit import Floats, Orbit, draw_orbit, sun_direction, sunlight
from tests.regimes.telemetry import House, heat, loads, room, torquing

_2021, _2026 = 1_609_459_200, 1_798_761_600
_HOUR = 3600.0


@dataclass(frozen=True, slots=True)
class Regime:
    """What distinguishes a regime.

    Parameters
    ----------
    motions: names of the motions that are drawn from.
    seconds: shortest and longest recording [s].
    period_s: from sample to sample.
    noise_nt: values of the noise, 1 sigma per axis, that are drawn from.
    on_ground: on a turntable, with the magnitude of the field alone.
    """

    motions: tuple[str, ...]
    seconds: tuple[float, float] = (2.0 * _HOUR, 4.5 * _HOUR)
    period_s: float = 1.0
    noise_nt: tuple[float, ...] = (50.0, 100.0, 200.0, 300.0)
    has_gaps: bool = False
    has_attitude: bool = False
    on_ground: bool = False
    effects: int = 1
    decoys: int = 2
    model_is_off: bool = False


_ANY = ("fast", "slow", "turning", "tumbling", "nadir")
_LIVELY = ("fast", "slow", "tumbling")

REGIMES: dict[str, Regime] = {
    "spin_fast": Regime(("fast",)),
    "spin_slow": Regime(("slow",)),
    "nadir": Regime(("nadir",), (4.0 * _HOUR, 6.0 * _HOUR)),
    "inertial": Regime(("inertial",), (4.0 * _HOUR, 6.0 * _HOUR)),
    "slow_turning": Regime(("turning",)),
    "tumbling": Regime(("tumbling",)),
    "short": Regime(_LIVELY, (1200.0, 2400.0), noise_nt=(50.0, 100.0)),
    "gaps": Regime(_ANY, (3.0 * _HOUR, 5.0 * _HOUR), has_gaps=True),
    "ten_hertz": Regime(("fast", "tumbling"), (900.0, 900.0), 0.1, (50.0, 100.0)),
    "turntable": Regime(("turntable",), (1800.0, 3600.0), has_attitude=True, on_ground=True, decoys=1),
    "fluxgate": Regime(_LIVELY, noise_nt=(5.0,)),
    "noisy": Regime(_LIVELY, (4.0 * _HOUR, 6.0 * _HOUR), noise_nt=(1000.0,)),
    "attitude": Regime((*_ANY, "inertial"), has_attitude=True),
    "three_effects": Regime(_LIVELY, (4.0 * _HOUR, 5.0 * _HOUR), effects=3),
    "decoys": Regime(_LIVELY, decoys=20),
    "model_off": Regime(_ANY, noise_nt=(5.0, 20.0, 50.0, 100.0), model_is_off=True),
}
"""Every regime by name; cases go through them in turn."""


@dataclass(frozen=True, slots=True, eq=False)
class World:
    """A craft, or a turntable, before anything is wrong with its magnetometer.

    Parameters
    ----------
    t: (n,) tags [s] on an even grid; ``kept`` (n,) marks those that were recorded.
    orbit, position_km: None on the ground; (n, 3) ECI [km].
    true_field: (n, 3) [nT], ECI, on the ground in the room's axes; ``reference`` what the model says.
    body: (n, 3, 3) to body axes.
    field_body: (n, 3) true field there [nT].
    light: (n,) share of the Sun's light; ``sun_body`` (n, 3) its direction.
    motion, motion_name: the turn, and which of the regime's it is.
    spin: axis (3,) and rate [rpm] that the descriptor states, or None.
    model_parts_nt: rms of what the model leaves, by cause; empty where it is right.
    bias_nt, scale: b (3,) and D (3, 3); B = (I + D)^-1 (A H + b + d + eps).
    """

    regime: Regime
    name: str
    start_unix_s: float
    t: Floats
    kept: NDArray[np.bool_]
    orbit: Orbit | None
    position_km: Floats | None
    true_field: Floats
    reference: Floats
    body: Floats
    field_body: Floats
    light: Floats
    sun_body: Floats
    motion: Motion
    motion_name: str
    spin: tuple[Floats, float] | None
    house: House
    bias_nt: Floats
    scale: Floats
    noise_nt: float
    model_parts_nt: dict[str, float] = field(default_factory=dict)

    @property
    def has_eclipses(self) -> bool:
        """Whether light and shadow both fill a tenth of the recording or more."""
        return 0.1 < float(self.light.mean()) < 0.9

    def late_reference(self, offset_s: float) -> Floats:
        """The reference (n, 3) of a clock that lags: its value at tag t + ``offset_s`` belongs to the sample at t."""
        assert self.orbit is not None
        t = self.t - offset_s
        return along_track(t, self.orbit.position_km(t), self.start_unix_s)


def draw_world(name: str, rng: np.random.Generator) -> World:
    """A world of the regime of that name."""
    regime = REGIMES[name]
    seconds = rng.uniform(*regime.seconds)
    t = np.arange(round(seconds / regime.period_s)) * regime.period_s
    start = float(rng.integers(_2021, _2026))
    kept = np.ones(len(t), dtype=bool)
    if regime.has_gaps:
        kept = _with_gaps(rng, t)
    noise = float(rng.choice(regime.noise_nt))
    scale = np.diag(rng.uniform(-0.08, 0.08, 3))
    for a, b in ((0, 1), (0, 2), (1, 2)):
        scale[a, b] = scale[b, a] = rng.uniform(-0.04, 0.04)
    bias = rng.uniform(-6000.0, 6000.0, 3)
    make: Callable[..., World] = _ground if regime.on_ground else _flight
    return make(regime, name, rng, t, start, kept=kept, noise_nt=noise, scale=scale, bias_nt=bias)


def _with_gaps(rng: np.random.Generator, t: Floats) -> NDArray[np.bool_]:
    kept = rng.uniform(size=len(t)) > rng.uniform(0.0, 0.03)
    for _ in range(int(rng.integers(2, 6))):
        begin, length = rng.uniform(0.05, 0.95) * t[-1], rng.uniform(120.0, 1500.0)
        kept &= (t < begin) | (t > begin + length)
    kept[0] = True
    return kept


def _motion(
    name: str, rng: np.random.Generator, seconds: float, orbit: Orbit | None
) -> tuple[Motion, tuple[Floats, float] | None]:
    """The motion of that name, and the spin that the descriptor states."""
    if name in ("fast", "slow", "turning"):
        limits = {"fast": (9.0, 24.0), "slow": (0.6, 3.0), "turning": (0.06, 0.35)}[name]
        rate = float(np.exp(rng.uniform(*np.log(limits)))) * float(rng.choice([-1.0, 1.0]))
        axis = np.eye(3)[int(rng.integers(0, 3))]
        return attitude.spinning(rng, rate, axis), (axis, rate) if name != "turning" else None
    if name == "nadir":
        assert orbit is not None
        return attitude.nadir_pointing(rng, orbit), None
    if name == "inertial":
        return attitude.inertial(rng), None
    if name == "turntable":
        return attitude.turntable(rng), None
    return attitude.tumbling(rng, seconds, rng.uniform(0.4, 5.0)), None


def _flight(regime: Regime, name: str, rng: np.random.Generator, t: Floats, start: float, **sensor: object) -> World:
    orbit, light, position = draw_orbit(rng), np.ones(1), np.zeros((1, 3))
    sun = sun_direction(start)
    for _ in range(20):  # mostly orbits with an eclipse, where one fits in
        orbit = draw_orbit(rng)
        position = orbit.position_km(t)
        light = sunlight(position, sun)
        if 0.2 < float(light.mean()) < 0.9:
            break
    reference = along_track(t, position, start)
    extra, parts = (model_error(rng, t, position, start)) if regime.model_is_off else (np.zeros_like(reference), {})
    motion_name = str(rng.choice(regime.motions))
    motion, spin = _motion(motion_name, rng, float(t[-1]), orbit)
    body = motion(t)
    field_body = np.einsum("nij,nj->ni", body, reference + extra)
    sun_body = body @ sun
    panels = 0.5 * light[:, None] * np.maximum(np.c_[sun_body[:, :2], -sun_body[:, :2]], 0.0)
    pattern = str(rng.choice(["regular", "bdot", "steps"]))
    house = House(
        heat(rng, light, regime.period_s),
        loads(rng, t),
        panels,
        torquing(rng, t, field_body, pattern),
        is_duty_regular=pattern != "steps",
    )
    return World(
        regime,
        name,
        start,
        t,
        orbit=orbit,
        position_km=position,
        true_field=reference + extra,
        reference=reference,
        body=body,
        field_body=field_body,
        light=light,
        sun_body=sun_body,
        motion=motion,
        motion_name=motion_name,
        spin=spin,
        house=house,
        model_parts_nt=parts,
        **sensor,  # type: ignore[arg-type]
    )


def _ground(regime: Regime, name: str, rng: np.random.Generator, t: Floats, start: float, **sensor: object) -> World:
    motion, _ = _motion("turntable", rng, float(t[-1]), None)
    level, dip, way = rng.uniform(35000.0, 55000.0), math.radians(rng.uniform(20.0, 70.0)), rng.uniform(-0.2, 0.2)
    north = np.array([math.cos(dip) * math.cos(way), math.cos(dip) * math.sin(way), math.sin(dip)])
    field_room = np.tile(level * north, (len(t), 1))
    body = motion(t)
    field_body = np.einsum("nij,nj->ni", body, field_room)
    pattern = str(rng.choice(["regular", "steps"]))
    moment = torquing(rng, t, field_body, pattern)
    house = House(room(rng, t), loads(rng, t), np.zeros((len(t), 4)), moment, is_duty_regular=pattern == "regular")
    return World(
        regime,
        name,
        start,
        t,
        orbit=None,
        position_km=None,
        true_field=field_room,
        reference=field_room,
        body=body,
        field_body=field_body,
        light=np.zeros(len(t)),
        sun_body=np.zeros((len(t), 3)),
        motion=motion,
        motion_name="turntable",
        spin=None,
        house=house,
        **sensor,  # type: ignore[arg-type]
    )


def kept_rows(world: World, values: Floats) -> Floats:
    """The rows of values (n, ...) that were recorded."""
    return values[world.kept]
