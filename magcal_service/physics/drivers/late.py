"""The length of a vector that follows another one late while both turn: a low-pass, or an average of samples.

In axes that turn along, y_k = E y_(k-1) + c_k, where c_k is what came in since.  Its length is known, and so is the
angle from y_(k-1) to y_k; the triangle of the three gives the length of y_k from the one before, with no expansion:
|y_k| = E |y_(k-1)| cos a + sqrt(|c_k|^2 - E^2 |y_(k-1)|^2 sin^2 a).

Source: the response of a first-order low-pass to what turns in a plane, 1 / (1 + i w tau), over one step.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from magcal_service.model import Array


@dataclass(frozen=True, slots=True, eq=False)
class _Steps:
    """The triangle of each row but the first: E cos a (n - 1,), E^2 sin^2 a and |c|^2; |y| at the first row."""

    along: Array
    across2: Array
    came2: Array
    first: float

    @classmethod
    def of(cls, drive: Array, turn_rad: Array, kept: Array, gain: Array) -> _Steps:
        """Of a drive's length (n,) over the steps to each row, the steps' angles, E, and what is left of a drive's
        length in such a turn for ever; E = 0 begins anew, as if the turn had always been so."""
        cosine = np.cos(turn_rad)
        came2 = np.maximum(1.0 - 2.0 * kept * cosine + kept**2, 0.0) * (gain * drive) ** 2
        along, across2 = kept * cosine, (kept * np.sin(turn_rad)) ** 2
        return cls(along[1:], across2[1:], came2[1:], math.sqrt(float(came2[0])))

    def followed(self) -> Array:
        """Length (n,) of what follows."""
        value, found, root = self.first, [self.first], math.sqrt
        for towards, beside2, new2 in zip(self.along.tolist(), self.across2.tolist(), self.came2.tolist(), strict=True):
            left2 = new2 - beside2 * value * value
            value = towards * value if left2 <= 0.0 else towards * value + root(left2)
            found.append(value)
        return np.array(found)

    def longer(self, more: float) -> Array:
        """By how much longer (n,) it is if it begins so much longer; zero from where that is forgotten to the bit."""
        value, other, root = self.first, self.first + more, math.sqrt
        found = np.zeros(len(self.along) + 1)
        found[0] = other - value
        for row, towards in enumerate(self.along.tolist(), 1):
            if value == other:
                break
            beside2, new2 = float(self.across2[row - 1]), float(self.came2[row - 1])
            value, other = (towards * one + root(max(new2 - beside2 * one * one, 0.0)) for one in (value, other))
            found[row] = other - value
        return found


def by_low_pass(field_nt: Array, rate_rad_s: Array, step_s: Array, tau_s: float) -> Array:
    """Length (n,) after a low-pass of a field of length (n,), which turns and changes evenly in each step.

    ``step_s`` (n,): of the step to each row; infinite where one begins anew, whose field is the drive then.
    """
    return _low_pass_steps(field_nt, rate_rad_s, step_s, tau_s).followed()


def longer_by_low_pass(field_nt: Array, rate_rad_s: Array, step_s: Array, tau_s: float, more: float) -> Array:
    """By how much longer (n,) it is after a low-pass, parameters as ``by_low_pass``, that begins so much longer than if
    the first turn had always been."""
    return _low_pass_steps(field_nt, rate_rad_s, step_s, tau_s).longer(more)


def _low_pass_steps(field_nt: Array, rate_rad_s: Array, step_s: Array, tau_s: float) -> _Steps:
    again = ~np.isfinite(step_s)
    steps = np.where(again, 1.0, step_s)
    kept = np.where(again, 0.0, np.exp(-steps / tau_s))
    before = np.concatenate([field_nt[:1], field_nt[:-1]])
    # the drive's change within a step counts by the ramp's exact weights, as in ``sunlight.first_order``
    early = np.where(again, 0.0, ((1.0 - kept) * tau_s / steps - kept) / (1.0 - kept))
    drive = field_nt + (before - field_nt) * early
    return _Steps.of(drive, rate_rad_s * steps, kept, 1.0 / np.sqrt(1.0 + (rate_rad_s * tau_s) ** 2))


def by_average(field_nt: Array, rate_rad_s: Array, step_s: Array, period_s: float, share: float) -> Array:
    """Length (n,) after y_k = a x_k + (1 - a) y_(k-1) of a field of length (n,), a being the share of what is new.

    Parameters as ``by_low_pass``; a step of several periods has held samples that are not there, along an even turn.
    """
    again, old = ~np.isfinite(step_s), 1.0 - share
    steps = np.where(again, 1.0, np.rint(step_s / period_s))
    kept = np.where(again, 0.0, old**steps)
    turn = rate_rad_s * period_s
    gain = share / np.sqrt(1.0 - 2.0 * old * np.cos(turn) + old**2)
    return _Steps.of(field_nt, turn * steps, kept, gain).followed()
