"""A coarse lattice on a craft that turns slowly: what rounding leaves lasts, and is neither noise nor a cause."""

from __future__ import annotations

import numpy as np
import pytest

from magcal_service import Recording
from magcal_service.diagnosis.diagnose import Diagnosis, Verdict, diagnose
from magcal_service.earth import geomagnetic
from magcal_service.model import Array, measure
from magcal_service.physics.catalogue import effect_named
from tests.physics.scenes import AXIS_BODY, AXIS_ECI, ORIGIN_NS, X, orbit_eci_km, turning

COUNT, PERIOD_S, NOISE_NT, STEP_NT = 1500, 4.0, 60.0, 700.0


def diagnosed(disturbance_nt: Array | float = 0.0, turn_s: float = 2400.0) -> Diagnosis:
    """A craft that turns once in so long, its samples rounded, with a body field (n, 3)."""
    time_s = np.arange(COUNT) * PERIOD_S
    time_ns = ORIGIN_NS + np.rint(time_s * 1e9).astype(np.int64)
    place = orbit_eci_km(time_s)
    reference = geomagnetic.igrf_eci_nt(time_ns, place)
    attitude = turning(AXIS_BODY, AXIS_ECI, 2.0 * np.pi * time_s / turn_s)
    body = np.einsum("nij,nj->ni", attitude, reference) + disturbance_nt
    field = measure(X, body + np.random.default_rng(77).normal(0.0, NOISE_NT, body.shape))
    recording = Recording.from_arrays(
        time_ns.astype("datetime64[ns]"),
        np.round(field / STEP_NT) * STEP_NT,
        reference,
        position_ecef_km=geomagnetic.ecef_from_eci(time_ns, place),
        noise_nt=NOISE_NT,
    )
    return diagnose(recording, effects=tuple(effect_named(name) for name in ("quantisation", "tone", "coloured_noise")))


def test_what_coarse_rounding_leaves_is_its_own() -> None:
    """Values on a lattice of twelve sigma: that is the name, and nothing is left that it could not be."""
    found = diagnosed()
    assert found.verdict is Verdict.NAMED
    assert list(found.findings) == ["quantisation"]
    assert found.trusted
    assert found.unexplained == 0.0


def test_what_is_larger_than_the_rounding_stays_unknown() -> None:
    """A field that comes and goes, twenty times what the lattice adds per axis."""
    on = np.random.default_rng(5).random(COUNT // 50) > 0.5
    found = diagnosed(np.repeat(on, 50)[:, None] * np.array([2700.0, -2100.0, 2400.0]))
    assert found.verdict is Verdict.UNKNOWN
    assert "quantisation" in found.findings
    assert found.unexplained == pytest.approx(1.0)
    assert "unexplained_structure" in found.reasons


def test_what_is_left_beneath_a_rounding_that_is_white_stays_unknown() -> None:
    """A craft that turns by more than a step from sample to sample: half of what the lattice adds is seen as it is."""
    on = np.random.default_rng(5).random(COUNT // 50) > 0.5
    found = diagnosed(np.repeat(on, 50)[:, None] * np.array([150.0, -110.0, 130.0]), turn_s=47.0)
    assert found.left[0].squares < len(found.fit.residual) * STEP_NT**2 / 12.0
    assert found.verdict is Verdict.UNKNOWN
