"""The steps of a diagnosis one by one: what is a spike, a room, a memory, a name, and what speaks against a result."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from magcal_service.diagnosis.collapse import is_collapsed
from magcal_service.diagnosis.diagnose import (
    NUTATION,
    SPIN_RATE,
    Verdict,
    _beside_a_pattern,
    _beside_disturbances,
    _doubts,
    _is_coning,
    _simulation,
    verdict_of,
)
from magcal_service.diagnosis.doubts import reasons as reasons_of
from magcal_service.diagnosis.leftover import Structure, unexplained_share
from magcal_service.diagnosis.prepare import _room, _room_field, _usable, _white, baseline_start, prepare
from magcal_service.diagnosis.problem import Problem, Term, evaluate
from magcal_service.diagnosis.searching import memory_of
from magcal_service.diagnosis.shapes import Shape
from magcal_service.diagnosis.solution import solve
from magcal_service.model import Array, measure
from magcal_service.physics.interface import Finding, value_of
from magcal_service.recordings.channels import Axes
from magcal_service.recordings.in_memory import from_arrays
from tests.diagnosis.made_up import TIME_S, along, body_form, flown
from tests.physics.scenes import AXIS_BODY, COUNT, NOISE_NT, X, scene, spoiled, turning, view

QUIET = np.zeros((COUNT, 3))


def finding(**parameters: float) -> Finding:
    return Finding({name: value_of(value, 0.0, "1") for name, value in parameters.items()}, 20.0, 0.5)


def structure(nats: float, squares: float) -> Structure:
    return Structure(Shape("field", "says", lambda unit: unit), nats, squares, lambda: np.zeros(COUNT))


def explained(terms: int) -> Any:
    return SimpleNamespace(fit=SimpleNamespace(terms=(None,) * terms))


# What it comes to


@pytest.mark.parametrize(
    ("terms", "findings", "unexplained", "verdict"),
    [
        (0, {}, 0.0, Verdict.NONE),
        (1, {}, 0.2, Verdict.NAMED),
        (1, {}, 0.201, Verdict.UNKNOWN),
        (0, {"nutation": None}, 0.0, Verdict.NAMED),
        (0, {"coloured_noise": None}, 0.0, Verdict.NONE),
        (0, {}, 0.9, Verdict.UNKNOWN),
    ],
)
def test_up_to_a_fifth_may_be_left_without_a_name(
    terms: int, findings: dict[str, Any], unexplained: float, verdict: Verdict
) -> None:
    assert verdict_of(explained(terms), findings, unexplained) is verdict


def residuals(before: float, after: float) -> tuple[Any, Any]:
    """A preparation and a fit with an effect whose residuals have these squares."""
    prepared = SimpleNamespace(baseline=SimpleNamespace(residual=np.sqrt([before])))
    return prepared, SimpleNamespace(residual=np.sqrt([after]), terms=(None,))


def test_what_is_unexplained_is_the_best_structures_share_of_all_that_is_there() -> None:
    prepared, fit = residuals(1000.0, 400.0)
    assert unexplained_share(prepared.baseline, fit, [structure(7.0, 150.0)]) == pytest.approx(150.0 / 750.0)
    assert unexplained_share(prepared.baseline, fit, [structure(5.9, 150.0)]) == 0.0
    assert unexplained_share(prepared.baseline, fit, []) == 0.0
    worse, grown = residuals(400.0, 1000.0)
    assert unexplained_share(worse.baseline, grown, [structure(7.0, 150.0)]) == pytest.approx(1.0)


def test_without_an_effect_nothing_is_explained() -> None:
    """Nine errors fitted again leave less; a lattice beside a structure of 258 nats was all that was said, trusted."""
    prepared, fit = residuals(1000.0, 400.0)
    fit.terms = ()
    assert unexplained_share(prepared.baseline, fit, [structure(7.0, 150.0)]) == 1.0
    assert unexplained_share(prepared.baseline, fit, [structure(5.9, 150.0)]) == 0.0


@pytest.mark.parametrize(
    ("bias_sigma", "d_sigma", "rows", "verdict", "x", "reasons"),
    [
        (999.0, 0.049, 300, Verdict.NAMED, X, ()),
        (1001.0, 0.001, 300, Verdict.NAMED, X, ("poor_coverage",)),
        (1.0, 0.051, 300, Verdict.NAMED, X, ("poor_coverage",)),
        (1.0, 0.001, 299, Verdict.NAMED, X, ("not_enough_data",)),
        (1.0, 0.001, 300, Verdict.UNKNOWN, X, ("unexplained_structure",)),
        (1.0, 0.001, 300, Verdict.NONE, np.array([0, 0, 0, -0.61, 0, 0, 0, 0, 0.0]), ("collapsed",)),
    ],
)
def test_a_result_has_the_reasons_against_it(
    bias_sigma: float, d_sigma: float, rows: int, verdict: Verdict, x: Array, reasons: tuple[str, ...]
) -> None:
    """The largest sigma of bias and of D, the number of rows, the verdict, and whether it is a sensor at all."""
    sigmas = np.array([1.0, bias_sigma, 1.0, *[0.001] * 5, d_sigma, 1e9])
    problem = SimpleNamespace(scene=range(rows), is_collapsed=is_collapsed, noise_nt=1.0, field_error=None)
    fit: Any = SimpleNamespace(
        x=x,
        covariance=np.diag(sigmas**2),
        converged=True,
        problem=problem,
        terms=(),
        held_out_white=np.ones(9),
        noise_gain=1.0,
    )
    explained: Any = SimpleNamespace(fit=fit)
    assert reasons_of(explained, 0.0, verdict is Verdict.UNKNOWN) == reasons


def test_a_doubtful_recording_is_a_reason_of_its_own() -> None:
    sound: Any = SimpleNamespace(open=())
    doubtful: Any = SimpleNamespace(open=("wraps",))
    assert (_doubts(sound), _doubts(doubtful)) == ((), ("recording_doubtful",))


# Attitude


@pytest.mark.parametrize(("found_rpm", "coning"), [(2.0 * 0.9926, True), (2.0 * 0.9922, False), (2.0 * 1.0078, False)])
def test_a_rate_that_coning_makes_slower_is_coning(found_rpm: float, coning: bool) -> None:
    """5 degrees: 1 - cos is 0.0038, and twice that is allowed, to either side."""
    findings = {
        SPIN_RATE: finding(rate_rpm=found_rpm, nominal_rpm=-2.0 if found_rpm < 0 else 2.0),
        NUTATION: finding(angle_deg=5.0),
    }
    assert _is_coning(findings) is coning
    unstated = {SPIN_RATE: finding(rate_rpm=found_rpm), NUTATION: finding(angle_deg=5.0)}
    assert not _is_coning(unstated)
    rate = findings[SPIN_RATE].parameters["rate_rpm"]
    unsure = replace(
        findings[SPIN_RATE],
        parameters={**findings[SPIN_RATE].parameters, "rate_rpm": replace(rate, sigma=np.array(0.01))},
    )
    assert _is_coning({**findings, SPIN_RATE: unsure})  # within three of its sigma besides


@pytest.mark.parametrize(("angle_deg", "imitated"), [(0.55, True), (0.60, False)])
def test_a_nutation_no_larger_than_the_rest_of_the_disturbance_is_imitated(angle_deg: float, imitated: bool) -> None:
    """A residual of 200 nT over noise of 100: 173 nT along the field, so 300 nT in every direction, of 30 uT."""
    spin: Any = SimpleNamespace(across_nt=np.array([29_000.0, 31_000.0]))
    prepared: Any = SimpleNamespace(
        baseline=SimpleNamespace(rms_nt=200.0), problem=SimpleNamespace(noise_nt=100.0, scene=scene())
    )
    quiet: Any = SimpleNamespace(terms=(), problem=SimpleNamespace(scene=scene(), field_error=None))
    found = _beside_disturbances(finding(angle_deg=angle_deg), prepared, quiet, [], spin)
    assert (found is None) is imitated


def test_a_nutation_is_doubted_by_what_is_left_without_a_name() -> None:
    """100 nT of structure are 173 nT in every direction, whatever the whole residual says: 0.31 degrees of 30 uT.

    Of twice that angle a quarter in power may be it, so a sixteenth in probability.
    """
    spin: Any = SimpleNamespace(across_nt=np.full(3, 30_000.0))
    prepared: Any = SimpleNamespace(baseline=SimpleNamespace(rms_nt=1000.0), problem=SimpleNamespace(noise_nt=1000.0))
    bare = SimpleNamespace(scene=scene(), field_error=None)
    quiet: Any = SimpleNamespace(terms=(), problem=bare, residual=np.zeros(COUNT))
    left: Any = [SimpleNamespace(nats=20.0, squares=COUNT * 100.0**2), SimpleNamespace(nats=9.0, squares=COUNT * 9e5)]
    size = math.sqrt(3.0) * 100.0 / 30_000.0
    assert _beside_disturbances(finding(angle_deg=math.degrees(0.99 * size)), prepared, quiet, left, spin) is None
    twice = _beside_disturbances(finding(angle_deg=math.degrees(2.0 * size)), prepared, quiet, left, spin)
    assert twice is not None
    assert twice.doubt == pytest.approx(1.0 / 16.0, rel=1e-3)
    noise: Any = [SimpleNamespace(nats=3.0, squares=COUNT * 900.0**2)]
    for nothing in ([], noise):
        alone = _beside_disturbances(finding(angle_deg=math.degrees(2.0 * size)), prepared, quiet, nothing, spin)
        assert alone is not None
        assert alone.doubt == 0.0


@pytest.mark.parametrize(("angle_deg", "imitated"), [(0.04, True), (0.05, False)])
def test_a_nutation_no_larger_than_a_field_models_usual_error_is_imitated(angle_deg: float, imitated: bool) -> None:
    """22 nT turn a vector of 30 uT by 0.042 degrees, however quiet the sensor."""
    error: Any = SimpleNamespace(usual_nt=22.0)
    fit: Any = SimpleNamespace(terms=(), problem=SimpleNamespace(scene=scene(), field_error=error))
    prepared: Any = SimpleNamespace(baseline=SimpleNamespace(rms_nt=8.0), problem=SimpleNamespace(noise_nt=8.0))
    spin: Any = SimpleNamespace(across_nt=np.full(3, 30_000.0))
    found = _beside_disturbances(finding(angle_deg=angle_deg), prepared, fit, [], spin)
    assert (found is None) is imitated


@pytest.mark.parametrize(("angle_deg", "imitated"), [(0.75, True), (0.78, False)])
def test_a_nutation_no_larger_than_the_effects_that_were_found_is_imitated(angle_deg: float, imitated: bool) -> None:
    """400 nT of a found field turn a vector of 30 uT by 0.76 degrees."""
    form = body_form("one", "", np.tile([0.0, 0.6, 0.8], (COUNT, 1)))
    term = Term(form, np.zeros(0), np.array([400.0]))
    fit: Any = SimpleNamespace(terms=(term,), problem=SimpleNamespace(scene=scene(), field_error=None))
    prepared: Any = SimpleNamespace(baseline=SimpleNamespace(rms_nt=90.0), problem=SimpleNamespace(noise_nt=100.0))
    spin: Any = SimpleNamespace(across_nt=np.full(3, 30_000.0))
    found = _beside_disturbances(finding(angle_deg=angle_deg), prepared, fit, [], spin)
    assert (found is None) is imitated


# The noise


def remembering(correlation: float, seed: int = 3) -> Array:
    """Noise (n, 3) fixed in the body, whose neighbours correlate."""
    white = np.random.default_rng(seed).normal(0.0, NOISE_NT, (COUNT, 3))
    found = np.array(white)
    for row in range(1, COUNT):
        found[row] = correlation * found[row - 1] + math.sqrt(1.0 - correlation**2) * white[row]
    return found


def coefficients_of(noise: Array) -> Array:
    of = spoiled(measure(X, scene().calibrated_nt + noise), scene())
    fit = solve(Problem(of, NOISE_NT), X)
    prepared: Any = SimpleNamespace(view=view(of))
    return memory_of(prepared, fit.problem, fit)


def test_noise_with_a_memory_has_coefficients_and_white_noise_none() -> None:
    found = coefficients_of(remembering(0.8))
    assert float(found[0]) == pytest.approx(0.8, abs=0.15)
    assert len(coefficients_of(remembering(0.0))) == 0


def test_an_oscillation_is_no_memory() -> None:
    coming = np.exp(-(((TIME_S - 3000.0) / 1500.0) ** 2))[:, None]
    swing = 6.0 * NOISE_NT * coming * np.outer(np.sin(2.0 * np.pi * 0.045 * TIME_S), [0.5, -0.7, 0.5])
    assert len(coefficients_of(remembering(0.0) + swing)) == 0


# What it is compared with


def test_a_simulation_that_is_given_has_its_own_residual() -> None:
    problem = Problem(flown(QUIET), NOISE_NT)
    baseline = solve(problem, X)
    prepared: Any = SimpleNamespace(problem=problem, baseline=baseline)
    given = X + np.array([500.0, 0, 0, 0, 0, 0, 0, 0, 0])
    x, residual = _simulation(prepared, given)
    assert x is given
    assert residual == pytest.approx(evaluate(problem, given, ()).residual)


def test_without_one_the_first_half_of_the_recording_is_what_it_is_compared_with() -> None:
    """A step at the middle leaves the first half clean: its errors come out, and the second half shows the step."""
    half = np.arange(COUNT) >= COUNT // 2
    problem = Problem(flown(along(0, 400.0 * half)), NOISE_NT)
    prepared: Any = SimpleNamespace(problem=problem, baseline=solve(problem, X))
    x, residual = _simulation(prepared, None)
    assert x[:3] == pytest.approx(X[:3], abs=40.0)
    assert float(np.sqrt(np.mean(residual[~half] ** 2))) == pytest.approx(NOISE_NT, rel=0.05)
    assert float(np.sqrt(np.mean(residual[half] ** 2))) > 2.0 * NOISE_NT


# Preparing


def test_a_row_in_a_field_of_less_than_ten_times_the_noise_is_left_out() -> None:
    """Where a step of the field ends near zero: its direction there is noise."""
    of = scene(NOISE_NT)
    weak = np.arange(COUNT) % 40 == 7
    scale = np.where(weak, 9.0 * NOISE_NT / of.magnitude_nt, 1.0)
    calibrated, reference = of.calibrated_nt * scale[:, None], of.reference_eci_nt * scale[:, None]
    made = from_arrays(of.time_s, measure(X, calibrated), reference, noise_nt=NOISE_NT)
    prepared = prepare(made, ())
    assert prepared.left_out["weak_field"] == np.count_nonzero(weak) == 50
    assert not np.isin(made.time_ns[weak], prepared.recording.time_ns).any()


def test_the_white_level_is_that_of_the_noise() -> None:
    assert _white(scene(NOISE_NT), X) == pytest.approx(NOISE_NT, rel=0.05)
    assert _white(scene(), X) == pytest.approx(1e-3)


@pytest.mark.parametrize("noise_nt", [None, NOISE_NT])
def test_the_nine_errors_are_found_without_a_start(noise_nt: float | None) -> None:
    found = baseline_start(scene(NOISE_NT), noise_nt)
    assert found[:3] == pytest.approx(X[:3], abs=25.0)
    assert found[3:] == pytest.approx(X[3:], abs=1e-3)


def test_rows_are_sorted_counted_and_of_very_many_some_taken() -> None:
    time_s = np.array([3.0, 1.0, 2.0, 2.0])
    B = np.tile([1.0, 2.0, 3.0], (4, 1)) * np.arange(1.0, 5.0)[:, None]
    recording = from_arrays(time_s, B, np.full(4, 45e3))
    usable, thinned = _usable(recording, None)
    assert np.diff(usable.time_ns).tolist() == [10**9, 10**9]
    assert thinned == 0
    many = 120_001
    recording = from_arrays(np.arange(float(many)), np.tile([1.0, 2.0, 3.0], (many, 1)), np.full(many, 45e3))
    usable, thinned = _usable(recording, None)
    assert (len(usable), thinned) == (40_001, 80_000)
    assert np.diff(usable.time_ns[:3]).tolist() == [3 * 10**9] * 2
    usable, thinned = _usable(recording, 4)
    assert (len(usable), thinned) == (30_001, 90_000)


@pytest.mark.parametrize(("spread", "is_room"), [(0.004, True), (0.006, False)])
def test_a_room_has_one_magnitude_to_half_a_per_cent(spread: float, is_room: bool) -> None:
    """And an attitude: the transpose of the recorded one turns the body into the room."""
    magnitude = 45e3 * (1.0 + spread * np.where(np.arange(COUNT) % 2, 1.0, -1.0))
    of = replace(scene(), magnitude_nt=magnitude)
    attitude = turning(AXIS_BODY, np.array([0.0, 0.0, 1.0]), 0.1 * TIME_S)
    room = _room(of, (Axes.ECI, attitude))
    assert (room is not None) is is_room
    if room is not None:
        assert np.array_equal(room[5], attitude[5].T)
    assert _room(of, None) is None


def test_a_rooms_field_is_the_mean_vector_brought_to_its_length() -> None:
    field = np.array([20e3, -5e3, 40e3])
    attitude = turning(AXIS_BODY, np.array([0.0, 0.0, 1.0]), 0.1 * TIME_S)
    seen = np.einsum("nij,j->ni", attitude, field)
    of = replace(scene(), calibrated_nt=2.0 * seen, magnitude_nt=np.full(COUNT, float(np.linalg.norm(field))))
    assert _room_field(of, np.transpose(attitude, (0, 2, 1))) == pytest.approx(field)


@pytest.mark.parametrize(
    ("driver", "is_free", "doubt"),
    [("inferred:detumbling", True, 0.5), ("channel:one", True, 0.0), ("none", False, 0.0)],
)
def test_noise_beside_a_guessed_pattern_may_be_what_that_leaves(driver: str, is_free: bool, doubt: float) -> None:
    """A pattern of torquers that is nearly right leaves something that hangs together."""
    form = replace(body_form("torquer", "", np.zeros((COUNT, 3))), driver=driver, is_free=is_free)
    noise = _beside_a_pattern(finding(correlation=0.1), [Term(form, np.zeros(0), np.ones(1))])
    assert noise.doubt == doubt
    assert [name for name, _ in noise.rivals] == ["torquer"] * (doubt > 0.0)
