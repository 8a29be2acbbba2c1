"""Concealed cases: folders and their answers, what the diagnosis says, and what counts as right; written by hand."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from magcal_service.base.errors import ConfigError, InputRefusedError
from magcal_service.many.pieces import Done, Failed, Refused
from magcal_service.studies.cases.ask import Named, Said, ask, said_of
from magcal_service.studies.cases.folders import cases_of
from magcal_service.studies.cases.score import Scored, all_distances, reliability, wilson
from magcal_service.studies.cases.truth import Put, Truth, read_answers
from tests.regimes.case import draw_case
from tests.regimes.world import REGIMES
from tests.regimes.write import write_answers, write_case

STEP = Put("bias_step", {"step_nt": [10.0, 0.0, -20.0], "at_s": 100.0})
NOTHING = {"effect": "none", "driver_concealed": False, "detectability": 0.0}


def _truth(kind: str = "effect", *effects: Put, **more: Any) -> Truth:
    given = {"regime": "spin_fast", "also": (), "detectability": 50.0} | more
    return Truth(kind=kind, effects=effects, **given)


def _named(effect: str, probability: float = 0.99, members: tuple[str, ...] = (), **parameters: Any) -> Named:
    return Named(effect, probability, (effect, *members), parameters)


def _said(verdict: str, *named: Named, trusted: bool = True) -> Said:
    return Said(verdict, trusted, (), named, 1.0)


def _scored(truth: Truth, said: Said) -> Scored:
    return Scored("regimes", "case-000", truth, said)


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
            _truth("several", STEP, Put("tone", {})),
            _said("named", _named("tone"), _named("bias_drift", 0.6, ("bias_step",))),
            False,
            True,
            1,
        ),
        (
            _truth("several", STEP, Put("bias_drift", {})),  # one name is one cause, whatever its class holds
            _said("named", _named("bias_drift", 0.6, ("bias_step",)), _named("tone")),
            False,
            False,
            1,
        ),
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
    scored = _scored(truth, said)
    assert (scored.is_right, scored.is_in_class, len(scored.false)) == (right, in_class, false)


def test_distances_are_in_sigmas_and_only_where_both_give_a_number() -> None:
    """Each component of what both give in one shape; no sigma, another shape or another name: not compared."""
    entry = _named(
        "bias_step",
        step_nt={"value": [12.0, 0.5, -20.0], "sigma": [1.0, 1.0, 2.0], "unit": "nT"},
        at_s={"value": 99.0, "sigma": None, "unit": "s"},
    )
    one = _scored(_truth("effect", STEP), _said("named", entry))
    assert one.distances() == {"bias_step.step_nt": [2.0, 0.5, 0.0]}
    assert all_distances([one, one]) == {"all": [2.0, 0.5, 0.0] * 2, "bias_step.step_nt": [2.0, 0.5, 0.0] * 2}
    scalar = _named("bias_step", step_nt={"value": 12.0, "sigma": 1.0, "unit": "nT"})
    assert _scored(_truth("effect", STEP), _said("named", scalar)).distances() == {}


def test_reliability_counts_each_claim_in_its_bin() -> None:
    """Bins hold claims from their lower edge on, the last one 1 as well; ``unknown`` claims nothing."""
    said = _said(
        "named", _named("bias_step", 0.99), _named("tone", 0.9), _named("bias_drift", 1.0), _named("unknown", 0.5)
    )
    bins = {(one.low, one.high): one for one in reliability([_scored(_truth("effect", STEP), said)])}
    found = {edges: (one.names, one.true, one.mean, one.share) for edges, one in bins.items() if one.names}
    assert found == {
        (0.99, 0.999): (1, 1, 0.99, 1.0),
        (0.9, 0.95): (1, 0, 0.9, 0.0),
        (0.999, 1.0): (1, 0, 1.0, 0.0),
    }
    empty = bins[0.5, 0.8]
    assert (empty.names, empty.mean, empty.share, empty.interval) == (0, None, None, None)


@pytest.mark.parametrize(
    ("count", "of", "low", "high"),
    [(0, 10, 0.0, 0.2775), (10, 10, 0.7225, 1.0), (5, 10, 0.2366, 0.7634), (81, 263, 0.2553, 0.3662)],
)
def test_a_share_s_interval_is_wilson_s(count: int, of: int, low: float, high: float) -> None:
    """The last one is the example of Newcombe, Statistics in Medicine 17 (1998), table I, method 3."""
    assert wilson(count, of) == pytest.approx((low, high), abs=5e-5)


def test_a_share_of_all_or_none_lies_in_its_interval() -> None:
    """Where rounding would put its end beside it."""
    for of in range(1, 200):
        assert wilson(of, of)[1] == 1.0  # type: ignore[index]
        assert wilson(0, of)[0] == 0.0  # type: ignore[index]


def test_nothing_has_no_interval() -> None:
    assert wilson(0, 0) is None


def test_cases_below_what_can_be_found_do_not_count() -> None:
    """Clean cases always count, others from a detectability of 12 on."""
    counts = [_truth("effect", STEP, detectability=value).counts for value in (11.9, 12.0)]
    assert counts == [False, True]
    assert _truth("clean", detectability=0.0).counts


def test_a_case_s_group_is_what_it_asks() -> None:
    hidden, lost = Put("torquer", {}, concealed=True), Put("current_loop", {}, concealed=True, inferable=False)
    assert [
        _truth("clean").group,
        _truth("effect", STEP).group,
        _truth("effect", hidden).group,
        _truth("effect", lost).group,
        _truth("several", STEP, hidden).group,
        _truth("outside", Put("bursts", {})).group,
    ] == [
        "clean",
        "driver recorded or none needed",
        "driver left out",
        "driver left out, not to be guessed",
        "several effects",
        "in no catalogue",
    ]


def test_flat_answers_are_read_with_the_products_names(tmp_path: Path) -> None:
    """One effect a case, numbers under other names; what is off the catalogue, and nothing at all."""
    common = {"detectability": 20.0, "noise_nt": 50.0}
    answers = {
        "case-000": {"effect": "thermal_bias", "driver_concealed": True, "nT_per_K": [1.0, 2.0, 3.0], **common},
        "case-001": {"effect": "bias_step", "driver_concealed": True, "at_s": 5.0, "nT": [1.0, 0.0, 0.0], **common},
        "case-002": {"effect": "off_catalogue", "driver_concealed": False, **common},
        "case-003": NOTHING,
        "case-004": {"effect": "tone", "driver_concealed": False, "period_s": 20.0, **common},
        "case-005": {"effect": "coloured_noise", "driver_concealed": False, **common},
    }
    write_answers(answers, tmp_path)
    truths = read_answers(tmp_path)
    assert [truth.kind for truth in truths.values()] == ["effect", "effect", "outside", "clean", "effect", "effect"]
    assert [truth.unknown_is_right for truth in truths.values()] == [False, False, True, False, False, True]
    assert truths["case-000"].group == "driver left out"
    assert truths["case-000"].effects[0].parameters == {"nt_per_k": [1.0, 2.0, 3.0]}
    assert truths["case-001"].group == "driver recorded or none needed"
    assert truths["case-001"].effects[0].parameters == {"at_s": 5.0, "step_nt": [1.0, 0.0, 0.0]}
    assert truths["case-004"].effects[0].parameters == {"frequency_hz": 0.05}


def test_a_case_is_diagnosed_as_it_was_written(tmp_path: Path) -> None:
    """A short clean case has a verdict and no false name, and its answer is read with its regime."""
    case = draw_case(6, list(REGIMES).index("short"), clean=True)
    write_case(case, tmp_path / "case-000")
    write_answers({"case-000": case.answer}, tmp_path)
    (found,) = cases_of((tmp_path,))
    said = ask(found.path)
    assert (found.simulator, found.name, found.truth.regime) == (tmp_path.name, "case-000", "short")
    assert Scored(found.simulator, found.name, found.truth, said).is_right
    assert said.processor_s is not None
    assert said.processor_s > 0.1


def test_a_refusal_and_a_fault_are_answers_without_the_case_s_place(tmp_path: Path) -> None:
    path = tmp_path / "case-000/recording.toml"
    with pytest.raises(InputRefusedError) as refused:
        ask(path)
    said = said_of(Refused(str(refused.value), 2), path)
    assert (said.verdict, said.trusted, said.processor_s) == ("refused", False, None)
    assert said.reasons[0].startswith("recording.toml: ")
    assert said_of(Failed("ValueError: x\nmore"), path) == replace(said, verdict="failed", reasons=("ValueError: x",))
    answer = _said("none")
    assert said_of(Done(answer), path) is answer


def _write_folder(folder: Path, cases: dict[str, str], answered: tuple[str, ...]) -> Path:
    for name, file in cases.items():
        (folder / name).mkdir(parents=True)
        (folder / name / file).write_text("version = 1\n", encoding="utf-8")
    folder.mkdir(parents=True, exist_ok=True)
    write_answers(dict.fromkeys(answered, NOTHING), folder)
    return folder


def test_cases_are_found_in_order_whether_in_capitals_or_not(tmp_path: Path) -> None:
    first = _write_folder(
        tmp_path / "b", {"case-001": "recording.toml", "case-000": "RECORDING.toml"}, ("case-000", "case-001")
    )
    second = _write_folder(tmp_path / "a", {"case-000": "recording.toml"}, ("case-000",))
    found = cases_of((first, second))
    assert [(one.simulator, one.name, one.path.name) for one in found] == [
        ("b", "case-000", "RECORDING.toml"),
        ("b", "case-001", "recording.toml"),
        ("a", "case-000", "recording.toml"),
    ]
    assert all(one.truth.kind == "clean" and one.path.is_absolute() for one in found)


@pytest.mark.parametrize(
    ("cases", "answered", "accepted"),
    [
        ((), (), r"a folder with case-\*/recording\.toml is accepted; "),
        (("case-000", "case-001"), ("case-000",), "case-001 has a recording and no answer; write"),
        (("case-000",), ("case-000", "case-001"), "case-001 has an answer and no recording; write"),
    ],
)
def test_a_folder_whose_answers_are_not_its_cases_is_refused(
    tmp_path: Path, cases: tuple[str, ...], answered: tuple[str, ...], accepted: str
) -> None:
    folder = _write_folder(tmp_path, dict.fromkeys(cases, "recording.toml"), answered)
    with pytest.raises(ConfigError, match=accepted):
        cases_of((folder,))


@pytest.mark.parametrize("content", [None, "{", "[]", '{"case-000": {}}', '{"case-000": {"effects": []}}'])
def test_a_folder_without_answers_or_with_others_is_refused(tmp_path: Path, content: str | None) -> None:
    folder = _write_folder(tmp_path / "blind", {"case-000": "recording.toml"}, ("case-000",))
    (folder / "answers.json").unlink()
    if content is not None:
        (folder / "answers.json").write_text(content, encoding="utf-8")
    with pytest.raises(ConfigError, match=r"answers\.json.*tests\.blind"):
        cases_of((folder,))


def test_a_kind_that_nobody_knows_is_refused(tmp_path: Path) -> None:
    folder = _write_folder(tmp_path, {"case-000": "recording.toml"}, ("case-000",))
    answer = {"regime": "x", "kind": "strange", "effects": [], "also": [], "detectability": 0.0}
    content = json.dumps({"case-000": answer | {"model_detectability": 0.0}})
    (folder / "answers.json").write_text(content, encoding="utf-8")
    with pytest.raises(ConfigError, match="kind 'strange'"):
        cases_of((folder,))


def test_folders_of_one_name_and_no_folder_at_all_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="--recordings: 'none' is refused; folders of concealed cases"):
        cases_of(())
    with pytest.raises(ConfigError, match="'blind' is refused; a folder's name is its simulator's"):
        cases_of((tmp_path / "a/blind", tmp_path / "b/blind"))
