"""The scorer on answers and diagnoses written by hand."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pytest

from tests.many.here import HERE
from tests.regimes.case import draw_case
from tests.regimes.score import (
    SAID,
    Named,
    Put,
    Said,
    Scored,
    Truth,
    diagnose_all,
    diagnose_case,
    read_answers,
    reliability,
    said_in,
    scored_of,
    summarise,
)
from tests.regimes.world import REGIMES
from tests.regimes.write import write_answers, write_case

STEP = Put("bias_step", {"step_nt": [10.0, 0.0, -20.0], "at_s": 100.0})


def _truth(kind: str = "effect", *effects: Put, **more: Any) -> Truth:
    given = {"regime": "spin_fast", "also": (), "detectability": 50.0} | more
    return Truth(kind=kind, effects=effects, **given)


def _named(effect: str, probability: float = 0.99, members: tuple[str, ...] = (), **parameters: Any) -> Named:
    return Named(effect, probability, (effect, *members), parameters)


def _said(verdict: str, *named: Named, trusted: bool = True) -> Said:
    return Said("case-000", verdict, trusted, (), named, 1.0)


@pytest.mark.parametrize(
    ("truth", "said", "right", "in_class", "false"),
    [
        (_truth("effect", STEP), _said("named", _named("bias_step")), True, True, 0),
        (_truth("effect", STEP), _said("named", _named("bias_drift", 0.6, ("bias_step",))), False, True, 1),
        (_truth("effect", STEP), _said("named", _named("bias_step"), _named("tone")), True, True, 1),
        (_truth("effect", STEP), _said("unknown", _named("unknown"), _named("bias_step")), False, False, 0),
        (_truth("effect", STEP), _said("none"), False, False, 0),
        (
            _truth("effect", STEP, also=("nutation",)),
            _said("named", _named("nutation"), _named("bias_step")),
            True,
            True,
            0,
        ),
        (_truth("effect", STEP, unknown_is_fair=True), _said("unknown", _named("bias_step")), True, True, 0),
        (_truth("effect", STEP, unknown_is_fair=True), _said("unknown"), False, False, 0),
        (_truth("several", STEP, Put("tone", {})), _said("named", _named("tone")), False, False, 0),
        (_truth("several", STEP, Put("tone", {})), _said("named", _named("tone"), _named("bias_step")), True, True, 0),
        (
            _truth("outside", Put("bursts", {}), unknown_is_right=True),
            _said("unknown", _named("unknown")),
            True,
            True,
            0,
        ),
        (_truth("outside", Put("bursts", {}), unknown_is_right=True), _said("named", _named("tone")), False, False, 1),
        (_truth("clean"), _said("none"), True, True, 0),
        (_truth("clean"), _said("named", _named("tone")), False, False, 1),
        (_truth("clean"), _said("unknown", _named("unknown")), False, False, 0),
        (_truth("clean", unknown_is_fair=True), _said("unknown", _named("unknown")), True, True, 0),
        (_truth("clean"), _said("failed"), False, False, 0),
    ],
)
def test_what_counts_as_right(truth: Truth, said: Said, right: bool, in_class: bool, false: int) -> None:
    """A right name first, a right name in the class, names that are not true."""
    scored = Scored(truth, said)
    assert (scored.is_right, scored.is_in_class, len(scored.false)) == (right, in_class, false)


def test_distances_are_in_sigmas_and_only_where_both_give_a_number() -> None:
    """Each component of what both give in one shape; no sigma, another shape or another name: not compared."""
    entry = _named(
        "bias_step",
        step_nt={"value": [12.0, 0.5, -20.0], "sigma": [1.0, 1.0, 2.0], "unit": "nT"},
        at_s={"value": 99.0, "sigma": None, "unit": "s"},
    )
    assert Scored(_truth("effect", STEP), _said("named", entry)).distances() == {"bias_step.step_nt": [2.0, 0.5, 0.0]}
    scalar = _named("bias_step", step_nt={"value": 12.0, "sigma": 1.0, "unit": "nT"})
    assert Scored(_truth("effect", STEP), _said("named", scalar)).distances() == {}


def test_reliability_counts_each_claim_in_its_bin() -> None:
    """Bins hold claims from their lower edge on, the last one 1 as well; ``unknown`` claims nothing."""
    said = _said(
        "named", _named("bias_step", 0.99), _named("tone", 0.9), _named("bias_drift", 1.0), _named("unknown", 0.5)
    )
    rows = {row[0]: row[1:] for row in reliability([Scored(_truth("effect", STEP), said)])}
    assert rows["0.99 to 0.999"] == [1, pytest.approx(0.99), 1.0]
    assert rows["0.9 to 0.95"] == [1, pytest.approx(0.9), 0.0]
    assert rows["0.999 to 1"] == [1, pytest.approx(1.0), 0.0]
    assert rows["0.5 to 0.8"] == [0, None, None]


def test_tables_count_groups_and_names_that_may_be_acted_on() -> None:
    """Drivers left out are a group of their own; false names count among all, and among those with exit 0."""
    hidden = Put("torquer", {}, concealed=True)
    blind = Put("current_loop", {}, concealed=True, inferable=False)
    scored = [
        Scored(_truth("effect", STEP), _said("named", _named("bias_step"))),
        Scored(_truth("effect", hidden), _said("named", _named("tone"), trusted=False)),
        Scored(_truth("effect", blind), _said("unknown", _named("unknown"), trusted=False)),
        Scored(_truth("clean"), _said("named", _named("tone"))),
    ]
    tables = summarise(scored).tables
    assert tables["By what was asked"][1:] == [
        ["clean", 1, 0, 0, 0, 1],
        ["driver left out", 1, 0, 0, 0, 1],
        ["driver left out, not to be guessed", 1, 0, 0, 1, 0],
        ["driver recorded or none needed", 1, 1, 1, 0, 0],
    ]
    assert tables["False names"][1:] == [["clean", 1, 1, 1, 1], ["all", 4, 2, 3, 2], ["exit 0", 2, 1, 2, 1]]
    assert "torquer" in summarise(scored).text()


def test_cases_below_what_can_be_found_are_left_out() -> None:
    """Clean cases always count, others from a detectability of 12 on."""
    truths = {"a": _truth("effect", STEP, detectability=11.9), "b": _truth("clean", detectability=0.0)}
    said = [Said(name, "none", True, ()) for name in truths]
    assert [one.said.case for one in scored_of(truths, said)] == ["b"]


def test_flat_answers_are_read_with_the_products_names(tmp_path: Path) -> None:
    """One effect a case, numbers under other names; what is off the catalogue, and nothing at all."""
    common = {"detectability": 20.0, "noise_nt": 50.0}
    answers = {
        "case-000": {"effect": "thermal_bias", "driver_concealed": True, "nT_per_K": [1.0, 2.0, 3.0], **common},
        "case-001": {"effect": "bias_step", "driver_concealed": True, "at_s": 5.0, "nT": [1.0, 0.0, 0.0], **common},
        "case-002": {"effect": "off_catalogue", "driver_concealed": False, **common},
        "case-003": {"effect": "none", "driver_concealed": False, "detectability": 0.0},
        "case-004": {"effect": "tone", "driver_concealed": False, "period_s": 20.0, **common},
    }
    write_answers(answers, tmp_path)
    truths = read_answers(tmp_path)
    assert [truth.kind for truth in truths.values()] == ["effect", "effect", "outside", "clean", "effect"]
    assert [truth.unknown_is_right for truth in truths.values()] == [False, False, True, False, False]
    assert truths["case-000"].group == "driver left out"
    assert truths["case-000"].effects[0].parameters == {"nt_per_k": [1.0, 2.0, 3.0]}
    assert truths["case-001"].group == "driver recorded or none needed"
    assert truths["case-001"].effects[0].parameters == {"at_s": 5.0, "step_nt": [1.0, 0.0, 0.0]}
    assert truths["case-004"].effects[0].parameters == {"frequency_hz": 0.05}


def test_a_case_is_diagnosed_and_a_refusal_is_an_answer(tmp_path: Path) -> None:
    """A short clean case as written has a verdict and no false name; a folder without a recording is refused."""
    case = draw_case(6, list(REGIMES).index("short"), clean=True)
    write_case(case, tmp_path / "case-000")
    write_answers({"case-000": case.answer}, tmp_path)
    said = diagnose_case(tmp_path / "case-000")
    assert Scored(read_answers(tmp_path)["case-000"], said).is_right
    assert said.processor_s > 0.1
    assert diagnose_case(tmp_path / "case-001").verdict == "refused"
    assert json.loads((tmp_path / "answers.json").read_text(encoding="utf-8"))["case-000"]["regime"] == "short"


def test_all_cases_are_diagnosed_in_their_order_and_their_answers_kept(tmp_path: Path) -> None:
    """What is said of each case is yielded, and stands in the folder's file as it was."""
    for name in ("case-001", "case-000"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "recording.toml").write_text("version = 1\n", encoding="utf-8")
    said = list(diagnose_all(tmp_path, HERE))
    assert [(one.case, one.verdict) for one in said] == [("case-000", "refused"), ("case-001", "refused")]
    assert said_in(tmp_path) == said


def test_an_answer_comes_back_from_its_file_as_it_was(tmp_path: Path) -> None:
    entry = _named("bias_step", step_nt={"value": [1.0], "sigma": [0.1], "unit": "nT"})
    kept = Said("case-001", "named", False, ("poor_coverage",), (entry,), 2.5)
    (tmp_path / SAID).write_text(json.dumps(asdict(kept)) + "\n", encoding="utf-8")
    assert said_in(tmp_path) == [kept]
