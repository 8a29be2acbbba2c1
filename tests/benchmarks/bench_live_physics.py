"""What live compensation adds to the vector path: a sample's vector with 0, 1 and 2 effects of physics.toml.

    python -m tests.benchmarks.bench_live_physics [--json docs/results/live-physics.json]

The effects are the usual two, a bias that follows a recorded temperature and a loop that follows a recorded current.
Samples go to three pipelines in turn; what is timed is ``Pipeline.answer`` of a sample, from message to vector.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np

from magcal_service.config.settings import CraftConfig, PhysicsConfig, SensorConfig
from magcal_service.daemon.pipeline import Pipeline
from magcal_service.wire.messages import Frame, MagnetometerSample, ReferenceSample, TelemetrySample
from tests.benchmarks.results import write

HEAD: Final = """
version = 1
[recording]
name = "bench"
origin_ns = 0
clock = "elapsed"
[errors]
bias_nt = [100.0, -50.0, 20.0]
D = [0.01, 0.02, -0.01, 0.0, 0.0, 0.0]
"""
EFFECTS: Final = (
    """
[[effect]]
name = "thermal_bias"
driver = "channel:t"
[effect.amplitudes]
nt_per_k = [4.0, -3.0, 5.0]
[effect.constants]
zero_degc = 20.0
column = 0.0
""",
    """
[[effect]]
name = "current_loop"
driver = "channel:i"
[effect.amplitudes]
nt_per_a = [100.0, 20.0, -40.0]
[effect.constants]
column_0 = 0.0
""",
)
WARM_UP: Final = 200  # samples before the first that is timed


def pipeline(count: int) -> Pipeline:
    """A craft that compensates so many effects."""
    text = HEAD + "".join(EFFECTS[:count])
    physics = PhysicsConfig(Path("physics.toml"), text) if count else None
    return Pipeline(CraftConfig("bench", sensor=SensorConfig(noise_nt=100.0), physics=physics))


def messages(second: int) -> Iterator[MagnetometerSample | ReferenceSample | TelemetrySample]:
    """Reference, temperature, current and sample of one second; the field turns slowly in the body."""
    angle = 0.01 * second
    field = (25_000.0 * float(np.cos(angle)), 20_000.0 * float(np.sin(angle)), 30_000.0 * float(np.cos(0.7 * angle)))
    stamp = {"craft": "bench", "sequence": second, "time_ns": second * 10**9}
    yield ReferenceSample(**stamp, source="model", field_nt=field, frame=Frame.ECI)  # type: ignore[arg-type]
    for channel, unit, value in (("t", "degC", 20.0 + np.sin(angle)), ("i", "A", 1.0 + 0.1 * np.cos(angle))):
        yield TelemetrySample(**stamp, source="obc", channel=channel, unit=unit, values=(float(value),))  # type: ignore[arg-type]
    yield MagnetometerSample(**stamp, source="mag", field_body_nt=field)  # type: ignore[arg-type]


def main() -> None:
    """Print the medians and their ratios."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--samples", type=int, default=5000)
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    crafts = [pipeline(count) for count in (0, 1, 2)]
    times = np.empty((3, options.samples))
    for second in range(WARM_UP + options.samples):
        for message in messages(second):
            for index, craft in enumerate(crafts):
                begun = time.perf_counter()
                craft.answer(message)
                if isinstance(message, MagnetometerSample) and second >= WARM_UP:
                    times[index, second - WARM_UP] = time.perf_counter() - begun
        for craft in crafts:
            craft.advance()
    micros = (1e6 * np.median(times, axis=1)).tolist()
    for count, value in enumerate(micros):
        print(f"{count} effects: {value:.1f} us a vector, {value / micros[0]:.2f} times none")
    assert all(craft.ticks.counters["accepted"] == WARM_UP + options.samples for craft in crafts)
    missing = [craft.compensation.missing for craft in crafts if craft.compensation is not None]
    assert not any(missing), missing
    write(options.json, {f"median_us_{count}": value for count, value in enumerate(micros)})


if __name__ == "__main__":
    main()
