"""The field model's own errors as noise: variance by degree, whitening against the dense covariance, and its limits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.polynomial import legendre

from magcal_service.diagnosis.explain import Search
from magcal_service.diagnosis.field_error import FieldError, Scale
from magcal_service.diagnosis.groups import Groups
from magcal_service.diagnosis.knots import Lines
from magcal_service.diagnosis.leftover import _beside
from magcal_service.diagnosis.linear import Workspace
from magcal_service.diagnosis.model_errors import by_place, common_orbit, degree_variances, of_currents, polar
from magcal_service.diagnosis.problem import Problem
from magcal_service.diagnosis.shapes import shapes
from magcal_service.diagnosis.solution import solve
from magcal_service.model import Array
from magcal_service.physics.scene.main_field import DIPOLE_ECEF
from tests.physics.scenes import scene

NOISE_NT = 5.0


@pytest.fixture(scope="module")
def error() -> FieldError:
    """Of the flight that the physics' tests use."""
    found = FieldError.of(scene(), NOISE_NT)
    assert found is not None
    return found


def test_errors_at_one_scale_are_made_once(error: FieldError) -> None:
    """Whichever scale they are asked of."""
    twice = error.scaled(Scale(2.0, 1.0))
    assert twice.scaled(Scale()) is error
    assert error.scaled(Scale(4.0, 1.0)) is twice.scaled(Scale(4.0, 1.0))


def test_variances_add_up_to_their_sources() -> None:
    """19 nT of the core field and 12 nT from outside; the crust fades with (a / r)^(2n + 4)."""
    low, high = degree_variances(300.0), degree_variances(600.0)
    assert float(low[:14].sum()) == pytest.approx(19.0**2 + 12.0**2)
    assert low[0] == 0.0
    for degree in (14, 30, 45):
        upward = ((6371.2 + 300.0) / (6371.2 + 600.0)) ** (2 * degree + 4)
        assert high[degree] / low[degree] == pytest.approx(upward)
        assert low[degree] == pytest.approx(20.0 / 3.0 * (6371.2 / 6671.2) ** (2 * degree + 4))


def test_errors_fade_with_the_height_of_each_place() -> None:
    """On an eccentric orbit against the sum over degrees of every pair; on a circle each place has the same."""
    altitude_km = np.array([310.0, 420.0, 1500.0, 4500.0, 35_800.0])
    angle = np.array([0.0, 0.08, 0.5, 2.1, 3.0])
    place = (6371.2 + altitude_km)[:, None] * np.stack([np.cos(angle), np.sin(angle), np.zeros(5)], axis=1)
    low, high = by_place(place, 1500.0)
    ground = degree_variances(600.0)
    ground[1] -= 12.0**2
    for i, j in np.ndindex(5, 5):
        cosine, nearer = np.cos(angle[i] - angle[j]), 6971.2 / np.sqrt(np.prod(6371.2 + altitude_km[[i, j]]))
        terms = ground * nearer ** (2 * np.arange(46) + 4)
        assert low[i, j] == pytest.approx(legendre.legval(cosine, terms[:14]) + 12.0**2 * cosine, rel=1e-9)
        assert high[i, j] == pytest.approx(
            legendre.legval(cosine, [0.0] * 14 + terms[14:].tolist()), rel=1e-9, abs=1e-9
        )
    assert high[0, 0] == pytest.approx(degree_variances(310.0)[14:].sum())
    circle = 6871.2 * place / np.linalg.norm(place, axis=1)[:, None]
    low, high = by_place(circle, 500.0)
    assert np.diagonal(low + high) == pytest.approx(degree_variances(500.0).sum())


@pytest.mark.parametrize("degree", [14, 30, 45])
def test_the_crust_is_a_potential_field_of_lowes_power(degree: int) -> None:
    """A zonal harmonic of 20 nT^2 on the ground, squared and averaged over a sphere 400 km up, a third for a component.

    By quadrature: B_r = (n + 1) (a / r)^(n + 2) g P_n, B_theta = -(a / r)^(n + 2) g dP_n / dtheta, (n + 1) g^2 = 20.
    """
    cosine, weight = legendre.leggauss(80)
    zonal = legendre.Legendre.basis(degree)
    up = (degree + 1.0) * zonal(cosine)
    south = np.sqrt(1.0 - cosine**2) * zonal.deriv()(cosine)
    height = (6371.2 / 6771.2) ** (degree + 2)
    square = 20.0 / (degree + 1.0) * height**2 * float(weight @ (up**2 + south**2)) / 2.0
    assert degree_variances(400.0)[degree] == pytest.approx(square / 3.0, rel=1e-9)


