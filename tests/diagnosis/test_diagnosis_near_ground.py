"""What field models err by near the ground: its covariance, whole vectors whitened by it, and tracks over a crust."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.polynomial import legendre
from scipy.spatial.transform import Rotation

from magcal_service.diagnosis.diagnose import Verdict, diagnose
from magcal_service.diagnosis.field_error import FieldError, Scale
from magcal_service.diagnosis.knots import Lines, TurnedLines
from magcal_service.diagnosis.model_errors import heights_km, near_ground
from magcal_service.diagnosis.prepare import Form
from magcal_service.earth.geomagnetic import ecef_from_geodetic
from magcal_service.model import Array
from magcal_service.recordings.recording import Recording
from magcal_service.recordings.scene_of import scene_of
from magcal_service.recordings.specs import PlatformKind, PlatformSpec

COUNT = 1500
NOISE_NT = 40.0
BIAS_NT = np.array([800.0, -500.0, 300.0])


def track(speed_km_s: float, height_km: float = 0.5) -> Array:
    """Places (n, 3) along a meridian, a second apart [km]."""
    north = speed_km_s * np.arange(COUNT) / 111.2
    return np.asarray(ecef_from_geodetic(40.0 + north, np.full(COUNT, 33.0), np.full(COUNT, height_km)))


def crust(rng: np.random.Generator, way_km: Array, size_nt: float) -> Array:
    """(n, 3) waves of 4 to 80 km along a way (n,), rms of each component ``size_nt``, each with its own."""
    found = np.zeros((len(way_km), 3))
    for _ in range(60):
        wave = rng.uniform(2.0 * np.pi / 80.0, 2.0 * np.pi / 4.0)
        phase = wave * way_km[:, None] + rng.uniform(0.0, 6.28, 3)
        found += np.exp(-2.0 * wave) * rng.normal(size=3) * np.cos(phase)
    return np.asarray(size_nt * found / found.std(axis=0))


def recording(
    seed: int, crust_nt: float, *, vectors: bool, speed_km_s: float = 0.06, per_k_nt: Array | float = 0.0
) -> Recording:
    """A craft that turns every way while it flies; its reference leaves out a crust, and its temperature is known."""
    rng, time_s = np.random.default_rng([seed, 77]), np.arange(COUNT, dtype=np.float64)
    angles = [2.0 * np.sin(np.outer(time_s, rng.uniform(0.02, 0.06, 3)) + rng.uniform(0.0, 6.28, 3)) for _ in range(2)]
    turned = Rotation.from_euler("xyz", angles[0] + angles[1])
    reference = np.array([21e3, -4e3, 33e3]) + np.outer(time_s / COUNT, [-300.0, 200.0, 400.0])
    field = turned.apply(reference + (crust(rng, speed_km_s * time_s, crust_nt) if crust_nt else 0.0))
    warm_k = 8.0 * np.sin(time_s / 170.0 + 0.3) + 3.0 * np.sin(time_s / 61.0)
    measured = field + np.outer(warm_k, np.broadcast_to(per_k_nt, 3)) + BIAS_NT
    quaternion = turned.as_quat()[:, [3, 0, 1, 2]]
    made = Recording.from_arrays(
        time=np.datetime64("2024-05-01T10:00:00") + (1e3 * time_s).astype("timedelta64[ms]"),
        B=measured + rng.normal(0.0, NOISE_NT, (COUNT, 3)),
        H=reference if vectors else np.linalg.norm(reference, axis=1),
        position_ecef_km=track(speed_km_s),
        noise_nt=NOISE_NT,
        channels={"temperature": (20.0 + warm_k, "degC")},
        attitude=quaternion if vectors else None,
    )
    return replace(made, descriptor=replace(made.descriptor, platform=PlatformSpec(PlatformKind.AIR)))


def test_between_two_places_it_is_lowes_spectrum_from_a_depth_and_what_surveys_see_on_top() -> None:
    """Against the sum over degrees of 20 nT^2 each from 6 km, to 6 %, where waves longer than the sum's begin with."""
    places = np.asarray(ecef_from_geodetic(np.array([40.0, 40.2]), np.array([33.0, 33.0]), np.array([1.0, 1.0])))
    coarse, fine = near_ground(places)
    angle = float(np.linalg.norm(places[1] - places[0])) / 6371.2
    degree = np.arange(6000)
    power = 20.0 / 3.0 * (6371.2 / 6377.2) ** (2 * degree + 4) * (degree > 13)
    summed = 2.0 * (power.sum() - legendre.legval(np.cos(angle), power))
    differs = [part[0, 0] + part[1, 1] - 2.0 * part[0, 1] for part in (coarse, fine)]
    assert differs[0] == pytest.approx(summed, rel=0.06)
    assert differs[1] == pytest.approx(2.0 * (115.0 / 3.0) ** 2 * (1.0 - 2.6 / np.hypot(2.6, 6371.2 * angle)), rel=1e-3)
    assert np.abs(np.concatenate([coarse, fine]).sum(axis=1)).max() < 1e-9  # what places have in common is left out


