"""From the field at the sensor to samples, what a cause can change on that way, and how well the magnitude shows it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tests.regimes.orbit import Floats
from tests.regimes.world import World

SUBSTEPS = 8
"""Steps from sample to sample in which what has a memory is followed: 18 degrees each at 24 rpm and 1 Hz."""


@dataclass(frozen=True, slots=True, eq=False)
class Change:
    """What one cause does.

    Parameters
    ----------
    added: (n, 3) field d in corrected axes [nT].
    gain: (n, 3) what is added to the diagonal of D.
    offset_s: the sample at tag t belongs to the reference at t + offset.
    lag_s: time constant of a first-order low-pass.
    lsb_nt: samples are rounded to multiples of it; 0: not.
    """

    added: Floats | None = None
    gain: Floats | None = None
    offset_s: float = 0.0
    lag_s: float = 0.0
    lsb_nt: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """Samples B (n, 3) in the sensor's axes [nT], and the reference (n, 3) that goes with them."""

    samples: Floats
    reference: Floats


def measure(world: World, changes: tuple[Change, ...], noise: Floats | float = 0.0) -> Measured:
    """B = (I + D)^-1 (A H + b + d + eps), with every change at once."""
    lag = sum(change.lag_s for change in changes)
    total = (lagging(world, lag) if lag else world.field_body) + world.bias_nt + noise
    matrix = np.broadcast_to(np.eye(3) + world.scale, (len(world.t), 3, 3))
    for change in changes:
        if change.added is not None:
            total = total + change.added
        if change.gain is not None:
            matrix = matrix + change.gain[:, :, None] * np.eye(3)
    samples = np.linalg.solve(matrix, total[:, :, None])[:, :, 0]
    lsb = max((change.lsb_nt for change in changes), default=0.0)
    if lsb:
        samples = lsb * np.round(samples / lsb)
    offset = sum(change.offset_s for change in changes)
    return Measured(samples, world.late_reference(offset) if offset else world.reference)


def between_samples(world: World) -> Floats:
    """The true field in the body at every eighth of a sample (8 n, 3); that at the samples is every eighth row."""
    fine = float(world.t[1] - world.t[0]) / SUBSTEPS
    course = []
    for part in range(SUBSTEPS):
        at = world.t - part * fine
        weight = part / SUBSTEPS
        before = np.vstack([2.0 * world.true_field[0] - world.true_field[1], world.true_field[:-1]])
        space = (1.0 - weight) * world.true_field + weight * before
        course.append(np.einsum("nij,nj->ni", world.motion(at), space))
    return np.stack(course[::-1], axis=1).reshape(-1, 3)


def lagging(world: World, tau_s: float) -> Floats:
    """The true field in the body (n, 3) through a low-pass, integrated in steps of an eighth of a sample."""
    fine = float(world.t[1] - world.t[0]) / SUBSTEPS
    dense = between_samples(world)
    kept = math.exp(-fine / tau_s)
    share = tau_s / fine * (1.0 - kept)  # exact for a drive that is straight between its values
    level = (dense[0] - tau_s * (dense[1] - dense[0]) / fine).tolist()
    answer = np.empty_like(dense)
    for axis in range(3):
        value, before_value, found = level[axis], float(dense[0, axis]), []
        for now in dense[:, axis].tolist():
            value = kept * value + (share - kept) * before_value + (1.0 - share) * now
            before_value = now
            found.append(value)
        answer[:, axis] = found
    return answer[SUBSTEPS - 1 :: SUBSTEPS]


def scalar_residual(world: World, measured: Measured) -> Floats:
    """|(I + D) B - b| - |H| (n,) [nT], with the sensor's true errors."""
    calibrated = measured.samples @ (np.eye(3) + world.scale) - world.bias_nt
    return np.linalg.norm(calibrated, axis=1) - np.linalg.norm(measured.reference, axis=1)


def nine_columns(world: World, samples: Floats) -> Floats:
    """Derivatives (n, 9) of the scalar residual by b, D11 D22 D33, D12 D13 D23, at samples (n, 3)."""
    calibrated = samples @ (np.eye(3) + world.scale) - world.bias_nt
    u = calibrated / np.linalg.norm(calibrated, axis=1)[:, None]
    mixed = [u[:, a] * samples[:, b] + u[:, b] * samples[:, a] for a, b in ((0, 1), (0, 2), (1, 2))]
    return np.c_[-u, u * samples, np.stack(mixed, axis=1)]


def detectability(world: World, changed: Measured, twin: Measured) -> float:
    """Norm of the scalar residual's change, nine errors projected out, over the noise; of the rows recorded."""
    kept = world.kept
    change = (scalar_residual(world, changed) - scalar_residual(world, twin))[kept]
    columns = nine_columns(world, twin.samples)[kept]
    basis = np.linalg.qr(columns / np.linalg.norm(columns, axis=0))[0]
    return float(np.linalg.norm(change - basis @ (basis.T @ change)) / world.noise_nt)
