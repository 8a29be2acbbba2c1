"""From the field where the craft is to the numbers of its magnetometer.

B = (I + D)^-1 (A H + b + d + eps), with d a disturbance in the corrected frame.  What a cause changes on that way is
a ``Spoiling``; several are applied together.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from tests.blind.attitude import Motion
from tests.blind.vectors import Floats, OverTime, turn
from tests.blind.world import World

Sampling = Callable[[OverTime, Floats], Floats]
T = TypeVar("T")


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Spoiling:
    """What one cause, at one strength, changes; None where it leaves things as they are.

    Parameters
    ----------
    clock_s: seconds (n,) to add to a tag (n,) for the instant at which the sensor looks.
    field_eci: the field (n, 3) [nT] ECI at the craft instead of the world's.
    extra_eci: field (n, 3) [nT] ECI added to it.
    motion: the craft's motion instead of the world's.
    sampling: how values (n, 3) are taken from a function of time at the instants (n,), instead of at once.
    disturbance: d (n, 3) [nT] from the tags (n,), which the telemetry has too, and the field in the body (n, 3).
    scale_change: diagonal (n, 3) added to D at the tags (n,).
    nonlinear: d (n, 3) [nT] from the field in the sensor's axes, B (n, 3).
    output: the recorded values (n, 3) from the tags and B (n, 3), noise included.
    reference_eci: what is recorded as the reference (n, 3) [nT] ECI instead of the world's field.
    """

    clock_s: OverTime | None = None
    field_eci: OverTime | None = None
    extra_eci: OverTime | None = None
    motion: Motion | None = None
    sampling: Sampling | None = None
    disturbance: Callable[[Floats, Floats], Floats] | None = None
    scale_change: OverTime | None = None
    nonlinear: Callable[[Floats], Floats] | None = None
    output: Callable[[Floats, Floats], Floats] | None = None
    reference_eci: OverTime | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """B (n, 3) and the reference (n, 3) ECI as recorded [nT], and the attitude (n, 3, 3) when the sensor looked."""

    field_nt: Floats
    reference_nt: Floats
    attitude: Floats


def measure(world: World, spoilings: Sequence[Spoiling] = (), noise_nt: Floats | None = None) -> Measured:
    """The samples of a world under some spoilings; ``noise_nt`` (n, 3) in the corrected frame, or none."""
    times = world.time_s
    instants = times + sum((s.clock_s(times) for s in spoilings if s.clock_s is not None), np.zeros_like(times))
    field = _last([s.field_eci for s in spoilings], world.field_eci)
    motion = _last([s.motion for s in spoilings], world.motion)
    extras = [s.extra_eci for s in spoilings if s.extra_eci is not None]

    def body_field(at_s: Floats) -> Floats:
        total = sum((extra(at_s) for extra in extras), field(at_s))
        return turn(motion.body_from_eci(at_s), total)

    sampling: Sampling = _last([s.sampling for s in spoilings], _at_once)
    body = sampling(body_field, instants)
    corrected = body + world.bias_nt
    for spoiling in spoilings:
        if spoiling.disturbance is not None:
            corrected = corrected + spoiling.disturbance(times, body)
    if noise_nt is not None:
        corrected = corrected + noise_nt
    measured = _through_scale(world.scale, corrected, spoilings, times)
    for spoiling in spoilings:
        if spoiling.output is not None:
            measured = spoiling.output(times, measured)
    reference = _last([s.reference_eci for s in spoilings], world.field_eci)
    return Measured(measured, reference(times), motion.body_from_eci(instants))


def _last(given: Sequence[T | None], otherwise: T) -> T:
    chosen = [value for value in given if value is not None]
    return chosen[-1] if chosen else otherwise


def _at_once(field: OverTime, instants: Floats) -> Floats:
    return field(instants)


def _through_scale(scale: Floats, corrected: Floats, spoilings: Sequence[Spoiling], tags: Floats) -> Floats:
    """B with (I + D) B = corrected + d(B); the nonlinear part by fixed-point steps, each a hundredfold gain."""
    changes = [s.scale_change(tags) for s in spoilings if s.scale_change is not None]
    curves = [s.nonlinear for s in spoilings if s.nonlinear is not None]
    whole = np.eye(3) + scale
    if changes:
        matrices = np.broadcast_to(whole, (len(corrected), 3, 3)).copy()
        matrices[:, np.arange(3), np.arange(3)] += sum(changes, np.zeros_like(corrected))
        inverse: Floats = np.linalg.inv(matrices).astype(np.float64)
    else:
        inverse = np.linalg.inv(whole)[None].astype(np.float64)
    measured = turn(inverse, corrected)
    for _ in range(6 if curves else 0):
        measured = turn(inverse, corrected + sum((curve(measured) for curve in curves), np.zeros_like(corrected)))
    return measured


def scalar_residual(world: World, measured: Measured) -> Floats:
    """e = |(I + D) B - b| - |H| (n,) [nT] with the world's own D and b."""
    corrected = measured.field_nt @ (np.eye(3) + world.scale) - world.bias_nt
    return np.asarray(np.linalg.norm(corrected, axis=1) - np.linalg.norm(measured.reference_nt, axis=1))
