"""A replay with ``physics.toml`` reports the residual of what it really did, against its own rows and messages."""

from __future__ import annotations

import csv
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from magcal_service.offline.replay import craft_of, replay
from magcal_service.physics.apply.model_file import ModelTerm
from magcal_service.recordings.reader import read_recording
from magcal_service.wire.messages import CalibratedVector, Message, Verdict
from sim_sensor.recorder import record_simulation
from sim_sensor.simulation import Simulation
from tests.cli.cli_inputs import run
from tests.physics.live_models import NOISE_NT, THERMAL, hot, physics

DURATION_S = 1500.0
GONE = ModelTerm(
    "current_loop", "channel:gone", "", {"nt_per_a": np.array([90.0, 0.0, 0.0])}, constants={"column_0": 0}
)
"""Its channel is not on board: what a formula over the recording refuses as a whole, the service leaves out."""

CONFIG = """
version = 1
[[craft]]
name = "hot"
physics = "{physics}"
[craft.sensor]
noise_nt = 100.0
[craft.spin]
rate_rpm = 7.5
"""


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("recorded")
    thermal = hot().effects.thermal
    assert thermal is not None
    heating = replace(thermal, bias_nt_per_k=(40.0, -30.0, 60.0), time_constant_s=600.0, start_degc=50.0)
    scenario = hot(effects=replace(hot().effects, thermal=heating))
    record_simulation(Simulation(scenario, 3, DURATION_S), folder)
    terms = (replace(THERMAL[0], amplitudes={"nt_per_k": np.array([40.0, -30.0, 60.0])}), THERMAL[1], GONE)
    (folder / "physics.toml").write_text(physics(*terms, origin_ns=scenario.start_ns).text, encoding="utf-8")
    (folder / "magcal.toml").write_text(CONFIG.format(physics=folder / "physics.toml"), encoding="utf-8")
    return folder


def ticks_squares(path: Path) -> list[float]:
    """Squared residual of each tick since the start, out of the running mean over 300 ticks that the rows hold."""
    squares, before, count = [], 0.0, 0
    for row in csv.DictReader(path.read_text(encoding="utf-8").splitlines()):
        running = float(row["residual_rms_nt"]) ** 2
        if running:
            count += 1
            squares.append(before + (running - before) * min(count, 300))
            before = running
    return squares


def test_the_residual_that_is_printed_is_that_of_the_rows(recorded: Path) -> None:
    """To 2 %: a vector leaves with the estimate of one or two ticks before the one whose residual its row has."""
    rows = recorded / "rows.csv"
    out = run("replay", recorded / "RECORDING.toml", "--config", recorded / "magcal.toml", "--out", rows).out
    after, published = (float(re.search(text, out)[1]) for text in (r"([\d.]+) nT after", r"since the start: ([\d.]+)"))  # type: ignore[index]
    squares = ticks_squares(rows)
    assert len(squares) > 900
    assert published == pytest.approx(np.sqrt(np.mean(squares)), rel=0.02)
    assert after == pytest.approx(NOISE_NT, rel=0.1)  # every sample without the heat, at the estimate of the end


def test_the_published_residual_is_that_of_the_messages(recorded: Path) -> None:
    """|B_cal| - |H| of each vector that went out after the start, to the last digit."""
    recording = read_recording(recorded / "RECORDING.toml")
    model = (recorded / "physics.toml").read_text(encoding="utf-8")
    craft = replace(craft_of(recording), physics=replace(physics(origin_ns=0), text=model))
    sent: list[Message] = []
    result = replay(recording, craft, sink=sent.append)
    vectors = [m for m in sent if isinstance(m, CalibratedVector) and m.verdict is not Verdict.NOT_STARTED]
    magnitude = dict(zip(recording.time_ns.tolist(), recording.reference.magnitude_nt.tolist(), strict=True))
    wanted = [np.linalg.norm(m.field_body_nt) - magnitude[m.time_ns] for m in vectors]
    assert result.published is not None
    assert result.published.since_start() == pytest.approx(np.array(wanted), abs=1e-6)
