"""The history of estimates and the numbers summed up from it."""

from __future__ import annotations

import csv
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from magcal_service.views.nine import sigmas
from magcal_service.wire.messages import Verdict
from sim_sensor.view.history import History, covariance_matrix, inside
from sim_sensor.view.summary import ONE_FLIGHT_NEES, summarise
from tests.sim_sensor.view.view_estimates import FINAL_SIGMA, START_NS, TRUTH, converging, estimate


def shifted(place: int, sigmas_off: float) -> tuple[float, ...]:
    """The truth with one value moved by a number of its final sigmas."""
    x = list(TRUTH)
    x[place] += sigmas_off * FINAL_SIGMA[place]
    return tuple(x)


def test_sigmas_are_the_roots_of_the_diagonal_in_order() -> None:
    ascending = tuple(float(i) for i in range(1, 10))
    assert sigmas(estimate(TRUTH, ascending)) == pytest.approx(ascending)


def test_covariance_matrix_is_the_symmetric_matrix_that_was_sent() -> None:
    root = np.random.default_rng(3).standard_normal((9, 9))
    full = root @ root.T
    message = replace(estimate(TRUTH, FINAL_SIGMA), covariance=tuple(full[np.triu_indices(9)].tolist()))
    np.testing.assert_array_equal(covariance_matrix(message), full)


@pytest.mark.parametrize(("error", "sigma", "expected"), [(2.9, 1.0, True), (-3.1, 1.0, False), (0.1, math.nan, False)])
def test_inside_means_within_three_sigma(error: float, sigma: float, expected: bool) -> None:
    assert inside(error, sigma) is expected


def test_estimates_before_the_start_are_counted_and_not_plotted() -> None:
    history = History(START_NS)
    history.add(estimate(TRUTH, FINAL_SIGMA, time_s=1.0, verdict=Verdict.NOT_STARTED))
    history.add(estimate(TRUTH, FINAL_SIGMA, time_s=2.0))
    assert (history.waiting, len(history), history.time_s.tolist()) == (1, 1, [2.0])


def test_summary_of_no_estimate_is_refused() -> None:
    with pytest.raises(ValueError, match="no estimate"):
        summarise(History())


def test_summary_of_a_filter_that_never_started_is_not_a_success() -> None:
    history = History(START_NS)
    history.add(estimate(TRUTH, FINAL_SIGMA, verdict=Verdict.NOT_STARTED, reasons=("no_reference",)), TRUTH)
    summary = summarise(history)
    assert not summary.rows
    assert "not_started; no_reference" in summary.text()


@pytest.mark.parametrize("place", range(9))
@pytest.mark.parametrize(("off", "expected"), [(2.9, True), (-3.1, False)])
def test_one_error_outside_its_limit_is_enough_to_fail(place: int, off: float, expected: bool) -> None:
    history = History(START_NS)
    history.add(estimate(shifted(place, off), FINAL_SIGMA), TRUTH)
    summary = summarise(history)
    assert summary.truth_known
    assert [row.inside for row in summary.rows].count(False) == (0 if expected else 1)


def test_nees_of_a_diagonal_covariance_is_the_sum_of_squared_sigmas() -> None:
    history = History(START_NS)
    history.add(estimate(shifted(1, 2.0), FINAL_SIGMA), TRUTH)
    assert summarise(history).nees == pytest.approx(4.0)


def test_settled_time_is_after_the_last_excursion() -> None:
    history = History(START_NS)
    for time_s, bz_off in enumerate((0.0, 80.0, 0.0, -51.0, 49.0, 0.0)):
        x = (*TRUTH[:2], TRUTH[2] + bz_off, *TRUTH[3:])
        history.add(estimate(x, FINAL_SIGMA, time_s=float(time_s)), TRUTH)
    rows = summarise(history).rows
    assert (rows[1].settled_s, rows[2].settled_s) == (0.0, 4.0)


def test_trusted_time_starts_anew_after_a_doubtful_verdict() -> None:
    history = History(START_NS)
    for time_s, verdict in enumerate((Verdict.TRUSTED, Verdict.DOUBTFUL, Verdict.TRUSTED, Verdict.TRUSTED)):
        history.add(estimate(TRUTH, FINAL_SIGMA, time_s=float(time_s), verdict=verdict))
    assert summarise(history).trusted_s == 2.0


def test_share_inside_counts_every_estimate() -> None:
    history = History(START_NS)
    for time_s, off in enumerate((10.0, 0.0, 1.0, -4.0)):
        history.add(estimate(shifted(0, off), FINAL_SIGMA, time_s=float(time_s)), TRUTH)
    assert summarise(history).rows[0].share_inside == 0.5


def test_truth_that_moves_is_compared_at_its_own_time() -> None:
    history = History(START_NS)
    history.add(estimate(TRUTH, FINAL_SIGMA, time_s=1.0), TRUTH)
    moved = (6000.0, *TRUTH[1:])
    history.add(estimate(moved, FINAL_SIGMA, time_s=2.0), moved)
    np.testing.assert_array_equal(history.x - history.truth, np.zeros((2, 9)))


def test_summary_without_truth_claims_nothing_about_errors() -> None:
    summary = summarise(converging(200, known=False))
    assert not summary.truth_known
    assert "inside" not in summary.text()


def test_summary_text_fits_a_terminal_and_names_the_result() -> None:
    text = summarise(converging(2000)).text()
    assert max(map(len, text.splitlines())) <= 80
    assert "9 of 9 final errors inside 3 sigma" in text


def test_one_flight_is_one_draw_of_chi_square() -> None:
    special = pytest.importorskip("scipy.special")
    assert special.chdtri(9, [0.975, 0.025]) == pytest.approx(ONE_FLIGHT_NEES, abs=0.05)
    summary = summarise(converging(2000))
    low, high = (replace(summary, nees=nees).text() for nees in (2.6, 18.9))
    assert "NEES 2.6: one flight is one draw; 95 % lie from 2.7 to 19.0, not this one; mean 9" in low
    assert "NEES 18.9: one flight is one draw; 95 % lie from 2.7 to 19.0; mean 9" in high


def test_csv_holds_every_estimate_with_named_units(tmp_path: Path) -> None:
    history = converging(50)
    history.write_csv(tmp_path / "history.csv")
    with (tmp_path / "history.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [float(row["sigma_bz_nt"]) for row in rows] == history.sigma[:, 2].tolist()
