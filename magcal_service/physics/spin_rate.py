"""The rate is not what was assumed, or changes: torque, despin, spin-up."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from magcal_service.physics.interface import Effect, Finding, value_of
from magcal_service.physics.view import View

_LEAST_NATS: Final = 15.0
_LEAST_BEND_RAD: Final = math.radians(3.0)
_LEAST_SHARE: Final = 0.001


def _tolerance(nominal_rad_s: float) -> float:
    """How far a steady rate may be from the stated one [rad/s]: half a unit of its last digit, at least 0.1 %."""
    rpm = abs(nominal_rad_s) * 30.0 / math.pi
    text = f"{rpm:.9g}".partition("e")[0]
    unit = 10.0 ** -len(text.partition(".")[2])
    return max(_LEAST_SHARE * rpm, 0.5 * unit) * math.pi / 30.0


def _find(view: View) -> Finding | None:
    spin, scene = view.spin, view.scene
    if spin is None or len(scene.pauses) > 1 or len(scene) < 200:
        return None
    time_s = scene.time_s - scene.time_s[0]
    sigma = view.noise_nt / np.maximum(spin.across_nt, 1e-3 * scene.magnitude_nt)
    weight = 1.0 / np.maximum(sigma, 1e-6)
    span = max(float(time_s[-1]), 1.0)
    x = time_s / span
    fits = []
    for order in (1, 2):
        design = np.vander(x, order + 1, increasing=True) * weight[:, None]
        values, *_ = np.linalg.lstsq(design, spin.raw_phase_rad * weight, rcond=None)
        left = spin.raw_phase_rad * weight - design @ values
        fits.append((values, left, np.linalg.inv(design.T @ design)))
    (_, left_1, _), (bent, left_2, covariance) = fits
    scatter = max(1.0, float(np.mean(left_2**2)))
    bend = abs(float(bent[2])) / 4.0
    nats = 0.5 * (float(left_1 @ left_1) - float(left_2 @ left_2)) / scatter - math.log(len(scene))
    drifting = nats > _LEAST_NATS and bend > _LEAST_BEND_RAD
    nominal = view.nominal_rate_rad_s
    other = nominal is not None and abs(spin.rate_rad_s - nominal) > _tolerance(nominal)
    if not drifting and not other:
        return None
    to_rpm = 30.0 / math.pi
    sigmas = np.sqrt(np.diagonal(covariance) * scatter)
    parameters = {
        "rate_rpm": value_of(float(bent[1]) / span * to_rpm, float(sigmas[1]) / span * to_rpm, "rpm"),
        "rate_rpm_per_s": value_of(
            2.0 * float(bent[2]) / span**2 * to_rpm, 2.0 * float(sigmas[2]) / span**2 * to_rpm, "rpm/s"
        ),
    }
    if nominal is not None:
        parameters["nominal_rpm"] = value_of(nominal * to_rpm, 0.0, "rpm")
    total = float(left_1 @ left_1) - len(scene)
    share = 1.0 if other and not drifting else min(1.0, (float(left_1 @ left_1 - left_2 @ left_2)) / max(total, 1.0))
    return Finding(parameters, max(nats, _LEAST_NATS), max(share, 0.0))


EFFECT = Effect(
    name="spin_rate",
    title="the spin rate is not what was assumed, or changes",
    equation="phase = phase_0 + rate t + change t^2 / 2, from the part of the field across the axis",
    units={"rate_rpm": "rpm", "rate_rpm_per_s": "rpm/s", "nominal_rpm": "rpm"},
    prior=(10.0, 50000.0),
    valid="turn about one axis; the rate changes smoothly; seen in the vectors, never in their magnitude",
    confused_with=("nutation", "time_offset"),
    separated_by="a gyro; a later recording",
    source="Wertz 1978, section 17.2: eddy-current torque despins over hours to months",
    says=("The craft turns at {rate_rpm} rpm at the start, changing by {rate_rpm_per_s} rpm per second.",),
    find=_find,
    absorbed="the magnitude is the same whatever the attitude: only the windows of the pseudo-measurements leak",
)
