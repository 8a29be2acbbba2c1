"""What protection levels cost, how seldom their test is wrong, and how loose they are.

    python -m tests.benchmarks.bench_protection cost
    python -m tests.benchmarks.bench_protection false-alarms --flights 40
    python -m tests.benchmarks.bench_protection just-below --json docs/results/just-below.json
    python -m tests.benchmarks.bench_protection new-step --json docs/results/new-step.json

The first gives each tick of the paper's flight to the filter and to two monitors in turn, one with protection levels
and one without.  The second flies the paper's craft at drawn spin directions with nothing wrong, and prints the largest
evidence of a flight beside the alarm.  The third looks for the largest size of each hazard that is not seen, and prints
the level over the error there (``just_below``).  The fourth does so for the step that the published level always holds.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from magcal_service.config.settings import CraftConfig, SensorConfig, SpinConfig, TrustConfig
from magcal_service.estimators.ukf import Ukf
from magcal_service.model import BIAS
from magcal_service.ticks.assembler import Tick
from magcal_service.trust import hazard_look
from magcal_service.trust.hazard_look import ALARM_NATS
from magcal_service.trust.monitor import TrustMonitor
from magcal_service.trust.protection import alarm_gain
from magcal_service.wire.messages import Verdict
from sim_sensor.scenario_reader import load_scenario
from sim_sensor.simulation import Simulation
from tests.benchmarks.just_below import GIVEN, MOTIONS, cases, medians, new_step_row, row_of, search
from tests.benchmarks.just_below import NOISES_NT as BELOW_NT
from tests.benchmarks.results import write

FLIGHT_S = 9000.0
NOISES_NT = (20.0, 100.0, 300.0)
SHARP_NT = 50.0


def ticks(noise_nt: float, seed: int, towards: np.ndarray | None = None) -> Iterator[Tick]:
    """The paper's flight at 1 Hz."""
    scenario = load_scenario("paper")
    spin = scenario.spin
    if towards is not None:
        x, y, z = (towards / np.linalg.norm(towards)).tolist()
        spin = replace(spin, direction_eci=(x, y, z))
    scenario = replace(scenario, spin=spin, sensor=replace(scenario.sensor, noise_nt=(noise_nt,) * 3))
    block = Simulation(scenario, seed, FLIGHT_S).arrays()
    magnitude = np.linalg.norm(block.true_eci_nt, axis=1)
    for row, eci in enumerate(block.true_eci_nt):
        yield Tick(row, np.array([float(row)]), block.measured_nt[row : row + 1], magnitude[row : row + 1], eci[None])


def craft(noise_nt: float, *, protection: bool) -> CraftConfig:
    """What its operator configures."""
    trust = TrustConfig(protection=protection)
    return CraftConfig("paper", SensorConfig(noise_nt=noise_nt), SpinConfig(rate_rpm=7.5), trust=trust)


def cost() -> None:
    """Print the time of a tick in the filter, and in the monitor with protection levels and without [us]."""
    ukf = Ukf(craft(300.0, protection=True))
    monitors = [TrustMonitor(craft(300.0, protection=protection)) for protection in (False, True)]
    spent = []
    for tick in ticks(300.0, 1):
        marks = [time.thread_time()]
        outcome, state = ukf.handle(tick), ukf.estimate()
        marks.append(time.thread_time())
        for monitor in monitors:
            monitor.observe(tick, outcome, state)
            monitor.judge(state)
            marks.append(time.thread_time())
        spent.append(np.diff(marks))
    filtered, without, within = 1e6 * np.array(spent[1000:]).T
    for name, figure in (("median", np.median), ("mean", np.mean)):
        own, bare, protected = (float(figure(one)) for one in (filtered, without, within))
        ratio = (own + protected) / (own + bare)
        print(f"{name}: filter {own:.0f}, monitor {bare:.1f}, protected {protected:.1f} us; a tick {ratio:.2f} times")
    print(f"the slowest tick in 320, with a look: {1e-3 * float(np.quantile(within, 1.0 - 0.5 / 320.0)):.1f} ms")