def test_the_crust_has_5_nt_at_400_km_and_1_nt_beyond_what_is_taken() -> None:
    """Root of Lowes' sum over the degrees from 14: 5 nT of the vector; beyond 45, 300 km up, 1 nT of a component."""
    degree = np.arange(14.0, 500.0)
    whole = 20.0 * (6371.2 / 6771.2) ** (2.0 * degree + 4.0)
    beyond = 20.0 / 3.0 * (6371.2 / 6671.2) ** (2.0 * degree[degree > 45] + 4.0)
    assert np.sqrt(whole.sum()) == pytest.approx(5.0, abs=0.05)
    assert np.sqrt(beyond.sum()) == pytest.approx(1.0, abs=0.05)
    assert len(degree_variances(300.0)) == 46


def test_the_whole_variance_is_kept_at_every_sample(error: FieldError) -> None:
    """The diagonal of U diag(v) U' is the sum over degrees, but for what lies under the noise."""
    place = scene().position_ecef_km
    assert place is not None
    altitude_km = float(np.median(np.linalg.norm(place, axis=1))) - 6371.2
    diagonal = (error.basis**2 * error.variance).sum(axis=1)
    assert float(diagonal.mean()) == pytest.approx(float(degree_variances(altitude_km).sum()), rel=0.02)
    assert float(np.sqrt(diagonal.max())) < 24.0
    assert error.rms_nt == pytest.approx(float(np.sqrt(diagonal.mean())))


def test_whitening_is_the_inverse_root_of_the_covariance(error: FieldError) -> None:
    """W'W = sigma^2 C^-1 with C = sigma^2 I + U diag(v) U', by solving with the dense matrix."""
    count = 300
    lines = Lines(np.linspace(0, count - 1, 14).astype(np.intp), count)
    drawn = np.random.default_rng(8).normal(size=(len(lines.at), 6))
    dense = np.linalg.cholesky(lines.carried_on(drawn).T @ lines.carried_on(drawn)).T
    small = replace(error, lines=lines, courses=drawn @ np.linalg.inv(dense), variance=error.variance[-6:])
    assert np.abs(small.basis.T @ small.basis - np.eye(6)).max() < 1e-12
    covariance = NOISE_NT**2 * np.eye(count) + (small.basis * small.variance) @ small.basis.T
    white = small.whitened(np.eye(count))
    assert np.abs(white.T @ white @ covariance / NOISE_NT**2 - np.eye(count)).max() < 1e-9
    volume = 0.5 * (np.linalg.slogdet(covariance)[1] - count * np.log(NOISE_NT**2))
    assert small.log_volume() == pytest.approx(volume)


def test_what_the_model_may_err_by_weighs_less_and_a_spin_tone_as_before(error: FieldError) -> None:
    """A course of an orbit is all but gone, a tone of a minute is untouched."""
    elapsed = scene().time_s
    slow, fast = np.sin(2.0 * np.pi * elapsed / 5600.0), np.sin(2.0 * np.pi * elapsed / 40.0)
    assert np.linalg.norm(error.whitened(slow)) < 0.1 * np.linalg.norm(slow)
    assert np.linalg.norm(error.whitened(fast)) > 0.98 * np.linalg.norm(fast)


def test_twice_the_error_is_four_times_the_variance(error: FieldError) -> None:
    """But for what lies under the noise and between knots; shorter ways have a scale of their own."""
    usual, twice = error.scaled(Scale()), error.scaled(Scale(2.0, 2.0))
    assert twice.rms_nt == pytest.approx(2.0 * usual.rms_nt, rel=1e-3)
    assert (twice.noise_nt, twice.scale, twice.usual_nt) == (error.noise_nt, (2.0, 2.0), error.usual_nt)
    assert error.scaled(Scale(2.0, 2.0)) is twice
    for scale in (Scale(0.25, 9.0), Scale(4.0, 1.0)):
        scaled = error.scaled(scale)
        covariance = scale.coarse**2 * error.coarse + scale.fine**2 * error.fine
        assert scaled.rms_nt == pytest.approx(np.sqrt(np.mean(np.diagonal(covariance))), rel=0.05)


