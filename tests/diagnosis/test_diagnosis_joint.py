"""Several recordings of one craft together: what is common, what is not, and each predicted from the others."""

from __future__ import annotations

import html
import json
import re
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import chi2

import magcal_service as magcal
from magcal_service.diagnosis.belief import posterior
from magcal_service.diagnosis.diagnose import Verdict, diagnose
from magcal_service.diagnosis.field_error import FieldError
from magcal_service.diagnosis.joint.compare import chi_square_tail
from magcal_service.diagnosis.joint.diagnose import JointDiagnosis, diagnose_together
from magcal_service.diagnosis.joint.gather import gather
from magcal_service.diagnosis.joint.page import report
from magcal_service.diagnosis.joint.problem import JointProblem
from magcal_service.diagnosis.joint.result import as_json, model_of
from magcal_service.diagnosis.joint.words import (
    ONE_ALONE,
    name_in_words,
    noise_of_one,
    samples_lines,
    sentence,
    summary,
)
from magcal_service.diagnosis.prepare import prepare
from magcal_service.diagnosis.report.frame import Origin
from magcal_service.diagnosis.words import chance
from magcal_service.physics.apply.advice import REASONS
from magcal_service.physics.apply.model_file import parse_model, text_of
from magcal_service.physics.catalogue import effect_named
from magcal_service.physics.interface import Effect
from magcal_service.recordings.recording import Recording
from tests.diagnosis.joint_days import COUNT, NOISE_NT, Day, day

PER_K = np.array([12.0, -8.0, 15.0])
PER_A = np.array([[300.0, -200.0, 100.0], [-250.0, 150.0, 200.0], [50.0, 300.0, -220.0]])
NONE = np.zeros(3)
EFFECTS = tuple(effect_named(name) for name in ("thermal_bias", "current_loop", "bias_step"))


def _together(days: list[Day], effects: tuple[Effect, ...] = EFFECTS) -> JointDiagnosis:
    gathered = gather([one.recording for one in days])
    return diagnose_together(gathered.inspections, gathered.names, effects)


@pytest.fixture(scope="module")
def days() -> list[Day]:
    """Three days with one field per kelvin, and another per ampere on each."""
    return [day(number, PER_K, PER_A[number]) for number in range(3)]


@pytest.fixture(scope="module")
def found(days: list[Day]) -> JointDiagnosis:
    return _together(days)


def test_what_is_common_is_told_from_what_each_day_has_itself(found: JointDiagnosis) -> None:
    content = json.loads(as_json(found))
    assert content["verdict"] == "named"
    assert found.trusted, found.reasons
    assert {one["effect"]: one["common"] for one in content["effects"]} == {"thermal_bias": True, "current_loop": False}
    (shared,) = content["shared"]
    assert (shared["parameter"], shared["agrees"]) == ("nt_per_k", True)


def test_numbers_lie_within_their_sigma(found: JointDiagnosis, days: list[Day]) -> None:
    effects = {one["effect"]: one for one in json.loads(as_json(found))["effects"]}
    per_k = effects["thermal_bias"]["parameters"]["nt_per_k"]
    assert np.abs((np.array(per_k["value"]) - PER_K) / per_k["sigma"]).max() < 3.0
    own = list(effects["current_loop"]["own"]["nt_per_a"].values())
    z = (np.array([one["value"] for one in own]) - PER_A) / np.array([one["sigma"] for one in own])
    assert np.sqrt(np.mean(z**2)) < 1.6
    for one, true in zip(found.recordings, days, strict=True):
        assert np.abs(one.fit.x[:3] - true.bias_nt).max() < 60.0
        assert one.fit.rms_nt == pytest.approx(NOISE_NT, rel=0.1)


def test_each_days_errors_are_said_to_hold_at_the_common_temperature(found: JointDiagnosis) -> None:
    page = report(found, Origin("three days", "magcal diagnose a b c", ()))
    (heat,) = (term.hypothesis for term in found.fit.terms if term.hypothesis.effect == "thermal_bias")
    zero = heat.constants["zero_degc"]
    assert 10.0 < zero < 14.0
    for one in json.loads(as_json(found))["recordings"]:
        current, held = one["errors_hold_at"]
        assert (held["driver"], held["value"], held["unit"]) == ("channel:board", zero, "degC")
        assert (current["value"], current["unit"]) == (0.0, "A")
        assert f", at {current['says']} and {held['says']}" in page


