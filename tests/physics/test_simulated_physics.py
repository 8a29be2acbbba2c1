"""The circle: a recording is diagnosed, its physics.toml goes back into the simulator, and the two are alike."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from magcal_service.base.errors import ConfigError
from magcal_service.cli.__main__ import main as magcal
from magcal_service.diagnosis.diagnose import Diagnosis, diagnose
from magcal_service.diagnosis.handover import write_model
from magcal_service.diagnosis.result import entries
from magcal_service.physics.apply.model_file import parse_model, read_model, text_of
from magcal_service.physics.catalogue import effect_named
from magcal_service.recordings.reader import read_recording
from sim_sensor.cli import main
from sim_sensor.physics import doubled, own_effects
from sim_sensor.recorder import record_simulation
from sim_sensor.scenario import Scenario
from sim_sensor.scenario_reader import load_scenario, shipped_scenarios
from sim_sensor.simulation import Simulation
from tests.physics.live_models import THERMAL, hot, model_of
from tests.physics.test_model_file import drawn, forms

DURATION_S = 6000.0
LOOKED_FOR = tuple(effect_named(name) for name in ("thermal_bias", "thermal_scale", "bias_drift"))


def cold() -> Scenario:
    """The hot board with its temperature, and nothing that follows it."""
    scenario = hot()
    thermal = scenario.effects.thermal
    assert thermal is not None
    harmless = replace(thermal, bias_nt_per_k=(0.0, 0.0, 0.0), scale_per_k=(0.0, 0.0, 0.0))
    return replace(scenario, effects=replace(scenario.effects, thermal=harmless))


def diagnosed(simulation: Simulation, directory: Path) -> Diagnosis:
    return diagnose(read_recording(record_simulation(simulation, directory)), effects=LOOKED_FOR)


def test_a_diagnosis_put_back_into_the_simulator_gives_the_recording_again(tmp_path: Path) -> None:
    """Same effect, parameters within 3.5 sigma of each other, and one residual of the nine errors alone, to 2 %."""
    first = diagnosed(Simulation(hot(), 11, DURATION_S), tmp_path / "first")
    text = write_model(first, entries(first), "first")
    second = diagnosed(Simulation(cold(), 12, DURATION_S, parse_model(text.encode())), tmp_path / "second")
    named = [[term.hypothesis.label for term in found.fit.terms] for found in (first, second)]
    assert "thermal_bias by channel:temperature" in named[0]
    assert sorted(named[0]) == sorted(named[1])
    for one in entries(first):
        other = next(entry for entry in entries(second) if entry.effect == one.effect)
        for name, value in one.parameters.items():
            if np.isfinite(value.sigma).all():
                sigma = np.hypot(value.sigma, other.parameters[name].sigma)
                assert (np.abs(value.value - other.parameters[name].value) < 3.5 * sigma).all()
    rms = [found.prepared.baseline.rms_nt for found in (first, second)]
    assert rms[1] == pytest.approx(rms[0], rel=0.02)


@pytest.mark.parametrize("effect", ["hysteresis", "bias_drift", "cubic_response"])
def test_a_run_in_blocks_has_what_the_whole_has(effect: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Effects with a past, and those that count time, go on from block to block."""
    term = drawn(next(h for h in forms() if h.effect == effect))[0]
    scenario = replace(cold(), sensor=replace(cold().sensor, noise_nt=(0.0, 0.0, 0.0)))
    model = model_of(term, origin_ns=scenario.start_ns)
    whole = Simulation(scenario, 1, 600.0, model).arrays().measured_nt
    monkeypatch.setattr("sim_sensor.simulation._BLOCK", 100)
    assert Simulation(scenario, 1, 600.0, model).arrays().measured_nt == pytest.approx(whole, abs=1e-6)


def test_what_is_added_is_what_the_model_says() -> None:
    """The thermal model on a board without its own coefficients measures what the board with them measures."""
    own, added = Simulation(hot(), 1, 900.0), Simulation(cold(), 1, 900.0, model_of(*THERMAL, origin_ns=0))
    assert added.arrays().measured_nt == pytest.approx(
        own.arrays().measured_nt, abs=1.0
    )  # a (T - T0) D B: second order