def test_polar_currents_are_where_the_oval_is_and_others_in_each_pass() -> None:
    """4 nT poleward of 62 degrees, nothing before 58; a minute later 0.74 of it, an orbit later nothing."""
    latitude = np.radians([50.0, 58.0, 62.0, 85.0, 85.0, 85.0])
    across = np.cross(DIPOLE_ECEF, [0.0, 0.0, 1.0])
    across /= np.linalg.norm(across)
    direction = np.outer(np.sin(latitude), DIPOLE_ECEF) + np.outer(np.cos(latitude), across)
    found = of_currents(polar(6900.0 * direction), np.array([0.0, 1.0, 2.0, 3.0, 63.0, 5700.0]))
    assert np.sqrt(np.diagonal(found)) == pytest.approx([0.0, 0.0, 4.0, 4.0, 4.0, 4.0], abs=1e-6)
    assert found[3, 4] == pytest.approx(16.0 * 2.0 * np.exp(-1.0))
    assert found[3, 5] < 1e-9


def test_what_the_noise_hides_at_a_small_scale_is_kept_as_nothing(error: FieldError) -> None:
    """Under 3 uT of noise a twentieth of the usual errors changes no row."""
    loud = FieldError.of(scene(), 400.0)
    assert loud is not None
    rows = np.random.default_rng(12).normal(size=(len(scene()), 2))
    assert loud.scaled(Scale(0.001, 0.001)).whitened(rows) == pytest.approx(rows, abs=1e-3)


def test_without_places_errors_fade_with_the_way_of_acommon_orbit(error: FieldError) -> None:
    """As many nT, those of the poles spread over all of it: 0.97 of them are shared by places 3 degrees apart."""
    there = FieldError.of(replace(scene(), position_ecef_km=None), NOISE_NT)
    assert there is not None
    assert there.rms_nt == pytest.approx(error.rms_nt, rel=0.03)
    sized = FieldError.of(replace(scene(), position_ecef_km=None, reference_eci_nt=None), NOISE_NT)
    assert sized is not None
    crust = by_place(common_orbit(scene().time_s[sized.lines.at]), 500.0)[1]
    assert np.diagonal(sized.fine - crust) == pytest.approx(0.58**2 * 4.0**2)
    place = common_orbit(np.array([0.0, 48.0, 5677.0]))
    direction = place / np.linalg.norm(place, axis=1)[:, None]
    assert np.linalg.norm(place, axis=1) == pytest.approx(6871.2)
    assert np.degrees(np.arccos(direction[0] @ direction[1])) == pytest.approx(3.0, abs=0.15)
    assert np.degrees(np.arccos(direction[0] @ direction[2])) == pytest.approx(5677.0 * 360.0 / 86164.1, abs=0.5)


def test_there_is_none_without_places_off_orbit_or_under_much_noise() -> None:
    """A room has no field model, and a noise of 1 mT hides all."""
    assert FieldError.of(replace(scene(), in_orbit=False, position_ecef_km=None), NOISE_NT) is None
    assert FieldError.of(scene(), 1e6) is None


@pytest.mark.parametrize("knots", [4, 17, 40])
def test_lines_carry_on_and_gather_as_interpolation_and_its_transpose(knots: int) -> None:
    """Against numpy's own interpolation, and (L a)'b = a'(L'b)."""
    rng = np.random.default_rng(4)
    at = np.concatenate([[0], np.cumsum(rng.integers(1, 9, knots - 1))]).astype(np.intp)
    count = int(at[-1]) + 1
    lines = Lines(at, count)
    values, rows = rng.normal(size=(knots, 2)), rng.normal(size=(count, 2))
    expected = np.stack([np.interp(np.arange(count), at, column) for column in values.T], axis=1)
    assert lines.carried_on(values) == pytest.approx(expected)
    assert lines.less(rows, values) == pytest.approx(rows - expected)
    assert float((expected * rows).sum()) == pytest.approx(float((values * lines.gathered(rows)).sum()))
    assert lines.weighed(values) == pytest.approx(lines.gathered(expected))