def test_it_fades_with_height_and_the_ground_may_be_a_kilometre_high() -> None:
    heights = np.array([0.0, 0.9, 11.0])
    places = np.asarray(ecef_from_geodetic(np.full(3, 40.0), np.array([33.0, 33.0, 34.0]), heights))
    assert heights_km(places) == pytest.approx([0.0, 0.0, 10.0], abs=1e-6)
    low, high = (near_ground(track(0.06, height)[::10])[1][0, 0] for height in (0.5, 11.0))
    assert high < 0.2 * low


@pytest.mark.parametrize("seed", [1, 2])
def test_turned_lines_carry_on_and_gather_as_a_matrix_and_its_transpose(seed: int) -> None:
    rng = np.random.default_rng(seed)
    lines = TurnedLines(Lines(np.array([0, 3, 7, 11]), 12), rng.normal(size=(12, 3, 3)))
    matrix = lines.carried_on(np.eye(12))
    values, rows = rng.normal(size=(12, 2)), rng.normal(size=(36, 2))
    assert lines.count == 36
    at_knot = matrix[9:12] @ values
    assert at_knot == pytest.approx(lines.onto[3] @ values[3:6])
    assert lines.gathered(rows) == pytest.approx(matrix.T @ rows)
    assert lines.weighed(values) == pytest.approx(matrix.T @ matrix @ values)
    assert lines.less(rows, values) == pytest.approx(rows - matrix @ values)


def test_whole_vectors_are_whitened_by_the_inverse_root_of_their_covariance() -> None:
    """Of three components that err alike and by themselves, in axes that turn against the rows'."""
    count = 800
    scene = scene_of(recording(5, 0.0, vectors=False).select(np.arange(COUNT) < count))
    onto = Rotation.random(count, random_state=3).as_matrix() * np.array([1.0, 0.3, 0.3])[:, None]
    error = FieldError.of(scene, NOISE_NT, onto)
    assert error is not None
    error = error.scaled(Scale(2.0, 3.0))
    matrix = error.lines.carried_on(np.eye(3 * len(error.coarse)))
    covariance = matrix @ np.kron(4.0 * error.coarse + 9.0 * error.fine, np.eye(3)) @ matrix.T
    rows = np.random.default_rng(6).normal(size=(3 * count, 2))
    expected = NOISE_NT**2 * rows.T @ np.linalg.solve(covariance + NOISE_NT**2 * np.eye(3 * count), rows)
    assert error.whitened(rows).T @ error.whitened(rows) == pytest.approx(expected, rel=0.01, abs=2.0)
    assert error.products(rows) == pytest.approx(error.whitened(rows).T @ error.whitened(rows))


def test_who_does_not_move_has_none() -> None:
    """What places have in common is in the nine errors already."""
    scene = scene_of(recording(5, 0.0, vectors=False, speed_km_s=0.0))
    assert FieldError.of(scene, NOISE_NT) is None


def test_a_coil_that_plays_an_orbit_has_none() -> None:
    """Its places are not where it is."""
    scene = scene_of(recording(5, 0.0, vectors=False))
    assert scene.position_ecef_km is not None
    assert FieldError.of(replace(scene, position_ecef_km=1.08 * scene.position_ecef_km), NOISE_NT) is None


@pytest.mark.parametrize("vectors", [False, True])
def test_a_crust_along_the_track_is_no_physics(vectors: bool) -> None:
    """It was structure without a name."""
    found = diagnose(recording(11, 90.0, vectors=vectors))
    assert found.prepared.form is (Form.AIMED if vectors else Form.SCALAR)
    assert (found.verdict, found.trusted) == (Verdict.NONE, True)
    sigma = np.sqrt(np.diagonal(found.fit.covariance)[:3])
    assert np.abs((found.fit.x[:3] - BIAS_NT) / sigma).max() < 4.0


@pytest.mark.parametrize("vectors", [False, True])
def test_heat_is_named_above_a_crust(vectors: bool) -> None:
    per_k_nt = np.array([20.0, -15.0, 10.0])
    found = diagnose(recording(12, 60.0, vectors=vectors, per_k_nt=per_k_nt))
    (term,) = found.fit.terms
    assert term.hypothesis.effect == "thermal_bias"
    assert term.amplitudes == pytest.approx(per_k_nt, abs=3.0)
