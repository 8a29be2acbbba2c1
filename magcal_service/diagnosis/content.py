"""What ``diagnosis.json`` holds."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from magcal_service.diagnosis.diagnose import Diagnosis
from magcal_service.diagnosis.entry import Entry
from magcal_service.diagnosis.errors_spread import errors_sigma
from magcal_service.diagnosis.locate import Place, locate
from magcal_service.diagnosis.mounting import mounting_of
from magcal_service.diagnosis.problem import Fit
from magcal_service.diagnosis.reference_off import reference_off_of
from magcal_service.diagnosis.result import entries, held_out_rms, moved_bias
from magcal_service.diagnosis.rows import account_of
from magcal_service.diagnosis.words import compared_with, verdict_sentence
from magcal_service.model import BIAS, STATE_SIZE, d_matrix
from magcal_service.offline.result_head import DIAGNOSIS, head
from magcal_service.physics.apply.advice import advice


def as_json(diagnosis: Diagnosis, found: Sequence[Entry] | None = None) -> str:
    """The contract's ``diagnosis.json``."""
    found = entries(diagnosis) if found is None else found
    fit = diagnosis.fit
    sigma = errors_sigma(fit)
    mounting, reference_off = mounting_of(fit), reference_off_of(fit)
    moved_nt, moved_sigma_nt = moved_bias(diagnosis)
    places: Sequence[Place] = locate(diagnosis.search, diagnosis.prepared.baseline)
    content: dict[str, Any] = {
        **head(DIAGNOSIS),
        "verdict": str(diagnosis.verdict),
        "sentence": verdict_sentence(diagnosis, found, held_out_rms(diagnosis)),
        "compared_with": compared_with(has_simulation=diagnosis.has_simulation),
        "effects": [entry.as_json() for entry in found],
        "fit": {
            "noise_floor_nt": diagnosis.noise_nt,
            "noise_is_stated": diagnosis.prepared.view.stated_noise_nt is not None,
            "added_noise_nt": diagnosis.added_noise_nt,
            "noise_by_axis_nt": _by_axis(fit, diagnosis.noise_nt),
            "noise_with_memory_nt": diagnosis.memory_nt,
            "held_out_rms_nt": held_out_rms(diagnosis),
            "in_sample_rms_nt": {"recalibrated": diagnosis.prepared.baseline.rms_nt, "with_effects": fit.rms_nt},
            "bias_nt": fit.x[BIAS].tolist(),
            "D": d_matrix(fit.x[:STATE_SIZE]).tolist(),
            "sigma": {"bias_nt": sigma[BIAS].tolist(), "D": d_matrix(sigma).tolist()},
            "errors_hold_at": [one.to_dict() for one in diagnosis.held_at],
            "bias_before_nt": diagnosis.prepared.baseline.x[BIAS].tolist(),
            "bias_moved_nt": moved_nt,
            "bias_moved_sigma_nt": moved_sigma_nt,
            "vectors_off_nt": diagnosis.misled.to_dict() if fit.terms else None,
        },
        "residual": str(diagnosis.prepared.form),
        "not_borne_out": [str(form) for form in diagnosis.refused],
        "mounting": None if mounting is None else mounting.as_json(),
        "reference_off": None if reference_off is None else reference_off.as_json(),
        "located": [place.as_json() for place in places],
        "empirical": None if diagnosis.modelled is None else diagnosis.modelled.as_json(),
        "unexplained_share": round(diagnosis.unexplained, 4),
        "left_share": round(diagnosis.left_share, 4),
        "rows": account_of(diagnosis.inspection, diagnosis.prepared).to_dict(),
        "spin": _spin(diagnosis),
        "sun_seen": None if diagnosis.prepared.sun is None else asdict(diagnosis.prepared.sun),
        "seconds": round(diagnosis.seconds, 2),
        "converged": fit.converged,
        "trusted": diagnosis.trusted,
        "reasons": list(diagnosis.reasons),
        "advice": advice(diagnosis.reasons, diagnosis.concerned),
        "findings": [one.to_dict() for one in diagnosis.inspection.findings],
    }
    return json.dumps(content, indent=2, allow_nan=False) + "\n"


def _by_axis(fit: Fit, noise_nt: float) -> list[float] | None:
    """Noise of each axis of the sensor [nT]; None where it may be alike in all directions."""
    covariance = fit.problem.noise_covariance
    if covariance is None:
        return None
    inverse = np.linalg.inv(np.eye(3) + d_matrix(fit.x[:STATE_SIZE]))
    variances = np.diagonal(inverse @ covariance @ inverse.T)
    return [round(float(one), 3) for one in noise_nt * np.sqrt(variances / variances.mean())]


def _spin(diagnosis: Diagnosis) -> dict[str, Any] | None:
    spin = diagnosis.spin
    if spin is None:
        return None
    return {
        "axis_body": spin.axis_body.tolist(),
        "axis_eci": spin.axis_eci.tolist(),
        "rate_rpm": spin.rate_rpm,
    }
