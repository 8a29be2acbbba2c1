"""Channels that resemble one another, channels that drive nothing, and a quadrotor's current."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from magcal_service.diagnosis.diagnose import Verdict, diagnose
from magcal_service.diagnosis.explain import Explained
from magcal_service.diagnosis.linear import Gain
from magcal_service.diagnosis.problem import Problem, Term
from magcal_service.diagnosis.result import entries
from magcal_service.diagnosis.screen import Candidate
from magcal_service.diagnosis.solution import solve
from magcal_service.diagnosis.which_driver import drivers_of, otherwise
from magcal_service.model import Array
from magcal_service.physics.catalogue import effect_named
from magcal_service.physics.drivers.readout import lost_by_hold
from magcal_service.physics.scene.scene import Telemetry
from magcal_service.recordings.reader import read_recording
from magcal_service.recordings.recording import Recording
from tests.benchmarks.bench_drivers import driven, idle, named
from tests.benchmarks.bench_suchai3 import DATA
from tests.physics.scenes import COUNT, NOISE_NT, X, scene

DRONE = DATA / "ardupilot"


@pytest.mark.parametrize("seed", [100, 101, 102])
def test_the_channel_that_drives_is_in_the_class(seed: int) -> None:
    """Of twenty that go along with one another by 0.9 to 0.99 no false one is given for sure."""
    truth, diagnosis = driven(seed)
    first = named(diagnosis)[0]
    assert first.effect == "current_loop"
    assert truth in [name for name, _ in first.drivers]
    assert all(chance < 0.95 for name, chance in first.drivers if name != truth)
    assert first.as_json()["drivers"][0]["driver"] == first.drivers[0][0]


@pytest.mark.parametrize("seed", [100, 101, 102])
def test_channels_that_drive_nothing_are_not_named(seed: int) -> None:
    assert named(idle(seed)) == []


def believed(values: dict[str, Array], nats: dict[str, float]) -> tuple[tuple[tuple[str, float], ...], float]:
    """Drivers of a current's field with so much evidence each, and the probability that it is another's."""
    of = replace(scene(), channels={name: Telemetry(name, "current", one[:, None]) for name, one in values.items()})
    forms = {h.driver.removeprefix("channel:"): h for h in effect_named("current_loop").hypotheses(of) if not h.variant}
    ranked = [Candidate(forms[name], np.zeros(0), Gain(one, 0.0, 3.0, np.zeros(3)), one) for name, one in nats.items()]
    first = next(iter(nats))
    problem = Problem(of, NOISE_NT)
    fit = solve(problem, X, [Term(forms[first], np.zeros(0), np.array([30.0, 20.0, 10.0]))])
    named = Explained(fit, (tuple(ranked),), (100.0,), drivers=(tuple(ranked),))
    return drivers_of(named, 0), otherwise(named, 0)


BUS = np.repeat(np.random.default_rng(77).normal(1.0, 0.3, COUNT // 40), 40) + 0.02 * np.sin(np.arange(COUNT))


@pytest.mark.parametrize(("sign", "is_other"), [(-1.0, True), (1.0, False)])
def test_a_record_that_goes_against_the_one_that_fits_best_is_no_driver_to_act_on(sign: float, is_other: bool) -> None:
    """A battery gives what the bus takes: numbers by the one have the other sign by the other."""
    found, other = believed({"bus": BUS, "battery": sign * BUS + 0.01}, {"bus": 82.0, "battery": 80.0})
    assert [driver for driver, _ in found] == ["channel:bus", "channel:battery"]
    assert (other > 0.2) is is_other
    assert other == pytest.approx(found[1][1] if is_other else 0.0)
    assert believed({"bus": BUS, "battery": -BUS}, {"bus": 82.0, "battery": 60.0})[1] < 0.01


def test_a_record_that_is_held_may_lack_the_evidence_that_it_does_not_show() -> None:
    """Held for fifteen rows it differs from what flows by half of the square of its steps."""
    walk = np.cumsum(np.random.default_rng(78).normal(size=COUNT))
    held = walk[np.arange(COUNT) // 15 * 15]
    of = scene()
    lost = lost_by_hold(replace(of), Telemetry("held", "current", held[:, None]))
    assert lost == pytest.approx(float(np.mean((held - walk) ** 2) / np.var(held)), rel=0.35)
    assert lost_by_hold(replace(of), Telemetry("fresh", "current", walk[:, None])) == 0.0
    for switched in (
        (np.random.default_rng(79).random(COUNT) < 0.03).cumsum() % 2,
        np.arange(COUNT) // 20 % 2,  # on a beat: that is no readout
    ):
        assert lost_by_hold(replace(of), Telemetry("load", "current", 1.0 * switched[:, None])) == 0.0
    steps = np.repeat(np.random.default_rng(80).normal(size=COUNT // 2), 2)[:COUNT]
    assert lost_by_hold(replace(of), Telemetry("steps", "current", steps[:, None])) == 0.5  # of 1, at the most


def every_second(name: str) -> Recording:
    """Every second row, at 5 Hz, as quick as the current changes: half of the rows takes a third of the time."""
    recording = read_recording(DRONE / name)
    return recording.select(np.arange(len(recording)) % 2 == 0)


@pytest.mark.skipif(not DRONE.exists(), reason="the recording ardupilot/log171 is not in ../shared/data")
def test_the_compass_inside_a_quadrotor_follows_its_current() -> None:
    """Half of what is left without it is left with it at the most."""
    found = diagnose(every_second("log171-internal.toml"))
    first = entries(found)[0]
    assert (first.effect, first.driver) == ("current_loop", "channel:current")
    assert found.fit.held_out_rms_nt < 0.5 * found.prepared.baseline.held_out_rms_nt


@pytest.mark.skipif(not DRONE.exists(), reason="the recording ardupilot/log171 is not in ../shared/data")
def test_the_compass_on_its_mast_is_not_told_a_cause_to_act_on() -> None:
    found = diagnose(every_second("log171-external.toml"))
    assert found.verdict is Verdict.UNKNOWN
    assert not found.trusted