def test_each_day_is_predicted_from_the_others(found: JointDiagnosis) -> None:
    assert [one.kept for one in found.compared.predicted] == pytest.approx([1.0, 1.0, 1.0], abs=0.05)
    assert all(one.stands_out for one in found.compared.predicted)


def test_the_model_has_what_is_common_alone(found: JointDiagnosis) -> None:
    model = parse_model(text_of(model_of(found)).encode())
    assert [term.effect for term in model.terms] == ["thermal_bias"]
    assert model.terms[0].amplitudes["nt_per_k"] == pytest.approx(PER_K, abs=1.5)
    assert model.x[:3].tolist() == found.recordings[-1].fit.x[:3].tolist()


def test_the_model_has_the_spin_that_live_drivers_need(found: JointDiagnosis) -> None:
    model, latest = model_of(found), found.recordings[-1].prepared.spin
    assert latest is not None
    assert model.spin is not None
    assert model.spin.axis_body == pytest.approx(latest.axis_body.tolist())
    assert model.spin.rate_rad_s == latest.rate_rad_s


def test_the_model_has_the_noise_that_the_effects_leave() -> None:
    """A current that is another one at every sample looks like noise to nine errors alone."""
    fast = np.random.default_rng(1).normal(0.0, 1.0, COUNT)
    per_a = np.array([300.0, -200.0, 100.0])
    days = [day(number, NONE, per_a, stated_nt=None, current=fast) for number in range(2)]
    found = _together(days)
    assert [term.hypothesis.effect for term in found.fit.terms] == ["current_loop"]
    assert found.recordings[-1].prepared.problem.noise_nt > 2.0 * NOISE_NT
    assert model_of(found).noise_nt == pytest.approx(NOISE_NT, rel=0.1)


def test_recordings_count_by_the_noise_that_is_left_in_each() -> None:
    """What nobody stated is taken before the effects, which hide how quiet a recording is."""
    noises = (20.0, 400.0)
    fast = np.random.default_rng(1).normal(0.0, 1.0, COUNT)
    per_a = np.array([300.0, -200.0, 100.0])
    days = [day(k, NONE, per_a, noise_nt=one, stated_nt=None, current=fast) for k, one in enumerate(noises)]
    problem = _together(days).fit.problem
    assert isinstance(problem, JointProblem)
    counted = [one.noise_nt * relative for one, relative in zip(problem.singles, problem.relative, strict=True)]
    assert counted[1] / counted[0] == pytest.approx(20.0, rel=0.15)


def test_summary_and_page_say_what_is_common_and_what_is_not(found: JointDiagnosis) -> None:
    text = "\n".join(summary(found, ()))
    page = report(found, Origin("three days", "magcal diagnose a b c", ()))
    for said in ("not common: each recording has numbers of its own", "thermal_bias"):
        assert said in text
        assert said in page
    assert "of its own fit's gain is kept" in text
    assert 'http-equiv="Content-Security-Policy"' in page
    assert f'<span class="tag {found.verdict}">' in page


def test_what_samples_show_is_said_of_each_recording_where_nothing_is_named() -> None:
    """Rounded to 200 nT on the second day alone: that has a name, as it has where the day is diagnosed by itself."""
    clean = [day(number, NONE, NONE) for number in range(2)]
    rounded = np.round(clean[1].recording.field_body_nt / 200.0) * 200.0
    clean[1] = replace(clean[1], recording=replace(clean[1].recording, field_body_nt=rounded))
    names = ("quantisation", "thermal_bias")
    both = _together(clean, tuple(map(effect_named, names)))
    assert (both.verdict, both.trusted) == (Verdict.NAMED, True)
    assert sentence(both) == f"In {both.recordings[1].name}: values on a lattice."
    (line,) = samples_lines(both)
    assert line.startswith(f"{both.recordings[1].name}: quantisation: Values lie on a lattice of 200.0")
    assert f"  {line}" in summary(both, ())
    assert line in html.unescape(report(both, Origin("two days", "magcal diagnose a b", ())))