def test_products_of_white_rows_need_no_white_rows(error: FieldError) -> None:
    """Smooth rows, which the errors absorb, and rough ones; and the evidence that comes of them beside a model."""
    time_s, rng = scene().time_s, np.random.default_rng(4)
    smooth = np.stack([np.cos(k * time_s / 900.0) for k in range(4)], axis=1)
    rows = 30.0 * np.concatenate([smooth, rng.normal(size=(len(time_s), 3))], axis=1)
    white = error.whitened(rows)
    assert error.products(rows) == pytest.approx(white.T @ white, rel=1e-9, abs=1e-6)
    problem = Problem(scene(), NOISE_NT, field_error=error)
    space = Workspace(problem.white(rng.normal(size=len(time_s)) + smooth[:, 1]), problem.white(rows[:, 4:6]))
    expected, found = space.gain(white[:, :4], NOISE_NT), space.products_before(rows[:, :4], problem).gain(NOISE_NT)
    assert found.nats == pytest.approx(expected.nats, rel=1e-9)
    assert found.amplitudes == pytest.approx(expected.amplitudes, rel=1e-7)
    known = space.products_before(rows[:, :4], problem, white[:, :4].T @ white[:, :4]).gain(NOISE_NT)
    assert known.nats == pytest.approx(expected.nats, rel=1e-9)
    whole, parts = space.sums_before(rows[:, :4], problem), space.segments(white[:, :4], np.array([0]))
    assert whole.drops == pytest.approx(parts.drops, rel=1e-7)
    assert (whole.squares, whole.count) == (parts.squares, parts.count)


def test_products_of_groups_are_those_of_columns_that_are_zero_outside_of_one(error: FieldError) -> None:
    """Of four groups and rows in none, each once with the errors of the field and once without."""
    rng = np.random.default_rng(6)
    count = len(scene())
    groups, rows = Groups(rng.integers(0, 5, count).astype(np.int16), 4), 30.0 * rng.normal(size=(count, 2))
    columns = groups.columns(rows)
    expected = np.concatenate([rows * (groups.number == number)[:, None] for number in range(4)], axis=1)
    assert (columns == expected).all()
    assert groups.products(rows) == pytest.approx(expected.T @ expected)
    assert error.products(rows, groups) == pytest.approx(error.products(expected), rel=1e-9, abs=1e-6)
    for problem in (Problem(scene(), NOISE_NT, field_error=error), Problem(scene(), NOISE_NT)):
        white = problem.white(expected)
        assert problem.white_products(rows, groups) == pytest.approx(white.T @ white, rel=1e-9, abs=1e-6)


def test_families_have_the_evidence_of_white_columns(error: FieldError) -> None:
    """Their columns are not made white, for that takes longer than their products."""
    problem, rng = Problem(scene(), NOISE_NT, field_error=error), np.random.default_rng(5)
    fit = solve(replace(problem, scene=replace(scene(), field_nt=noisy(rng))), np.zeros(9))
    beside, sigma = _beside(Search(fit.problem, ()), fit, 0.3 * NOISE_NT)
    assert beside.white_whole is not None
    slowly = replace(beside, white_whole=None, search=Slowly(fit.problem, ()))
    for shape in shapes(fit.problem, None):
        for found, expected in zip(beside.products(shape), slowly.products(shape), strict=True):
            assert found.gain(sigma).nats == pytest.approx(expected.gain(sigma).nats, rel=1e-7, abs=1e-7), shape.name
            assert found.gain(sigma).squares == pytest.approx(expected.gain(sigma).squares, rel=1e-6), shape.name


class Slowly(Search):
    """Makes all columns white."""

    @property
    def is_symmetric(self) -> bool:
        """Taken for one that is none."""
        return False


def noisy(rng: np.random.Generator) -> Array:
    """What the flight's magnetometer reads, with a field that swings in the body."""
    swing = 40.0 * np.sin(scene().time_s / 400.0)[:, None] * np.array([1.0, -0.5, 0.3])
    return np.asarray(scene().field_nt + swing + rng.normal(0.0, NOISE_NT, scene().field_nt.shape))
