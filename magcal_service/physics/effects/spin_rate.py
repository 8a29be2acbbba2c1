"""The rate is not what was assumed, or changes: torque, despin, spin-up."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from magcal_service.model import Array
from magcal_service.physics.acting import ActsOn
from magcal_service.physics.interface import Effect, Finding, value_of
from magcal_service.physics.scene.view import View

_LEAST_NATS: Final = 15.0
"""Evidence from which on a rate changes: odds of 3 million, after the number of samples."""

_LEAST_BEND_RAD: Final = math.radians(3.0)
"""Least bend of the phase over the recording; choice: less moves no vector by more than 5 % of the field across."""

_LEAST_SHARE: Final = 0.001
"""Least difference from the stated rate that is one; choice: a rate is stated to three digits at best."""

_MOST_BENT: Final = 7
"""Order of the phase's polynomial at the most: of a rate that dies away to a twentieth it leaves 0.02 % at the start,
and its columns still keep five digits."""

_BACK: Final = 0.05
"""Of all that a rate changes, what it may go back again where one torque takes it: what a polynomial of this order is
off by at its ends.  What goes back and forth is no torque's, and may be the direction that a phase is counted from."""

_SIGMAS: Final = 5.0
"""Sigmas of the rate that a difference has to have: by chance once in 2 million."""

_STANDS_OUT: Final = 3.0
"""Of its own sigma, by which the rate or its change has to differ from what was stated, as all effects' numbers do."""

TO_RPM: Final = 30.0 / math.pi
"""rad/s to turns a minute."""


def _tolerance(nominal_rad_s: float) -> float:
    """How far a steady rate may be from the stated one [rad/s]: half a unit of its last digit, at least 0.1 %."""
    rpm = abs(nominal_rad_s) * TO_RPM
    text = f"{rpm:.9g}".partition("e")[0]
    unit = 10.0 ** -len(text.partition(".")[2])
    return max(_LEAST_SHARE * rpm, 0.5 * unit) / TO_RPM


def _find(view: View) -> Finding | None:
    turn, scene = view.turn, view.scene
    if turn is None or len(scene.pauses) > 1 or len(scene) < 200:
        return None
    time_s = scene.time_s - scene.time_s[0]
    span = max(float(time_s[-1]), 1.0)
    sigma = view.noise_nt / np.maximum(turn.across_nt, 1e-3 * scene.magnitude_nt)
    orders = [_fitted(turn.raw_phase_rad, time_s / span, sigma, order) for order in range(1, _MOST_BENT + 1)]
    line, curve = orders[:2]
    scatter = max(1.0, float(np.mean(curve.left**2)))
    bend = abs(float(curve.values[2])) / 4.0
    # what the direction may bend that the phase is counted from, and what the axis bends where it is off
    drifted = turn.drift_rad_s * span / 4.0 + turn.bent_rad
    nats = 0.5 * (float(line.left @ line.left) - float(curve.left @ curve.left)) / scatter - math.log(len(scene))
    drifting = nats > _LEAST_NATS and bend > _LEAST_BEND_RAD + drifted
    nominal = view.nominal_rate_rad_s
    steady_sigma = math.sqrt(line.covariance[1, 1] * max(1.0, float(np.mean(line.left**2)))) / span
    allowed = (
        0.0
        if nominal is None
        else _tolerance(nominal) + turn.drift_rad_s + turn.bent_rad / span + _SIGMAS * steady_sigma
    )
    other = nominal is not None and abs(turn.rate_rad_s - nominal) > allowed
    if not drifting and not other:
        return None
    # beneath what the direction bends nothing is the rate's
    curve, *more = _as_bent(orders[1:]) if float(np.std(curve.left * sigma)) > drifted else orders[1:3]
    sigmas = np.sqrt(np.diagonal(curve.covariance) * max(1.0, float(np.mean(curve.left**2))))
    # what more orders say otherwise, and the turn of the direction itself
    bent = turn.bent_rad  # at one end of three and at another, so once for a rate and twice for its change
    otherwise = np.max([np.abs(one.values[:3] - curve.values[:3]) for one in more], axis=0)
    rate_sigma = math.hypot(sigmas[1], float(otherwise[1]), 0.5 * turn.drift_rad_s * span, bent)
    change_sigma = math.hypot(sigmas[2], float(otherwise[2]), 0.25 * turn.drift_rad_s * span, 2.0 * bent)
    start_rad_s = float(curve.values[1]) / span
    differs = nominal is not None and abs(start_rad_s - nominal) > _STANDS_OUT * rate_sigma / span
    if not differs and abs(float(curve.values[2])) < _STANDS_OUT * change_sigma:
        return None  # neither number, with all that it may be off by, differs from what was stated
    parameters = {
        "rate_rpm": value_of(float(curve.values[1]) / span * TO_RPM, rate_sigma / span * TO_RPM, "rpm"),
        "rate_rpm_per_s": value_of(
            2.0 * float(curve.values[2]) / span**2 * TO_RPM, 2.0 * change_sigma / span**2 * TO_RPM, "rpm/s"
        ),
    }
    if nominal is not None:
        parameters["nominal_rpm"] = value_of(nominal * TO_RPM, 0.0, "rpm")
    total = float(line.left @ line.left) - len(scene)
    drop = float(line.left @ line.left - curve.left @ curve.left)
    share = 1.0 if other and not drifting else min(1.0, drop / max(total, 1.0))
    return Finding(parameters, max(nats, _LEAST_NATS), max(share, 0.0))