def test_numbers_of_one_alone_are_said_to_be_of_the_common_form(found: JointDiagnosis) -> None:
    """Beside the table and in the file: a diagnosis of one day by itself may take another form."""
    page = html.unescape(report(found, Origin("three days", "magcal diagnose a b c", ())))
    assert f"{ONE_ALONE.capitalize()}." in page
    assert page.index(" alone</th>") < page.index("Numbers of one recording alone")
    assert json.loads(as_json(found))["own_numbers"] == ONE_ALONE


def test_nothing_is_named_from_clean_days() -> None:
    clean = _together([day(number, NONE, NONE) for number in range(2)])
    assert (clean.verdict, clean.fit.terms, clean.reasons) == (Verdict.NONE, (), ())
    content = json.loads(as_json(clean))
    assert content["sentence"].startswith("The calibrated model and the recordings agree to the noise: ")
    assert content["fit"]["held_out_rms_nt"]["with_effects"] == pytest.approx(NOISE_NT, rel=0.1)
    assert content["advice"] == []


def test_a_field_model_that_errs_is_doubted_as_of_one_recording() -> None:
    """Six times the usual errors, drawn along the field; with errors as usual neither says anything."""
    for times, doubts in ((1.0, ()), (6.0, ("field_model_doubtful",))):
        days = [erring(number, times) for number in range(2)]
        for one in days:
            assert diagnose(one.recording, effects=EFFECTS).reasons == doubts
        found = _together(days)
        assert (found.verdict, found.reasons) == (Verdict.NONE, doubts)
        assert sentence(found).startswith("Nothing that has a form was left out" if doubts else "The calibrated model")
        assert bool(doubts) == ("differ by more than field models usually err by" in sentence(found))


def erring(number: int, times: float) -> Day:
    """A clean day whose reference errs by so many times what field models do."""
    clean = day(number, NONE, NONE)
    scene = prepare(clean.recording, ()).problem.scene
    usual = FieldError.of(scene, NOISE_NT)
    assert usual is not None
    drawn = np.sqrt(usual.variance) * np.random.default_rng(9300 + number).standard_normal(len(usual.variance))
    field = scene.field_nt @ (np.eye(3) + clean.D) - clean.bias_nt
    unit = field / np.linalg.norm(field, axis=1, keepdims=True)
    return day(number, NONE, NONE, added_nt=times * (usual.basis @ drawn)[:, None] * unit)


def test_noise_that_rounding_adds_is_no_noise_beyond_the_stated() -> None:
    """Of several recordings as of one: on steps of 250 nT there is more than the stated noise, and rounding is why."""
    coarse, effects = [], (*EFFECTS, effect_named("quantisation"))
    for number in range(2):
        one = day(number, NONE, NONE)
        field = np.round(one.recording.field_body_nt / 250.0) * 250.0
        coarse.append(replace(one, recording=replace(one.recording, field_body_nt=field)))
    for one in coarse:
        assert "noisier_than_stated" not in diagnose(one.recording, effects=effects).reasons
    assert "noisier_than_stated" in _together(coarse).reasons
    found = _together(coarse, effects)
    assert all("quantisation" in one.prepared.findings for one in found.recordings)
    assert "noisier_than_stated" not in found.reasons


def _rms(values: list[np.ndarray]) -> float:
    return float(np.sqrt(np.mean(np.concatenate(values) ** 2)))


