"""The interpolation of the reference: its rule, and its error on the field of a real low orbit."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from magcal_service.ticks.assembler import SECOND_NS
from magcal_service.ticks.reference_track import ReferenceTrack
from magcal_service.wire.messages import Clock, Frame, ReferenceSample
from sim_sensor.scenario_reader import load_scenario
from sim_sensor.simulation import Simulation
from tests.ticks.tick_streams import START_NS, reference


def track(max_gap_s: float = 10.0) -> ReferenceTrack:
    return ReferenceTrack(round(max_gap_s * SECOND_NS), Counter(), 30 * SECOND_NS, 600 * SECOND_NS)


def vector(seconds: float, field_nt: tuple[float, float, float], frame: Frame) -> ReferenceSample:
    at_ns = START_NS + round(seconds * SECOND_NS)
    return ReferenceSample(craft="c", source="r", sequence=0, time_ns=at_ns, field_nt=field_nt, frame=frame)


def magnitude_at(target: ReferenceTrack, seconds: float) -> float | None:
    found = target.at(START_NS + round(seconds * SECOND_NS), Clock.UTC)
    return None if found is None else found.magnitude_nt


@pytest.fixture(scope="module")
def orbit_field() -> tuple[np.ndarray, np.ndarray]:
    """Times [s] every 0.5 s over one orbit of the paper's scenario, and the field [nT] ECI (n, 3)."""
    simulation = Simulation(load_scenario("paper"), duration_s=5820.0)
    times_ns = simulation.times_ns(2.0)
    field = simulation.truth.field.true_eci_nt(simulation.truth.orbit, times_ns)
    return simulation.elapsed_s(times_ns), field


@pytest.mark.parametrize(("period_s", "bound_nt"), [(1, 0.04), (10, 4.0)])
def test_the_error_in_a_low_orbit_stays_within_the_stated_bound(
    orbit_field: tuple[np.ndarray, np.ndarray], period_s: int, bound_nt: float
) -> None:
    """Linear interpolation of IGRF-14 along 612 km: T^2/8 times 0.3 nT/s^2, as the module says."""
    times_s, field = orbit_field
    target, known = track(), 2 * period_s
    errors = []
    for row in range(0, len(times_s) - known, known):
        for at in (row, row + known):
            target.add(vector(times_s[at], tuple(field[at].tolist()), Frame.ECI))
        for at in range(row, row + known):
            found = target.at(START_NS + round(times_s[at] * SECOND_NS), Clock.UTC)
            assert found is not None
            assert found.field_eci_nt is not None
            errors.append(np.linalg.norm(np.array(found.field_eci_nt) - field[at]))
    assert 0.1 * bound_nt < max(errors) <= bound_nt


def test_a_reference_at_exactly_the_time_is_taken_as_it_is() -> None:
    target = track()
    target.add(reference(7))
    assert magnitude_at(target, 7) == 30_070.0


def test_nothing_is_extrapolated() -> None:
    target = track()
    for second in (0, 1):
        target.add(reference(second))
    assert (magnitude_at(target, -0.1), magnitude_at(target, 1.1)) == (None, None)


def test_an_inertial_vector_is_interpolated_as_a_vector() -> None:
    target = track()
    target.add(vector(0, (30_000.0, 0.0, 0.0), Frame.ECI))
    target.add(vector(1, (0.0, 30_000.0, 0.0), Frame.ECI))
    found = target.at(START_NS + SECOND_NS // 2, Clock.UTC)
    assert found is not None
    assert found.field_eci_nt == (15_000.0, 15_000.0, 0.0)
    assert found.magnitude_nt == pytest.approx(15_000.0 * math.sqrt(2.0))


@pytest.mark.parametrize("frame", [Frame.ECEF, Frame.NED])
def test_of_a_vector_in_turning_axes_the_magnitude_is_interpolated(frame: Frame) -> None:
    target = track()
    target.add(vector(0, (30_000.0, 0.0, 0.0), frame))
    target.add(vector(1, (0.0, 32_000.0, 0.0), frame))
    found = target.at(START_NS + SECOND_NS // 2, Clock.UTC)
    assert found is not None
    assert (found.magnitude_nt, found.field_eci_nt) == (31_000.0, None)


def test_between_a_vector_and_a_magnitude_the_magnitude_is_interpolated() -> None:
    target = track()
    target.add(vector(0, (30_000.0, 0.0, 0.0), Frame.ECI))
    target.add(ReferenceSample(craft="c", source="r", sequence=0, time_ns=START_NS + SECOND_NS, magnitude_nt=32_000.0))
    assert magnitude_at(target, 0.25) == 30_500.0


def test_two_references_too_far_apart_are_not_interpolated_between() -> None:
    target = track(max_gap_s=5.0)
    for second in (0, 5, 11):
        target.add(reference(second))
    assert (magnitude_at(target, 2), magnitude_at(target, 8)) == (30_020.0, None)


def test_the_order_in_which_references_come_does_not_matter() -> None:
    seconds = np.random.default_rng(5).permutation(29).tolist()
    target = track()
    for second in (29, *seconds):
        target.add(reference(second))
    assert [magnitude_at(target, at + 0.5) for at in range(29)] == [30_005.0 + 10.0 * at for at in range(29)]


def test_what_is_remembered_is_bounded() -> None:
    target = track()
    for second in range(10_000):
        target.add(reference(second))
    assert (magnitude_at(target, 1000.5), magnitude_at(target, 9000.5)) == (None, 120_005.0)


def test_forgetting_keeps_the_reference_before_the_time() -> None:
    target = track()
    for second in range(500):
        target.add(reference(second))
    target.discard_before(START_NS + 450 * SECOND_NS + 1)
    assert (magnitude_at(target, 321.5), magnitude_at(target, 450.5)) == (None, 34_505.0)


def test_a_history_sent_again_is_known_and_no_step_of_the_clock() -> None:
    """The 100 references before the newest, 30 s of which would be too far behind for new ones."""
    counters: Counter[str] = Counter()
    target = ReferenceTrack(10 * SECOND_NS, counters, 30 * SECOND_NS, 600 * SECOND_NS)
    for second in (*range(200), *range(100, 200), 200):
        target.add(reference(second))
    assert (counters["reference"], counters["reference_doubled"], counters["reference_step"]) == (201, 100, 0)


def test_while_a_step_of_the_clock_is_in_the_air_no_reference_is_given() -> None:
    """The old track's reference at the new label belongs to another place of the orbit."""
    target = track()
    for second in range(100):
        target.add(reference(second))
    target.add(replace(reference(50), field_nt=(0.0, 0.0, 40_000.0)))
    assert (magnitude_at(target, 49.5), target.covers(START_NS + 50 * SECOND_NS, Clock.UTC)) == (None, False)


@pytest.mark.parametrize(("seconds", "due_s"), [((0,), 10.0), ((0, 1), 2.0), ((0, 4), 8.0), ((0, 300), 310.0)])
def test_the_next_reference_is_due_by_the_pace_of_the_last_two(seconds: tuple[int, ...], due_s: float) -> None:
    target = track(max_gap_s=10.0)
    for second in seconds:
        target.add(reference(second))
    assert target.due_ns(Clock.UTC) == START_NS + round(due_s * SECOND_NS)


def test_on_another_clock_no_reference_is_due() -> None:
    target = track()
    target.add(reference(0))
    assert target.due_ns(Clock.ELAPSED) is None
