"""How strong a cause is, how well the data can show it, and the scale that makes it as strong as wanted.

Strength, in sigmas of the noise per axis: rms of the length of d, the disturbance in the corrected frame.

Detectability of what the magnitude shows (``Measure.VECTOR``, ``SCALAR``): the change of the scalar residual
e = |(I + D) B - b| - |H| between the noise-free samples with the cause and without it, after the nine columns of the
calibration (-u_i, u_i B_i, u_i B_j + u_j B_i) have been projected out; its norm over sigma.  It is the distance, in
standard deviations, at which a perfect observer that knows the shape sees the effect.

What the magnitude does not show has a measure of its own (``Cause.scalar`` is False):

| measure | effects | strength | detectability |
|---|---|---|---|
| TURNED | nutation, spin_rate, stuck_axis | rms length of the change of the samples | norm of that change over sigma |
| WIDENED | quantisation | as above | sqrt(3 n / 2) v / sigma^2, with v the variance it adds per axis |
| COLOURED | coloured_noise | correlation of neighbours | sqrt(3 n) times it |

``SCALAR`` effects (a lag, a skew) mostly turn the vector by a constant angle that nobody can see; their strength is the
rms of the change of the scalar residual.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tests.blind.cause import Cause, Measure
from tests.blind.sensor import Measured, measure, scalar_residual
from tests.blind.vectors import Floats, dot, turn, unit
from tests.blind.world import World

STEPS = 8


@dataclass(frozen=True, slots=True, eq=False)
class Tuned:
    """A cause at the scale that was chosen.

    Parameters
    ----------
    scale, strength, detectability: see the module.
    signature: (n,) change of the scalar residual that is left after the nine columns, over sigma.
    """

    cause: Cause
    scale: float
    strength: float
    detectability: float
    signature: Floats


def calibration_columns(world: World, clean: Measured) -> Floats:
    """The nine columns (n, 9) of the scalar residual, orthonormal, at the noise-free samples without any cause."""
    u = unit(clean.field_nt @ (np.eye(3) + world.scale) - world.bias_nt)
    field = clean.field_nt / np.abs(clean.field_nt).max()
    shear = [u[:, i] * field[:, j] + u[:, j] * field[:, i] for i, j in ((0, 1), (0, 2), (1, 2))]
    columns = np.concatenate([-u, u * field, np.stack(shear, axis=-1)], axis=1)
    return np.asarray(np.linalg.qr(columns)[0], dtype=np.float64)


def without(columns: Floats, values: Floats) -> Floats:
    """Values (n,) with orthonormal columns (n, k) projected out."""
    return np.asarray(values - columns @ (columns.T @ values), dtype=np.float64)


class Scales:
    """Evaluates one cause at one scale after another against the same clean samples."""

    def __init__(self, cause: Cause) -> None:
        self.cause = cause
        self._world = cause.world
        self._clean = measure(cause.world)
        self._columns = calibration_columns(cause.world, self._clean)
        self._residual = scalar_residual(cause.world, self._clean)

    def at(self, scale: float) -> Tuned:
        """Strength and detectability at one scale."""
        cause, world = self.cause, self._world
        spoiled = measure(world, [cause.spoil(scale)])
        change = scalar_residual(world, spoiled) - self._residual
        signature = without(self._columns, change) / world.noise_nt
        strength = self._strength(scale, spoiled, change)
        return Tuned(cause, scale, strength, self._detectability(strength, signature), signature)

    def _strength(self, scale: float, spoiled: Measured, change: Floats) -> float:
        world = self._world
        if self.cause.measure is Measure.COLOURED:
            return float(self.cause.parameters(scale)["correlation"])
        if self.cause.measure is Measure.SCALAR:
            return float(np.sqrt(np.mean(change**2))) / world.noise_nt
        if self.cause.measure is Measure.VECTOR:
            corrected = spoiled.field_nt @ (np.eye(3) + world.scale) - world.bias_nt
            vectors = corrected - turn(spoiled.attitude, spoiled.reference_nt)
        else:
            vectors = spoiled.field_nt - self._clean.field_nt
        return float(np.sqrt(dot(vectors, vectors).mean())) / world.noise_nt

    def _detectability(self, strength: float, signature: Floats) -> float:
        count = len(signature)
        if self.cause.measure is Measure.TURNED:
            return strength * float(np.sqrt(count))
        if self.cause.measure is Measure.WIDENED:
            return float(np.sqrt(3.0 * count / 2.0)) * strength**2 / 3.0
        if self.cause.measure is Measure.COLOURED:
            return strength * float(np.sqrt(3.0 * count))
        return float(np.linalg.norm(signature))


def tune(
    cause: Cause, rng: np.random.Generator, strengths: tuple[float, float], detectability: tuple[float, float]
) -> Tuned | None:
    """The cause at a strength within both ranges, or None where this world has none.

    A first strength is drawn, its logarithm uniform over the range; where it lies outside the range of detectability,
    another is drawn from the part of the range that lies within, as far as one can tell from the first.
    """
    scales = Scales(cause)
    if cause.fixed:
        tuned = scales.at(cause.scale)
        strong = not cause.scalar or strengths[0] <= tuned.strength <= strengths[1]
        return tuned if strong and detectability[0] <= tuned.detectability <= detectability[1] else None
    low, high = strengths
    for _ in range(4):
        found = _at_strength(scales, float(np.exp(rng.uniform(np.log(low), np.log(high)))))
        if found is None:
            return None
        if detectability[0] <= found.detectability <= detectability[1]:
            return found
        per_strength = max(found.detectability / found.strength, 1e-9)
        low = max(strengths[0], 1.02 * detectability[0] / per_strength)
        high = min(strengths[1], 0.98 * detectability[1] / per_strength)
        if low >= high:
            return None
    return None


def _at_strength(scales: Scales, wanted: float) -> Tuned | None:
    """The scale of a wanted strength to 2 %, by secant steps on logarithms; None where it cannot be reached."""
    limit = scales.cause.largest_scale
    if not limit > 0.0:
        return None
    scale, power = min(scales.cause.scale, limit), 1.0
    before: Tuned | None = None
    for _ in range(STEPS):
        tuned = scales.at(scale)
        if not tuned.strength > 0.0:
            scale = min(4.0 * scale, limit)
            continue
        if abs(tuned.strength - wanted) < 0.02 * wanted:
            return tuned
        if tuned.strength < wanted and scale >= limit:
            return None
        if before is not None and scale != before.scale and tuned.strength != before.strength:
            slope = np.log(tuned.strength / before.strength) / np.log(scale / before.scale)
            power = float(np.clip(slope, 0.3, 4.0))
        before = tuned
        scale = min(scale * float(np.clip((wanted / tuned.strength) ** (1.0 / power), 0.05, 20.0)), limit)
    return None
