"""The numbers of an answer, in the conventions of README.md, explain the recording down to its noise."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pytest

from magcal_service.earth import geomagnetic
from tests.blind import Case, draw_case
from tests.blind.field import YEAR_S, dipole_axis_eci, ring_current_field, times_ns
from tests.blind.vectors import Floats, hermite, unit

Truth = Mapping[str, Any]
SEED = 62
EVERY = 5


def _length(case: Case) -> Floats:
    vectors = case.reference_nt
    return np.asarray(np.linalg.norm(vectors, axis=1) if vectors.ndim == 2 else vectors, dtype=np.float64)


def _channel(case: Case, name: str) -> Floats:
    return next(channel.values for channel in case.channels if channel.name == name)


def _residual(case: Case, disturbance: Floats | None = None, scale: Floats | None = None) -> Floats:
    """Calibrated length without a disturbance d (n, 3) and with a change of D's diagonal (n, 3), minus reference."""
    field = case.field_nt
    corrected = field @ (np.eye(3) + np.array(case.answer.scale)) - np.array(case.answer.bias_nt)
    if scale is not None:
        corrected = corrected + scale * field
    if disturbance is not None:
        corrected = corrected - disturbance
    return np.asarray(np.linalg.norm(corrected, axis=1) - _length(case), dtype=np.float64)


def _ecef_km(case: Case) -> Floats:
    assert case.position is not None
    if case.position_form == "ecef":
        return case.position
    latitude, longitude, altitude = case.position.T
    return geomagnetic.ecef_from_geodetic(latitude, longitude, altitude)


def _after(case: Case, truth: Truth) -> Floats:
    return np.asarray((case.time_s >= truth["at_s"])[:, None], dtype=np.float64)


def _centred(case: Case) -> Floats:
    return np.asarray((case.time_s - case.time_s.mean())[:, None], dtype=np.float64)


def thermal_bias(case: Case, truth: Truth) -> Floats:
    warmer = _channel(case, "temperature") - truth["reference_degc"]
    return _residual(case, warmer * np.array(truth["nt_per_k"]))


def thermal_scale(case: Case, truth: Truth) -> Floats:
    warmer = _channel(case, "temperature") - truth["reference_degc"]
    return _residual(case, scale=warmer * np.array(truth["per_k"]))


def current_loop(case: Case, truth: Truth) -> Floats:
    currents = np.concatenate([_channel(case, name) for name in truth["channels"]], axis=1)
    return _residual(case, currents @ np.array(truth["nt_per_a"]))


def torquer(case: Case, truth: Truth) -> Floats:
    if truth["remanence_share"]:
        pytest.skip("the command alone does not say what the cores keep")
    return _residual(case, _channel(case, "torquer") @ np.array(truth["nt_per_am2"]).T)


def bias_step(case: Case, truth: Truth) -> Floats:
    return _residual(case, _after(case, truth) * np.array(truth["step_nt"]))


def scale_step(case: Case, truth: Truth) -> Floats:
    return _residual(case, scale=_after(case, truth) * np.array(truth["step"]))


def bias_drift(case: Case, truth: Truth) -> Floats:
    return _residual(case, _centred(case) * np.array(truth["nt_per_s"]))


def scale_drift(case: Case, truth: Truth) -> Floats:
    return _residual(case, scale=_centred(case) * np.array(truth["per_s"]))


def cubic_response(case: Case, truth: Truth) -> Floats:
    field = case.field_nt
    straight, transverse = np.array(truth["per_nt2"]), np.array(truth["transverse_per_nt2"])
    return _residual(case, straight * field**3 + field * (field**2 @ transverse.T))


def sun_disturbance(case: Case, truth: Truth) -> Floats:
    sun = np.nan_to_num(_channel(case, "sun"))
    products = np.stack([sun[:, 0] * sun[:, 1], sun[:, 0] * sun[:, 2], sun[:, 1] * sun[:, 2]], axis=-1)
    field = sun @ np.array(truth["nt_linear"]).T + products @ np.array(truth["nt_products"]).T
    return _residual(case, field)


def _against(case: Case, length: Floats, every: int = 1) -> Floats:
    """Residual of every so many samples against another reference length (m,)."""
    return (_residual(case) + _length(case))[::every] - length


def time_offset(case: Case, truth: Truth) -> Floats:
    late = case.time_s + truth["offset_s"] + 1e-6 * truth["drift_ppm"] * case.time_s
    step = case.time_s[1] - case.time_s[0]
    inside = (late > 0.0) & (late < case.time_s[-1])
    stride = max(1, round(10.0 / step))
    coarse = hermite(0.0, stride * step, _length(case)[::stride, None], late)[:, 0]
    within = inside & (late < case.time_s[-1] - 2 * stride * step)
    return np.asarray(_against(case, coarse)[within], dtype=np.float64)


