"""Whole vectors by attitude and reference: the mounting, the noise across the field, and what magnitudes cannot see."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from magcal_service.diagnosis.aimed import Aimed, guessed, left_jacobian, turn
from magcal_service.diagnosis.belief import posterior
from magcal_service.diagnosis.diagnose import Verdict, diagnose
from magcal_service.diagnosis.mounting import mounting_of
from magcal_service.diagnosis.prepare import Form
from magcal_service.diagnosis.result import entries
from magcal_service.model import measure
from magcal_service.recordings.recording import Recording
from tests.diagnosis.turntable import Bench
from tests.physics.scenes import X, scene, spoiled

BIAS_NT = np.array([1500.0, -900.0, 700.0])


def mounted(degrees: tuple[float, float, float]) -> np.ndarray:
    """Sensor from body (3, 3), turned by these angles about x, y and z."""
    return np.asarray(Rotation.from_euler("xyz", degrees, degrees=True).as_matrix())


def test_a_turn_and_its_derivative_are_those_of_a_rotation_vector() -> None:
    phi, step = np.array([0.4, -0.3, 0.9]), np.array([2e-6, -1e-6, 3e-6])
    assert turn(phi) == pytest.approx(Rotation.from_rotvec(phi).as_matrix(), abs=1e-12)
    assert turn(phi + step) == pytest.approx(turn(left_jacobian(phi) @ step) @ turn(phi), abs=1e-10)
    aimed = Aimed(np.random.default_rng(1).normal(0.0, 3e4, (5, 3)), np.eye(3))
    moved = (aimed.turned(phi + step) - aimed.turned(phi - step)) / 2.0
    assert aimed.slopes(phi) @ step == pytest.approx(moved, abs=1e-6)


def test_rows_across_the_field_are_weighted_and_those_along_it_are_not() -> None:
    aimed = Aimed(np.array([[0.0, 0.0, 3e4], [2e4, 0.0, 0.0]]), np.eye(3), across=0.25)
    rows = np.arange(12.0).reshape(6, 2)
    expected = rows * np.array([0.25, 0.25, 1.0, 1.0, 0.25, 0.25])[:, None]
    assert aimed.weighed(rows) == pytest.approx(expected)
    assert aimed.weighed(rows[:, 0]) == pytest.approx(expected[:, 0])


def test_a_field_that_turns_gives_mounting_and_nine_errors_at_once() -> None:
    """Without noise the linear fit is exact, whatever the nine errors it was called with."""
    truth = mounted((21.0, -13.0, 9.0))
    aimed, x = guessed(scene(), scene().calibrated_nt @ truth, np.zeros(9))
    assert aimed.guess == pytest.approx(truth, abs=1e-9)
    assert aimed.reference_nt == pytest.approx(scene().calibrated_nt, abs=1e-4)
    assert x == pytest.approx(X, rel=1e-6)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_field_that_stays_in_a_plane_gives_the_mounting_by_the_errors_that_are_known(seed: int) -> None:
    """What no field was along has no gain in a linear fit, nor has rounding: the nine errors stay as given."""
    truth, rng = mounted((21.0, -13.0, 9.0)), np.random.default_rng(seed)
    flat_nt = scene().calibrated_nt * [1.0, 1.0, 0.0]
    field_nt = measure(X, flat_nt) + 1e-9 * rng.normal(size=flat_nt.shape)
    aimed, x = guessed(spoiled(field_nt, scene()), flat_nt @ truth + rng.normal(size=flat_nt.shape), X)
    assert aimed.guess == pytest.approx(truth, abs=1e-5)
    assert np.linalg.det(aimed.guess) == pytest.approx(1.0)
    assert x is X


@pytest.mark.parametrize(("seed", "noise_rad"), [(3, 0.0), (4, 0.01)])
def test_the_mounting_is_found_within_its_sigma(seed: int, noise_rad: float) -> None:
    """Nothing is named, and nine errors and mounting are true; an attitude with noise costs accuracy, not truth."""
    truth = mounted((21.0, -13.0, 9.0))
    bench = Bench(seed, with_attitude=True, attitude_noise_rad=noise_rad, sensor_from_body=truth)
    found = diagnose(bench.recording())
    assert (found.verdict, found.prepared.form, found.refused) == (Verdict.NONE, Form.AIMED, ())
    mounting = mounting_of(found.fit)
    assert mounting is not None
    off_deg = np.degrees(Rotation.from_matrix(mounting.sensor_from_body @ truth.T).as_rotvec())
    assert np.abs(off_deg / mounting.sigma_deg).max() < 3.5
    assert mounting.sigma_deg.max() < (0.01 if noise_rad == 0.0 else 0.05)
    assert mounting.angle_deg == pytest.approx(np.degrees(Rotation.from_matrix(truth).magnitude()), abs=0.2)
    sigma = np.sqrt(np.diagonal(found.fit.covariance)[:3])
    assert np.abs((found.fit.x[:3] - BIAS_NT) / sigma).max() < 3.5


def test_a_lag_is_seen_by_vectors_and_by_what_it_takes_off_their_length() -> None:
    """In a steady field a sensor that answers late turns the vectors; by magnitudes alone its square shows."""
    lagging = Bench(6, with_attitude=True, steady=True, lag_s=0.5, noise_nt=30.0)
    found = diagnose(lagging.recording().select(np.arange(5, 1800)))  # what it began with has decayed
    term = found.fit.terms[0]
    assert (term.hypothesis.effect, term.hypothesis.variant) == ("response_lag", "of whole vectors")
    assert posterior(found.explained, 0).members == ("response_lag",)
    assert float(term.amplitudes[0]) == pytest.approx(0.5, rel=0.003)
    lagging.with_attitude = False
    (term,) = diagnose(lagging.recording()).fit.terms
    assert (term.hypothesis.effect, term.hypothesis.variant) == ("response_lag", "average of samples")
    assert float(np.sqrt(term.amplitudes[0])) * term.hypothesis.constants["period_s"] == pytest.approx(0.5, rel=0.15)


def test_a_lag_in_which_the_craft_hardly_turns_is_no_other_than_a_clock() -> None:
    """Half a hundredth of a radian: what a low-pass shortens is a thousandth of what both turn."""
    lagging = Bench(6, with_attitude=True, steady=True, lag_s=0.1, noise_nt=30.0)
    found = diagnose(lagging.recording().select(np.arange(5, 1800)))
    (term,) = found.fit.terms
    assert set(posterior(found.explained, 0).members) == {"time_offset", "response_lag"}
    assert found.reasons == ("name_uncertain",)
    assert float(term.amplitudes[0]) == pytest.approx(0.1, rel=0.02)


def late(made: Recording, samples: int) -> Recording:
    """The same with vectors that are so many samples older than their tags, without the first of them."""
    older = replace(made, field_body_nt=np.roll(made.field_body_nt, samples, axis=0))
    return older.select(np.arange(max(samples, 30), len(made)))


@pytest.mark.parametrize("in_a_room", [False, True])
@pytest.mark.parametrize("lags", [False, True])
def test_what_answers_seconds_late_is_told_from_a_clock(in_a_room: bool, lags: bool) -> None:
    """A quarter of a radian: the clock's vectors are turned, those of a low-pass are turned less and shorter."""
    bench = Bench(16, with_attitude=True, steady=True, in_a_room=in_a_room, lag_s=4.0 * lags, noise_nt=30.0)
    found = diagnose(late(bench.recording(), 0 if lags else 4))
    (term,) = found.fit.terms
    assert term.hypothesis.effect == ("response_lag" if lags else "time_offset")
    assert term.hypothesis.needs_vectors
    assert posterior(found.explained, 0).members == (term.hypothesis.effect,)
    assert float(term.amplitudes[0]) == pytest.approx(4.0, rel=0.003)
    assert found.trusted


