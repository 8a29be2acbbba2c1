"""Several recordings of one craft together: what is common, what is not, and each predicted from the others."""

from __future__ import annotations

import json

import numpy as np
import pytest

import magcal_service as magcal
from magcal_service.diagnosis.diagnose import Verdict
from magcal_service.diagnosis.joint.compare import chi_square_tail
from magcal_service.diagnosis.joint.diagnose import JointDiagnosis, diagnose_together
from magcal_service.diagnosis.joint.gather import gather
from magcal_service.diagnosis.joint.page import report
from magcal_service.diagnosis.joint.result import as_json, model_of, summary
from magcal_service.diagnosis.report.page import Origin
from magcal_service.physics.apply.model_file import parse_model, text_of
from magcal_service.physics.catalogue import effect_named
from tests.diagnosis.joint_days import NOISE_NT, Day, day

PER_K = np.array([12.0, -8.0, 15.0])
PER_A = np.array([[300.0, -200.0, 100.0], [-250.0, 150.0, 200.0], [50.0, 300.0, -220.0]])
NONE = np.zeros(3)
EFFECTS = tuple(effect_named(name) for name in ("thermal_bias", "current_loop", "bias_step"))


def _together(days: list[Day]) -> JointDiagnosis:
    gathered = gather([one.recording for one in days])
    return diagnose_together(gathered.inspections, gathered.names, EFFECTS)


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


def test_each_day_is_predicted_from_the_others(found: JointDiagnosis) -> None:
    assert [one.kept for one in found.compared.predicted] == pytest.approx([1.0, 1.0, 1.0], abs=0.05)
    assert all(one.stands_out for one in found.compared.predicted)


def test_the_model_has_what_is_common_alone(found: JointDiagnosis) -> None:
    model = parse_model(text_of(model_of(found)).encode())
    assert [term.effect for term in model.terms] == ["thermal_bias"]
    assert model.terms[0].amplitudes["nt_per_k"] == pytest.approx(PER_K, abs=1.5)
    assert model.x[:3].tolist() == found.recordings[-1].fit.x[:3].tolist()


def test_summary_and_page_say_what_is_common_and_what_is_not(found: JointDiagnosis) -> None:
    text = "\n".join(summary(found, ()))
    page = report(found, Origin("three days", "magcal diagnose a b c", ()))
    for said in ("not common: each recording has numbers of its own", "thermal_bias"):
        assert said in text
        assert said in page
    assert "of its own fit's gain is kept" in text
    assert 'http-equiv="Content-Security-Policy"' in page


def test_nothing_is_named_from_clean_days() -> None:
    clean = _together([day(number, NONE, NONE) for number in range(2)])
    assert (clean.verdict, clean.fit.terms, clean.reasons) == (Verdict.NONE, (), ())


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
