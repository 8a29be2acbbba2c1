"""A chip whose axes are not alike noisy: found out, and no physics made of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from magcal_service.diagnosis.axis_noise import shares_of, step_to_clean
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


@pytest.mark.parametrize("rate_rad_s", [0.01, 0.15, 0.9, 2.3], ids=["slow", "spin", "by the residual", "fast"])
@pytest.mark.parametrize("noise_nt", [NOISE_NT, np.full(3, 600.0)], ids=["unlike", "alike"])
def test_the_noise_of_each_axis_is_told(rate_rad_s: float, noise_nt: Array) -> None:
    of = flown(8000, rate_rad_s, 8921, noise_nt)
    found = shares_of(of, X, *seen(of), 600.0)
    assert found is not None
    assert found == pytest.approx(noise_nt**2 / np.mean(noise_nt**2), abs=0.12)


@pytest.mark.parametrize(("stated_nt", "is_told"), [(600.0, False), (None, True)])
def test_a_load_that_switches_from_row_to_row_is_no_noise(stated_nt: float | None, is_told: bool) -> None:
    """Beside the noise that was stated it is more; where none was, nothing tells them apart."""
    of = flown(4000, 0.02, 8929)
    on = np.random.default_rng(8930).random(len(of)) < 0.5
    loaded = replace(of, field_nt=of.field_nt + np.array([0.0, 0.0, 2500.0]) * on[:, None])
    assert (shares_of(loaded, X, *seen(loaded), stated_nt) is not None) is is_told


def test_of_few_samples_nothing_is_told() -> None:
    of = flown(200, 0.15, 8922)
    assert shares_of(of, X, *seen(of), 600.0) is None


@pytest.mark.parametrize("stated_nt", [None, 200.0])
def test_of_a_fast_craft_s_residual_that_may_be_more_than_noise_nothing_is_told(stated_nt: float | None) -> None:
    """A gain that is left, of 3 % on one axis, goes with the field's direction as such an axis' noise does."""
    of = flown(8000, 2.3, 8927)
    unit, residual = seen(of)
    left = residual + 0.03 * 3e4 * unit[:, 0] ** 2
    assert shares_of(of, X, unit, left, stated_nt) is None


def test_a_share_that_a_recording_says_little_of_stays_near_what_is_usual() -> None:
    """The field lies across the last axis: its noise does not show, whatever it is, and samples are jumps."""
    of = flown(2000, 0.15, 8923)
    flat = np.array(of.calibrated_nt)
    flat[:, 2] = 0.0
    rng = np.random.default_rng(8924)
    field = measure(X, flat * rng.choice([-1.0, 1.0], size=(2000, 1))) + NOISE_NT * rng.standard_normal((2000, 3))
    still = replace(of, field_nt=field, magnitude_nt=np.linalg.norm(flat, axis=1))
    found = shares_of(still, X, *seen(still), 600.0)
    assert found is not None
    assert found[2] == pytest.approx(1.0, abs=0.3)


@pytest.mark.parametrize("shares", [SHARES, None], ids=["known", "taken as alike"])
def test_what_is_left_of_the_noise_goes_along_with_nothing_that_is_seen(shares: Array | None) -> None:
    of = flown(20_000, 0.15, 8925)
    unit, residual = seen(of)
    true = of.calibrated_nt
    clean = (residual + of.magnitude_nt)[:, None] * unit - step_to_clean(X, unit, shares) * residual[:, None]
    along = np.corrcoef(np.concatenate([(clean - true).T, residual[None]]))[-1, :3]
    by_direction = np.array([np.corrcoef((clean - true)[:, i] * true[:, 2] / 3e4, residual)[0, 1] for i in range(3)])
    most = float(np.abs(np.concatenate([along, by_direction])).max())
    assert (most < 0.03) is (shares is not None)


def test_a_clean_recording_of_such_a_chip_is_clean() -> None:
    """It was `unknown`, a body-fixed field that follows the field itself, at odds beyond all doubt."""
    of = flown(16_000, 0.07, 8926, 1.2 * NOISE_NT)
    made = Recording.from_arrays(of.time_ns.astype("datetime64[ns]"), of.field_nt, of.magnitude_nt)
    found = diagnose(made)
    assert (found.verdict, found.trusted) == (Verdict.NONE, True)
    assert found.fit.problem.axis_noise == pytest.approx(SHARES, abs=0.1)
