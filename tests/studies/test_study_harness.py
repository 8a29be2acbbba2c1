"""Flights, executors, Monte-Carlo statistics and reports of the studies."""

import json
from dataclasses import replace

import numpy as np
import pytest

from magcal_service.base.errors import ConfigError, InputRefusedError
from magcal_service.config.settings import FilterConfig, SpinConfig
from magcal_service.many.executor import Executor
from magcal_service.many.pool import Pool
from magcal_service.model import calibrate, measure
from magcal_service.studies import find_study, run_study, save, studies
from magcal_service.studies.flights import FlightPlan, fly
from magcal_service.studies.montecarlo import Ensemble, nees, seeds_of, simulate, statistics
from magcal_service.studies.report import Findings, Line, Panel, Report, Table
from magcal_service.studies.study import Request
from tests.cli import cli_inputs
from tests.many.here import HERE

pytest.importorskip("ppigrf")

SHORT = FlightPlan(duration_s=400, noise_nt=100.0)


def test_the_body_field_is_the_reference_turned() -> None:
    flown = fly(SHORT)
    assert np.allclose(np.linalg.norm(flown.field_body_nt, axis=1), flown.magnitude_nt, rtol=1e-12)


def test_the_field_along_the_spin_axis_is_the_same_in_both_frames() -> None:
    plan = replace(SHORT, spin_body=(0.3, -0.5, 0.8), spin_eci=(1.0, 2.0, -0.5))
    flown = fly(plan)
    along_body = flown.field_body_nt @ (np.array(plan.spin_body) / np.linalg.norm(plan.spin_body))
    along_eci = flown.reference_eci_nt @ (np.array(plan.spin_eci) / np.linalg.norm(plan.spin_eci))
    assert np.allclose(along_body, along_eci, atol=1e-6)


def test_the_body_turns_at_the_plan_s_rate_about_plus_axis() -> None:
    flown = fly(replace(SHORT, rate_rpm=6.0))
    phase = np.unwrap(np.arctan2(flown.field_body_nt[:60, 1], flown.field_body_nt[:60, 0]))
    turns_per_minute = (phase[50] - phase[0]) / (2.0 * np.pi) / 50.0 * 60.0
    assert turns_per_minute == pytest.approx(-6.0, abs=0.05)  # seen from the body, the field turns backwards


def test_the_orbit_returns_after_its_period() -> None:
    plan = FlightPlan(duration_s=round(FlightPlan().period_s) + 1)
    flown = fly(plan)
    assert flown.magnitude_nt.min() > 15_000.0
    assert flown.magnitude_nt.max() < 55_000.0
    assert plan.period_s == pytest.approx(5810.0, abs=20.0)


def test_measured_vectors_without_noise_calibrate_to_the_field() -> None:
    flown = fly(SHORT)
    x = np.array(SHORT.x)
    assert np.allclose(calibrate(x, measure(x, flown.field_body_nt)), flown.field_body_nt, atol=1e-6)


def test_the_noise_has_the_plan_s_size() -> None:
    flown = fly(FlightPlan(duration_s=4000, noise_nt=250.0))
    noise = calibrate(np.array(flown.plan.x), flown.measured(seeds_of(1, 1)[0])) - flown.field_body_nt
    assert noise.std(axis=0) == pytest.approx([250.0] * 3, rel=0.04)


def test_a_step_moves_truth_and_measurement_from_its_time_on() -> None:
    plan = replace(SHORT, step_at_s=200.0, step_nt=(200.0, 0.0, 0.0))
    seed = seeds_of(1, 1)[0]
    moved = calibrate(np.array(SHORT.x), fly(plan).measured(seed)) - calibrate(
        np.array(SHORT.x), fly(SHORT).measured(seed)
    )
    assert np.abs(moved[:200]).max() < 1e-6
    assert np.allclose(moved[200:], [200.0, 0.0, 0.0], atol=1e-6)
    assert fly(plan).truth(199.0)[0] == SHORT.x[0]
    assert fly(plan).truth(200.0)[0] == SHORT.x[0] + 200.0


