"""How the sensor itself answers: a gain that depends on the field, an end of scale, a converter's step, a fault."""

from __future__ import annotations

import numpy as np

from tests.blind.cause import Cause, Measure, plain
from tests.blind.sensor import Spoiling, measure
from tests.blind.vectors import Floats
from tests.blind.world import World

TYPICAL_NT = 40000.0


def cubic_response(world: World, _recorded: bool) -> Cause:
    """d_i = c_i B_i^3, in some sensors with the transverse terms k_ij B_i B_j^2; B in the sensor's axes."""
    rng = world.streams.rng("cubic_response")
    gains = rng.uniform(-1.0, 1.0, 3) if rng.random() < 0.7 else np.eye(3)[rng.integers(3)]
    gains = gains / TYPICAL_NT**3
    transverse = rng.uniform(-1.0, 1.0, (3, 3)) / TYPICAL_NT**3 * float(rng.random() < 0.3)
    np.fill_diagonal(transverse, 0.0)

    def curve(scale: float, field: Floats) -> Floats:
        squares = field**2
        return np.asarray(scale * field * (gains * squares + squares @ transverse.T), dtype=np.float64)

    return Cause(
        name="cubic_response",
        world=world,
        spoil=lambda scale: Spoiling(nonlinear=lambda field: curve(scale, field)),
        parameters=lambda scale: {"per_nt2": plain(scale * gains), "transverse_per_nt2": plain(scale * transverse)},
        scale=100.0,
        largest_scale=4000.0,
    )


def saturation(world: World, _recorded: bool) -> Cause:
    """One axis ends at a full scale, hard or over a soft knee; ``scale`` is what that takes off its largest value."""
    rng = world.streams.rng("saturation")
    axis = int(rng.integers(3))
    largest = float(np.abs(measure(world).field_nt[:, axis]).max())
    knee = float(rng.uniform(0.01, 0.1)) * largest if rng.random() < 0.4 else 0.0

    def ended(scale: float, field: Floats) -> Floats:
        field = field.copy()
        start = largest - scale
        beyond = np.maximum(np.abs(field[:, axis]) - start, 0.0)
        passed = knee * np.tanh(beyond / knee) if knee else 0.0
        field[:, axis] -= np.sign(field[:, axis]) * (beyond - passed)
        return field

    return Cause(
        name="saturation",
        world=world,
        spoil=lambda scale: Spoiling(output=lambda _tags, field: ended(scale, field)) if scale else Spoiling(),
        parameters=lambda scale: {"axis": axis, "limit_nt": largest - scale + knee, "knee_nt": knee},
        scale=500.0,
        largest_scale=0.4 * largest,
    )


def quantisation(world: World, _recorded: bool) -> Cause:
    """The converter's step is not small against the noise."""
    return Cause(
        name="quantisation",
        world=world,
        spoil=lambda scale: Spoiling(output=lambda _tags, field: _steps(field, scale)) if scale else Spoiling(),
        parameters=lambda scale: {"lsb_nt": scale},
        scale=100.0,
        measure=Measure.WIDENED,
    )


def stuck_axis(world: World, _recorded: bool) -> Cause:
    """The register of one axis freezes, once or a few times; samples of that axis repeat the last good value."""
    rng = world.streams.rng("stuck_axis")
    axis, spells = int(rng.integers(3)), int(rng.integers(1, 4))
    starts = (np.arange(spells) + rng.uniform(0.05, 0.5, spells)) / spells * world.duration_s
    lengths = rng.uniform(0.1, 0.45, spells) / spells * world.duration_s
    spans = [[float(start), float(start + length)] for start, length in zip(starts, lengths, strict=True)]

    def frozen(tags: Floats, field: Floats) -> Floats:
        field = field.copy()
        for first, last in spans:
            rows = np.flatnonzero((tags >= first) & (tags < last))
            field[rows, axis] = field[rows[0], axis]
        return field

    return Cause(
        name="stuck_axis",
        world=world,
        spoil=lambda scale: Spoiling(output=frozen) if scale else Spoiling(),
        parameters=lambda scale: {"axis": axis, "spans_s": spans if scale else []},
        fixed=True,
        measure=Measure.TURNED,
    )


def _steps(field: Floats, step: float) -> Floats:
    return np.asarray(np.round(field / step) * step, dtype=np.float64)
