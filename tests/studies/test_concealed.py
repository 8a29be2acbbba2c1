"""The study of concealed cases: its tables, figures and pictures of answers and diagnoses written by hand."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest

from magcal_service.cli.__main__ import main
from magcal_service.studies import run_study, save
from magcal_service.studies.cases.ask import Named, Said
from magcal_service.studies.cases.score import Scored
from magcal_service.studies.cases.truth import Put, Truth
from magcal_service.studies.concealed import figures, panels, tables
from magcal_service.studies.report import Report
from magcal_service.studies.study import Request
from tests.many.here import HERE

STEP = Put("bias_step", {"step_nt": [10.0, 0.0, -20.0]})
TONE = Put("tone", {})
HIDDEN = Put("torquer", {}, concealed=True)
LOST = Put("current_loop", {}, concealed=True, inferable=False)
BURSTS = Put("bursts", {})


def _truth(kind: str, *effects: Put, regime: str = "spin_fast", **more: Any) -> Truth:
    return Truth(regime, kind, effects, (), 50.0, **more)


def _named(effect: str, probability: float, members: tuple[str, ...] = (), **parameters: Any) -> Named:
    return Named(effect, probability, (effect, *members), parameters)


SIZE = {"value": [11.5, 0.5, -17.5], "sigma": [1.0, 1.0, 1.0], "unit": "nT"}

SCORED = [
    Scored(
        "regimes",
        "case-000",
        _truth("effect", STEP),
        Said("named", True, (), (_named("bias_step", 0.97, step_nt=SIZE),), 4.0),
    ),
    Scored(
        "regimes",
        "case-001",
        _truth("effect", HIDDEN, regime="nadir"),
        Said("named", False, ("poor_coverage",), (_named("tone", 0.6, ("torquer",)),), 9.0),
    ),
    Scored("regimes", "case-002", _truth("effect", LOST), Said("unknown", False, (), (_named("unknown", 1.0),), 2.0)),
    Scored("regimes", "case-003", _truth("clean"), Said("named", True, (), (_named("tone", 0.96),), 1.0)),
    Scored(
        "blind",
        "case-000",
        _truth("several", STEP, TONE, regime="blind"),
        Said("named", True, (), (_named("tone", 0.9995), _named("bias_step", 0.9985)), 3.0),
    ),
    Scored(
        "blind",
        "case-001",
        _truth("outside", BURSTS, regime="blind", unknown_is_right=True),
        Said("unknown", False, (), (), 6.0),
    ),
    Scored("blind", "case-002", _truth("clean", regime="blind"), Said("refused", False, ("no samples",))),
]


def rows(title: str, scored: list[Scored] = SCORED) -> list[tuple[Any, ...]]:
    """The rows of the table whose title begins so."""
    (found,) = [table for table in tables(scored) if table.title.startswith(title)]
    assert all(len(row) == len(found.columns) for row in found.rows)
    return list(found.rows)


def test_cases_are_counted_by_simulator_and_what_was_asked() -> None:
    """Cases, right, or in class, unknown, with a false name, trusted, trusted with a false name."""
    assert rows("By simulator") == [
        ("regimes", "clean", 1, 0, 0, 0, 1, 1, 1),
        ("regimes", "driver recorded or none needed", 1, 1, 1, 0, 0, 1, 0),
        ("regimes", "driver left out", 1, 0, 1, 0, 1, 0, 0),
        ("regimes", "driver left out, not to be guessed", 1, 0, 0, 1, 0, 0, 0),
        ("blind", "clean", 1, 0, 0, 0, 0, 0, 0),
        ("blind", "several effects", 1, 1, 1, 0, 0, 1, 0),
        ("blind", "in no catalogue", 1, 1, 1, 1, 0, 0, 0),
    ]


def test_cases_are_counted_by_regime() -> None:
    assert rows("By regime") == [
        ("blind", "blind", 3, 2, 2, 1, 0, 1, 0),
        ("regimes", "nadir", 1, 0, 1, 0, 1, 0, 0),
        ("regimes", "spin_fast", 3, 1, 1, 1, 1, 2, 1),
    ]


def test_cases_are_counted_by_what_was_put_in_over_all_simulators() -> None:
    assert rows("By what was put in") == [
        ("bias_step", 1, 1, 1, 0, 0, 1, 0),
        ("bursts", 1, 1, 1, 1, 0, 0, 0),
        ("current_loop", 1, 0, 0, 1, 0, 0, 0),
        ("nothing", 2, 0, 0, 0, 1, 1, 1),
        ("several effects", 1, 1, 1, 0, 0, 1, 0),
        ("torquer", 1, 0, 1, 0, 1, 0, 0),
    ]


def test_false_names_are_counted_among_clean_cases_all_and_those_with_exit_0() -> None:
    assert rows("False names") == [
        ("all", "clean", 2, 1, 1, 1),
        ("all", "all", 7, 2, 5, 2),
        ("all", "exit 0", 3, 1, 4, 1),
        ("regimes", "clean", 1, 1, 1, 1),
        ("regimes", "all", 4, 2, 3, 2),
        ("regimes", "exit 0", 2, 1, 2, 1),
        ("blind", "clean", 1, 0, 0, 0),
        ("blind", "all", 3, 0, 2, 0),
        ("blind", "exit 0", 1, 0, 2, 0),
    ]


def test_reliability_is_of_all_simulators_and_of_each() -> None:
    """Claimed 0.97 truly and 0.96 falsely: half of two names, from 0.095 to 0.905 by Wilson's score."""
    found = {(row[0], row[1]): row[2:] for row in rows("Reliability")}
    assert len(found) == 3 * 7
    assert found["all", "0.95 to 0.99"] == pytest.approx((2, 0.965, 0.5, 0.0945, 0.9055), abs=1e-4)
    assert found["regimes", "0.95 to 0.99"] == found["all", "0.95 to 0.99"]
    assert found["blind", "0.95 to 0.99"] == (0, None, None, None, None)
    assert found["blind", "0.999 to 1"] == pytest.approx((1, 0.9995, 1.0, 0.2065, 1.0), abs=1e-4)
    assert found["all", "0.5 to 0.8"][:3] == (1, 0.6, 0.0)


