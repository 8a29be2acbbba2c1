"""What one unit of each amplitude of a hypothesis adds, as columns, and how columns are made of signals."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from magcal_service.model import Array

AFTER_BIAS: Final = "of the field alone"
"""Form of a gain that acts on the calibrated field: the bias arises behind what changes, and is not amplified."""


@dataclass(frozen=True, slots=True, eq=False)
class Columns:
    """What one unit of each amplitude adds, for n samples; one of three forms.

    Parameters
    ----------
    axes: (s, n, 3), 3 s amplitudes: number 3 j + i adds ``axes[j, :, i]`` along body axis i [nT per unit].
    body: (k, n, 3), k amplitudes: each adds a vector in the corrected body frame [nT per unit].
    magnitude: (k, n), k amplitudes: growth of the field's magnitude at the sensor over the reference's [nT per unit].
    """

    axes: Array | None = None
    body: Array | None = None
    magnitude: Array | None = None

    def along(self, unit: Array) -> Array:
        """Columns of the scalar residual (n, k), each in one piece, for directions ``unit`` (n, 3) of the field."""
        if self.axes is not None:
            rows = np.empty((len(self.axes), 3, len(unit)))
            for each, part in zip(rows, self.axes, strict=True):
                for i in range(3):
                    np.multiply(part[:, i], unit[:, i], out=each[i])
            return rows.reshape(-1, len(unit)).T
        if self.body is not None:
            return np.asarray(np.einsum("kni,ni->kn", self.body, unit)).T
        assert self.magnitude is not None
        return self.magnitude.T

    def components(self) -> Array | None:
        """Columns of a vector residual (3 n, k), as ``along``; None for a magnitude, which has no direction."""
        body = self.body
        if self.axes is not None:
            body = np.zeros((3 * len(self.axes), *self.axes.shape[1:]))
            for i in range(3):
                body[i::3, :, i] = self.axes[:, :, i]
        return None if body is None else body.reshape(len(body), -1).T

    def field(self, amplitudes: Array) -> Array:
        """The body field (n, 3) of amplitudes (k,) [nT], each axis in one piece; zeros (n, 3) for a magnitude."""
        if self.axes is not None:
            found = np.zeros((3, self.axes.shape[1]))
            for part, each in zip(self.axes, amplitudes.reshape(-1, 3).tolist(), strict=True):
                for i, amplitude in enumerate(each):
                    found[i] += amplitude * part[:, i]
            return found.T
        if self.body is not None:
            return np.asarray(np.einsum("k,kni->ni", amplitudes, self.body))
        assert self.magnitude is not None
        return np.zeros((self.magnitude.shape[1], 3))

    def times(self, signal: Array) -> Columns:
        """Every column times a signal (n,)."""
        return Columns(
            axes=None if self.axes is None else self.axes * signal[:, None],
            body=None if self.body is None else self.body * signal[:, None],
            magnitude=None if self.magnitude is None else self.magnitude * signal,
        )

    def sizes(self) -> Array:
        """rms over the recording of what one unit of each amplitude adds (k,) [nT per unit]."""
        if self.axes is not None:
            squares = [float(part[:, i] @ part[:, i]) for part in self.axes for i in range(3)]
            return np.asarray(np.sqrt(np.array(squares) / self.axes.shape[1]))
        if self.body is not None:
            return np.asarray(np.sqrt(np.einsum("kni,kni->k", self.body, self.body) / self.body.shape[1]))
        assert self.magnitude is not None
        return np.asarray(np.sqrt(np.mean(self.magnitude**2, axis=1)))

    def growth(self, amplitudes: Array) -> Array | float:
        """Growth of the magnitude (n,) of amplitudes (k,) [nT]; 0 for a body field."""
        return 0.0 if self.magnitude is None else amplitudes @ self.magnitude


def along_axes(signals: Array) -> Columns:
    """Every signal of (n,) or (n, s) along each body axis."""
    each = signals[None] if signals.ndim == 1 else signals.T
    return Columns(axes=np.broadcast_to(each[:, :, None], (*each.shape, 3)))


def oscillation(time_s: Array, frequency_hz: float) -> Columns:
    """Cosine and sine at a frequency along each body axis: six amplitudes."""
    angle = 2.0 * np.pi * frequency_hz * time_s
    return along_axes(np.stack([np.cos(angle), np.sin(angle)], axis=1))


def gains(field_nt: Array, signals: Array) -> Columns:
    """D + diag(a) s(t) for each signal of (n,) or (n, s): d = -a_i B_i s along axis i.

    With the gain left out, w = (I + D) B - b = A H + eps - diag(a) s B, so the disturbance is minus the gain's effect.
    """
    each = signals[None] if signals.ndim == 1 else signals.T
    return Columns(axes=-each[:, :, None] * field_nt[None])


def common_gain(field_nt: Array, signals: Array) -> Columns:
    """``gains`` with one number for all three axes."""
    return Columns(body=gains(field_nt, signals).axes)


def joined(*parts: Columns) -> Columns:
    """The columns of several parts of one form, one after another."""
    if all(part.axes is not None for part in parts):
        return Columns(axes=np.concatenate([part.axes for part in parts if part.axes is not None]))
    return Columns(body=np.concatenate([part.body for part in parts if part.body is not None]))
