"""Several recordings together: what speaks against a name in one of them speaks against it in all."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from magcal_service.diagnosis.joint.catalogue import Forms
from magcal_service.diagnosis.joint.diagnose import JointDiagnosis, diagnose_together
from magcal_service.diagnosis.joint.gather import gather
from magcal_service.diagnosis.joint.problem import JointProblem
from magcal_service.diagnosis.joint.result import as_json
from magcal_service.diagnosis.joint.search import JointSearch
from magcal_service.diagnosis.prepare import Form, prepare
from magcal_service.diagnosis.problem import Fit, Term
from magcal_service.diagnosis.screen import Candidate
from magcal_service.diagnosis.solution import solve
from magcal_service.diagnosis.which_driver import otherwise
from magcal_service.model import Array
from magcal_service.physics.catalogue import effect_named
from magcal_service.physics.interface import Effect
from magcal_service.recordings.recording import Channel, Recording
from tests.diagnosis.joint_days import COUNT, TIME_S, Day, day

PER_K = np.array([12.0, -8.0, 15.0])
PER_A = np.array([250.0, -150.0, 100.0])
OF_A_LOAD = np.array([300.0, -200.0, 150.0])
NONE = np.zeros(3)


def catalogued(*names: str) -> tuple[Effect, ...]:
    return tuple(effect_named(name) for name in names)


STEPS = catalogued("thermal_bias", "current_loop", "bias_step")


def together(days: list[Day], effects: tuple[Effect, ...]) -> JointDiagnosis:
    gathered = gather([one.recording for one in days])
    return diagnose_together(gathered.inspections, gathered.names, effects)


def effect(found: JointDiagnosis, name: str) -> dict[str, Any]:
    return next(one for one in json.loads(as_json(found))["effects"] if one["effect"] == name)


def on_from(from_s: float, to_s: float = np.inf) -> Array:
    return np.asarray(((from_s <= TIME_S) & (to_s > TIME_S)).astype(np.float64))


def test_what_is_switched_in_one_recording_may_be_a_loads_current() -> None:
    """Nobody recorded the load by itself: its field comes and goes as a magnet's would that is switched."""
    added = [None, np.outer(on_from(1200.0, 2600.0), OF_A_LOAD)]
    found = together([day(k, 3.0 * PER_K, 3.0 * PER_A, added[k], seed=970) for k in range(2)], STEPS)
    step = effect(found, "bias_step")
    assert step["recordings"] == ["arrays-2"]
    assert np.abs(np.array(step["parameters"]["at_s"]["value"]) - (1200.0, 2600.0)).max() < 10.0
    assert (step["as_well"], step["class"]) == (["current_loop"], ["bias_step", "current_loop"])
    assert step["probability"] < 0.51
    assert "name_uncertain" in found.reasons


def test_a_jump_with_which_a_recorded_current_jumps_may_be_a_loads_in_that_recording() -> None:
    """The load's wires lie elsewhere than those of all loads together, whose current was recorded."""
    currents = [None, 0.6 + 0.1 * np.sin(TIME_S / 300.0) + 0.9 * on_from(2500.0)]
    added = [None, np.outer(on_from(2500.0), OF_A_LOAD)]
    found = together([day(k, PER_K, PER_A, added[k], seed=971, current=currents[k]) for k in range(2)], STEPS)
    step = effect(found, "bias_step")
    assert (step["recordings"], step["class"]) == (["arrays-2"], ["bias_step", "current_loop"])
    assert step["probability"] < 0.51
    quiet = together([day(k, PER_K, PER_A, added[k], seed=971) for k in range(2)], STEPS)
    assert effect(quiet, "bias_step")["class"] == ["bias_step"]  # no record jumps along


