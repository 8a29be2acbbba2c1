"""Attitude of a craft that turns about one axis, from calibrated and reference vectors of a whole recording.

With a_b the axis in the body and a_i in inertial space, w . a_b = H . a_i at every instant, whatever the phase: of all
pairs of unit vectors they come nearest to that.  The phase at each sample follows from the parts across the axes, one
complex number each.  Nothing is assumed of the rate: it may change.

Source: the axis condition is that of Shuster & Oh 1981 for one common direction; phase as in spin-plane demodulation.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from magcal_service.model import Array
from magcal_service.physics.scene.scene import Scene
from magcal_service.physics.scene.spin_phase import phases
from magcal_service.residuals import rms

LARGEST_MISFIT: Final = 0.3
"""Of |H|: a craft whose field along the axis misses by more does not turn about a fixed axis."""

_FAR_OFF: Final = 0.2
"""Of |H|, what the vectors turned by a spin may miss by: a craft that swings farther beside it has another attitude,
and what follows from this one (the Sun in the body, how fast the field turns) is not its own."""

ORBITAL_RATE_RAD_S: Final = 1.1e-3
"""Once round the Earth in 95 min; the field goes round twice in a polar orbit."""

_MOST_OFF_RAD: Final = (0.2, 0.4)
"""What an axis may be off by, of its misfit and what a turn adds to that; and what where the field is well seen."""

_WELL_SEEN: Final = 0.2
"""Of |H|, what a turn of an axis by a radian adds to the misfit at the least where the field is seen well: a craft that
nutates misses by a tenth of |H| and more, whatever its axis.  Choice: five times what one turn in an arc of ten minutes
adds on a craft that looks down."""

_SIGNS: Final = np.repeat([1.0, -1.0], 3)

_AS_GOOD: Final = 1.3
"""Times the misfit of the best axis, up to which its mirror image is as good; choice: noise does not tell the two."""

_MOST_OF_IT: Final = 0.95
"""Quantile of the part of the field along the axis over that across it by which an axis that is off turns the phase."""

_LEAST_ACROSS: Final = 0.1  # of |H|

_HALVINGS: Final = 60
"""Of the range of a multiplier, to where a double has no more digits."""

_ALIKE: Final = 1e-3
"""Difference of the squares of two lengths, of their sum, up to which they are alike; choice: it turns nothing."""


@dataclass(frozen=True, slots=True, eq=False)
class SpinSolution:
    """A turn about one axis.

    Parameters
    ----------
    axis_body, axis_eci: unit vectors (3,).
    phase_rad: (n,) smoothed angle about +axis, unwrapped.
    raw_phase_rad: (n,) the same from each sample alone.
    rate_rad_s: mean rate about +axis.
    body_from_eci: (n, 3, 3).
    axial_misfit_nt: (n,) w . a_b - H . a_i.
    across_nt: (n,) part of H across the axis.
    size_nt: mean of |H|.
    bent_rad: what the phase may be bent by because the axis may be off.
    """

    axis_body: Array
    axis_eci: Array
    phase_rad: Array
    raw_phase_rad: Array
    rate_rad_s: float
    body_from_eci: Array
    axial_misfit_nt: Array
    across_nt: Array
    size_nt: float
    bent_rad: float = 0.0

    @property
    def is_attitude(self) -> bool:
        """Whether the craft is turned so, and does not swing far beside it."""
        beside_nt = 2.0 * np.sin(0.5 * (self.raw_phase_rad - self.phase_rad)) * self.across_nt
        return math.hypot(rms(self.axial_misfit_nt), rms(beside_nt)) < _FAR_OFF * self.size_nt

    @property
    def rate_rpm(self) -> float:
        """Mean rate [rpm] about +axis."""
        return self.rate_rad_s * 30.0 / np.pi

    @property
    def turn(self) -> Turn:
        """The turn alone."""
        turned = self.phase_rad, self.raw_phase_rad
        return Turn(self.axis_body, *turned, self.rate_rad_s, self.across_nt, bent_rad=self.bent_rad)


@dataclass(frozen=True, slots=True, eq=False)
class Turn:
    """How far a craft has turned about one axis of its body.

    Parameters
    ----------
    axis_body: unit vector (3,).
    phase_rad, raw_phase_rad: (n,) angle about +axis, unwrapped, smoothed and from each sample alone.
    rate_rad_s: mean rate about +axis.
    across_nt: (n,) part of the field across the axis.
    drift_rad_s: how fast the direction from which the phase is counted may turn.
    bent_rad: what the phase may be bent by because the axis may be off.
    """

    axis_body: Array
    phase_rad: Array
    raw_phase_rad: Array
    rate_rad_s: float
    across_nt: Array
    drift_rad_s: float = 0.0
    bent_rad: float = 0.0


def turn_alone(scene: Scene, axis_body: Array, nominal_rate_rad_s: float | None) -> Turn | None:
    """The turn about a known axis (3,) against the field itself, whose direction in space is unknown.

    That direction goes round twice an orbit at most.  None where the field does not turn about the axis.
    """
    b1, b2 = across(axis_body)
    body = scene.calibrated_nt @ b1 + 1j * (scene.calibrated_nt @ b2)
    strength = np.abs(body)
    if len(scene) < 60 or float(np.mean(strength)) < _LEAST_ACROSS * float(np.mean(scene.magnitude_nt)):
        return None
    turn = np.conj(body) / np.maximum(strength, 1e-9)
    rate = _rate(scene, turn, nominal_rate_rad_s)
    if rate is None:
        return None
    raw, smooth = phases(scene, turn, strength, rate)
    mean_rate = float(np.polyfit(scene.time_s, smooth, 1)[0])
    return Turn(axis_body, smooth, raw, mean_rate, strength, 2.0 * ORBITAL_RATE_RAD_S)


def across(axis: Array) -> tuple[Array, Array]:
    """Two unit vectors that make a right-handed triad with the axis (3,); in plain floats: four are asked a sample."""
    helper = [0.0, 0.0, 0.0]
    helper[int(np.argmin(np.abs(axis)))] = 1.0
    first = _cross(axis.tolist(), helper)
    first /= np.linalg.norm(first)
    return first, _cross(axis.tolist(), first.tolist())


def _cross(a: list[float], b: list[float]) -> Array:
    """a x b (3,)."""
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def solve_spin(scene: Scene, nominal_axis: Array | None, nominal_rate_rad_s: float | None) -> SpinSolution | None:
    """The spin of a recording, or None where it has no vector reference or does not turn about a fixed axis.

    Parameters
    ----------
    nominal_axis: body axis (3,) that gives the solution its sign; None: that which makes the rate positive.
    nominal_rate_rad_s: about the nominal axis; only needed where the phase step between samples exceeds half a turn.
    """
    reference = scene.reference_eci_nt
    if reference is None or len(scene) < 60:
        return None
    axes = _axes(scene.calibrated_nt, reference)
    if axes is None:
        return None
    body, inertial, off_rad = axes
    along, mirrored = scene.calibrated_nt @ body, _mirrored(inertial, reference)
    is_as_good = rms(along - reference @ mirrored) < _AS_GOOD * rms(along - reference @ inertial)
    pairs = [(body, inertial), (body, mirrored)] if is_as_good else [(body, inertial)]
    found = [_about(scene, one, off_rad, nominal_axis, nominal_rate_rad_s) for one in pairs]
    return min(filter(None, found), key=lambda one: _unsteadiness(scene, one), default=None)


def _about(
    scene: Scene,
    axes: tuple[Array, Array],
    off_rad: float,
    nominal_axis: Array | None,
    nominal_rate_rad_s: float | None,
) -> SpinSolution | None:
    """The turn about an axis in the body and in inertial space, of any sign; None where there is none."""
    reference, w = scene.reference_eci_nt, scene.calibrated_nt
    assert reference is not None
    axis_body, axis_eci = axes
    if nominal_axis is not None and float(axis_body @ nominal_axis) < 0.0:
        axis_body, axis_eci = -axis_body, -axis_eci
    misfit = w @ axis_body - reference @ axis_eci
    if not rms(misfit) <= LARGEST_MISFIT * float(np.mean(scene.magnitude_nt)):
        return None
    turn, strength = turns_of(w, reference, axis_body, axis_eci)
    rate = _rate(scene, turn, nominal_rate_rad_s)
    if rate is None:
        return None
    if nominal_axis is None and rate < 0.0:
        axis_body, axis_eci, turn, rate = -axis_body, -axis_eci, np.conj(turn), -rate
        misfit = -misfit
    raw, smooth = phases(scene, turn, strength, rate)
    attitude = attitude_of(axis_body, axis_eci, smooth)
    mean_rate = float(np.polyfit(scene.time_s, smooth, 1)[0])
    lever = float(np.quantile(np.abs(reference @ axis_eci) / np.maximum(strength, 1e-9), _MOST_OF_IT))
    size_nt, bent_rad = float(np.mean(scene.magnitude_nt)), 2.0 * off_rad * lever
    return SpinSolution(axis_body, axis_eci, smooth, raw, mean_rate, attitude, misfit, strength, size_nt, bent_rad)


def _mirrored(axis_eci: Array, reference: Array) -> Array:
    """The axis (3,) beyond the plane that the field (n, 3) stays nearest to: H . a_i is the same for a field in it.

    A turn about that one would take up the field's own turn in the plane twice, so the rate would not be steady.
    """
    normal = np.linalg.eigh(reference.T @ reference)[1][:, 0]
    return np.asarray(axis_eci - 2.0 * float(axis_eci @ normal) * normal)


def _unsteadiness(scene: Scene, spin: SpinSolution) -> float:
    """rms of a turn's phase about a steady one [rad], by the field across the axis."""
    line = np.polyfit(scene.time_s, spin.raw_phase_rad, 1, w=spin.across_nt)
    left = spin.raw_phase_rad - np.polyval(line, scene.time_s)
    return float(np.sqrt(np.average(left**2, weights=spin.across_nt**2)))