def test_the_levels_before_are_those_of_nine_errors_alone(found: JointDiagnosis) -> None:
    """Of each recording by its own fit, and of all; the joint fit after; and both over rows that took no part."""
    content = json.loads(as_json(found))
    before = [one.baseline.held_out_residual for one in found.recordings]
    assert {len(one.baseline.terms) for one in found.recordings} == {0}
    levels = content["fit"]["held_out_rms_nt"]
    assert levels == pytest.approx({"recalibrated": _rms(before), "with_effects": found.fit.held_out_rms_nt})
    assert levels["recalibrated"] > 2.0 * levels["with_effects"] > 1.8 * NOISE_NT
    for one, own, predicted in zip(content["recordings"], before, content["predicted_from_the_others"], strict=True):
        assert one["held_out_rms_nt"]["recalibrated"] == pytest.approx(_rms([own]))
        assert one["held_out_rms_nt"]["with_effects"] == pytest.approx(NOISE_NT, rel=0.1)
        assert one["in_sample_rms_nt"]["with_effects"] < one["held_out_rms_nt"]["with_effects"]
        assert one["bias_moved_nt"] == pytest.approx(np.linalg.norm(np.subtract(one["bias_nt"], one["bias_before_nt"])))
        rms = predicted["held_out_rms_nt"]
        assert rms["recalibrated"] == pytest.approx(_rms([own]), rel=1e-3)


def test_what_is_not_common_is_no_part_of_nine_errors_alone(found: JointDiagnosis) -> None:
    """The current has numbers of each day's own: beside them, heat alone is left to be predicted."""
    for one in found.compared.predicted:
        assert one.nine_nt > 1.1 * one.without_nt > 1.3 * one.predicted_nt
    text = "\n".join(summary(found, ()))
    first = found.compared.predicted[0]
    assert f"{first.nine_nt:.0f} nT with nine errors, {first.without_nt:.0f} with what is not common besides" in text


def test_where_all_is_common_nothing_stands_between() -> None:
    heat = _together([day(number, PER_K, NONE) for number in range(2)])
    assert all(one.nine_nt == one.without_nt for one in heat.compared.predicted)
    assert "what is not common" not in "\n".join(summary(heat, ()))


def test_json_summary_and_page_say_it_in_the_words_of_one_recording(found: JointDiagnosis) -> None:
    content = json.loads(as_json(found))
    text, page = "\n".join(summary(found, ())), report(found, Origin("three days", "magcal diagnose a b c", ()))
    assert content["sentence"] in text
    assert content["sentence"] in html.unescape(page)
    assert content["sentence"].startswith("3 recordings have in common a bias that follows the sensor's temperature; ")
    assert "; each recording has numbers of its own for " in content["sentence"]
    assert content["sentence"].endswith(("of the mismatch is explained.", "is not seen in the noise."))
    assert all(f"{one.name}: rms on held-out rows " in text for one in found.recordings)


def _with_memory(number: int, added_nt: Any = None) -> Recording:
    """A day without physics whose noise of 150 nT keeps 0.8 from sample to sample, and states nothing."""
    quiet = day(number, NONE, NONE, added_nt=added_nt, stated_nt=None, seed=7340).recording
    steps = np.random.default_rng(7341 + number).normal(0.0, 150.0 * 0.6, (COUNT, 3))
    return replace(quiet, field_body_nt=quiet.field_body_nt + lfilter([1.0], [1.0, -0.8], steps, axis=0))


def test_noise_with_a_memory_is_no_structure_of_several_recordings_either() -> None:
    """It was all of the mismatch, without a name; of one recording it is noise.  Structure on top of it stays one."""
    gathered = gather([_with_memory(number) for number in range(2)])
    found = diagnose_together(gathered.inspections, gathered.names, EFFECTS)
    assert diagnose(_with_memory(0), effects=EFFECTS).verdict is found.verdict is Verdict.NONE
    assert re.search(r"over a noise of 1[01]\d\.\d nT that has a memory and makes 15\d\.\d nT with it", sentence(found))
    for one, written in zip(found.recordings, json.loads(as_json(found))["recordings"], strict=True):
        assert one.memory_nt == written["noise_with_memory_nt"] == pytest.approx(158.0, rel=0.1)
        assert noise_of_one(one).endswith(" nT with its memory")
    swing = 900.0 * np.outer(np.sin(np.arange(COUNT) / 120.0) ** 3, [1.0, 0.5, -0.5])
    gathered = gather([_with_memory(number, swing) for number in range(2)])
    structured = diagnose_together(gathered.inspections, gathered.names, EFFECTS[:1])
    assert structured.verdict is Verdict.UNKNOWN
    assert [one.memory_nt for one in structured.recordings] == [None, None]


