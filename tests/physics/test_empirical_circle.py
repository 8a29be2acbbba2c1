"""What has no name goes round: diagnosed on one flight, loaded on another, and the residual falls there."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from magcal_service.cli.__main__ import main as magcal
from magcal_service.diagnosis.diagnose import Verdict, diagnose
from magcal_service.diagnosis.handover import write_model
from magcal_service.diagnosis.result import entries
from magcal_service.model import Array
from magcal_service.physics.apply.empirical import Empirical, Kind
from magcal_service.physics.apply.model_file import parse_model
from magcal_service.recordings.reader import read_recording
from sim_sensor.recorder import record_simulation
from sim_sensor.simulation import Simulation
from tests.physics.live_models import NOISE_NT, model_of
from tests.physics.test_simulated_physics import LOOKED_FOR, cold

KNOTS = np.linspace(0.0, 46.0, 21)
SIZE = np.array([600.0, -400.0, 500.0])


def peak(warm: Array) -> Array:
    """A field (n, 3) [nT] that is there around 23 degC only."""
    return np.asarray(np.exp(-0.5 * ((warm - 23.0) / 3.7) ** 2)[:, None] * SIZE)


TRUTH = Empirical(
    "channel:temperature", Kind.BIAS, "temperature", 0, KNOTS, peak(KNOTS), np.zeros((21, 3)), (0.0, 46.0)
)


def flown(seed: int, duration_s: float, folder: Path, start_degc: float) -> Path:
    """A flight of the craft whose bias peaks at a temperature."""
    scenario = cold()
    thermal = scenario.effects.thermal
    assert thermal is not None
    begun = replace(thermal, start_degc=start_degc)
    scenario = replace(scenario, effects=replace(scenario.effects, thermal=begun))
    model = model_of(origin_ns=scenario.start_ns, empirical=(TRUTH,))
    return record_simulation(Simulation(scenario, seed, duration_s, model), folder)


@pytest.fixture(scope="module")
def physics(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The ``physics.toml`` of every second sample of the first flight, where no name for heat holds its curve."""
    recording = read_recording(flown(11, 9000.0, tmp_path_factory.mktemp("first"), 17.5))
    found = diagnose(recording.select(np.arange(len(recording)) % 2 == 0), effects=LOOKED_FOR)
    assert found.verdict is Verdict.UNKNOWN
    assert not found.trusted
    assert found.fit.held_out_rms_nt > 1.5 * NOISE_NT
    assert found.modelled is not None
    assert found.modelled.fit.held_out_rms_nt < 1.15 * NOISE_NT
    return write_model(found, entries(found), "first")


def test_the_curve_is_the_one_that_was_put_in(physics: str) -> None:
    (curve,) = parse_model(physics.encode()).empirical
    assert (curve.driver, curve.kind) == ("channel:temperature", Kind.BIAS)
    warm = np.linspace(*curve.span, 200)
    off = curve.at(warm) - peak(warm)
    off -= off.mean(axis=0)  # its mean over the recording is in the bias
    assert np.sqrt(np.mean(off**2)) < 0.15 * np.abs(SIZE).max()


def test_another_flight_has_less_residual_with_it(
    physics: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """By replay through the daemon, from another temperature at the start."""
    path = flown(12, 3000.0, tmp_path, 23.0)
    (tmp_path / "physics.toml").write_text(physics, encoding="utf-8")
    after = {}
    for name, line in (("without", ""), ("with", f'physics = "{tmp_path / "physics.toml"}"\n')):
        config = tmp_path / f"{name}.toml"
        head = f'version = 1\n[[craft]]\nname = "hot"\n{line}'
        config.write_text(f"{head}[craft.sensor]\nnoise_nt = 100.0\n[craft.spin]\nrate_rpm = 7.5\n", encoding="utf-8")
        magcal(["replay", str(path), "--config", str(config)])
        out = capsys.readouterr().out
        found = re.search(r"([\d.]+) nT after", out)
        assert found is not None
        after[name] = float(found[1])
        if line:
            assert re.search(
                r"physics\.toml: empirical \(channel:temperature\): compensated in \d+ of 3000 samples", out
            )
    assert after["without"] > 1.45 * NOISE_NT
    assert after["with"] < 1.2 * NOISE_NT