def battery_and_bus(number: int) -> Day:
    """A day whose battery's current makes the field, recorded held for 60 s; the bus takes what the battery gives."""
    rng = np.random.default_rng(972 + number)
    flows = np.convolve(np.cumsum(rng.normal(0.0, 1.0, COUNT + 5)), np.ones(6) / 6.0, "valid")
    flows = 0.6 * (flows - flows.mean()) / flows.std()
    one = day(number, NONE, PER_A, seed=973, current=flows)
    of = one.recording.channels["bus"]
    held, bus = flows[np.arange(COUNT) // 12 * 12], 0.3 - flows + rng.normal(0.0, 0.06, COUNT)
    channels = {
        "board": one.recording.channels["board"],
        "bus": replace(of, values=bus[:, None]),
        "battery": Channel(replace(of.spec, name="battery"), held[:, None]),
    }
    return replace(one, recording=replace(one.recording, channels=channels))


@pytest.fixture(scope="module")
def powered() -> JointDiagnosis:
    return together([battery_and_bus(k) for k in range(2)], catalogued("thermal_bias", "current_loop"))


def test_a_bus_beside_a_held_record_of_the_battery_is_no_driver_to_act_on(powered: JointDiagnosis) -> None:
    """Its numbers have the other sign; in both recordings either may be what makes the field."""
    loop = effect(powered, "current_loop")
    assert {one["driver"] for one in loop["drivers"]} >= {"channel:bus", "channel:battery"}
    assert otherwise(powered.explained, 0) > 0.1
    assert powered.reasons == ("name_uncertain",)
    assert "battery" in loop["says"]


def test_names_that_came_near_in_the_search_are_rivals_at_its_end(powered: JointDiagnosis) -> None:
    """The fit is made again under the scatter that its blocks have, by a search that has not looked at any name."""
    assert [one.hypothesis.effect for one in powered.explained.rivals[0]] == ["current_loop", "thermal_bias"]


def test_two_jumps_that_follow_one_another_in_one_recording_are_not_told_from_a_drift() -> None:
    """To a sensor of some noise they are an even change; it was named for sure."""
    added = [None, np.outer(on_from(2000.0) + on_from(2150.0), [120.0, -80.0, 60.0])]
    days = [day(k, PER_K, NONE, added[k], seed=983) for k in range(2)]
    found = together(days, catalogued("thermal_bias", "bias_step", "bias_drift"))
    drift = effect(found, "bias_drift")
    assert (drift["recordings"], drift["class"]) == (["arrays-2"], ["bias_drift", "bias_step"])
    assert drift["probability"] < 0.95
    assert found.reasons == ("name_uncertain",)


def late(number: int, by_s: float) -> Day:
    """A day whose samples are tagged earlier than they were taken: their reference is that of before."""
    one = day(number, NONE, NONE, seed=974)
    vector = one.recording.reference.vector_nt
    assert vector is not None
    then = np.stack([np.interp(TIME_S - by_s, TIME_S, axis) for axis in vector.T], axis=1)
    reference = replace(one.recording.reference, vector_nt=then, magnitude_nt=np.linalg.norm(then, axis=1))
    return replace(one, recording=replace(one.recording, reference=reference))


def test_a_clock_that_is_off_by_the_same_in_all_recordings_is_predicted_from_the_others() -> None:
    """It moves the reference, in a recording that is held at the others' numbers as well."""
    found = together([late(k, 8.0) for k in range(2)], catalogued("time_offset", "thermal_bias"))
    clock = effect(found, "time_offset")
    assert clock["common"]
    assert all(one.kept > 0.9 for one in found.compared.predicted)


def test_two_offsets_of_a_clock_are_no_common_one() -> None:
    """A mean of the two holds most of the evidence, and was called common: of a clock nothing is guessed that errs."""
    found = together([late(0, 4.0), late(1, 10.0)], catalogued("time_offset", "thermal_bias"))
    clock = effect(found, "time_offset")
    assert not clock["common"]
    own = [clock["own"]["offset_s"][one.name] for one in found.recordings]
    for one, true in zip(own, (4.0, 10.0), strict=True):
        assert abs(one["value"] - true) < 3.0 * one["sigma"] < 1.5


def searching(days: list[Day], *names: str) -> tuple[JointSearch, Fit]:
    """A search over days of one craft, and the fit of their nine errors."""
    effects = catalogued(*names)
    ready = [prepare(one.recording, effects, (Form.SCALAR,)) for one in days]
    singles, called = [one.problem for one in ready], tuple(f"day {k}" for k in range(len(days)))
    forms, problem = Forms.of(effects, singles), JointProblem.of(singles)
    search = JointSearch(problem, forms.on(singles, called), effects, catalogue=forms, names=called)
    return search, solve(problem, np.concatenate([one.baseline.x for one in ready]))


def labels(found: Sequence[Candidate], effect: str) -> set[str]:
    return {one.hypothesis.label for one in found if one.hypothesis.effect == effect}


def test_numbers_of_each_recordings_own_are_held_against_those_of_rivals() -> None:
    """Against common ones alone a place that was ahead on one day was a clock's offset at 0.97."""
    search, alone = searching([late(0, 3.0), late(1, 4.0)], "time_offset", "position_offset")
    known = {one.label: one for one in search.hypotheses}
    search.close = {"position_offset[along]", "time_offset"}
    for label, has_own in (("time_offset[each its own]", True), ("time_offset", False)):
        form = known[label]
        fit = search.refreshed(solve(search.problem, alone.x, [Term(form, np.zeros(0), np.zeros(form.size))]))
        rivals = labels(search._rivals(fit, 0, 50.0), "position_offset")
        assert ("position_offset[along, each its own]" in rivals) is has_own
        assert "position_offset[along]" in rivals


@pytest.mark.parametrize(("on_other", "is_common"), [(0.0, False), (0.3, False), (0.7, True)])
def test_a_record_drives_the_same_on_all_days_or_each_days_own(on_other: float, is_common: bool) -> None:
    """With none on one day a common number holds half of the evidence; a drift took the rest."""
    search, alone = searching([day(0, 4.0 * PER_K, NONE), day(1, on_other * 4.0 * PER_K, NONE)], "thermal_bias")
    found = labels(search.screen(search.workspace(alone), alone, 50.0), "thermal_bias")
    assert "thermal_bias by channel:board" in found
    assert ("thermal_bias[each its own] by channel:board" in found) is not is_common


@pytest.mark.parametrize("seed", [990, 991])
def test_each_of_two_recordings_may_have_a_jump_of_its_own(seed: int) -> None:
    """With the one named, a drift stood in the other's place, and could be trusted."""
    added = [np.outer(on_from(at_s), sign * OF_A_LOAD) for at_s, sign in ((2000.0, -1.0), (3000.0, 1.0))]
    days = [day(k, 3.0 * PER_K if seed == 991 else PER_K, NONE, added[k], seed=seed) for k in range(2)]
    found = together(days, catalogued("thermal_bias", "current_loop", "bias_step", "bias_drift"))
    jumps = [one for one in json.loads(as_json(found))["effects"] if one["effect"] != "thermal_bias"]
    assert [one["effect"] for one in jumps] == ["bias_step", "bias_step"]
    at_s = {name: one["parameters"]["at_s"]["value"] for one in jumps for name in one["recordings"]}
    assert at_s == {"arrays-1": pytest.approx(2000.0, abs=20.0), "arrays-2": pytest.approx(3000.0, abs=20.0)}


def in_a_room(number: int, after: float, warms_nt: float = 0.0) -> Recording:
    """A body that is turned about by hand in a room of 48 uT, times ``after`` from the 700th second on.

    Parameters
    ----------
    warms_nt: the field of what warms up beside the sensor, with a time constant of 400 s [nT].
    """
    rng, time_s = np.random.default_rng([985, number]), np.arange(1500.0)
    angles = [2.0 * np.sin(np.outer(time_s, rng.uniform(0.02, 0.06, 3)) + rng.uniform(0.0, 6.28, 3)) for _ in range(2)]
    room_nt = np.outer(np.where(time_s < 700.0, 1.0, after), [21e3, -4e3, 43e3])
    warm = np.outer(1.0 - np.exp(-time_s / 400.0), warms_nt * np.array([0.6, -0.5, 0.62]))
    field = Rotation.from_euler("xyz", angles[0] + angles[1]).apply(room_nt) + warm + [800.0, -500.0, 300.0]
    return Recording.from_arrays(
        time=np.datetime64(f"2024-05-0{1 + number}T10:00:00") + (1e3 * time_s).astype("timedelta64[ms]"),
        B=field + rng.normal(0.0, 40.0, field.shape),
        H=np.full(len(time_s), float(np.linalg.norm(room_nt[0]))),
        noise_nt=40.0,
    )


def found_in_a_room(recordings: list[Recording], *names: str) -> JointDiagnosis:
    gathered = gather(recordings)
    return diagnose_together(gathered.inspections, gathered.names, catalogued(*names))


def test_a_gain_that_jumps_in_a_room_may_be_the_rooms_field() -> None:
    """Here it is: iron was moved in the second recording."""
    found = found_in_a_room([in_a_room(0, 1.0), in_a_room(1, 1.004)], "scale_step", "bias_step")
    step = effect(found, "scale_step")
    assert (step["as_well"], step["class"]) == (["unknown"], ["scale_step", "unknown"])
    assert "a room's" in step["unlisted"]
    assert step["probability"] < 0.5


def test_a_drift_is_each_recordings_own_and_may_be_warmth_that_nobody_recorded() -> None:
    """Here it is, and alike in both; but its course begins with the first sample, which another day does not."""
    found = found_in_a_room([in_a_room(k, 1.0, 200.0) for k in range(2)], "bias_drift", "thermal_bias")
    drift = effect(found, "bias_drift")
    assert not drift["common"]
    assert (drift["as_well"], drift["class"]) == (["thermal_bias"], ["bias_drift", "thermal_bias"])
    assert found.reasons == ("name_uncertain", "not_predicted")