def test_parameters_are_counted_within_one_two_and_three_sigma() -> None:
    assert rows("Parameters") == [
        (name, 3, pytest.approx(1 / 3), pytest.approx(2 / 3), 1.0, 2.5) for name in ("all", "bias_step.step_nt")
    ]


def test_times_are_the_median_and_the_worst_of_what_was_diagnosed() -> None:
    assert rows("Processor time") == [
        ("all", 3.5, 9.0, "regimes/case-001"),
        ("regimes", 3.0, 9.0, "regimes/case-001"),
        ("blind", 4.5, 6.0, "blind/case-001"),
    ]


def test_every_case_that_is_not_right_is_shown_with_its_answer() -> None:
    hidden, lost = "driver left out", "driver left out, not to be guessed"
    said = "named (poor_coverage)"
    assert rows("Every case") == [
        ("regimes", "case-001", "nadir", "torquer", 50.0, hidden, said, "tone 0.6000", 3),
        ("regimes", "case-002", "spin_fast", "current_loop", 50.0, lost, "unknown", None, 3),
        ("regimes", "case-003", "spin_fast", "nothing", 50.0, "clean", "named", "tone 0.9600", 0),
        ("blind", "case-002", "blind", "nothing", 50.0, "clean", "refused (no samples)", None, 2),
    ]


def test_of_one_simulator_alone_nothing_stands_twice() -> None:
    alone = SCORED[:4]
    assert {row[0] for row in rows("Reliability", alone)} == {"all"}
    assert len(panels(alone)) == 1


def test_the_figures_are_shares_over_all_simulators() -> None:
    assert figures(SCORED) == {
        "right: clean": 0.0,
        "right: driver recorded or none needed": 1.0,
        "right: driver left out": 0.0,
        "right: driver left out, not to be guessed": 0.0,
        "right: several effects": 1.0,
        "right: in no catalogue": 1.0,
        "exit 0: cases": 3,
        "exit 0: share with a false name": pytest.approx(1 / 3),
        "claimed at 0.95 or more: names": 4,
        "claimed at 0.95 or more: share true": 0.75,
        "parameters: components": 3,
        "parameters: share within 1 sigma": pytest.approx(1 / 3),
        "parameters: share within 2 sigma": pytest.approx(2 / 3),
    }