def _axes(w: Array, reference: Array) -> tuple[Array, Array, float] | None:
    """Axis in the body and in inertial space (3,) each, and how far either may be off [rad]; None where the vectors do
    not tell them.

    They make |w . a_b - H . a_i| least among pairs of one length.  While the field stays near a plane, as over a short
    arc, H . a_i is small for another direction as well, and the singular vector alone is a mixture of the two.
    """
    rows = np.hstack([w, -reference])
    normal = rows.T @ rows
    pair = _of_one_length(normal)
    if pair is None:
        return None
    lost = float(pair @ normal @ pair)
    multiplier = float(pair @ (_SIGNS * (normal @ pair)))
    tangents = np.linalg.qr(np.stack([pair, _SIGNS * pair], axis=1), mode="complete")[0][:, 2:]
    bent = normal - multiplier * np.diag(_SIGNS) - lost * np.eye(6)
    least = float(np.linalg.eigvalsh(tangents.T @ bent @ tangents)[0])  # what a turn of an axis costs, the cheapest
    off_rad = math.sqrt(max(lost, 0.0) / least) if least > 0.0 else math.inf
    is_well_seen = 4.0 * least > _WELL_SEEN**2 * float(np.trace(normal))
    if off_rad > _MOST_OFF_RAD[is_well_seen]:
        return None
    body, inertial = pair[:3], pair[3:]
    return body / np.linalg.norm(body), inertial / np.linalg.norm(inertial), off_rad