def test_every_reason_comes_with_what_would_lift_it(found: JointDiagnosis) -> None:
    doubted = replace(found, reasons=("not_predicted", "poor_coverage"))
    content = json.loads(as_json(doubted))
    assert [(one["reason"], one["means"], one["remedy"]) for one in content["advice"]] == [
        ("not_predicted", *REASONS["not_predicted"]),
        ("poor_coverage", *REASONS["poor_coverage"]),
    ]
    text = "\n".join(summary(doubted, ()))
    assert "  do not act on this:\n    not_predicted: " in text
    assert REASONS["poor_coverage"][1] in " ".join(text.split())


def test_a_name_that_is_open_is_said_to_be(found: JointDiagnosis) -> None:
    index = next(k for k, term in enumerate(found.fit.terms) if term.hypothesis.effect == "thermal_bias")
    alike = [
        SimpleNamespace(nats=nats, hypothesis=SimpleNamespace(effect=effect, odds=0.0, driver="none", as_well=()))
        for effect, nats in (("thermal_bias", 9.0), ("bias_step", 8.0))
    ]
    rivals: list[Any] = [()] * len(found.fit.terms)
    rivals[index] = tuple(alike)
    text = sentence(replace(found, explained=replace(found.explained, rivals=tuple(rivals))))
    heat, step = effect_named("thermal_bias").title, effect_named("bias_step").title
    said = (
        rf"in common something whose name is open, [67]\d.* % thermal_bias \({heat}\); or 2\d.* % bias_step \({step}\)"
    )
    assert re.search(said, text)


