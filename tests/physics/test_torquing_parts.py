"""Patterns of torquers that nobody recorded, sample by sample as their controllers would make them."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from magcal_service.model import Array
from magcal_service.physics.catalogue import effect_named
from magcal_service.physics.columns import Columns
from magcal_service.physics.drivers import duty, torquing
from magcal_service.physics.interface import Hypothesis
from magcal_service.physics.scene.scene import Scene
from magcal_service.physics.segments import Segments, Sums

PERIOD_S, COUNT = 2.0, 600
TIME_S = PERIOD_S * np.arange(float(COUNT))


def course() -> Array:
    """A field (n, 3) that swings on every axis with a period of its own."""
    return 30e3 * np.stack([np.sin(TIME_S / 37.0), np.cos(TIME_S / 53.0), np.sin(TIME_S / 29.0 + 1.0)], axis=1)


def flown(count: int = COUNT, period_s: float = PERIOD_S) -> Scene:
    field = course()[:count]
    time_s = period_s * np.arange(float(count))
    return Scene(time_s, 0, False, field, field, field, np.linalg.norm(field, axis=1))


def form(variant: str, of: Scene | None = None) -> Hypothesis:
    return next(h for h in effect_named("torquer").hypotheses(of or flown()) if h.variant == variant)


def field_of(hypothesis: Hypothesis, matrix: Array, *theta: float) -> Array:
    return hypothesis.columns(np.array(theta)).field(matrix.reshape(-1))


MATRIX = np.arange(1.0, 10.0).reshape(3, 3)


@pytest.mark.parametrize(
    ("count", "period_s", "offered"), [(200, 2.0, True), (199, 2.0, False), (300, 20.0, True), (300, 20.1, False)]
)
def test_patterns_need_two_hundred_samples_no_more_than_twenty_seconds_apart(
    count: int, period_s: float, offered: bool
) -> None:
    found = [h for h in effect_named("torquer").hypotheses(flown(count, period_s)) if h.driver.startswith("inferred")]
    assert bool(found) is offered
    given = replace(flown(count, period_s), given={})
    assert [h for h in effect_named("torquer").hypotheses(given) if h.driver.startswith("inferred")]


def test_detumbling_without_end_is_against_the_sign_of_the_slope() -> None:
    slope = np.gradient(course(), TIME_S, axis=0)
    assert field_of(form("sign of dB/dt"), MATRIX) == pytest.approx(-np.sign(slope) @ MATRIX)
    assert form("sign of dB/dt").odds == 6.0


@pytest.mark.parametrize(
    ("cycle_s", "share", "phase", "lead_s"), [(20.0, 0.5, 0.0, 0.0), (20.0, 0.3, 0.25, 4.0), (30.0, 0.75, 0.5, 2.0)]
)
def test_detumbling_fires_for_a_share_of_each_cycle_by_the_slope_seen_before_it(
    cycle_s: float, share: float, phase: float, lead_s: float
) -> None:
    """From one instant to another; the slope is that of the first sample no earlier than the lead before the cycle."""
    first_s, last_s = 200.0, 900.0
    slope = np.gradient(course(), TIME_S, axis=0)
    expected = np.zeros((COUNT, 3))
    for row, now_s in enumerate(TIME_S.tolist()):
        cycle = math.floor(now_s / cycle_s - phase)
        into = now_s / cycle_s - phase - cycle
        seen_s = (cycle + phase) * cycle_s - lead_s
        seen = next((number for number, at_s in enumerate(TIME_S) if at_s >= seen_s - 0.5 * PERIOD_S), COUNT - 1)
        if into < share and first_s <= now_s < last_s:
            expected[row] = -np.sign(slope[seen]) @ MATRIX
    found = field_of(form("sign of dB/dt on a duty"), MATRIX, cycle_s, share, phase, lead_s, first_s, last_s)
    assert found == pytest.approx(expected)


def test_detumbling_is_searched_by_cycles_phases_shares_and_parts() -> None:
    hypothesis = form("sign of dB/dt on a duty")
    grids = {number.name: number.grid for number in hypothesis.nonlinear}
    assert grids["period_s"] == pytest.approx(2.0 * torquing.CYCLES_S)
    assert form("sign of dB/dt on a duty", flown(COUNT, 0.5)).nonlinear[0].grid == pytest.approx(torquing.CYCLES_S)
    assert grids["on_share"].tolist() == [0.3, 0.5, 0.75]
    assert grids["phase"] == pytest.approx(np.arange(8) / 8.0)
    assert grids["lead_s"].tolist() == [0.0, 0.5, 1.0, 2.0, 4.0]
    edges = np.linspace(0.0, TIME_S[-1], 25)
    assert grids["from_s"] == pytest.approx(edges[:-1])
    assert grids["to_s"] == pytest.approx([*edges[1:-1], TIME_S[-1] + PERIOD_S])
    assert {number.role for number in hypothesis.nonlinear} == {"held"}
    assert (hypothesis.odds, hypothesis.largest_nt) == (7.0, 5000.0)


def test_parts_are_all_stretches_of_seven_and_more() -> None:
    parts = torquing._parts()
    assert parts.shape == (171, 24)
    assert len({tuple(part) for part in parts.tolist()}) == 171
    for part in parts:
        used = np.flatnonzero(part)
        assert len(used) >= 7
        assert np.array_equal(used, np.arange(used[0], used[-1] + 1))
        assert set(part) <= {0.0, 1.0}


@pytest.mark.parametrize(
    ("interval_s", "share", "phase", "hold_s"),
    [(300.0, 0.25, 0.0, None), (300.0, 0.2, 0.4, 10.0), (400.0, 0.3, 0.9, 5.0)],
)
def test_dumping_follows_the_field_or_holds_it_for_a_while(
    interval_s: float, share: float, phase: float, hold_s: float | None
) -> None:
    """Intervals count from the middle of the recording; a held dipole is that of the beginning of its hold."""
    numbers = [interval_s, share, phase] + ([] if hold_s is None else [hold_s])
    hypothesis = form("momentum dumped at intervals, " + ("in any direction" if hold_s is None else "held"))
    middle_s = 0.5 * TIME_S[-1]
    assert hypothesis.constants == {"middle_s": middle_s}
    expected = np.zeros((COUNT, 3))
    for row, now_s in enumerate(TIME_S.tolist()):
        into_s = ((now_s - middle_s) / interval_s - phase) % 1.0 * interval_s
        made_s = now_s - into_s % hold_s if hold_s else now_s
        made = next(number for number, at_s in enumerate(TIME_S) if at_s >= made_s - 0.5 * PERIOD_S)
        if into_s / interval_s < share:
            expected[row] = course()[min(made, row)] @ MATRIX
    assert field_of(hypothesis, MATRIX, *numbers) == pytest.approx(expected)
    if hold_s is None:
        symmetric = 0.5 * (MATRIX + MATRIX.T)[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
        found = field_of(form("momentum dumped at intervals"), symmetric, *numbers)
        assert (found * course()).sum(axis=1) == pytest.approx((expected * course()).sum(axis=1))


def test_dumping_is_searched_by_intervals_slots_and_holds() -> None:
    held = "momentum dumped at intervals, held"
    grids = {number.name: number.grid for number in form(held).nonlinear}
    assert grids["on_share"] == pytest.approx(np.array([3, 5, 7, 10]) / 24.0)
    assert grids["phase"] == pytest.approx(np.arange(24) / 24.0)
    assert grids["hold_s"].tolist() == [4.0, 5.0, 10.0]  # longer than a sample
    slow = {number.name: number.grid for number in form(held, flown(COUNT, 6.0)).nonlinear}
    assert slow["hold_s"].tolist() == [10.0]
    assert grids["period_s"] == pytest.approx(torquing._intervals(TIME_S[-1]))


@pytest.mark.parametrize(("count", "offered"), [(376, True), (375, False)])
def test_dumping_needs_three_of_its_shortest_intervals(count: int, offered: bool) -> None:
    variants = [h.variant for h in effect_named("torquer").hypotheses(flown(count))]
    assert ("momentum dumped at intervals" in variants) is offered


@pytest.mark.parametrize(("span_s", "last_s"), [(3000.0, 1000.0), (9000.0, 1600.0)])
def test_intervals_rise_by_an_eighth_of_a_turn_over_the_recording(span_s: float, last_s: float) -> None:
    """From 250 s, each so near the one before that both ends differ by 0.12 of an interval, to a third of the span."""
    found = torquing._intervals(span_s)
    assert float(found[0]) == 250.0
    assert found[1:] / found[:-1] - 1.0 == pytest.approx(0.12 * found[:-1] / span_s)
    assert found[-2] < last_s <= found[-1]


def test_slots_that_are_on_go_round_the_interval() -> None:
    assert torquing._ON.shape == (96, 24)
    for (share, slot), row in zip(torquing._ON_NUMBERS, torquing._ON, strict=True):
        assert sorted(np.flatnonzero(row)) == sorted((slot + number) % 24 for number in range(share))
    assert torquing._ON_NUMBERS[:2] == [(3, 0), (3, 1)]


# Proposals


def sums_of(residual_nt: Array) -> Sums:
    """Sums over stretches of samples for a residual (n, 3) of vectors with nothing else in the model."""

    def sums(columns: Columns, firsts: NDArray[np.intp]) -> Segments:
        rows = columns.components()
        rows = rows / np.maximum(np.sqrt(np.mean(rows**2, axis=0)), 1e-12)
        ends = np.append(firsts[1:], COUNT)
        parts = [slice(3 * first, 3 * end) for first, end in zip(firsts.tolist(), ends.tolist(), strict=True)]
        right = residual_nt.reshape(-1)
        return Segments(
            np.stack([rows[part].T @ rows[part] for part in parts]),
            np.zeros((len(parts), 0, rows.shape[1])),
            np.stack([rows[part].T @ right[part] for part in parts]),
            float(right @ right),
            len(right),
        )

    return sums


def proposed(hypothesis: Hypothesis, *theta: float, amplitude: float) -> Array:
    """What is proposed for a pattern with these numbers under noise of a tenth of its field."""
    assert hypothesis.proposals is not None
    field = field_of(hypothesis, amplitude * np.eye(3), *theta)
    noise = np.random.default_rng(3).normal(0.0, 0.1 * np.sqrt(np.mean(field**2)), field.shape)
    return hypothesis.proposals(sums_of(field + noise), [number.grid for number in hypothesis.nonlinear])


@pytest.mark.parametrize(
    ("cycle_s", "share", "phase", "first", "last"), [(20.0, 0.5, 0.25, 5, 14), (40.0, 0.3, 0.5, 0, 9)]
)
def test_detumbling_for_a_while_is_proposed_first_with_its_numbers(
    cycle_s: float, share: float, phase: float, first: int, last: int
) -> None:
    """And once more over the whole recording; each of the six best so."""
    edges = [*np.linspace(0.0, TIME_S[-1], 25)[:-1], TIME_S[-1] + PERIOD_S]
    numbers = (cycle_s, share, phase, 0.5, edges[first], edges[last + 1])
    found = proposed(form("sign of dB/dt on a duty"), *numbers, amplitude=100.0)
    assert found.shape == (12, 6)
    assert found[0] == pytest.approx(numbers)
    assert found[1] == pytest.approx([*numbers[:4], 0.0, edges[-1]])


@pytest.mark.parametrize(("share", "phase"), [(0.35, 0.79), (0.1, 0.03), (0.5, 0.5)])
@pytest.mark.parametrize("off", [-0.45, 0.0, 0.3])
def test_a_duty_is_proposed_first_from_a_line_that_is_a_part_of_a_width_off(
    off: float, share: float, phase: float
) -> None:
    """Its period to an eighth of 1 / duration, and its share and phase to the width of a slot, of 48 s cycles."""
    period_s, hypothesis = 48.0, form("regular duty")
    on = field_of(hypothesis, np.array([300.0, -200.0, 100.0]), period_s, share, phase)
    noise = np.random.default_rng(9051).normal(0.0, 50.0, on.shape)
    line_s = 1.0 / (1.0 / period_s + off / TIME_S[-1])
    assert hypothesis.proposals is not None
    found = hypothesis.proposals(
        sums_of(on + noise), [np.array([line_s, 31.0]), *(n.grid for n in hypothesis.nonlinear[1:])]
    )
    again = field_of(hypothesis, np.array([300.0, -200.0, 100.0]), *found[0].tolist())
    assert 1.0 / found[0][0] == pytest.approx(1.0 / period_s, abs=0.13 / TIME_S[-1])
    assert float(np.mean((again - on) ** 2)) < 0.2 * float(np.mean(on**2))


@pytest.mark.parametrize(("step", "slot", "length"), [(2, 6, 5), (0, 20, 7)])
def test_dumping_is_proposed_first_at_its_interval_with_every_hold(step: int, slot: int, length: int) -> None:
    hypothesis = form("momentum dumped at intervals, held")
    intervals, _, _, holds = (number.grid for number in hypothesis.nonlinear)
    numbers = (float(intervals[step]), length / 24.0, slot / 24.0, float(holds[0]))
    found = proposed(hypothesis, *numbers, amplitude=0.01)
    assert found.shape == (6 * len(holds), 4)
    best = found[: len(holds)]
    assert best[:, 3] == pytest.approx(holds)
    assert np.ptp(best[:, :3], axis=0) == pytest.approx(0.0)
    assert best[0, :3] == pytest.approx(numbers[:3])
    assert len(set(found[:, 0].tolist())) == 6


@pytest.mark.parametrize("later_s", [4_000.0, 350_000.0])
def test_intervals_without_samples_take_no_place_among_the_sums(later_s: float) -> None:
    """Two passes an hour or four days apart: every sample is in one interval, and none of those between is kept."""
    times = np.concatenate([100.0 + TIME_S, later_s + TIME_S])
    cuts = duty.cuts(times, 20.0)
    assert len(cuts) == 60 + 60
    assert cuts[0, 0] == 0
    assert cuts[-1, -1] == len(times)
    assert (cuts[1:, 0] == cuts[:-1, -1]).all()
    interval = np.repeat(np.arange(len(cuts)), cuts[:, -1] - cuts[:, 0])
    assert np.floor(times / 20.0) == pytest.approx(np.floor(times[cuts[interval, 0]] / 20.0))


def test_a_strong_duty_is_proposed_with_its_edges_between_the_same_samples() -> None:
    """Cycle, share and phase between those that are tried: of 600 rows hardly one is taken for on that is off, or the
    other way."""
    hypothesis, numbers = form("regular duty"), (47.3, 0.37, 0.713)
    assert hypothesis.proposals is not None
    field = field_of(hypothesis, np.array([300.0, -200.0, 100.0]), *numbers)
    noise = np.random.default_rng(8).normal(0.0, 60.0, field.shape)
    tried = hypothesis.proposals(
        sums_of(field + noise), [np.array([47.5]), *(n.grid for n in hypothesis.nonlinear[1:])]
    )
    on, truly = (field_of(hypothesis, np.ones(3), *each)[:, 0] for each in (tried[0], numbers))
    assert int(np.sum(on != truly)) <= 3
    by_slots = field_of(hypothesis, np.ones(3), *tried[1])[:, 0]
    assert int(np.sum(by_slots != truly)) > 10