def test_the_craft_is_told_spin_and_noise_as_they_are() -> None:
    craft = replace(SHORT, spin_body=(0.0, 3.0, 4.0), rate_rpm=-2.0).craft(FilterConfig(), SpinConfig(window_turns=5))
    assert craft.spin is not None
    assert craft.spin.axis == pytest.approx((0.0, 0.6, 0.8))
    assert (craft.spin.rate_rpm, craft.spin.window_turns, craft.sensor.noise_nt) == (-2.0, 5, 100.0)


def test_the_first_runs_are_the_same_however_many_there_are() -> None:
    few, many = seeds_of(7, 3), seeds_of(7, 30)
    assert [seed.generate_state(4).tolist() for seed in few] == [seed.generate_state(4).tolist() for seed in many[:3]]


def test_no_two_runs_draw_the_same() -> None:
    assert len({seed.generate_state(4).tobytes() for seed in seeds_of(7, 200)}) == 200


def test_two_processes_give_the_same_numbers_as_one() -> None:
    config = SHORT.craft(FilterConfig(method="ekf"))
    here = simulate(SHORT, config, seeds_of(3, 6), HERE)
    pool = simulate(SHORT, config, seeds_of(3, 6), Executor(Pool(2)))
    assert np.array_equal(here.x, pool.x)
    assert np.array_equal(here.covariance, pool.covariance)


@pytest.mark.parametrize("method", ["ukf", "scalar-ukf"])
def test_a_batched_filter_equals_the_registry_s_run_alone(method: str) -> None:
    config = SHORT.craft(FilterConfig(method=method))
    batched = simulate(SHORT, config, seeds_of(3, 2), HERE)
    from magcal_service.estimators import find_method

    for run, seed in enumerate(seeds_of(3, 2)):
        alone = find_method(method).build(config)
        for tick in fly(SHORT).ticks(fly(SHORT).measured(seed)):
            alone.handle(tick)
        estimate = alone.estimate()
        sigma = np.sqrt(np.diagonal(estimate.covariance))
        assert np.abs((batched.x[run, -1] - estimate.x) / sigma).max() < 1e-9


def test_estimates_are_kept_at_the_times_asked_for() -> None:
    plan = replace(SHORT, duration_s=400)
    config = plan.craft(FilterConfig())
    early = simulate(replace(plan, duration_s=300), config, seeds_of(3, 2), HERE)
    both = simulate(plan, config, seeds_of(3, 2), HERE, at_s=(299.0, 399.0))
    assert both.at_s.tolist() == [299.0, 399.0]
    assert np.allclose(both.x[:, 0], early.x[:, -1], rtol=1e-9)


def ensemble_of(error: np.ndarray, covariance: np.ndarray) -> Ensemble:
    runs = len(error)
    return Ensemble(
        at_s=np.array([0.0]),
        truth=np.zeros((1, 9)),
        x=error[:, None],
        covariance=np.tile(covariance, (runs, 1, 1, 1)),
        started=np.ones((runs, 1), dtype=bool),
        restarts=np.zeros(runs, dtype=int),
    )


def test_errors_drawn_from_their_own_covariance_have_nees_nine() -> None:
    rng = np.random.default_rng(1)
    factor = rng.standard_normal((9, 9)) * np.repeat([100.0, 1e-3], [3, 6])[:, None]
    covariance = factor @ factor.T
    end = statistics(ensemble_of(rng.standard_normal((2000, 9)) @ factor.T, covariance))
    assert end.nees == pytest.approx(9.0, abs=3.0 * (18.0 / 2000) ** 0.5)
    assert np.abs(end.formal / end.spread - 1.0).max() < 0.06


def test_a_covariance_half_as_wide_in_sigma_has_four_times_the_nees() -> None:
    rng = np.random.default_rng(2)
    error = rng.standard_normal((50, 9))
    covariance = np.tile(np.eye(9), (50, 1, 1))
    assert nees(error, 0.25 * covariance) == pytest.approx(4.0 * nees(error, covariance))