def test_samples_tagged_apart_from_the_attitude_are_a_clock_s_offset() -> None:
    """Later ones cannot be those of a sensor that lags."""
    bench = Bench(7, with_attitude=True, steady=True, noise_nt=30.0)
    made = bench.recording()
    early = replace(made, field_body_nt=np.roll(made.field_body_nt, -1, axis=0))
    late_s = float(np.median(np.diff(made.time_ns))) * 1e-9
    found = diagnose(early.select(np.arange(len(made) - 1)))
    (term,) = found.fit.terms
    assert (term.hypothesis.effect, term.hypothesis.variant) == ("time_offset", "ahead of the attitude")
    assert posterior(found.explained, 0).members == ("time_offset",)
    assert "more as the sensor answers late, if it does" in entries(found)[0].says
    assert float(term.amplitudes[0]) == pytest.approx(late_s, rel=0.02)


def test_in_a_room_too_an_attitude_that_errs_is_not_believed() -> None:
    """Angles that jitter by half a degree are 400 nT in each vector and nothing in its length."""
    bench = Bench(9, with_attitude=True, steady=True, in_a_room=True, attitude_noise_rad=0.009)
    found = diagnose(bench.recording())
    assert (found.prepared.form, found.refused) == (Form.SCALAR, (Form.ROOM,))
    assert found.verdict is Verdict.NONE
    bench.attitude_noise_rad = 0.0
    sound = diagnose(bench.recording())
    assert (sound.prepared.form, sound.refused, sound.verdict) == (Form.ROOM, (), Verdict.NONE)
    assert sound.trusted  # the stated magnitude fixes the common gain


def test_an_attitude_that_errs_slowly_is_not_believed() -> None:
    """Half a minute late, it disagrees with the field: magnitudes are compared, and it is said."""
    late = Bench(8, with_attitude=True).recording()
    attitude = late.channels["attitude"]
    attitude.values[30:] = attitude.values[:-30].copy()
    found = diagnose(late)
    assert (found.prepared.form, found.refused) == (Form.SCALAR, (Form.AIMED,))
    assert found.verdict is Verdict.NONE
    assert mounting_of(found.fit) is None


def test_a_line_is_found_on_vectors_as_on_magnitudes() -> None:
    """0.31 Hz of 90 nT beneath 100 nT of noise, with a frequency to a hundredth of the recording's resolution."""
    bench = Bench(21, with_attitude=True)
    angle = 2.0 * np.pi * 0.31 * bench.time_s
    bench.added_nt = np.outer(np.cos(angle), [60.0, -40.0, 20.0]) + np.outer(np.sin(angle), [20.0, 30.0, -30.0])
    found = diagnose(bench.recording())
    assert found.prepared.form is Form.AIMED
    (term,) = found.fit.terms
    assert term.hypothesis.effect == "tone"
    assert term.theta[0] == pytest.approx(0.31, abs=0.05 / 1800.0)
    assert found.trusted


def test_what_comes_and_goes_is_seen_on_vectors_as_on_magnitudes() -> None:
    """Forty seconds at a time, five times, each along another axis: nothing has that form, and it is no noise."""
    bench = Bench(22, with_attitude=True)
    rng = np.random.default_rng(9065)
    added_nt = np.zeros((bench.count, 3))
    for first in (130, 480, 790, 1180, 1530):
        added_nt[first : first + 40] = 200.0 * rng.normal(size=3)
    bench.added_nt = added_nt
    found = diagnose(bench.recording())
    assert found.prepared.form is Form.AIMED
    assert not found.trusted