def test_a_scenario_without_the_driver_is_refused_by_name(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """One line names the effect, its driver, and the telemetry that there is; the exit code is 2."""
    path = tmp_path / "physics.toml"
    path.write_text(text_of(model_of(*THERMAL, origin_ns=0)), encoding="utf-8")
    arguments = ["record", "--scenario", "paper", "--duration", "60", "--out", str(tmp_path), "--physics", str(path)]
    assert main(arguments) == 2
    assert "physics: thermal_bias.driver: \"'channel:temperature'\" is refused" in capsys.readouterr().err
    with pytest.raises(ConfigError):
        Simulation(load_scenario("paper"), 1, 60.0, read_model(path))


def test_a_replay_with_the_model_comes_to_the_noise_and_without_it_does_not(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The command, with a configuration that names the file: rms within 2 % of the noise, trusted, exit code 0."""
    scenario = hot()
    thermal = scenario.effects.thermal
    assert thermal is not None
    strong = replace(thermal, bias_nt_per_k=(80.0, -60.0, 120.0), time_constant_s=3000.0)
    strong_scenario = replace(scenario, effects=replace(scenario.effects, thermal=strong))
    path = record_simulation(Simulation(strong_scenario, 2, 3000.0), tmp_path)
    bias = replace(THERMAL[0], amplitudes={"nt_per_k": np.array(strong.bias_nt_per_k)})
    model = model_of(bias, THERMAL[1], origin_ns=scenario.start_ns)
    (tmp_path / "physics.toml").write_text(text_of(model), encoding="utf-8")
    lines = {}
    for name, physics in (("without", ""), ("with", f'physics = "{tmp_path / "physics.toml"}"\n')):
        config = tmp_path / f"{name}.toml"
        head = f'version = 1\n[[craft]]\nname = "hot"\n{physics}'
        config.write_text(f"{head}[craft.sensor]\nnoise_nt = 100.0\n[craft.spin]\nrate_rpm = 7.5\n", encoding="utf-8")
        code = magcal(["replay", str(path), "--config", str(config)])
        lines[name] = capsys.readouterr().out
        after = float(lines[name].partition(" nT before, ")[2].partition(" nT after")[0])
        if name == "with":
            assert code == 0
            assert after == pytest.approx(100.0, rel=0.02)
        else:
            assert code == 3
            assert after > 150.0
    assert "verdict: trusted" in lines["with"]


def test_an_effect_that_the_scenario_has_by_itself_is_said_to_be_there_twice(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The heat of the file adds to that of the scenario; what the file has not is not spoken of."""
    path = tmp_path / "physics.toml"
    path.write_text(text_of(model_of(*THERMAL[:1], origin_ns=0)), encoding="utf-8")
    arguments = ["record", "--scenario", "hot-electronics", "--duration", "60", "--physics", str(path)]
    assert main([*arguments, "--out", str(tmp_path / "twice")]) == 0
    (said,) = [line for line in capsys.readouterr().err.splitlines() if line.startswith("warning")]
    assert f"thermal_bias of {path} is added to what hot-electronics has by itself (thermal.bias_nt_per_k): bo" in said
    assert doubled(cold(), parse_model(path.read_bytes())) == {}


def test_every_effect_of_a_scenario_is_known_by_its_name_in_the_catalogue() -> None:
    """Of each shipped scenario its own, and every name is one of the catalogue."""
    own = {name: set(own_effects(load_scenario(name))) for name in shipped_scenarios()}
    assert own["paper"] == own["nutation"] == set()
    assert own["hot-electronics"] == {"thermal_bias", "thermal_scale"}
    assert own["torquer-duty"] == {"torquer"}
    assert {"current_loop", "sun_disturbance"} <= own["noisy-panels"]
    assert "bias_step" in own["bias-step"]
    assert "reference_epoch" in own["stale-reference"]
    for name in set().union(*own.values()):
        effect_named(name)


@pytest.mark.parametrize(
    ("part", "changes", "effect"),
    [
        ("sensor", {"lag_s": 0.1}, "response_lag"),
        ("field", {"ring_current_nt": -50.0}, "external_field"),
        ("field", {"reference_time_offset_s": 2.0}, "time_offset"),
        ("field", {"reference_radial_km": 0.5}, "position_offset"),
    ],
)
def test_what_the_field_and_the_sensor_do_counts_too(part: str, changes: dict[str, float], effect: str) -> None:
    scenario = load_scenario("paper")
    changed = replace(scenario, **{part: replace(getattr(scenario, part), **changes)})
    assert set(own_effects(changed)) == {effect}
    effect_named(effect)