def reference_epoch(case: Case, truth: Truth) -> Floats:
    assert case.start_unix_s is not None
    utc = times_ns(case.start_unix_s, case.time_s)[::EVERY]
    place = _ecef_km(case)[::EVERY]
    if "years" in truth:
        old = geomagnetic.igrf_ecef_nt(utc - round(truth["years"] * YEAR_S) * 10**9, place)
        assert np.abs(np.linalg.norm(old, axis=1) - _length(case)[::EVERY]).max() < 0.5
    return _against(case, np.linalg.norm(geomagnetic.igrf_ecef_nt(utc, place), axis=1), EVERY)


def position_offset(case: Case, truth: Truth) -> Floats:
    assert case.start_unix_s is not None
    utc = times_ns(case.start_unix_s, case.time_s)
    place = geomagnetic.eci_from_ecef(utc, _ecef_km(case))
    radial = unit(place)
    across = unit(np.cross(radial, np.gradient(place, axis=0)))
    along = np.cross(across, radial)
    forward = truth["along_km"] + truth["along_km_per_s"] * case.time_s
    true = place + truth["radial_km"] * radial + forward[:, None] * along + truth["cross_km"] * across
    true_nt = geomagnetic.igrf_eci_nt(utc[::EVERY], true[::EVERY])
    return _against(case, np.linalg.norm(true_nt, axis=1), EVERY)


def tone(case: Case, truth: Truth) -> Floats:
    """At its frequency the tone's strength is fitted (its phase is not in the answer) and compared."""
    angle = 2.0 * np.pi * truth["frequency_hz"] * case.time_s
    corrected = case.field_nt @ (np.eye(3) + np.array(case.answer.scale)) - np.array(case.answer.bias_nt)
    u = unit(corrected)
    columns = np.concatenate([u * np.cos(angle)[:, None], u * np.sin(angle)[:, None]], axis=1)
    fitted = np.linalg.lstsq(columns, _residual(case), rcond=None)[0]
    sigma = case.answer.noise_nt * math.sqrt(2.0 * 3.0 / len(angle))
    assert np.linalg.norm(fitted) == pytest.approx(truth["amplitude_nt"], abs=6.0 * sigma)
    return np.asarray(_residual(case) - columns @ fitted, dtype=np.float64)


CHECKS: tuple[Callable[[Case, Truth], Floats], ...] = (
    thermal_bias,
    thermal_scale,
    current_loop,
    torquer,
    bias_step,
    scale_step,
    bias_drift,
    scale_drift,
    cubic_response,
    sun_disturbance,
    time_offset,
    reference_epoch,
    position_offset,
    tone,
)


def _draw(kind: str) -> Case:
    """The first case whose answer is given in the form that is checked."""
    for seed in range(SEED, SEED + 1000, 100):
        case = draw_case(seed, kind, detectability=(25.0, math.inf), strengths=(0.5, 2.0))
        truth = case.answer.effects[0].parameters
        if truth.get("shape", "linear") == "linear" and not truth.get("remanence_share"):
            return case
    raise AssertionError(f"no {kind} of the wanted form from seed {SEED} on")


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.__name__)
def test_answer_explains_the_recording(check: Callable[[Case, Truth], Floats]) -> None:
    """With the effect taken out by the answer's numbers the residual is the noise, and before it was more."""
    case = _draw(check.__name__)
    before = float(np.sqrt(np.mean(_residual(case) ** 2)))
    left = check(case, case.answer.effects[0].parameters)
    after = float(np.sqrt(np.mean(left**2)))
    assert after == pytest.approx(case.answer.noise_nt, rel=4.0 / math.sqrt(2 * len(left)) + 2e-3)
    assert before > 1.02 * after


def test_storm_has_the_peak_of_its_answer() -> None:
    """Where the residual is largest over time it is what a ring current of the answer's peak gives."""
    case = draw_case(64, "external_field", detectability=(60.0, math.inf), strengths=(1.0, 2.0))
    assert case.start_unix_s is not None
    utc = times_ns(case.start_unix_s, case.time_s[::EVERY])
    place = geomagnetic.eci_from_ecef(utc, _ecef_km(case)[::EVERY])
    axis = dipole_axis_eci(case.start_unix_s, case.time_s[::EVERY])
    one = ring_current_field(np.ones(len(utc)), axis, place)
    along = np.sum(one * unit(geomagnetic.igrf_eci_nt(utc, place)), axis=1)
    residual = _residual(case)[::EVERY]
    parts = np.array_split(np.arange(len(utc)), 12)
    course = [float(along[part] @ residual[part] / (along[part] @ along[part])) for part in parts]
    peak = case.answer.effects[0].parameters["peak_nt"]
    assert min(course) == pytest.approx(peak, rel=0.2)
