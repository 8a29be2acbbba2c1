"""What happens more than once, and a driver that averages, in concealed cases: found there, and nowhere else.

Each is diagnosed among the effects that could be taken for one another, which keeps a diagnosis at a few seconds; the
whole catalogue is in ``test_diagnosis_matrix``.  Cases of what is slow are of a driver left out, so that nothing
recorded holds the course.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from magcal_service.diagnosis.belief import posterior
from magcal_service.diagnosis.diagnose import Diagnosis, diagnose
from magcal_service.diagnosis.handover import model_of
from magcal_service.diagnosis.result import entries
from magcal_service.physics.apply.model_file import parse_model, text_of
from magcal_service.physics.catalogue import effect_named
from magcal_service.recordings.reader import read_recording
from tests.blind import Case, draw_case, write_case

CHANGES = ("bias_step", "scale_step", "bias_drift", "scale_drift", "sun_disturbance")
SLOW_GAIN = ("response_lag", "scale_drift", "scale_step")


def diagnosed(case: Case, folder: Path, *among: str) -> Diagnosis:
    effects = tuple(effect_named(name) for name in among)
    return diagnose(read_recording(write_case(case, folder / "case")), effects=effects)


@pytest.mark.parametrize(("kind", "seed", "block"), [("switched", 22, "switched_nt"), ("steps", 15, "steps_nt")])
def test_several_instants_are_named_with_their_amounts_and_carried_on(
    kind: str, seed: int, block: str, tmp_path: Path
) -> None:
    case = draw_case(seed, kind)
    truth = case.answer.effects[0].parameters
    diagnosis = diagnosed(case, tmp_path, *CHANGES)
    (found,) = entries(diagnosis)
    # what swells and fades is met by many steps, too; what is switched may be a load
    assert (found.effect, diagnosis.reasons) == ("bias_step", ("name_uncertain",))
    at_s, amounts = found.parameters["at_s"], found.parameters[block]
    known_s, expected = np.array(truth["at_s"]), np.array(truth[block])
    nearest = np.abs(known_s[:, None] - at_s.value).argmin(axis=0)
    assert (np.abs(at_s.value - known_s[nearest]) < 75.0).all()  # the field points elsewhere for a while
    if kind == "switched":
        assert len(at_s.value) == len(known_s)
        assert (np.abs(amounts.value - expected) < 3.0 * amounts.sigma).all()
    else:  # the smallest steps may be unseen; their amounts are the others' then
        assert len(at_s.value) >= len(known_s) - 1
    (term,) = parse_model(text_of(model_of(diagnosis, entries(diagnosis), "flight")).encode()).terms
    assert np.array_equal(term.nonlinear["at_s"], at_s.value)


@pytest.mark.parametrize("seed", [2, 8])
def test_a_driver_that_averages_is_named_without_a_gyro(seed: int, tmp_path: Path) -> None:
    """The reference is a magnitude, no place, no time, no gyro: nothing tells how the craft turns but its samples.

    A spin that slows down loses ever less, as a gain that relaxes would: the two may not be told apart.
    """
    case = unturned(draw_case(seed, "moving_average"))
    diagnosis = diagnosed(case, tmp_path, *SLOW_GAIN)
    found = entries(diagnosis)[0]
    assert found.effect == "response_lag"
    assert set(diagnosis.reasons) <= {"name_uncertain"}
    assert set(posterior(diagnosis.explained, 0).members) <= {"response_lag", "scale_drift"}
    if diagnosis.reasons:  # as well a low-pass, whose share is another one where the craft turns by a radian a sample
        return
    share = found.parameters["new_share"]
    assert abs(float(share.value) - case.answer.effects[0].parameters["new_share"]) < 3.0 * float(share.sigma)


def unturned(case: Case) -> Case:
    """A case without anything that tells how the craft turns."""
    size = case.reference_nt if case.reference_nt.ndim == 1 else np.linalg.norm(case.reference_nt, axis=1)
    channels = tuple(channel for channel in case.channels if channel.unit != "rad/s")
    nothing = {"reference_frame": None, "position": None, "position_form": None, "start_unix_s": None}
    return replace(case, reference_nt=size, spin_axis=None, spin_rpm=None, channels=channels, **nothing)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("kind", "seed"),
    [("bias_drift", 202), ("sun_disturbance", 203), ("scale_drift", 201), ("outside:telegraph", 201), ("none", 13)],
)
def test_what_is_slow_or_switches_more_often_is_no_series_of_steps(kind: str, seed: int, tmp_path: Path) -> None:
    diagnosis = diagnosed(draw_case(seed, kind, driver_recorded=False), tmp_path, *CHANGES)
    assert [term.hypothesis.variant for term in diagnosis.fit.terms if "instants" in term.hypothesis.variant] == []


@pytest.mark.parametrize("seed", [301, 302])
@pytest.mark.parametrize("kind", ["none", "scale_drift"])
def test_no_average_is_named_where_there_is_none(kind: str, seed: int, tmp_path: Path) -> None:
    diagnosis = diagnosed(unturned(draw_case(seed, kind)), tmp_path, *SLOW_GAIN)
    assert "response_lag" not in {entry.effect for entry in entries(diagnosis)}


def test_a_long_time_constant_and_its_amplitude_arrive(tmp_path: Path) -> None:
    """Heat that nobody recorded, over an hour slow: Gauss-Newton's steps stall a third of a sigma from the end."""
    case = draw_case(300500035, "thermal_scale", driver_recorded=False)
    diagnosis = diagnosed(case, tmp_path, "thermal_scale", "scale_drift")
    assert [entry.effect for entry in entries(diagnosis)] == ["thermal_scale"]
    assert diagnosis.fit.converged
