"""Each study, small: it ends, has its shape, and says the same for the same seed."""

import json
import math

import numpy as np
import pytest

from magcal_service.cli.__main__ import main
from magcal_service.config.settings import FilterConfig
from magcal_service.studies import run_study, spin_rates, window
from magcal_service.studies.convergence import LARGEST_BIAS_NT, LARGEST_D, Job, draw, fly_one
from magcal_service.studies.flights import FlightPlan, fly
from magcal_service.studies.montecarlo import seeds_of
from magcal_service.studies.noise import LEVELS_NT
from magcal_service.studies.report import Report
from magcal_service.studies.spin_rates import RATES_RPM
from magcal_service.studies.step import _back
from magcal_service.studies.study import Request
from tests.many.here import HERE

pytest.importorskip("ppigrf")


def small(name: str, *, seed: int = 1, methods: tuple[str, ...] = (), duration_s: int = 300) -> Report:
    return run_study(name, Request(2, seed, HERE, methods, duration_s))


def content(report: Report) -> dict[str, object]:
    """The JSON without the one number that differs from run to run."""
    parsed: dict[str, object] = json.loads(report.as_json())
    del parsed["seconds"]
    return parsed


def test_table2_has_both_axes_with_paper_bound_and_method() -> None:
    tables = small("table2", methods=("ekf", "plkf")).findings.tables
    summaries = [table for table in tables if table.title.startswith("Spin axis")]
    assert [table.title.split(":")[0] for table in summaries] == ["Spin axis (1, 1, 1)", "Spin axis orbit normal"]
    first = [row[0] for row in summaries[0].rows]
    assert first == ["paper's two-step", "paper's ukf", "bound: scalar", "ekf", "plkf"]


def test_table2_states_nine_parameters_for_each_method_and_axis() -> None:
    tables = small("table2", methods=("ekf",)).findings.tables
    assert [len(table.rows) for table in tables if table.title.startswith("ekf")] == [9, 9]


def test_table2_says_which_method_it_did_not_run() -> None:
    findings = small("table2", methods=("rate-aided", "ekf")).findings
    assert any("`rate-aided` was not run" in note and "angular rate" in note for note in findings.notes)


def test_noise_has_a_row_for_each_level() -> None:
    report = small("noise", methods=("ekf",))
    assert [row[0] for row in report.findings.tables[0].rows] == list(LEVELS_NT)


def test_spin_rates_has_a_row_with_a_verdict_for_each_rate() -> None:
    table = small("spin-rates", methods=("ekf",)).findings.tables[0]
    assert [row[0] for row in table.rows] == list(RATES_RPM)
    assert all(row[table.columns.index("verdict")] for row in table.rows)


def test_spin_rates_warns_of_aliasing_at_half_a_turn_a_sample(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(spin_rates, "RATES_RPM", (7.5, 30.0))
    table = small("spin-rates", methods=("ekf",)).findings.tables[0]
    reasons = {row[0]: str(row[table.columns.index("reasons")]) for row in table.rows}
    assert "spin_aliasing" in reasons[30.0]
    assert "spin_aliasing" not in reasons[7.5]


def test_window_compares_none_mean_and_harmonic_at_each_rate(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(window, "RATES_RPM", (7.5,))
    monkeypatch.setattr(window, "MEAN_TURNS", (1,))
    monkeypatch.setattr(window, "HARMONIC_TURNS", (2,))
    table = small("window").findings.tables[0]
    assert [row[0] for row in table.rows] == ["none", "mean, N = 8", "harmonic, 2 turns"]


def test_step_has_a_row_for_each_method_and_axis() -> None:
    findings = small("step", methods=("ekf",), duration_s=2000).findings
    assert [table.rows[0][0] for table in findings.tables] == ["ekf", "ekf"]
    assert [table.title for table in findings.tables] == [
        "200 nT in bx, across the spin axis",
        "200 nT in bz, along the spin axis",
    ]


@pytest.mark.parametrize(
    ("inside", "expected"),
    [
        ([0, 0, 1, 1, 1, 1, 1], 200.0),
        ([1, 0, 1, 1, 1, 1, 1], 200.0),
        ([1, 1, 1, 1, 1, 1, 1], 0.0),
        ([0, 0, 0, 0, 0, 1, 1], math.inf),
        ([0, 1, 1, 0, 1, 1, 0], math.inf),
    ],
)
def test_back_is_the_first_time_that_lasts(inside: list[int], expected: float) -> None:
    assert _back(np.array(inside, dtype=bool), np.arange(7) * 100.0) == expected


def test_convergence_names_verdict_and_counts_of_every_run() -> None:
    report = small("convergence", duration_s=400)
    counted = report.findings.tables[0].rows
    assert sum(int(row[1] or 0) + int(row[2] or 0) for row in counted) == 2
    assert report.findings.figures["ukf: runs ever trusted and wrong"] == 0


def test_convergence_draws_errors_within_their_limits() -> None:
    plans = [draw(np.random.default_rng(seed)) for seed in seeds_of(1, 200)]
    bias = [float(np.linalg.norm(plan.x[:3])) for plan in plans]
    d = [np.array(plan.x)[[3, 6, 7, 6, 4, 8, 7, 8, 5]].reshape(3, 3) for plan in plans]
    size = [float(np.abs(np.linalg.eigvalsh(matrix)).max()) for matrix in d]
    assert 0.9 * LARGEST_BIAS_NT < max(bias) <= LARGEST_BIAS_NT
    assert 0.9 * LARGEST_D < max(size) <= LARGEST_D + 1e-12


def test_a_run_of_convergence_flown_alone_is_the_same() -> None:
    seeds = seeds_of(5, 2)
    first = fly_one(Job(1, "ukf", seeds[1], 300))
    again = fly_one(Job(1, "ukf", seeds_of(5, 9)[1], 300))
    assert repr(first) == repr(again)


@pytest.mark.parametrize("name", ["table2", "noise"])
def test_the_same_seed_gives_the_same_report(name: str) -> None:
    assert content(small(name, methods=("ekf",))) == content(small(name, methods=("ekf",)))


def test_another_seed_gives_other_numbers() -> None:
    assert content(small("noise", methods=("ekf",))) != content(small("noise", methods=("ekf",), seed=2))


def test_the_command_writes_json_that_its_own_command_line_repeats(tmp_path, capsys) -> None:
    target = tmp_path / "noise.json"
    arguments = ["study", "noise", "--runs", "2", "--seed", "3", "--methods", "ekf", "--duration-s", "300"]
    assert main([*arguments, "--workers", "1", "--json", str(target)]) == 0
    assert json.loads(target.read_text())["command"] == "magcal " + " ".join(arguments)
    assert "### ekf: final estimate" in capsys.readouterr().out


def test_the_command_refuses_an_unknown_study_with_one_line(capsys) -> None:
    assert main(["study", "nosie"]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_the_scalar_bound_of_the_paper_s_flight_has_the_proportions_of_its_two_step() -> None:
    from magcal_service.estimators.interface import InformationSet
    from magcal_service.studies.bounds import bound_sigma

    plan = FlightPlan()
    sigma = 3.0 * bound_sigma(fly(plan).for_bounds(), InformationSet.SCALAR)
    assert sigma[:3] == pytest.approx([13.5, 13.5, 10.3], abs=0.1)
    assert plan.craft(FilterConfig()).sensor.noise_nt == 300.0
