"""The pictures: what is drawn, within which limits."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from magcal_service.views.nine import PARAMETERS
from sim_sensor.view.history import History
from sim_sensor.view.plots import error_figure, plot_errors, plot_residual, residual_figure
from tests.sim_sensor.view.view_estimates import FINAL_SIGMA, START_NS, TRUTH, converging, estimate


def test_nine_panels_are_named_and_have_units() -> None:
    figure = error_figure(converging(500), "seed 1")
    titles = [axes.get_title().split(":")[0] for axes in figure.axes]
    labels = [figure.axes[i].get_ylabel() for i in (0, 3, 6)]
    assert titles == [parameter.name for parameter in PARAMETERS]
    assert labels == ["bias error [nT]", "scale error [1e-3]", "non-orthogonality error [1e-3]"]


@pytest.mark.parametrize(("place", "factor"), [(0, 1.0), (2, 1.0), (3, 1e3), (8, 1e3)])
def test_panel_draws_the_error_and_both_limits(place: int, factor: float) -> None:
    history = converging(500)
    upper, lower, error = (line.get_ydata() for line in error_figure(history).axes[place].get_lines()[:3])
    np.testing.assert_allclose(upper, 3.0 * factor * history.sigma[:, place])
    np.testing.assert_allclose(lower, -3.0 * factor * history.sigma[:, place])
    np.testing.assert_allclose(error, factor * (history.x - history.truth)[:, place])


def test_range_is_set_by_the_end_and_not_by_the_start() -> None:
    history = converging(2000)
    bottom, top = error_figure(history).axes[0].get_ylim()
    assert 15.0 <= top == -bottom <= 60.0  # final limit 9 nT, first limit 10000 nT and more


def test_a_late_excursion_stays_inside_the_picture() -> None:
    history = converging(400)
    history.add(estimate((5400.0, *TRUTH[1:]), FINAL_SIGMA, time_s=401.0), TRUTH)
    assert error_figure(history).axes[0].get_ylim()[1] > 400.0


def test_unknown_truth_is_said_in_the_title() -> None:
    assert "truth unknown" in error_figure(converging(100, known=False)).get_suptitle()


def test_long_runs_are_thinned_and_keep_their_last_estimate() -> None:
    history = converging(9000)
    line = error_figure(history).axes[4].get_lines()[2]
    assert len(line.get_xdata()) <= 4000
    assert line.get_xdata()[-1] == 9000.0


def test_residual_is_drawn_against_the_noise() -> None:
    residual, noise = residual_figure(converging(100)).axes[0].get_lines()
    assert residual.get_ydata()[-1] == pytest.approx(300.0 + 900.0)
    assert set(noise.get_ydata()) == {300.0}


def test_a_history_of_one_estimate_can_be_drawn(tmp_path: Path) -> None:
    history = History(START_NS)
    history.add(estimate(TRUTH, FINAL_SIGMA))
    plot_errors(history, tmp_path / "one.png")
    assert (tmp_path / "one.png").stat().st_size > 10_000


def test_an_empty_history_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="no estimate"):
        plot_residual(History(), tmp_path / "none.png")


def test_png_is_wide_enough_to_read(tmp_path: Path) -> None:
    plot_errors(converging(200), tmp_path / "errors.png")
    head = (tmp_path / "errors.png").read_bytes()[:24]
    assert head[:8] == b"\x89PNG\r\n\x1a\n"
    assert int.from_bytes(head[16:20], "big") >= 1300
