"""A chip whose axes are not alike noisy: found out, and no physics made of it."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from magcal_service.diagnosis.axis_noise import covariance_of, step_to_clean
from magcal_service.diagnosis.content import as_json
from magcal_service.diagnosis.diagnose import Verdict, diagnose
from magcal_service.earth.geomagnetic import igrf_eci_nt
from magcal_service.model import Array, d_matrix, measure
from magcal_service.physics.scene.scene import Scene
from magcal_service.recordings.recording import Recording
from tests.physics.scenes import AXIS_BODY, AXIS_ECI, ORIGIN_NS, X, orbit_eci_km, turning

NOISE_NT = np.array([500.0, 500.0, 750.0])
SHARES = NOISE_NT**2 / np.mean(NOISE_NT**2)


def flown(count: int, rate_rad_s: float, seed: int, noise_nt: Array = NOISE_NT) -> Scene:
    """A craft that turns about a fixed axis, at 1 Hz; calibrated vectors are the true ones."""
    time_s = np.arange(float(count))
    reference = igrf_eci_nt(ORIGIN_NS + (time_s * 1e9).astype(np.int64), orbit_eci_km(time_s))
    body = np.einsum("nij,nj->ni", turning(AXIS_BODY, AXIS_ECI, rate_rad_s * time_s), reference)
    noise = noise_nt * np.random.default_rng(seed).standard_normal((count, 3))
    size = np.linalg.norm(reference, axis=1)
    return Scene(time_s, ORIGIN_NS, True, measure(X, body) + noise, body, measure(X, body), size, reference)


def seen(of: Scene) -> tuple[Array, Array]:
    """Directions (n, 3) as calibrated with the true errors, and the residual (n,)."""
    w = of.field_nt @ (np.eye(3) + d_matrix(X)) - X[:3]
    length = np.linalg.norm(w, axis=1)
    return w / length[:, None], length - of.magnitude_nt


def told(of: Scene, stated_nt: float | None = 600.0) -> Array | None:
    """The covariance that a recording tells, at the true nine errors."""
    return covariance_of(of, X, *seen(of), stated_nt)


@pytest.mark.parametrize("rate_rad_s", [0.01, 0.15], ids=["slow", "spin"])
def test_noise_that_differs_between_the_axes_is_told(rate_rad_s: float) -> None:
    """Off the diagonal is what the nine errors make of it."""
    found = told(flown(8000, rate_rad_s, 8921))
    whole = np.eye(3) + d_matrix(X)
    true = whole @ np.diag(NOISE_NT**2) @ whole.T
    assert found == pytest.approx(3.0 * true / np.trace(true), abs=0.12)


@pytest.mark.parametrize("rate_rad_s", [0.01, 0.15, 0.9], ids=["slow", "spin", "fast"])
def test_noise_alike_in_all_directions_of_the_calibrated_vector_is_none(rate_rad_s: float) -> None:
    alike = np.linalg.inv(np.eye(3) + d_matrix(X))
    of = flown(8000, rate_rad_s, 8922, np.zeros(3))
    noise = 600.0 * np.random.default_rng(8923).standard_normal((8000, 3)) @ alike.T
    assert told(replace(of, field_nt=of.field_nt + noise)) is None


def test_of_a_fast_craft_or_few_samples_nothing_is_told() -> None:
    """A field that turns by a radian from sample to sample is in all their differences."""
    assert told(flown(8000, 0.9, 8924)) is None
    assert told(flown(200, 0.15, 8924)) is None


@pytest.mark.parametrize(("stated_nt", "is_told"), [(600.0, False), (None, True)])
def test_a_load_that_switches_from_row_to_row_is_no_noise(stated_nt: float | None, is_told: bool) -> None:
    """Beside the noise that was stated it is more; where none was, nothing tells them apart."""
    of = flown(4000, 0.02, 8929)
    on = np.random.default_rng(8930).random(len(of)) < 0.5
    loaded = replace(of, field_nt=of.field_nt + np.array([0.0, 0.0, 2500.0]) * on[:, None])
    assert (told(loaded, stated_nt) is not None) is is_told


def test_differences_that_say_more_than_is_seen_along_the_field_are_not_believed() -> None:
    """Jitter of the times is across the field, and is not in a magnitude."""
    of = flown(8000, 0.05, 8927, np.full(3, 20.0))
    jitter_s = 0.2 * np.random.default_rng(8928).standard_normal(len(of))
    moved = of.field_nt + jitter_s[:, None] * np.gradient(of.clean_field_nt, axis=0)
    assert told(replace(of, field_nt=moved), None) is None


@pytest.mark.parametrize("is_known", [True, False], ids=["known", "taken as alike"])
def test_what_is_left_of_the_noise_goes_along_with_nothing_that_is_seen(is_known: bool) -> None:
    of = flown(20_000, 0.15, 8925)
    unit, residual = seen(of)
    true, whole = of.calibrated_nt, np.eye(3) + d_matrix(X)
    step = step_to_clean(unit, whole @ np.diag(NOISE_NT**2) @ whole.T if is_known else None)
    clean = (residual + of.magnitude_nt)[:, None] * unit - step * residual[:, None]
    along = np.corrcoef(np.concatenate([(clean - true).T, residual[None]]))[-1, :3]
    by_direction = np.array([np.corrcoef((clean - true)[:, i] * true[:, 2] / 3e4, residual)[0, 1] for i in range(3)])
    most = float(np.abs(np.concatenate([along, by_direction])).max())
    assert (most < 0.03) is is_known


def test_a_clean_recording_of_such_a_chip_is_clean() -> None:
    """It was `unknown`, a body-fixed field that follows the field itself, at odds beyond all doubt."""
    of = flown(16_000, 0.07, 8926, 1.2 * NOISE_NT)
    made = Recording.from_arrays(of.time_ns.astype("datetime64[ns]"), of.field_nt, of.magnitude_nt)
    found = diagnose(made)
    assert (found.verdict, found.trusted) == (Verdict.NONE, True)
    by_axis = json.loads(as_json(found))["fit"]["noise_by_axis_nt"]
    assert by_axis == pytest.approx(found.noise_nt * np.sqrt(SHARES), rel=0.06)