class _Fitted(NamedTuple):
    """Polynomial (order + 1,), what it leaves (n,) in sigmas, and its covariance."""

    values: Array
    left: Array
    covariance: Array


def _as_bent(orders: Sequence[_Fitted]) -> Sequence[_Fitted]:
    """The polynomial of the least order that the next one gains no evidence over, and that next one; all of a rate that
    goes back and forth by it: they disagree by what none of them is right in."""
    enough = _LEAST_NATS + math.log(len(orders[0].left))
    scatter = max(1.0, float(np.mean(orders[-1].left ** 2)))
    squares = [float(one.left @ one.left) for one in orders]
    gained = [0.5 * (of_one - of_more) / scatter for of_one, of_more in itertools.pairwise(squares)]
    at = next((index for index, nats in enumerate(gained) if nats < enough), len(gained) - 1)
    return orders[at : at + 2] if _is_one_way(orders[at]) else orders


def _is_one_way(fitted: _Fitted) -> bool:
    """Whether a phase's rate changes in one sense."""
    slope = np.polynomial.Polynomial(fitted.values).deriv()
    steps = np.diff(slope(np.linspace(0.0, 1.0, 41)))
    return float(min(np.maximum(steps, 0.0).sum(), np.maximum(-steps, 0.0).sum())) <= _BACK * float(np.abs(steps).sum())


def _fitted(phase_rad: Array, share: Array, sigma_rad: Array, order: int) -> _Fitted:
    weight = 1.0 / np.maximum(sigma_rad, 1e-6)
    design = np.vander(share, order + 1, increasing=True) * weight[:, None]
    values, *_ = np.linalg.lstsq(design, phase_rad * weight, rcond=None)
    return _Fitted(values, phase_rad * weight - design @ values, np.linalg.inv(design.T @ design))


EFFECT = Effect(
    name="spin_rate",
    acts_on=ActsOn.ATTITUDE,
    title="the spin rate is not what was assumed, or changes",
    equation="phase = phase_0 + rate t + change t^2 / 2 (+ t^3 .. t^7 where uneven), from the field across the axis",
    units={"rate_rpm": "rpm", "rate_rpm_per_s": "rpm/s", "nominal_rpm": "rpm"},
    prior=(10.0, 50000.0),
    valid="turn about one axis; the rate changes smoothly; seen in the vectors, never in their magnitude",
    confused_with=("nutation", "time_offset"),
    separated_by="a later recording",
    or_record=(("angular rate", "a gyro"),),
    source="Wertz 1978, section 17.2: eddy-current torque despins over hours to months",
    says=("The craft turns at {rate_rpm.size} at the start, changing by {rate_rpm_per_s.signed}.",),
    find=_find,
    absorbed="the magnitude is the same whatever the attitude: only the windows of the pseudo-measurements leak",
)
