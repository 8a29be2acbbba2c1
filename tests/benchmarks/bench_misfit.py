"""What a ``physics.toml`` does to flights that it fits and that it does not: when harm is said, and how large it gets.

    python -m tests.benchmarks.bench_misfit [--seeds 40] [--size 5] [--only CASE ...] [--json docs/results/misfit.json]

The flight is the hot board's (``hot-electronics``, 100 nT), with a random orbit phase and start temperature a seed; its
temperature is recorded.  Each model is compensated live beside a daemon without one, and the vectors of both are held
against the true field.  A vector is worse than without by its own sigma where the rms error per axis over 100 s, the
error without taken off in squares, is above the rms of its published sigma; ``longest`` is how long that lasts.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from magcal_service.daemon.pipeline import Pipeline
from magcal_service.model import Array
from magcal_service.physics.apply.model_file import ModelTerm
from magcal_service.wire.messages import CalibratedVector, Verdict
from sim_sensor.scenario import Scenario
from sim_sensor.simulation import Simulation
from tests.benchmarks.results import write
from tests.physics.live_models import THERMAL, craft, hot, physics

DURATION_S: Final = 9000.0
ORBIT_S: Final = 5500.0
STRETCH: Final = 100  # samples over which errors are compared
BIAS: Final = np.array([8.0, -6.0, 12.0])


def _biased(nt_per_k: Array) -> tuple[ModelTerm, ...]:
    return replace(THERMAL[0], amplitudes={"nt_per_k": nt_per_k}), THERMAL[1]


CASES: Final[dict[str, Callable[[float], tuple[ModelTerm, ...]]]] = {
    "fits": lambda size: _biased(size * BIAS),
    "fits to 20 %": lambda size: _biased(0.8 * size * BIAS),
    "wrong sign": lambda size: _biased(-size * BIAS),
    "other axes": lambda size: _biased(size * np.roll(BIAS, 1)),
    "three times too strong": lambda size: _biased(3.0 * size * BIAS),
    "not there today": lambda size: _biased(size * BIAS),
}


@dataclass(frozen=True, slots=True)
class Outcome:
    """One flight under one model.

    Parameters
    ----------
    stopped_s: when compensation was stopped, since the first sample [s]; None where it was not.
    longest_s: longest time for which the vectors were worse than without a model by more than their own sigma [s].
    rms_nt: error of the vectors per axis over the last orbit, with the model and without [nT].
    """

    stopped_s: float | None
    longest_s: float
    rms_nt: tuple[float, float]


def flight(seed: int, size: float) -> Scenario:
    """The hot board with its heat as many times as strong, another start of the orbit and another temperature."""
    rng = np.random.default_rng(seed)
    scenario = hot()
    thermal = scenario.effects.thermal
    assert thermal is not None
    start_ns = scenario.start_ns + int(rng.uniform(0.0, 6000.0)) * 10**9
    k = tuple((size * BIAS).tolist())
    thermal = replace(thermal, bias_nt_per_k=k, start_degc=float(rng.uniform(-10.0, 45.0)))
    return replace(scenario, start_ns=start_ns, effects=replace(scenario.effects, thermal=thermal))


def played(case: str, seed: int, size: float, duration_s: float = DURATION_S) -> Outcome:
    """A flight with a case's model and without, against the truth."""
    scenario = flight(seed, 0.0 if case == "not there today" else size)
    simulation = Simulation(scenario, seed, duration_s)
    truth = simulation.arrays().ambient_body_nt
    model = physics(*CASES[case](size), origin_ns=scenario.start_ns)
    crafts = [Pipeline(craft("hot", one)) for one in (model, None)]
    error, sigma = np.zeros((2, len(truth), 3)), np.zeros((2, len(truth)))
    stopped_s, rows = None, [0, 0]
    for message in simulation.messages():
        for index, pipeline in enumerate(crafts):
            for vector in pipeline.answer(message):
                if isinstance(vector, CalibratedVector):
                    row, rows[index] = rows[index], rows[index] + 1
                    error[index, row] = np.array(vector.field_body_nt) - truth[row]
                    xx, _, _, yy, _, zz = vector.covariance_nt2
                    sigma[index, row] = (xx + yy + zz) / 3.0
            pipeline.advance()
        if stopped_s is None and crafts[0].stopped:
            stopped_s = (crafts[0].last_time_ns - crafts[0].first_time_ns) * 1e-9
    count = len(truth) // STRETCH * STRETCH
    square = (error[:, :count] ** 2).mean(axis=2).reshape(2, -1, STRETCH).mean(axis=2)
    own = sigma[0, :count].reshape(-1, STRETCH).mean(axis=1)
    worse = square[0] - square[1] > own
    edges = np.flatnonzero(np.diff(np.concatenate([[False], worse, [False]]).astype(int)))
    longest_s = float(STRETCH * max((edges[1::2] - edges[::2]).tolist(), default=0))
    last = int(ORBIT_S) // STRETCH
    with_it, without = np.sqrt(square[:, -last:].mean(axis=1)).tolist()
    assert crafts[0].trust.verdict is not Verdict.NOT_STARTED
    return Outcome(stopped_s, longest_s, (with_it, without))


def line(case: str, outcomes: Sequence[Outcome]) -> str:
    """A row of the table."""
    stops = sorted(one.stopped_s / 60.0 for one in outcomes if one.stopped_s is not None)
    when = f"{np.median(stops):.0f} to {stops[-1]:.0f} min" if stops else "-"
    longest = max(one.longest_s for one in outcomes) / 60.0
    with_it, without = (float(np.median([one.rms_nt[i] for one in outcomes])) for i in (0, 1))
    return f"| {case} | {len(stops)} of {len(outcomes)} | {when} | {longest:.0f} min | {with_it:.0f} | {without:.0f} |"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=40)
    parser.add_argument("--size", type=float, default=5.0, help="times the hot board's own coefficients")
    parser.add_argument("--only", nargs="*", choices=list(CASES), default=list(CASES))
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    print("| model | stopped | median and latest | worse than without for at most | error with it | without |")
    print("|---|---|---|---|---|---|")
    found = {}
    for case in options.only:
        outcomes = [played(case, seed, options.size) for seed in range(options.seeds)]
        print(line(case, outcomes), flush=True)
        found[case] = {
            "stopped": sum(one.stopped_s is not None for one in outcomes),
            "latest_s": max((one.stopped_s or 0.0) for one in outcomes),
            "longest_s": max(one.longest_s for one in outcomes),
        }
    write(options.json, {"seeds": options.seeds, **found})


if __name__ == "__main__":
    main()
