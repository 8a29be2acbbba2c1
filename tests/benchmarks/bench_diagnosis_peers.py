"""The published baseline of a diagnosis, and ours on the same physics: sparse regression against evidence.

The scenario is that of docs/peers.md: 550 km, 97.6 deg, a turn a minute, 50 nT, 18000 s.  Baseline figures: nine errors
fitted on the first half, then sequentially thresholded least squares on twelve features.

    python -m tests.benchmarks.bench_diagnosis_peers
"""

from __future__ import annotations

import math
import resource
import tempfile
import time
from pathlib import Path

import numpy as np

from magcal_service.diagnosis import result
from magcal_service.diagnosis.diagnose import Diagnosis, diagnose
from magcal_service.physics.interface import Value, Values
from magcal_service.recordings.reader import read_recording
from sim_sensor.recorder import record_simulation
from sim_sensor.scenario_reader import load_scenario
from sim_sensor.simulation import Simulation

BASE = """
version = 1
description = "a case of the baseline"
craft = "bench"
duration_s = 18000
seed = 11
start = "2025-06-01T00:00:00Z"

[orbit]
altitude_km = 550
eccentricity = 1e-4
inclination_deg = 97.6

[spin]
axis = "z"
direction = [1, 1, 1]
rate_rpm = 1.0

[magnetometer]
rate_hz = 1
noise_nt = 50
bias_nt = [500, -300, 400]
D = [0.01, 0.02, -0.01, 0.005, 0.003, -0.004]

[position]
rate_hz = 0.1
"""

CASES = {
    "nothing": ("", "none", (), math.nan),
    "solar current": (
        """
[[panel]]
normal = [0, 0, 1]
max_a = 1.0
field_nt_per_a = [300, -150, 200]

[telemetry]
channels = ["current"]
rate_hz = 1
current_noise = 0.001
""",
        "nt_per_a",
        (300.0, -150.0, 200.0),
        52.8,
    ),
    "gain by temperature": (
        """
[thermal]
hot_degc = 40
cold_degc = -5
time_constant_s = 1200
start_degc = 20
zero_degc = 20
scale_per_k = [2e-4, 2e-4, 2e-4]

[telemetry]
channels = ["temperature"]
rate_hz = 1
temperature_noise = 0.05
""",
        "per_k",
        (2e-4, 2e-4, 2e-4),
        50.2,
    ),
    "clock 3 s off": (
        """
[field]
reference_time_offset_s = 3
""",
        "offset_s",
        (3.0,),
        51.0,
    ),
}


def run(name: str) -> Diagnosis:
    """Simulate one case, record it, diagnose the recording."""
    with tempfile.TemporaryDirectory() as folder:
        scenario = Path(folder) / "case.toml"
        scenario.write_text(BASE + CASES[name][0], encoding="utf-8")
        recording = read_recording(record_simulation(Simulation(load_scenario(scenario)), Path(folder) / "out"))
        return diagnose(recording)


def fitted(parameters: Values, name: str) -> Value:
    """The number that was fitted: the one for all axes where that form stands, beside which each axis' own is given."""
    return parameters.get(f"{name}_common", parameters[name])


def main() -> None:
    """Print the table."""
    print(
        "| injected | held-out rms before | after | noise | baseline after | named | largest error | sigma | time [s] |"
    )
    print("|---|---|---|---|---|---|---|---|---|")
    for name, (_, parameter, truth, baseline) in CASES.items():
        began = time.process_time()
        diagnosis = run(name)
        found = result.entries(diagnosis)
        level = result.held_out_rms(diagnosis)
        error, sigma = "-", "-"
        if found and truth:
            numbers = fitted(found[0].parameters, parameter)
            value, size = np.abs(np.atleast_1d(numbers.value).ravel()), np.abs(np.array(truth))
            worst = int(np.argmax(np.abs(value / size - 1.0)))
            error = f"{100.0 * abs(value[worst] / size[worst] - 1.0):.2f} %"
            sigma = f"{100.0 * float(np.atleast_1d(numbers.sigma).ravel()[worst]) / size[worst]:.2f} %"
        names = ", ".join(entry.effect for entry in found) or "nothing"
        print(
            f"| {name} | {level['recalibrated']:.1f} | {level['with_effects']:.1f} | 50.0 | {baseline:.1f} | {names} "
            f"| {error} | {sigma} | {time.process_time() - began:.1f} |",
            flush=True,
        )
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    print(f"\npeak memory of the process: {peak:.0f} MB")


if __name__ == "__main__":
    main()