def false_alarms(flights: int) -> None:
    """Print the largest evidence of clean flights in units of the alarm's."""
    largest, alarms, levels, sharp = [], 0, [], []
    for number in range(flights):
        rng = np.random.default_rng([number, 3])
        noise_nt = NOISES_NT[number % len(NOISES_NT)]
        config = craft(noise_nt, protection=True)
        ukf, monitor = Ukf(config), TrustMonitor(config)
        worst, told = 0.0, False
        for tick in ticks(noise_nt, number, rng.standard_normal(3)):
            monitor.observe(tick, ukf.handle(tick), ukf.estimate())
            worst, told = max(worst, monitor.protector.evidence), told or monitor.protector.seen is not None
        largest.append(worst)
        alarms += told
        level = monitor.protector.level
        levels.append(np.nan if level is None else level.nt)
        state = ukf.estimate()
        if 3.0 * np.sqrt(state.covariance.diagonal()[BIAS].max()) < SHARP_NT:
            sharp.append(monitor.judge(state).verdict is Verdict.TRUSTED)
    print(f"{flights} flights of {FLIGHT_S:.0f} s: {alarms} with an alarm; evidence of a flight over the alarm's:")
    print(
        f"median {np.median(largest):.2f}, largest {max(largest):.2f}; level at the end {np.nanmedian(levels):.0f} nT"
    )
    print(f"trusted at the end: {sum(sharp)} of {len(sharp)} whose bias is known to {SHARP_NT:.0f} nT, 3 sigma")
    print(f"alarm from {ALARM_NATS:.1f} nats of significance: {alarm_gain(ALARM_NATS, 1):.1f} of gain by one column")
    print(f"false alarms a year by the threshold: at most {hazard_look.FALSE_PER_YEAR:g}")


def just_below(names: list[str], path: Path | None) -> None:
    """Print, and write, the level over the error of each hazard at its largest unseen size.

    Rows that the file has of other cases stay: the searches may be made one hazard at a time.
    """
    kept = json.loads(path.read_text(encoding="utf-8"))["figures"]["rows"] if path is not None and path.exists() else []
    rows = {tuple(row[key] for key in ("hazard", "motion", "noise_nt")): row for row in kept}
    for case in cases(names):
        found = search(case)
        if found is None:
            print(f"{case.hazard} {case.motion} {case.noise_nt:g} nT: seen at every size", flush=True)
            continue
        row = rows[str(case.hazard), str(case.motion), case.noise_nt] = row_of(found)
        print(", ".join(f"{key} {_said(value)}" for key, value in row.items()), flush=True)
        write(path, {"rows": list(rows.values()), "over_all": medians(list(rows.values()))})
    print("\n".join(f"{name}: {_said(value)}" for name, value in medians(list(rows.values())).items()))


def new_step(flights: int, path: Path | None) -> None:
    """Print, and write, the published level over the error between a step of ``disturbance_nt`` and the first doubt."""
    rows = []
    for noise_nt in BELOW_NT:
        for motion in MOTIONS:
            rows.append(new_step_row(motion, noise_nt, flights))
            print(", ".join(f"{key} {_said(value)}" for key, value in rows[-1].items()), flush=True)
    write(path, {"rows": rows})


def _said(value: object) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("cost", "false-alarms", "just-below", "new-step"))
    parser.add_argument("--flights", type=int, default=30, help="flights, of new-step each (default 30)")
    parser.add_argument("--hazard", action="append", default=[], choices=list(GIVEN), help="only this one")
    parser.add_argument("--json", type=Path, metavar="FILE", help="where the figures of the last two go")
    options = parser.parse_args()
    if options.what == "cost":
        cost()
    elif options.what == "just-below":
        just_below(options.hazard, options.json)
    elif options.what == "new-step":
        new_step(options.flights, options.json)
    else:
        false_alarms(options.flights)
