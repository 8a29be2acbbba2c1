"""Magnetic torquers: a controller that fires coils, coils that take time to follow, iron that remembers.

The field at the magnetometer is that of three dipoles somewhere in the craft, d = M m.  Currents follow a command with
the coil's time constant L / R; a core keeps part of the last command.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tests.blind.cause import Cause, Telemetry, plain
from tests.blind.sensor import Spoiling
from tests.blind.vectors import Floats, dot, log_uniform, random_direction
from tests.blind.world import World


@dataclass(frozen=True, slots=True, eq=False)
class Firing:
    """What the controller did, at switching instants in order.

    Parameters
    ----------
    switch_s: (k,) instants.
    command_am2: (k, 3) dipole commanded from each instant on.
    """

    switch_s: Floats
    command_am2: Floats

    def at(self, times_s: Floats) -> tuple[Floats, Floats, Floats]:
        """Command (n, 3), the one before it (n, 3), and seconds (n,) since it was given."""
        latest = np.clip(np.searchsorted(self.switch_s, times_s, side="right") - 1, 0, None)
        before = np.maximum(latest - 1, 0)
        return self.command_am2[latest], self.command_am2[before], times_s - self.switch_s[latest]

    def remembered(self, times_s: Floats) -> Floats:
        """Sign (n, 3) of the last command of each coil that was not zero."""
        signs = np.sign(self.command_am2)
        for row in range(1, len(signs)):
            signs[row] = np.where(signs[row] == 0.0, signs[row - 1], signs[row])
        latest = np.clip(np.searchsorted(self.switch_s, times_s, side="right") - 1, 0, None)
        return np.asarray(signs[latest], dtype=np.float64)


def detumbling(world: World, rng: np.random.Generator) -> Firing:
    """B-dot with full coils: look at the field, then fire against its change for part of every cycle."""
    cycle = float(rng.choice([5.0, 7.0, 10.0, 20.0, 30.0]) * max(1.0, world.period_s))
    on_share = rng.uniform(0.25, 0.6)
    begin = rng.uniform(0.0, cycle)
    starts = np.arange(begin, world.duration_s, cycle)
    change = world.field_body(starts) - world.field_body(starts - 0.1 * cycle)
    active = _active_part(world, rng, starts)
    dipole = -rng.uniform(0.05, 0.3) * np.sign(change) * active[:, None]
    return _on_and_off(starts, starts + on_share * cycle, dipole)


def dumping(world: World, rng: np.random.Generator) -> Firing:
    """Momentum of wheels dumped at set intervals: m = -k B x h, held for a few seconds at a time."""
    interval = log_uniform(rng, 300.0, 1500.0)
    length = rng.uniform(0.1, 0.4) * interval
    hold = max(4.0, world.period_s)
    first = rng.uniform(0.0, 0.5) * interval
    starts = np.concatenate(
        [np.arange(begin, begin + length, hold) for begin in np.arange(first, world.duration_s, interval)]
    )
    field = world.field_body(starts)
    across = np.cross(field, random_direction(rng)) / np.linalg.norm(field, axis=1, keepdims=True)
    dipole = rng.uniform(0.05, 0.3) * across
    return _on_and_off(starts, starts + hold, dipole)


def _active_part(world: World, rng: np.random.Generator, starts: Floats) -> Floats:
    """1 where the controller works (k,): throughout, or in one part of the recording only."""
    if rng.random() < 0.6:
        return np.ones_like(starts)
    first = rng.uniform(0.0, 0.5) * world.duration_s
    last = first + rng.uniform(0.3, 0.5) * world.duration_s
    return np.asarray((starts >= first) & (starts < last), dtype=np.float64)


def _on_and_off(on_s: Floats, off_s: Floats, dipole: Floats) -> Firing:
    """Commands of ``dipole`` (k, 3) from ``on_s`` to ``off_s``, which may be the next beginning."""
    switch = np.stack([on_s, off_s], axis=-1).ravel()
    command = np.stack([dipole, np.zeros_like(dipole)], axis=1).reshape(-1, 3)
    kept = np.append(switch[1:] > switch[:-1] + 1e-9, True)  # an end at which the next begins is none
    first = np.array([min(-1.0, switch[0] - 1.0)])
    return Firing(np.concatenate([first, switch[kept]]), np.concatenate([np.zeros((1, 3)), command[kept]]))


def dipole_field_nt(offset_m: Floats) -> Floats:
    """Field (3, 3) [nT per A m2] of unit dipoles along x, y, z at the magnetometer, ``offset_m`` (3,) away."""
    distance = float(np.linalg.norm(offset_m))
    direction = offset_m / distance
    return np.asarray(100.0 / distance**3 * (3.0 * np.outer(direction, direction) - np.eye(3)))


def coil_matrix(rng: np.random.Generator) -> Floats:
    """M (3, 3) [nT per A m2] of three coils along the body's axes, each at its own place 0.15 to 0.6 m away."""
    return np.stack(
        [dipole_field_nt(rng.uniform(0.15, 0.6) * random_direction(rng))[:, axis] for axis in range(3)], axis=-1
    )


def torquer(world: World, _recorded: bool) -> Cause:
    """d = M m(t), with the coils' decay and, in some craft, the cores' remanence."""
    rng = world.streams.rng("torquer")
    pattern = detumbling if rng.random() < 0.6 else dumping
    firing = pattern(world, rng)
    command, before, since = firing.at(world.time_s)
    tau = log_uniform(rng, 0.005, 0.12)
    dipole = command + (before - command) * np.exp(-since / tau)[:, None]
    matrix = coil_matrix(rng)
    keeps = rng.uniform(0.03, 0.12) if rng.random() < 0.25 else 0.0
    full = float(np.abs(firing.command_am2).max())
    remanent = keeps * full * firing.remembered(world.time_s)
    field = (dipole + remanent) @ matrix.T
    size = float(np.sqrt(dot(field, field).mean()))
    field, per_am2 = field / size, matrix / size
    return Cause(
        name="torquer",
        world=world,
        spoil=lambda scale: Spoiling(disturbance=lambda _tags, _body: scale * field),
        parameters=lambda scale: {
            "nt_per_am2": plain(scale * per_am2),
            "remanence_share": keeps,
            "decay_s": tau,
            "pattern": pattern.__name__,
        },
        drivers=(Telemetry("torquer", command, "A m2", decimals=5),),
        scale=100.0,
    )
