"""Logs shorter than a live start: nine numbers with a sigma that holds, or the one reason why there are none."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import magcal_service as magcal
from magcal_service.base.errors import ConfigError
from magcal_service.model import Array
from magcal_service.offline.calibrate import Calibration, calibrate
from magcal_service.offline.replay import craft_of
from magcal_service.offline.short_log import spread
from magcal_service.trust.reasons import Reason
from magcal_service.wire.messages import Verdict
from tests.cli.cli_inputs import CONFIG, DESCRIPTOR, log_rows, run
from tests.offline.hand_turned import TRUTH, hand_turned


def answered(**more: float) -> Calibration:
    time_s, field_nt, magnitude_nt = hand_turned(3, **more)
    return calibrate(magcal.Recording.from_arrays(time_s, field_nt, magnitude_nt, noise_nt=100.0))


def test_a_minute_turned_by_hand_gives_the_nine_numbers_of_one_batch() -> None:
    result = answered()
    error = result.x - TRUTH
    assert result.verdict is Verdict.CONVERGING
    assert error @ np.linalg.solve(result.covariance, error) < 23.6  # chi-squared of 9: one in 200
    fit = magcal.fit(*hand_turned(3)[1:], noise_nt=100.0)
    assert result.sigma_bias_nt == pytest.approx(fit.sigma_bias_nt, rel=0.1)
    assert "600 independent samples, taken as one batch" in result.remedy


def test_a_sensor_turned_about_one_axis_says_that_directions_are_missing() -> None:
    result = answered(around_z_only=1.0)
    assert result.verdict is Verdict.NOT_STARTED
    assert result.reasons[0] is Reason.NO_SOLUTION
    assert "B varies by 98 nT (1 sigma) where it varies least" in result.remedy


def test_iron_beside_the_sensor_is_doubted_for_it_and_not_for_the_log_s_length() -> None:
    time_s, field_nt, magnitude_nt = hand_turned(3, iron_nt=400.0)
    result = calibrate(magcal.Recording.from_arrays(time_s, field_nt, magnitude_nt))
    assert result.verdict is Verdict.DOUBTFUL
    assert result.reasons[0] is Reason.STRUCTURED_RESIDUAL
    assert "on one spot, far from iron" in result.remedy


def coloured(memory: float) -> Array:
    noise, value, found = np.random.default_rng(1).standard_normal(6000), 0.0, []
    for step in noise:
        value = memory * value + step
        found.append(value)
    return np.array(found)


@pytest.mark.parametrize(("memory", "factor"), [(0.0, 1.0), (0.5, 3.0), (0.8, 9.0)])
def test_neighbours_that_agree_widen_the_covariance(memory: float, factor: float) -> None:
    """The variance of the mean of a first-order process is (1 + m) / (1 - m) times that of white noise; never less."""
    assert 0.97 * factor < spread(coloured(memory), None)[0] < 1.6 * factor


def test_a_residual_above_the_stated_noise_widens_the_covariance() -> None:
    assert spread(2.0 * coloured(0.0), 1.0)[0] == pytest.approx(4.0, rel=0.1)


def test_start_s_stands_in_place_of_the_configured() -> None:
    time_s, field_nt, magnitude_nt = hand_turned(3, seconds=150.0)
    recording = magcal.Recording.from_arrays(time_s, field_nt, magnitude_nt, noise_nt=100.0)
    craft = craft_of(recording)
    configured = replace(craft, filter=replace(craft.filter, start_s=60.0))
    early = calibrate(recording, start_s=60.0)
    assert early.x.tolist() == calibrate(recording, config=configured).x.tolist() != calibrate(recording).x.tolist()
    assert "as one batch" in calibrate(recording, start_s=600.0).remedy
    with pytest.raises(ConfigError, match=r"--start-s: 5.0 is refused; 10 to 86400 s is accepted"):
        calibrate(recording, start_s=5.0)


def test_calibrate_takes_the_craft_of_a_configuration(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text(log_rows(200))
    (tmp_path / "log.toml").write_text(DESCRIPTOR)
    text = CONFIG.replace("rows.csv", str(tmp_path / "rows.csv"))
    (tmp_path / "magcal.toml").write_text(text.replace('method = "ukf"', 'method = "two-step"'))
    log, config = tmp_path / "log.toml", tmp_path / "magcal.toml"
    assert "method two-step" in run("calibrate", log, "--config", config).out
    assert "method scalar-ukf" in run("calibrate", log, "--config", config, "--method", "scalar-ukf").out
    refused = run("calibrate", log, log, "--config", config, "--out", tmp_path / "out")
    assert (refused.code, refused.out) == (2, "")
    assert "--config" in refused.err


def test_a_recording_goes_on_from_an_earlier_result(tmp_path: Path) -> None:
    """Two minutes after the first minute, each with its own noise: together surer than either, and still right."""
    first = answered(seconds=110.0)
    (tmp_path / "first.json").write_text(first.as_json())
    time_s, field_nt, magnitude_nt = hand_turned(4, seconds=110.0)
    recording = magcal.Recording.from_arrays(time_s, field_nt, magnitude_nt, noise_nt=100.0)
    both, alone = calibrate(recording, prior=tmp_path / "first.json"), calibrate(recording)
    expected = np.linalg.inv(np.linalg.inv(first.covariance) + np.linalg.inv(alone.covariance))
    assert both.sigma_bias_nt == pytest.approx(np.sqrt(np.diagonal(expected))[:3], rel=0.05)
    error = both.x - TRUTH
    assert error @ np.linalg.solve(both.covariance, error) < 23.6
    changed = magcal.Recording.from_arrays(time_s, field_nt + np.array([3e3, 0.0, 0.0]), magnitude_nt, noise_nt=100.0)
    assert Reason.RESTARTED in calibrate(changed, prior=tmp_path / "first.json").reasons


@pytest.mark.parametrize(
    ("method", "spoiled", "said"),
    [
        ("two-step", {}, "--prior with the method: 'two-step' is refused; scalar-ukf, ukf are accepted"),
        ("ukf", {"reasons": ["collapsed"]}, "reasons: 'collapsed' is refused; a result that is trusted"),
        ("ukf", {"covariance": np.eye(9).tolist()}, "1 sigma of a calibrated vector here"),
    ],
)
def test_a_prior_that_does_not_fit_is_refused(
    tmp_path: Path, method: str, spoiled: dict[str, object], said: str
) -> None:
    (tmp_path / "prior.json").write_text(json.dumps({**answered().to_dict(), **spoiled}))
    (tmp_path / "log.csv").write_text(log_rows(130))
    (tmp_path / "log.toml").write_text(DESCRIPTOR)
    refused = run("calibrate", tmp_path / "log.toml", "--method", method, "--prior", tmp_path / "prior.json")
    assert refused.code == 2
    assert said in refused.err


@pytest.mark.parametrize(
    ("noise_nt", "iron_nt", "says"), [(3500.0, 0.0, "average the sensor"), (100.0, 4000.0, "agree")]
)
def test_a_large_residual_is_called_noise_only_where_it_is_white(noise_nt: float, iron_nt: float, says: str) -> None:
    time_s, field_nt, magnitude_nt = hand_turned(3, noise_nt=noise_nt, iron_nt=iron_nt)
    result = calibrate(magcal.Recording.from_arrays(time_s, field_nt, magnitude_nt))
    assert result.reasons[0] is Reason.NOISE_TOO_HIGH
    assert says in result.remedy


def test_a_log_of_one_place_that_is_too_short_is_not_told_to_be_longer() -> None:
    result = answered(seconds=140.0)
    assert result.reasons[0] is Reason.NOT_SETTLED
    assert "at one place a longer one is not trusted either" in result.remedy
