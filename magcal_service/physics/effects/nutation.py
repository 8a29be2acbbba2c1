"""Coning about the momentum: the axis that is fixed in space moves in the body, and the body's axis in space."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from magcal_service.model import Array
from magcal_service.physics.acting import ActsOn
from magcal_service.physics.interface import Effect, Finding, value_of
from magcal_service.physics.scene.steady_spin import Turn, across
from magcal_service.physics.scene.view import View

Complex = NDArray[np.complexfloating[Any, Any]]

_LEAST_NATS: Final = 40.0
"""Height of a line over its neighbourhood from which it is a nutation.

Choice: higher than for named physics (12), because any disturbance that turns with the body gives lines here too.
"""

_LEAST_SIGMAS: Final = 0.1
"""Motion of the field, in noise sigmas, below which it is neglected: one percent of the variance."""

_STANDS_OUT: Final = 3.0
"""Of its own sigma, what the angle has to have, as all effects' numbers do."""

_SLOWEST_HZ: Final = 2e-3
"""Distance from the spin's lines within which what falls off from them is no nutation [Hz]: eleven times the orbit's
frequency, to which the edges of eclipses reach."""

_ORBITS_HZ: Final = 1.3e-3
"""Distance from the spin's lines within which nothing is nutation [Hz]: seven times the orbit's frequency.  An axis
that precesses by the field itself, with a dipole along it, has lines at four times and five, and as edges beyond."""

_SIDE_HZ: Final = 7e-4
"""Distance of side lines from their own [Hz]: four times the orbit's frequency, which a field that goes round twice an
orbit has in a product of two."""

_MOST_WAVES: Final = 32
"""Waves that what is slow is made of, at the most, for the cost of long recordings: what is left of it stands beside
the spin's line, where nothing is nutation."""

_LARGER: Final = 1.5
"""Times a line's height, what stands that near beside it makes it a side line of that;
choice: above the height that a line loses between two places of the transform."""


