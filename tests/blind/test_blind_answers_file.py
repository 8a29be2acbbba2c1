"""Many cases with their answers in the form that is read by others."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.blind import DRIVEN, EFFECTS, OUTSIDE, draw_case
from tests.blind.__main__ import plan, write_cases
from tests.blind.answers import COMMON, common_form


def test_a_plan_has_its_shares_every_effect_and_every_kind_left_out_or_in_no_catalogue() -> None:
    kinds = plan(300)
    assert len(kinds) == 300
    assert kinds.count(("none", True)) == 60
    assert kinds.count(("pair", True)) == 36
    outside = [kind for kind, _ in kinds if kind.startswith("outside:")]
    assert (len(outside), {kind.removeprefix("outside:") for kind in outside}) == (36, set(OUTSIDE))
    hidden = [kind for kind, recorded in kinds if not recorded]
    assert (len(hidden), set(hidden)) == (48, set(DRIVEN))
    single = [kind for kind, recorded in kinds if recorded and kind in EFFECTS]
    assert {single.count(name) for name in EFFECTS} == {5}


@pytest.mark.parametrize("count", [1, 3, 6])
def test_a_short_plan_is_as_long_as_asked(count: int) -> None:
    assert len(plan(count)) == count


def test_a_step_s_answer_holds_its_numbers_and_its_sensor() -> None:
    truth = draw_case(62, "bias_step").answer
    answer = common_form(truth, driver_concealed=False)
    (effect,) = answer["effects"]
    assert (answer["regime"], answer["kind"], answer["driver_concealed"]) == ("blind", "effect", False)
    assert effect["parameters"] == dict(truth.effects[0].parameters)
    assert answer["detectability"] == truth.effects[0].detectability >= 12.0
    assert (answer["noise_nt"], answer["model_detectability"]) == (truth.noise_nt, 0.0)


def test_numbers_of_another_convention_are_left_out() -> None:
    """The currents of this simulator have an order of their own, ``channels``."""
    truth = draw_case(62, "current_loop").answer
    assert "nt_per_a" in truth.effects[0].parameters
    assert "nt_per_a" not in COMMON
    assert common_form(truth, driver_concealed=False)["effects"][0]["parameters"] == {}


def test_a_driver_that_is_left_out_is_concealed_and_can_be_guessed() -> None:
    truth = draw_case(62, "thermal_bias", driver_recorded=False).answer
    answer = common_form(truth, driver_concealed=True)
    assert answer["driver_concealed"]
    (effect,) = answer["effects"]
    assert (effect["driver"], effect["driver_concealed"], effect["is_inferable"]) == ([], True, True)
    undriven = common_form(draw_case(62, "bias_step").answer, driver_concealed=True)
    assert not undriven["effects"][0]["driver_concealed"]


@pytest.mark.parametrize(
    ("kind", "written", "effects"),
    [("none", "clean", 0), ("outside:bursts", "outside", 1), ("tone+bias_step", "several", 2)],
)
def test_what_is_asked_has_its_name(kind: str, written: str, effects: int) -> None:
    answer = common_form(draw_case(3, kind).answer, driver_concealed=False)
    assert (answer["kind"], len(answer["effects"])) == (written, effects)


def test_what_is_true_besides_is_kept() -> None:
    truth = draw_case(3, "response_lag").answer
    assert "spin_rate" in common_form(truth, driver_concealed=False)["also"]


def test_cases_are_written_with_their_answers_beside_them_and_the_same_each_time(tmp_path: Path) -> None:
    for name in ("a", "b"):
        write_cases(4, 2, tmp_path / name)
    names = ["answers.json", *(f"case-00{k}/{file}" for k in (0, 1) for file in ("RECORDING.toml", "samples.csv"))]
    found = sorted(path.relative_to(tmp_path / "a").as_posix() for path in (tmp_path / "a").rglob("*.*"))
    assert found == names
    assert all((tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes() for name in names)
    answers = json.loads((tmp_path / "a/answers.json").read_text(encoding="utf-8"))
    assert [(name, one["kind"], one["seed"]) for name, one in answers.items()] == [
        ("case-000", "clean", 400_000),
        ("case-001", "outside", 400_001),
    ]
