"""What calibrate, replay and diagnose give back."""

from __future__ import annotations

import dataclasses
import json
from functools import cache

import numpy as np
import pytest

import magcal_service as magcal
from magcal_service.diagnosis.command import Request, run
from magcal_service.wire.messages import CalibratedVector, Estimate
from sim_sensor.recorder import record_simulation
from sim_sensor.scenario_reader import load_scenario
from sim_sensor.simulation import Simulation


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory):  # type: ignore[no-untyped-def]
    """The descriptor of half an hour of the paper's craft."""
    folder = tmp_path_factory.mktemp("face")
    return record_simulation(Simulation(load_scenario("paper"), seed=6, duration_s=1800.0), folder)


@cache
def calibrated(path) -> magcal.Calibration:  # type: ignore[no-untyped-def]
    return magcal.calibrate(path)


def test_results_are_frozen(recorded) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(dataclasses.FrozenInstanceError):
        calibrated(recorded).samples = 3  # type: ignore[misc]


def test_a_calibration_is_what_the_command_writes(recorded, tmp_path) -> None:  # type: ignore[no-untyped-def]
    from magcal_service.cli.__main__ import main

    main(["calibrate", str(recorded), "--json", str(tmp_path / "x.json")])
    assert json.loads((tmp_path / "x.json").read_text()) == json.loads(json.dumps(calibrated(recorded).to_dict()))


def test_a_configuration_of_its_own_is_used(recorded) -> None:  # type: ignore[no-untyped-def]
    craft = magcal.Craft("mine", sensor=magcal.Sensor(noise_nt=300.0), filter=magcal.Filter(method="two-step"))
    assert magcal.calibrate(recorded, config=craft).method == "two-step"


def test_a_replay_gives_every_message_and_the_last_estimate(recorded) -> None:  # type: ignore[no-untyped-def]
    messages: list[object] = []
    result = magcal.replay(recorded, sink=messages.append)
    last = [message for message in messages if isinstance(message, Estimate)][-1]
    assert result.estimates == sum(isinstance(message, Estimate) for message in messages)
    assert sum(isinstance(message, CalibratedVector) for message in messages) == 1800
    assert result.bias_nt.tolist() == list(last.bias_nt)
    assert result.to_dict()["verdict"] == str(last.verdict)
    assert result.covariance.shape == (9, 9)


def test_apply_is_the_pipelines_vector(recorded) -> None:  # type: ignore[no-untyped-def]
    """Equation (5) by the last estimate, as the daemon publishes it for the next sample."""
    result = magcal.replay(recorded)
    B = np.array([[20_000.0, -5_000.0, 31_000.0]])
    expected = (np.eye(3) + result.D) @ B[0] - result.bias_nt
    assert result.apply(B)[0] == pytest.approx(expected, rel=1e-14)


def test_a_diagnosis_is_what_the_command_writes(recorded, tmp_path) -> None:  # type: ignore[no-untyped-def]
    answer = magcal.diagnose(recorded)
    written = json.loads((run(Request(recorded, tmp_path / "out"), lambda _: None).files[0]).read_text())
    content = answer.to_dict()
    assert {**written, "seconds": 0} == {**content, "seconds": 0}
    assert answer.bias_nt.tolist() == content["fit"]["bias_nt"]
    assert answer.sigma_bias_nt.tolist() == pytest.approx(content["fit"]["sigma"]["bias_nt"])
    assert repr(answer).startswith(f"Diagnosis: {answer.verdict} (")


def test_a_recording_given_twice_is_refused(recorded) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(magcal.InputRefusedError, match="the same samples as"):
        magcal.diagnose([recorded, recorded])


def test_no_recording_is_refused() -> None:
    with pytest.raises(magcal.InputRefusedError, match="number of recordings: 0 is refused"):
        magcal.diagnose([])
