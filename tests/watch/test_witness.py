"""What one magnetometer alone sees is local; what all see, or what the others are too noisy to see, is not."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from magcal_service.estimators.interface import Phase, StateEstimate, TickOutcome
from magcal_service.ticks.assembler import Tick
from magcal_service.watch.witness import WINDOW, Witness
from magcal_service.wire.messages import Clock

Course = Callable[[int], float]


def nothing(_: int) -> float:
    return 0.0


def constant(nt: float) -> Course:
    return lambda _: nt


def estimate(noise_nt: float) -> StateEstimate:
    return StateEstimate(np.zeros(9), np.zeros((9, 9)), Phase.RUNNING, noise_nt, 1000, 0, 0, None, False)


class Sensor:
    """One magnetometer of given noise, whose residual is white but for what it sees."""

    def __init__(self, noise_nt: float, seed: int) -> None:
        self.witness, self.noise_nt, self._rng = Witness(), noise_nt, np.random.default_rng(seed)
        self.trusted = True

    def second(self, k: int, seen_nt: float, phase: Phase = Phase.RUNNING, clock: Clock = Clock.UTC) -> None:
        residual, field = np.array([seen_nt + self.noise_nt * self._rng.standard_normal()]), np.array([[2e4, 1e4, 3e4]])
        magnitude = np.linalg.norm(field, axis=1) - residual
        tick = Tick(k, np.array([float(k)]), field, magnitude, time_ns=k * 10**9, clock=clock)
        self.witness.push(tick, TickOutcome(phase, residual, 1), estimate(self.noise_nt), trusted=self.trusted)


def told(noises_nt: list[float], courses: list[Course], seconds: int = 60, quiet: int = 2 * WINDOW) -> dict[int, int]:
    """Which sensor's disturbance was called local, and how long after it began [s]."""
    sensors = [Sensor(noise, seed) for seed, noise in enumerate(noises_nt)]
    found: dict[int, int] = {}
    for k in range(-quiet, seconds):
        for sensor, course in zip(sensors, courses, strict=True):
            sensor.second(k + quiet, course(k) if k >= 0 else 0.0)
        for number, sensor in enumerate(sensors):
            sensor.witness.judge(other.witness for other in sensors if other is not sensor)
            if sensor.witness.local:
                found.setdefault(number, k)
    return found


def test_a_magnet_near_one_is_named_within_a_minute() -> None:
    for nt in (250.0, 500.0, 5000.0):
        (number, after_s) = told([100.0, 100.0], [nothing, constant(nt)]).popitem()
        assert (number, after_s <= 30) == (1, True)


def test_before_the_first_estimate_nothing_agrees_with_the_reference() -> None:
    """Not even readings that have its magnitude: there is no estimate that could agree."""
    sensor = Sensor(0.0, 1)
    for k in range(2 * WINDOW):
        sensor.second(k, 0.0, Phase.STARTING)
    assert not sensor.witness.is_quiet


def test_one_of_three_is_named_by_the_other_two() -> None:
    assert set(told([100.0] * 3, [nothing, constant(600.0), nothing])) == {1}


@pytest.mark.parametrize(
    ("noises_nt", "courses"),
    [
        ([100.0, 100.0], [nothing, nothing]),
        ([100.0, 100.0], [constant(500.0), constant(500.0)]),  # the reference, or what is near both
        ([10.0, 300.0], [constant(60.0), constant(60.0)]),  # both see it, and one of them cannot tell it from noise
        ([10.0, 100.0], [constant(60.0), constant(60.0)]),
        ([100.0] * 3, [constant(500.0), constant(500.0), nothing]),  # seen by two: near neither alone
        ([100.0, 100.0], [nothing, lambda k: 4000.0 * (k % 10 == 0)]),  # single spikes
    ],
    ids=["nothing", "common", "noisy witness", "less noisy witness", "two of three", "spikes"],
)
def test_nothing_else_is_called_local(noises_nt: list[float], courses: list[Course]) -> None:
    assert told(noises_nt, courses, 200) == {}


def test_a_residual_that_never_was_quiet_names_nothing() -> None:
    """The noise that is configured may be too small, or physics be missing from the beginning."""
    assert told([100.0, 100.0], [nothing, constant(600.0)], quiet=0) == {}


@pytest.mark.parametrize("doubtful", [0, 1])
def test_an_estimate_that_is_not_trusted_neither_names_nor_witnesses(doubtful: int) -> None:
    """Where the reference is wrong, estimates are wrong in different ways."""
    sensors = [Sensor(100.0, 1), Sensor(100.0, 2)]
    sensors[doubtful].trusted = False
    for k in range(120):
        sensors[0].second(k, 0.0)
        sensors[1].second(k, 800.0 * (k >= 60))
        sensors[1].witness.judge([sensors[0].witness])
        assert not sensors[1].witness.local


def test_one_that_has_fallen_silent_is_no_witness() -> None:
    first, second = Sensor(100.0, 1), Sensor(100.0, 2)
    for k in range(60):
        first.second(k, 0.0)
        second.second(k, 0.0)
    for k in range(75, 135):
        second.second(k, 800.0)
        second.witness.judge([first.witness])
        assert not second.witness.local


def test_it_lasts_until_the_residual_has_agreed_for_a_whole_window() -> None:
    first, second = Sensor(100.0, 1), Sensor(100.0, 2)
    local = []
    for k in range(300):
        first.second(k, 0.0)
        starting = 110 <= k < 160  # the filter has found itself contradicted and collects a new start
        second.second(k, 800.0 * (80 <= k < 160), Phase.STARTING if starting else Phase.RUNNING)
        second.witness.judge([first.witness])
        local.append(second.witness.local)
    assert local.index(True) in range(85, 100)
    assert all(local[100:189])
    assert not any(local[195:])


def test_an_estimate_that_the_filter_has_given_up_is_held_against_what_follows() -> None:
    """A magnet may contradict the filter before ten ticks have passed."""
    first, second = Sensor(100.0, 1), Sensor(100.0, 2)
    for k in range(100):
        first.second(k, 0.0)
        second.second(k, 450.0 * (k >= 60), Phase.STARTING if k >= 66 else Phase.RUNNING)
        second.witness.judge([first.witness])
        assert not (second.witness.local and k < 66)
    assert second.witness.local


def test_white_noise_is_never_loud() -> None:
    sensor, rng = Sensor(100.0, 3), np.random.default_rng(4)
    squares = rng.standard_normal(100_000) ** 2
    sums = np.convolve(np.minimum(squares, 9.0), np.ones(WINDOW) / WINDOW, mode="valid")
    assert sums.max() < 3.2
    assert np.mean(sums > 2.0) < 1e-3
    assert not sensor.witness.is_loud


@pytest.mark.parametrize(
    ("ahead_s", "clock", "local"),
    [(0, Clock.UTC, True), (10, Clock.UTC, True), (11, Clock.UTC, False), (0, Clock.ELAPSED, False)],
)
def test_a_witness_has_seen_the_same_seconds_by_the_same_clock(ahead_s: int, clock: Clock, local: bool) -> None:
    first, second = Sensor(100.0, 1), Sensor(100.0, 2)
    for k in range(120):
        first.second(k + ahead_s, 0.0, clock=clock)
        second.second(k, 800.0 * (k >= 60))
        second.witness.judge([first.witness])
    assert second.witness.local is local