def test_why_a_likelier_name_did_not_take_the_place_is_said_of_several_recordings_too(
    found: JointDiagnosis, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The likeliest here is the name itself; one that is not has its reason in JSON, summary and page."""
    assert {one["why_first"] for one in json.loads(as_json(found))["effects"]} == {""}
    index = next(k for k, term in enumerate(found.fit.terms) if term.hypothesis.effect == "thermal_bias")
    alike = [
        SimpleNamespace(nats=nats, hypothesis=SimpleNamespace(effect=effect, odds=0.0, driver="none", as_well=()))
        for effect, nats in (("bias_step", 9.5), ("thermal_bias", 9.0))
    ]
    rivals: list[Any] = [()] * len(found.fit.terms)
    rivals[index] = tuple(alike)
    of = replace(found, explained=replace(found.explained, rivals=tuple(rivals)))
    why = "bias_step is likelier by less than 3 to 1, and thermal_bias was found first"
    assert [one["why_first"] for one in json.loads(as_json(of))["effects"]][index] == why
    assert f"; {why}" in "\n".join(summary(of, ()))
    assert why in html.unescape(report(of, Origin("three days", "magcal diagnose a b c", ())))


def test_a_name_that_is_open_has_its_rivals_beside_it(found: JointDiagnosis) -> None:
    """And one that is sure its probability alone; the noise is said with whose it is."""
    lines = "\n".join(summary(found, ()))
    for index in range(len(found.fit.terms)):
        own = posterior(found.explained, index).own
        said = name_in_words(found, index)
        assert said in lines
        assert said.startswith(f"probability {chance(own)}" if own >= 0.95 else f"name open: {chance(own)} this, ")
    assert all(f"noise {noise_of_one(one)}" in lines for one in found.recordings)
    assert noise_of_one(found.recordings[0]).endswith("stated")


def test_recordings_that_name_no_craft_are_said_to_be_assumed_of_one(days: list[Day]) -> None:
    assumed = gather([one.recording for one in days[:2]]).assumed
    assert assumed.startswith("nothing says that arrays-1, arrays-2 are of one craft")
    assert 'craft = "NAME" under [samples]' in assumed


def _of(recording: Recording, craft: str | None) -> Recording:
    return replace(recording, descriptor=replace(recording.descriptor, craft=craft))


def test_craft_are_told_apart_by_the_names_that_recordings_give(days: list[Day]) -> None:
    first, second, third = (one.recording for one in days)
    assert gather([_of(first, "alpha"), _of(second, "alpha")]).assumed == ""
    some = gather([_of(first, "alpha"), second, _of(third, "alpha")]).assumed
    assert some.startswith("nothing says of which craft arrays-2 is; alpha is taken, as the others say they are")
    refused = r"craft: 'arrays-1 of alpha, arrays-3 of beta' is refused; recordings of one craft .* --separately"
    with pytest.raises(magcal.InputRefusedError, match=refused):
        gather([_of(first, "alpha"), second, _of(third, "beta")])


def test_an_answer_in_python_has_what_the_file_has(days: list[Day], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("magcal_service.diagnosis.joint.diagnose.catalogue", lambda: EFFECTS[:1])
    answer = magcal.diagnose([day(number, PER_K, NONE).recording for number in range(2)])
    content = answer.to_dict()
    assert answer.held_out_rms_nt == content["fit"]["held_out_rms_nt"]
    assert content["assumed"].startswith("nothing says that ")
    assert f"taken for granted: {content['assumed']}" in str(answer)
    assert content["sentence"] in str(answer)


def test_a_common_number_is_no_better_known_than_it_differs() -> None:
    """A fifth apart, which is many of its own sigma: the sigma said holds both days' numbers, everywhere the same."""
    apart = _together([day(0, PER_K, NONE), day(1, 1.2 * PER_K, NONE)])
    content = json.loads(as_json(apart))
    (effect,), (shared,) = content["effects"], content["shared"]
    assert (effect["common"], shared["agrees"]) == (True, False)
    (number,) = apart.compared.shared
    assert number.spread > 3.0
    assert number.spread**2 == pytest.approx(max(one.ratio for one in number.each))
    per_k = effect["parameters"]["nt_per_k"]
    value, sigma = np.array(per_k["value"]), np.array(per_k["sigma"])
    for truth in (PER_K, 1.2 * PER_K):
        assert np.all(np.abs(value - truth) < 2.5 * sigma)
    assert np.all(sigma < 0.2 * np.abs(PER_K))
    assert number.together.sigma == pytest.approx(sigma)
    assert model_of(apart).terms[0].sigma["nt_per_k"] == pytest.approx(sigma)


def test_opposite_signs_are_no_common_number(days: list[Day]) -> None:
    """A common number would be that of neither day, and nothing is left by which one predicts the other."""
    opposite = _together([day(0, PER_K, NONE), day(1, -PER_K, NONE)])
    (effect,) = json.loads(as_json(opposite))["effects"]
    assert (effect["effect"], effect["common"]) == ("thermal_bias", False)
    own = np.array([one["value"] for one in effect["own"]["nt_per_k"].values()])
    assert own == pytest.approx(np.array([PER_K, -PER_K]), abs=2.0)
    assert opposite.reasons == ("not_predicted",)


@pytest.mark.parametrize("degrees", [1, 2, 3, 18])
def test_the_tail_of_chi_square_is_that_of_its_density(degrees: int) -> None:
    value = np.linspace(7.0, 400.0, 400_001)
    density = value ** (degrees / 2.0 - 1.0) * np.exp(-value / 2.0)
    scale = 2.0 ** (degrees / 2.0) * float(np.prod(np.arange(degrees / 2.0 - 1.0, 0.0, -1.0)))
    scale *= np.sqrt(np.pi) if degrees % 2 else 1.0
    assert chi_square_tail(7.0, degrees) == pytest.approx(float(np.trapezoid(density, value)) / scale, rel=1e-4)


def test_a_recording_given_twice_is_refused(days: list[Day]) -> None:
    with pytest.raises(magcal.InputRefusedError, match=r"the same samples as .*; give each recording once"):
        magcal.diagnose([days[0].recording, days[1].recording, days[0].recording])


def test_one_recording_is_not_several(days: list[Day]) -> None:
    with pytest.raises(magcal.InputRefusedError, match="two or more are diagnosed together"):
        gather([days[0].recording])


@pytest.mark.parametrize("degrees", [1, 2, 3, 4, 7])
@pytest.mark.parametrize("value", [0.05, 0.8, 3.0, 25.0])
def test_the_tail_of_chi_square_is_that_of_scipy(degrees: int, value: float) -> None:
    assert chi_square_tail(value, degrees) == pytest.approx(float(chi2.sf(value, degrees)), rel=1e-12)