def _find(view: View) -> Finding | None:
    turn, scene = view.turn, view.scene
    if turn is None or len(scene) < 200:
        return None
    b1, b2 = across(turn.axis_body)
    w = scene.calibrated_nt
    turning = w @ b1 + 1j * (w @ b2)
    along, steady = _along(view, turn)
    steady = np.column_stack([w @ b1, w @ b2, steady])
    misfit = along - steady @ np.linalg.lstsq(steady, along, rcond=1e-10)[0]
    product: Complex = np.asarray(misfit * np.conj(turning), dtype=np.complex128)
    frequency, line = _spectrum(scene.time_s, product, scene.period_s)
    turn_hz = turn.rate_rad_s / (2.0 * math.pi)
    span_hz = 3.0 / max(float(np.ptp(scene.time_s)), 1.0)
    allowed, best = _line_apart(frequency, np.abs(line), turn_hz, span_hz, scene.period_s)
    if best is None:
        return None
    power, elapsed = float((np.abs(turning) ** 2).sum()), scene.time_s - scene.time_s[0]
    peak = _peak(scene.time_s, product, float(frequency[best]), span_hz / 6.0)
    if peak is None:
        return None
    line_hz, _ = peak
    coning = turning * np.exp(-2j * math.pi * line_hz * elapsed)
    tangent = _tangent(along, coning, steady)
    around = allowed & (np.abs(np.arange(len(line)) - best) < max(len(line) // 40, 40))
    around &= np.abs(np.arange(len(line)) - best) > 6
    usual = float(np.mean(np.abs(line[around]) ** 2)) if around.any() else math.inf
    nats = float(np.abs(line[best])) ** 2 / max(usual, power * view.noise_nt**2 * 0.5) - math.log(len(scene))
    strength = tangent * math.sqrt(power / len(scene) / 2.0)
    if nats < _LEAST_NATS or strength < _LEAST_SIGMAS * view.noise_nt:
        return None
    excess = max(float(np.mean(misfit**2)) - view.noise_nt**2, strength**2)
    first, last = (
        _tangent(along[part], coning[part], steady[part])
        for part in (slice(None, len(scene) // 2), slice(len(scene) // 2, None))
    )
    sigma = math.hypot(view.noise_nt * math.hypot(1.0, tangent) * math.sqrt(2.0 / power), 0.5 * (first - last))
    if tangent < _STANDS_OUT * sigma:
        return None  # a line that one half hardly has is no steady coning
    sigma_rad = sigma / (1.0 + tangent**2)
    parameters = {
        "angle_deg": value_of(math.degrees(math.atan(tangent)), math.degrees(sigma_rad), "deg"),
        "rate_rad_s": value_of(2.0 * math.pi * abs(line_hz), 2.0 * math.pi * span_hz / 3.0 * sigma / tangent, "rad/s"),
        "frequency_hz": value_of(abs(line_hz), span_hz / 3.0 * sigma / tangent, "Hz"),
    }
    return Finding(parameters, nats, min(1.0, strength**2 / excess))


def _tangent(along: Array, coning: Complex, steady: Array) -> float:
    """Tangent of the cone's half angle: what goes along the body's axis (n,) for what lies across it towards the axis
    that is fixed in space, w . a = H . h / cos(angle) - tan(angle) w . p with p (n,) in ``coning``, beside ``steady``
    (n, k), which has the first term."""
    columns = np.column_stack([coning.real, coning.imag, steady])
    cosine, sine = np.linalg.lstsq(columns, along, rcond=1e-10)[0][:2].tolist()
    return math.hypot(cosine, sine)


def _along(view: View, turn: Turn) -> tuple[Array, Array]:
    """What the field has along the body's axis (n,), less what it has along an axis in space where that is known, and
    what a craft without coning may have there (n, k): an axis that is tilted in space, or all that is as slow as the
    field itself changes along an orbit."""
    spin, scene = view.spin, view.scene
    if spin is not None and scene.reference_eci_nt is not None:
        i1, i2 = across(spin.axis_eci)
        space = np.stack([i1, i2, spin.axis_eci], axis=1)
        return spin.axial_misfit_nt, np.column_stack([scene.reference_eci_nt @ space, np.ones(len(scene))])
    elapsed = scene.time_s - scene.time_s[0]
    span_s = max(float(elapsed[-1]), 1.0)
    orders = np.arange(1, min(math.ceil(span_s * _SIDE_HZ), _MOST_WAVES) + 1)
    waves = np.exp(2j * math.pi * np.outer(elapsed / span_s, orders))
    slow = np.column_stack([np.vander(elapsed / span_s, 4), waves.real, waves.imag])
    return scene.calibrated_nt @ turn.axis_body, slow


def _line_apart(
    frequency: Array, height: Array, turn_hz: float, span_hz: float, period_s: float
) -> tuple[NDArray[np.bool_], int | None]:
    """Where nutation may stand (k,), and the place of its line; None where none stands apart from the still lines.

    What is fixed in the body or in space has its lines at a difference of none, one or two turns.  Near them what grows
    towards them belongs to them; a line that is higher than all between it and them is one of its own.
    """
    still = (0.0, turn_hz, 2.0 * turn_hz)
    distance = np.min([_distance(frequency, still_hz, period_s) for still_hz in still], axis=0)
    allowed, near = distance >= max(_SLOWEST_HZ, span_hz), distance >= max(_ORBITS_HZ, span_hz)
    if not near.any():
        return allowed, None
    best = int(np.argmax(np.where(near, height, 0.0)))
    if not allowed[best] and height[best] <= float(np.max(height[distance < distance[best]])):
        if not allowed.any():
            return allowed, None
        best = int(np.argmax(np.where(allowed, height, 0.0)))
    beside = np.abs(frequency - frequency[best]) < _SIDE_HZ
    return allowed, None if float(height[beside].max()) > _LARGER * float(height[best]) else best


def _spectrum(time_s: Array, signal: Complex, period_s: float) -> tuple[Array, Complex]:
    """Two-sided frequencies [Hz] and sum of signal exp(+i 2 pi f t) of samples put on an even grid."""
    slot = np.rint((time_s - time_s[0]) / period_s).astype(np.intp)
    size = 2 * (int(slot[-1]) + 1)
    grid = np.zeros(size, dtype=np.complex128)
    np.add.at(grid, slot, signal)
    return np.fft.fftfreq(size, period_s), np.fft.ifft(grid) * size


def _peak(time_s: Array, signal: Complex, near_hz: float, width_hz: float) -> tuple[float, float] | None:
    """Frequency [Hz] and height of the largest sum of signal exp(+i 2 pi f t) within a width of a frequency.

    Between the lines of a transform padded to twice its length up to a tenth of the height is lost.  None where it
    still rises at an end: that is the flank of another line.
    """
    offsets = np.linspace(-width_hz, width_hz, 17)
    elapsed = time_s - time_s[0]
    centred = signal * np.exp(2j * math.pi * near_hz * elapsed)
    heights = np.array([abs(complex(np.exp(2j * math.pi * offset * elapsed) @ centred)) for offset in offsets.tolist()])
    best = int(np.argmax(heights))
    if not 0 < best < len(heights) - 1:
        return None
    low, top, high = heights[best - 1 : best + 2].tolist()
    share = 0.5 * (low - high) / min(low - 2.0 * top + high, -1e-300)
    found_hz = near_hz + float(offsets[best]) + share * float(offsets[1] - offsets[0])
    return found_hz, top - 0.25 * (low - high) * share


def _distance(frequency: Array, line_hz: float, period_s: float) -> Array:
    """How far frequencies (k,) are from a line, of either sign, or from where it is folded to [Hz]."""
    rate = 1.0 / period_s
    distance = [np.abs((frequency - sign * line_hz + rate / 2.0) % rate - rate / 2.0) for sign in (1.0, -1.0)]
    return np.asarray(np.minimum(*distance))


EFFECT = Effect(
    name="nutation",
    acts_on=ActsOn.ATTITUDE,
    title="the craft nutates",
    equation="the momentum cones in the body: h = a_b + tan(angle) (b1 cos nu t + b2 sin nu t), w . h = H . a_i",
    units={"angle_deg": "deg", "rate_rad_s": "rad/s", "frequency_hz": "Hz"},
    prior=(10.0, 20000.0),
    valid="small angles, a body with two equal moments of inertia; seen in the vectors, never in their magnitude",
    confused_with=("spin_rate",),
    separated_by="side lines of the spin: nutation has them at a frequency of its own",
    source="Wertz 1978, section 16.2: coning at (I3 / I1 - 1) times the spin rate",
    says=("The craft nutates by {angle_deg.size} at {frequency_hz.size} in the body.",),
    find=_find,
    absorbed="the magnitude is the same whatever the attitude: the nine errors and the scalar residual do not see it",
)
