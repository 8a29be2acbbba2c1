"""``fit``: arrays in, nine errors out, beside ``calibrate`` on the same data."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import magcal_service as magcal
from magcal_service.estimators.interface import StartGate
from sim_sensor.scenario_reader import load_scenario
from sim_sensor.simulation import Simulation

NOISE_NT = 300.0
TRUTH = np.array([5000.0, 3000.0, 4000.0, 0.05, 0.10, 0.05, 0.05, 0.05, 0.05])
DATA = Path(__file__).resolve().parents[3] / "shared" / "data"


@cache
def flight() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times (n,) [s], B (n, 3) and H (n, 3) [nT] of the paper's craft over an orbit and a half."""
    block = Simulation(load_scenario("paper"), seed=41, duration_s=9000.0).arrays()
    return np.arange(9000.0), block.measured_nt, block.true_eci_nt


def test_the_errors_lie_within_their_sigma() -> None:
    """NEES of one flight: below the 99.9 % point of chi-squared with nine degrees of freedom, and no zero."""
    _, B, H = flight()
    found = magcal.fit(B, H, noise_nt=NOISE_NT)
    error = found.x - TRUTH
    nees = float(error @ np.linalg.solve(found.covariance, error))
    assert 0.5 < nees < 27.9
    assert found.samples == 9000
    assert found.residual_rms_nt == pytest.approx(NOISE_NT, rel=0.03)


def test_it_agrees_with_the_batch_method_through_the_daemons_path() -> None:
    """``two-step`` uses the same information: within a quarter of a sigma, with covariances within 5 %."""
    time, B, H = (values[:4500] for values in flight())
    found = magcal.fit(B, H, noise_nt=NOISE_NT)
    other = magcal.calibrate(magcal.Recording.from_arrays(time, B, H, noise_nt=NOISE_NT), method="two-step")
    sigma = np.sqrt(np.diagonal(other.covariance))
    assert np.abs((found.x - other.x) / sigma).max() < 0.25
    assert np.sqrt(np.diagonal(found.covariance)) == pytest.approx(sigma, rel=0.05)


def test_it_agrees_with_the_daemons_filter_within_its_sigma() -> None:
    """Without a spin ``ukf`` knows what ``fit`` knows; it starts from a part of the samples: within one sigma."""
    time, B, H = (values[:4500] for values in flight())
    found = magcal.fit(B, H, noise_nt=NOISE_NT)
    other = magcal.calibrate(magcal.Recording.from_arrays(time, B, H, noise_nt=NOISE_NT))
    assert np.abs((found.x - other.x) / np.sqrt(np.diagonal(other.covariance))).max() < 1.0


def test_noise_that_is_not_told_is_found() -> None:
    _, B, H = flight()
    found = magcal.fit(B, H)
    assert found.noise_nt == pytest.approx(NOISE_NT, rel=0.03)
    assert np.abs(found.x - TRUTH)[:3].max() < 20.0


def test_magnitudes_are_as_good_as_vectors() -> None:
    _, B, H = flight()
    assert np.array_equal(magcal.fit(B, np.linalg.norm(H, axis=1)).x, magcal.fit(B, H).x)


def test_apply_takes_the_errors_out() -> None:
    """Truth in, truth out: with the exact nine errors the residual is the noise itself, rotated."""
    _, B, H = flight()
    found = magcal.fit(B, H, noise_nt=NOISE_NT)
    D = np.array([[0.05, 0.05, 0.05], [0.05, 0.1, 0.05], [0.05, 0.05, 0.05]])
    expected = B + B @ D.T - [5000.0, 3000.0, 4000.0]
    assert found.apply(B).shape == (9000, 3)
    assert np.abs(found.apply(B) - expected).max() < 80.0


def test_rows_that_are_not_finite_are_left_out_and_counted() -> None:
    _, B, H = flight()
    spoiled, lost = B.copy(), H.copy()
    spoiled[10, 1], lost[20, 2] = np.nan, np.inf
    found = magcal.fit(spoiled, lost, noise_nt=NOISE_NT)
    keep = np.ones(9000, dtype=bool)
    keep[[10, 20]] = False
    assert (found.samples, found.left_out) == (8998, 2)
    assert np.array_equal(found.x, magcal.fit(B[keep], H[keep], noise_nt=NOISE_NT).x)


def test_the_result_reads_as_a_table_and_as_plain_data() -> None:
    _, B, H = flight()
    found = magcal.fit(B, H, noise_nt=NOISE_NT)
    lines = repr(found).splitlines()
    assert lines[0].startswith("Fit of 9000 samples, residual ")
    assert re.match(r"  bx \d{4}\.\d \+- \d+\.\d, by ", lines[1])
    data = found.to_dict()
    assert data["bias_nt"] == found.bias_nt.tolist()
    assert np.array(data["sigma"]["D"]) == pytest.approx(found.sigma_D)