def _of_one_length(normal: Array) -> Array | None:
    """(6,) that makes x' N x least among vectors of length one whose halves are of one length; None: there is none.

    That is where the smallest eigenvalue of N - m J is largest, J being 1 on the first half and -1 on the second; it is
    concave in m, so the difference of the halves' lengths, its slope, changes sign once.
    """
    low, high = -float(np.trace(normal)), float(np.trace(normal))
    vectors = np.linalg.eigh(normal)[1]
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        vectors = np.linalg.eigh(normal - middle * np.diag(_SIGNS))[1]
        if float(_SIGNS @ vectors[:, 0] ** 2) > 0.0:  # the first half is longer: it has to cost more
            high = middle
        else:
            low = middle
    least, next_ = vectors[:, 0], vectors[:, 1]
    more = float(_SIGNS @ least**2)
    if abs(more) < _ALIKE:
        return np.asarray(least)
    # two of them cost the same there, of which one has the one half longer and one the other: what lies between
    crossed, other = float(_SIGNS @ (least * next_)), float(_SIGNS @ next_**2)
    root = crossed**2 - more * other
    if root < 0.0 or not abs(other) > _ALIKE:
        return None
    mixed = least + (-crossed + math.copysign(math.sqrt(root), more)) / other * next_
    return np.asarray(mixed / np.linalg.norm(mixed))


def turns_of(w: Array, reference: Array, axis_body: Array, axis_eci: Array) -> tuple[Array, Array]:
    """exp(i phase) of each sample (n,), complex, and the part of the reference across the axis (n,) [nT]."""
    b1, b2 = across(axis_body)
    i1, i2 = across(axis_eci)
    body = w @ b1 + 1j * (w @ b2)
    inertial = reference @ i1 + 1j * (reference @ i2)
    turn = inertial * np.conj(body)
    return turn / np.maximum(np.abs(turn), 1e-9), np.abs(inertial)


def _rate(scene: Scene, turn: Array, nominal: float | None) -> float | None:
    """Rate [rad/s] from the mean phase step between neighbours, by the strongest line of exp(i phase)."""
    period = scene.period_s
    steps = np.diff(scene.time_s)
    near = np.abs(steps - period) < 0.2 * period
    product = (turn[1:] * np.conj(turn[:-1]))[near]
    if len(product) < 30:
        return None
    mean = product.mean()
    if abs(mean) < 0.2:
        return None
    rate = float(np.angle(mean)) / period
    if nominal is not None:
        alias = 2.0 * np.pi / period
        rate += alias * round((nominal - rate) / alias)
    return rate


def attitude_of(axis_body: Array, axis_eci: Array, phase: Array) -> Array:
    """(n, 3, 3) body from ECI: inertial triad -> turned by -phase about the axis -> body triad."""
    body = np.stack([*across(axis_body), axis_body])
    inertial = np.stack([*across(axis_eci), axis_eci])
    cosine, sine = np.cos(phase), np.sin(phase)
    turn = np.zeros((len(phase), 3, 3))
    turn[:, 0, 0], turn[:, 0, 1] = cosine, sine
    turn[:, 1, 0], turn[:, 1, 1] = -sine, cosine
    turn[:, 2, 2] = 1.0
    return np.asarray(body.T @ turn @ inertial)
