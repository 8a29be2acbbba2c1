"""The course of the field in the body as what remembers it passes through it: without noise, and between samples."""

from __future__ import annotations

from typing import Final

import numpy as np

from magcal_service.model import Array
from magcal_service.physics.scene.scene import Scene

_SMOOTHED: Final = 0.5
"""Turn of the field [rad] that half a window of the smoother may span: parabolas lose (3/280) 0.5^4 of it, 0.07 %."""

_WIDEST: Final = 256  # samples of half a window: beyond it noise moves the course by less than a hundredth of itself

_COARSE: Final = 0.15
"""Turn from sample to sample [rad] from which on turning points between them are followed: they lie up to
1 - cos(0.15 / 2), 0.3 %, beyond the samples there."""


def smoothing(scene: Scene) -> int:
    """Samples over which the field's direction turns by ``_SMOOTHED`` at the most, in the median; 0: no two."""
    found, width = 0, 2
    while width <= min(_WIDEST, len(scene) // 4):
        chord = np.linalg.norm(scene.unit[width:] - scene.unit[:-width], axis=1)
        if float(np.median(chord)) > _SMOOTHED:
            break
        found, width = width, 2 * width
    return found


def smooth_field(scene: Scene, half: int, field: Array | None = None) -> Array:
    """A vector (n, 3), the calibrated one by default, as local parabolas over ``half`` samples before and after; 0: as
    it is.

    What remembers takes each reversal for one of the field's; noise that is as large as a step would erase it.
    Source: Savitzky & Golay 1964, the quadratic smoother.
    """
    field = scene.calibrated_nt if field is None else field
    if half < 2:
        return field
    number = np.arange(-half, half + 1)
    weights = 3.0 * (3 * half**2 + 3 * half - 1) - 15.0 * number**2
    weights /= (2 * half - 1) * (2 * half + 1) * (2 * half + 3)
    found = np.array(field)
    ends = np.append(scene.pauses[1:], len(field))
    for first, end in zip(scene.pauses.tolist(), ends.tolist(), strict=True):
        part = field[first:end]
        if len(part) > 2 * half:
            before = 2.0 * part[0] - part[half:0:-1]
            after = 2.0 * part[-1] - part[-2 : -half - 2 : -1]
            wide = np.concatenate([before, part, after])
            found[first:end] = np.stack([np.convolve(axis, weights, "valid") for axis in wide.T], axis=1)
    return found


def is_coarse(scene: Scene) -> bool:
    """Whether a craft turns so far from sample to sample that turning points between them count, at a known rate."""
    if scene.rate_body is None:
        return False
    return bool(np.median(np.linalg.norm(scene.rate_body, axis=1)) * scene.period_s > _COARSE)


def with_turning_points(scene: Scene, field: Array) -> Array:
    """(2 n - 1, 3) what rods along the axes meet: the field (n, 3) at each sample, and between two its extreme there.

    Between samples the craft turns at its rate w about n: h(a) = h_n + p cos a + q sin a, with a = w t, h_n the part
    of a field that the turn leaves, p the rest of it, q = -(n x field).  Where there is no extreme in between, or more
    than one, the later sample stands there twice, and a rate-independent memory does not notice.
    """
    assert scene.rate_body is not None
    rate = scene.rate_body[:-1]
    speed = np.linalg.norm(rate, axis=1)
    axis = rate / np.maximum(speed, 1e-12)[:, None]
    along = np.einsum("ni,ni->n", axis, field[:-1])[:, None] * axis
    cosine, sine = field[:-1] - along, -np.cross(axis, field[:-1])
    peak = np.arctan2(sine, cosine)
    turned = (speed * np.diff(scene.time_s))[:, None]
    until = np.mod(peak, np.pi)  # to the next extreme; at 0 it is the sample itself
    inside = (until > 0.0) & (until < turned) & (turned < np.pi)
    size = np.hypot(cosine, sine)
    highest = np.maximum(along + size, np.maximum(field[:-1], field[1:]))
    lowest = np.minimum(along - size, np.minimum(field[:-1], field[1:]))
    dense = np.empty((2 * len(field) - 1, 3))
    dense[::2] = field
    dense[1::2] = np.where(inside, np.where(peak > 0.0, highest, lowest), field[1:])
    return dense