def test_no_sound_solution_is_an_error_that_names_the_gate() -> None:
    """A craft that does not turn shows one direction only."""
    rng = np.random.default_rng(3)
    B = np.array([20_000.0, 5_000.0, 30_000.0]) + rng.normal(0.0, 50.0, (500, 3))
    with pytest.raises(magcal.NoSolutionError, match="no sound solution fits 500 samples: poor_coverage: ") as caught:
        magcal.fit(B, np.linalg.norm(B, axis=1), noise_nt=50.0)
    assert caught.value.gate is StartGate.POOR_COVERAGE
    assert caught.value.exit_code == 3
    said = str(caught.value)
    sigma, limit = (float(one) for one in re.search(r"known to (\d+) nT .* at most (\d+) nT", said).groups())  # type: ignore[union-attr]
    assert sigma > 10.0 * limit > 100.0
    assert "take samples with the sensor turned in more directions" in said
    assert re.search(r"B varies by \d\d nT \(1 sigma\) where it varies least, by 21\d{3} nT if turned", said)


def test_the_error_names_the_value_that_was_refused_and_what_is_accepted() -> None:
    """B five times too large, a noise ten times too small, H of other instants, an axis that stands still."""
    _, B, H = flight()
    length, rng = np.linalg.norm(H, axis=1), np.random.default_rng(3)
    still = np.column_stack([B[:, :2], np.full(len(B), 30_000.0)])
    accepted = r"and 0\.4 to 2\.5 is accepted"
    level = r"the residual is (29|30)\d\.\d nT rms, and at most 45\.0 nT is accepted"
    cases = (
        (5.0 * B, H, NOISE_NT, rf"collapsed: eigenvalues of I \+ D from 0\.2 to 0\.23\d?, {accepted}; .*unit of B"),
        (B, H, 0.1 * NOISE_NT, rf"bad_fit: {level}; .*noise_nt"),
        (B, rng.permutation(length), NOISE_NT, r"not_positive: .*; check that rows of B and H are of the same inst"),
        (still, H, None, r"B varies by 0 nT \(1 sigma\) where it varies least"),
    )
    for field, reference, noise, says in cases:
        with pytest.raises(magcal.NoSolutionError, match=says) as caught:
            magcal.fit(field, reference, noise)
        ratio = np.linalg.norm(field, axis=1).mean() / length.mean()
        assert f"a ratio of {ratio:.3g}; " in str(caught.value)


B_GOOD, H_GOOD = np.full((60, 3), 20_000.0), np.full(60, 34_000.0)


@pytest.mark.parametrize(
    ("B", "H", "noise", "says"),
    [
        (B_GOOD[:, :2], H_GOOD, None, r"shape of B: \(60, 2\) is refused; an array of shape \(n, 3\)"),
        (B_GOOD, H_GOOD[:59], None, r"rows of H: 59 is refused; as many rows as B are accepted; B has 60"),
        (B_GOOD, np.zeros(60), None, r"smallest magnitude of H: 0.0 is refused; .* is H in nT"),
        (B_GOOD / 1e5, H_GOOD / 1e5, None, r"smallest magnitude of H: 0.34 is refused; .*1 G = 100000 nT"),
        (B_GOOD * 100, H_GOOD, None, r"largest component of B: 2000000.0 is refused; .* is B in nT"),
        (B_GOOD[:40], H_GOOD[:40], None, r"usable rows of B and H: 40 is refused; at least 50"),
        (B_GOOD, H_GOOD, -1.0, r"noise_nt: -1.0 is refused; a number above 0 nT"),
        (B_GOOD, ["north"] * 60, None, r"H: 'list' is refused; magnitudes \(n,\) or vectors"),
        ([["a", "b", "c"]], H_GOOD, None, r"B: 'list' is refused; an array of shape \(n, 3\) of numbers"),
    ],
    ids=["two columns", "lengths", "zero reference", "gauss", "too large", "few rows", "noise", "text in H", "text"],
)
def test_bad_arrays_are_refused_with_what_is_accepted(B: object, H: object, noise: float | None, says: str) -> None:
    with pytest.raises(magcal.InputRefusedError, match=says):
        magcal.fit(B, H, noise)  # type: ignore[arg-type]


@pytest.mark.skipif(not DATA.exists(), reason="../shared/data is not there: real recordings")
def test_on_a_real_recording_it_agrees_with_the_batch_method() -> None:
    """SUCHAI-3, 17 minutes: the same residual within 2 %; neither knows the noise."""
    recording = magcal.read_recording(DATA / "suchai3/2023-11-13.toml").sorted_unique()
    other = magcal.calibrate(recording, method="two-step")
    found = magcal.fit(recording.field_body_nt, recording.reference.magnitude_nt)
    assert found.residual_rms_nt == pytest.approx(other.residuals.after, rel=0.02)


def test_rows_of_zeros_are_left_out_and_counted() -> None:
    _, B, H = flight()
    spoiled = np.where(np.arange(len(B))[:, None] % 3 == 1, 0.0, B)
    found = magcal.fit(spoiled, H, noise_nt=NOISE_NT)
    kept = np.arange(len(B)) % 3 != 1
    assert (found.left_out, found.samples) == (3000, 6000)
    assert np.array_equal(found.x, magcal.fit(B[kept], H[kept], noise_nt=NOISE_NT).x)
