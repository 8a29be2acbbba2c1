"""The length of a vector that follows another one late while both turn: a low-pass, or an average of samples.

In axes that turn along, y_k = E y_(k-1) + c_k, where c_k is what came in since.  Its length is known, and so is the
angle from y_(k-1) to y_k; the triangle of the three gives the length of y_k from the one before, with no expansion:
|y_k| = E |y_(k-1)| cos a + sqrt(|c_k|^2 - E^2 |y_(k-1)|^2 sin^2 a).

Source: the response of a first-order low-pass to what turns in a plane, 1 / (1 + i w tau), over one step.
"""

from __future__ import annotations

import math

import numpy as np

from magcal_service.model import Array


def followed(drive: Array, turn_rad: Array, kept: Array, gain: Array, more: float = 0.0) -> Array:
    """Length (n,) of what follows a drive.

    Parameters
    ----------
    drive: (n,) length that came in over the step to each row.
    turn_rad: (n,) angle of that step.
    kept: (n,) share E of the vector before that is left after it; 0 begins anew, as if the turn had always been so.
    gain: (n,) what is left of a drive's length in such a turn for ever.
    more: by how much longer it begins than if the first turn had always been.
    """
    cosine = np.cos(turn_rad)
    came2 = np.maximum(1.0 - 2.0 * kept * cosine + kept**2, 0.0) * (gain * drive) ** 2
    along, across2 = kept * cosine, (kept * np.sin(turn_rad)) ** 2
    first = math.sqrt(float(came2[0])) + more
    value, found, root = first, [first], math.sqrt
    for towards, beside2, new2 in zip(along[1:].tolist(), across2[1:].tolist(), came2[1:].tolist(), strict=True):
        left2 = new2 - beside2 * value * value
        value = towards * value if left2 <= 0.0 else towards * value + root(left2)
        found.append(value)
    return np.array(found)


def by_low_pass(field_nt: Array, rate_rad_s: Array, step_s: Array, tau_s: float, more: float = 0.0) -> Array:
    """Length (n,) after a low-pass of a field of length (n,), which turns and changes evenly in each step.

    ``step_s`` (n,): of the step to each row; infinite where one begins anew, whose field is the drive then.  ``more``
    as of ``followed``.
    """
    again = ~np.isfinite(step_s)
    steps = np.where(again, 1.0, step_s)
    kept = np.where(again, 0.0, np.exp(-steps / tau_s))
    before = np.concatenate([field_nt[:1], field_nt[:-1]])
    # the drive's change within a step counts by the ramp's exact weights, as in ``sunlight.first_order``
    early = np.where(again, 0.0, ((1.0 - kept) * tau_s / steps - kept) / (1.0 - kept))
    drive = field_nt + (before - field_nt) * early
    return followed(drive, rate_rad_s * steps, kept, 1.0 / np.sqrt(1.0 + (rate_rad_s * tau_s) ** 2), more)


def by_average(field_nt: Array, rate_rad_s: Array, step_s: Array, period_s: float, share: float) -> Array:
    """Length (n,) after y_k = a x_k + (1 - a) y_(k-1) of a field of length (n,), a being the share of what is new.

    Parameters as ``by_low_pass``; a step of several periods has held samples that are not there, along an even turn.
    """
    again, old = ~np.isfinite(step_s), 1.0 - share
    steps = np.where(again, 1.0, np.rint(step_s / period_s))
    kept = np.where(again, 0.0, old**steps)
    turn = rate_rad_s * period_s
    gain = share / np.sqrt(1.0 - 2.0 * old * np.cos(turn) + old**2)
    return followed(field_nt, turn * steps, kept, gain)