def test_runs_without_an_estimate_are_counted_and_left_out() -> None:
    ensemble = ensemble_of(
        np.vstack([np.full((1, 9), 1e6), np.random.default_rng(1).standard_normal((5, 9))]), np.eye(9)
    )
    ensemble.started[0] = False
    end = statistics(ensemble)
    assert (end.runs, end.started) == (6, 5)
    assert np.abs(end.mean).max() < 10.0


def report() -> Report:
    findings = Findings(
        tables=(Table("a title", ("name", "value"), (("one", 1.5), ("none", float("nan")), ("truth", True))),),
        figures={"the figure": np.float64(2.5), "nothing": None},
        settings={"noise [nT]": 300.0},
        notes=("a note",),
        panels=(Panel("panel", "x", "y", (Line("line", (1.0, 2.0), (3.0, float("inf"))),)),),
    )
    return Report("noise", "A summary.", 10, 7, "magcal study noise --runs 10 --seed 7", 1.25, findings)


def test_the_json_has_seed_command_version_and_figures() -> None:
    content = json.loads(report().as_json())
    assert set(content) == {
        "study", "version", "command", "runs", "seed", "seconds", "settings", "figures", "tables", "curves", "notes",
    }  # fmt: skip
    assert (content["seed"], content["runs"]) == (7, 10)
    assert content["command"] == "magcal study noise --runs 10 --seed 7"
    assert content["figures"] == {"the figure": 2.5, "nothing": None}


def test_what_is_not_finite_is_null_in_the_json_and_a_dash_on_the_page() -> None:
    assert json.loads(report().as_json())["tables"][0]["rows"][1] == ["none", None]
    assert "| none | - |" in report().markdown()


def test_the_page_has_command_table_and_picture() -> None:
    page = report().markdown("noise.png")
    assert "magcal study noise --runs 10 --seed 7" in page
    assert "| one | 1.5 |" in page
    assert "![noise](noise.png)" in page


def test_saving_writes_page_json_and_the_picture_that_plot_draws(tmp_path) -> None:
    pytest.importorskip("matplotlib")
    save(report(), tmp_path / "own.json", tmp_path / "results")
    written = {path.name for path in (tmp_path / "results").iterdir()}
    assert written == {"noise.md", "noise.json", "noise.png"}
    assert cli_inputs.run("plot", tmp_path / "own.json", "--out", tmp_path / "own.png").code == 0
    assert (tmp_path / "own.png").read_bytes() == (tmp_path / "results" / "noise.png").read_bytes()
    assert (tmp_path / "own.json").read_text() == (tmp_path / "results" / "noise.json").read_text()


def test_a_file_that_cannot_be_written_is_refused_by_name(tmp_path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputRefusedError, match=r"file/x\.json"):
        save(report(), tmp_path / "file" / "x.json")


def test_every_study_of_the_contract_is_found() -> None:
    names = {study.name for study in studies()}
    assert names == {
        "concealed", "table2", "convergence", "integrity", "noise", "window", "step", "spin-rates", "reality",
    }  # fmt: skip


def test_an_unknown_study_is_refused_with_the_nearest() -> None:
    with pytest.raises(ConfigError, match="did you mean 'noise'"):
        find_study("nosie")


@pytest.mark.parametrize(
    ("request_", "field"),
    [
        (Request(1, 1, HERE), "--runs"),
        (Request(5, -1, HERE), "--seed"),
        (Request(5, 1, HERE, duration_s=10), "--duration-s"),
        (Request(5, 1, HERE, ("ufk",)), "method"),
        (Request(5, 1, HERE, scenarios=("clean",)), "--scenarios"),
        (Request(5, 1, HERE, noises_nt=(100.0,)), "take one that has: integrity"),
        (Request(5, 1, HERE, motions=("spin",)), "--motions"),
    ],
)
def test_a_request_that_means_nothing_is_refused_before_it_runs(request_: Request, field: str) -> None:
    with pytest.raises(ConfigError, match=field):
        run_study("noise", request_)