def test_a_panel_has_the_claims_in_odds_with_what_they_should_be_and_the_interval() -> None:
    """0.6 is 1.5 to one; as claimed is p = odds / (1 + odds)."""
    every, regimes, blind = panels(SCORED)
    assert [panel.title for panel in (every, regimes, blind)] == [
        "all (names: 5)",
        "regimes (names: 3)",
        "blind (names: 2)",
    ]
    claimed, true, low, high = regimes.lines
    assert claimed.limit
    assert not any(line.limit for line in (true, low, high))
    assert dict(zip(map(round, claimed.x), claimed.y, strict=True))[100] == pytest.approx(100 / 101)
    assert true.x == low.x == high.x == pytest.approx((1.5, 0.965 / 0.035))
    assert true.y == (0.0, 0.5)
    assert low.y == pytest.approx((0.0, 0.0945), abs=1e-4)
    assert high.y == pytest.approx((0.7935, 0.9055), abs=1e-4)


@pytest.mark.parametrize(("claim", "odds"), [(1.0, 1e4), (0.999999, 1e4), (0.99, 99.0)])
def test_a_certain_claim_is_drawn_at_the_end_of_the_scale(claim: float, odds: float) -> None:
    said = Said("named", True, (), (_named("bias_step", claim),), 1.0)
    (panel,) = panels([Scored("one", "case-000", _truth("effect", STEP), said)])
    assert panel.lines[1].x == pytest.approx((odds,))
    assert max(panel.lines[0].x) == pytest.approx(1e4)


def test_where_nothing_is_named_nothing_is_drawn() -> None:
    silent = [Scored("one", "case-000", _truth("clean"), Said("none", True, (), (), 1.0))]
    assert panels(silent) == ()
    assert figures(silent)["claimed at 0.95 or more: share true"] is None


def _folder(tmp_path: Path) -> Path:
    """Three cases whose recordings are refused; one of them cannot be found."""
    common = {"driver_concealed": False, "noise_nt": 50.0}
    answers = {
        "case-000": {"effect": "none", "detectability": 0.0, **common},
        "case-001": {"effect": "tone", "period_s": 20.0, "detectability": 20.0, **common},
        "case-002": {"effect": "tone", "period_s": 20.0, "detectability": 11.0, **common},
    }
    folder = tmp_path / "given"
    for name in answers:
        (folder / name).mkdir(parents=True)
        (folder / name / "recording.toml").write_text("version = 1\n", encoding="utf-8")
    (folder / "answers.json").write_text(json.dumps(answers), encoding="utf-8")
    return folder


def test_every_case_is_asked_and_those_that_count_are_scored(tmp_path: Path) -> None:
    report = run_study("concealed", Request(None, 1, HERE, recordings=(_folder(tmp_path),)))
    found = report.findings
    assert found.settings == {"simulators": "given", "cases": 3, "scored": 2, "least detectability": 12.0}
    missed = [(row[1], row[3], row[6].partition(":")[0], row[8]) for row in found.tables[-1].rows]
    assert missed == [
        ("case-000", "nothing", "refused (recording.toml", 2),
        ("case-001", "tone", "refused (recording.toml", 2),
    ]
    assert report.command == f"magcal study concealed --recordings {tmp_path / 'given'}"


def test_a_report_is_written_with_its_picture(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    found = run_study("concealed", Request(None, 1, HERE, recordings=(_folder(tmp_path),))).findings
    drawn = type(found)(tables(SCORED), figures(SCORED), found.settings, found.notes, panels(SCORED))
    save(Report("concealed", "A summary.", None, None, "magcal study concealed", 1.0, drawn), None, tmp_path / "out")
    assert {path.name for path in (tmp_path / "out").iterdir()} == {
        "concealed.md",
        "concealed.json",
        "concealed.png",
    }
    content = json.loads((tmp_path / "out/concealed.json").read_text(encoding="utf-8"))
    assert [curve["title"] for curve in content["curves"]] == [
        "all (names: 5)",
        "regimes (names: 3)",
        "blind (names: 2)",
    ]
    assert math.isclose(content["figures"]["claimed at 0.95 or more: share true"], 0.75)


def test_a_folder_without_cases_is_refused_by_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["study", "concealed", "--recordings", str(tmp_path)]) == 2
    assert "--recordings: " in capsys.readouterr().err
    assert main(["study", "concealed"]) == 2
    assert capsys.readouterr().err.startswith("--recordings: 'none' is refused; folders of concealed cases")
    assert main(["study", "concealed", "--runs", "9"]) == 2
    assert "--runs: 9 is refused; the study concealed takes recordings" in capsys.readouterr().err
