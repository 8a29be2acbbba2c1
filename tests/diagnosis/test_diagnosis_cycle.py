"""Courses that repeat: their cuts against every one, found with their period, absent from noise, tones and duties."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from magcal_service.diagnosis import cycle as module
from magcal_service.diagnosis import result
from magcal_service.diagnosis.cycle import CYCLE, Cycle, cycle
from magcal_service.diagnosis.explain import Explained, Search
from magcal_service.diagnosis.leftover import Structure, structures
from magcal_service.diagnosis.lines import body_spectrum
from magcal_service.diagnosis.nameless import standing
from magcal_service.diagnosis.problem import Problem
from magcal_service.diagnosis.screen import hypotheses_of
from magcal_service.diagnosis.solution import solve
from magcal_service.diagnosis.wander import TWO_LEVELS
from magcal_service.model import Array
from magcal_service.physics.catalogue import catalogue, effect_named
from tests.diagnosis.made_up import FLOOR_NT, TIME_S, flown
from tests.physics.scenes import COUNT, NOISE_NT, RATE_RAD_S, X, scene

SPIN_HZ = RATE_RAD_S / (2.0 * math.pi)
PERIOD_S = 263.0
LEVELS = np.random.default_rng(9161).normal(size=(5, 3))
EDGES = np.array([0.13, 0.38, 0.61, 0.86])


def share(period_s: float = PERIOD_S) -> Array:
    """(n,) how much of its cycle each sample has behind it."""
    return np.mod(TIME_S / period_s + 0.2, 1.0)


def stairs(size_nt: float) -> Array:
    """(n, 3) five levels of unequal length, in directions that differ, over and over."""
    return size_nt * LEVELS[np.searchsorted(EDGES, share())]


def saw(size_nt: float) -> Array:
    """(n, 3) a field in a fixed direction that grows and falls back."""
    return size_nt * np.outer(2.0 * share() - 1.0, [0.6, -0.64, 0.48])


def duty(size_nt: float) -> Array:
    """(n, 3) a field in a fixed direction that is on for a third of each cycle."""
    return size_nt * np.outer(share() < 0.33, [0.6, -0.64, 0.48])


def tone(size_nt: float) -> Array:
    """(n, 3) a line, elliptical in the body."""
    angle = 2.0 * np.pi * TIME_S / PERIOD_S
    return size_nt * (np.outer(np.cos(angle), [0.6, -0.64, 0.48]) + np.outer(np.sin(angle), [0.1, 0.3, -0.5]))


def bent_tone(size_nt: float) -> Array:
    """(n, 3) the same with a second wave of a quarter of its size, as a wheel's."""
    angle = 2.0 * np.pi * TIME_S / PERIOD_S
    return tone(size_nt) + 0.25 * size_nt * np.outer(np.cos(2.0 * angle + 0.5), [0.2, 0.7, 0.5])


def soft_duty(size_nt: float) -> Array:
    """(n, 3) a duty whose field comes and goes within 8 s, a tenth of its pulse."""
    since_s, pulse_s = share() * PERIOD_S, 0.33 * PERIOD_S
    begin, end = np.exp(-since_s / 8.0), np.exp(-(since_s - pulse_s) / 8.0)
    return size_nt * np.outer(np.where(since_s < pulse_s, 1.0 - begin, end), [0.6, -0.64, 0.48])


def found_in(field_nt: Array, seed: int = 0) -> Cycle | None:
    """In what a field (n, 3) and unit noise add to the magnitude."""
    unit = scene().unit
    residual = np.random.default_rng([9162, seed]).normal(size=COUNT) + np.einsum("ni,ni->n", field_nt, unit)
    return cycle(scene(), unit, residual, body_spectrum(scene(), residual, unit), 1.0, SPIN_HZ)


def stands(field_nt: Array) -> tuple[Explained, list[Structure]]:
    """Which of tones and torquers stand on a craft with this field, and what is left then."""
    effects = [effect_named("tone"), effect_named("torquer")]
    problem = Problem(flown(field_nt), NOISE_NT)
    search = Search(problem, hypotheses_of(effects, problem), effects, spin_hz=SPIN_HZ)
    baseline = search.refreshed(solve(problem, X))
    explained = search.run(baseline, FLOOR_NT)
    explained = standing(search, baseline, explained, None, FLOOR_NT, is_left=False)
    return explained, structures(search, explained.fit, None, FLOOR_NT)


def test_the_cuts_are_the_best_of_all(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a cycle of seven places every set of cuts is evaluated."""
    monkeypatch.setattr(module, "_SLOTS", 7)
    for seed in range(6):
        rng = np.random.default_rng([9163, seed])
        rows = rng.normal(size=(70, 3))
        slot: NDArray[np.intp] = np.arange(70) % 7
        shown = rows @ (1.5 * rng.normal(size=3)) * (slot < 3) + rng.normal(size=70)
        sums = module._sums(70, rows, shown)
        folded = np.stack([sums[slot == place].sum(axis=0) for place in range(7)])

        def evidence(cuts: tuple[int, ...], folded: Array = folded) -> float:
            ends = (*cuts[1:], cuts[0] + 7)
            parts = [folded[np.arange(first, end) % 7].sum(axis=0) for first, end in zip(cuts, ends, strict=True)]
            return float(module._nats(np.stack(parts), np.array([1.2])).sum()) - len(cuts) * math.log(7)

        every = [cuts for count in range(1, 8) for cuts in itertools.combinations(range(7), count)]
        best = max(every, key=evidence)
        nats, level = module._cut(folded, 1.2)
        assert nats == pytest.approx(evidence(best), abs=1e-9)
        if len(best) > 1:
            assert tuple(np.flatnonzero(level != np.roll(level, 1))) == best


def test_a_stretchs_evidence_is_that_of_a_normal_distribution() -> None:
    """Of samples whose noise and field are normal: their density with the field over that without."""
    rng = np.random.default_rng(9164)
    rows, shown = rng.normal(size=(9, 3)), rng.normal(size=9)
    whole = np.eye(9) + 0.49 * rows @ rows.T
    ratio = 0.5 * (shown @ shown - shown @ np.linalg.solve(whole, shown) - np.linalg.slogdet(whole)[1])
    sums = module._sums(9, rows, shown).sum(axis=0)
    assert module._nats(sums, np.array([0.7]))[0] == pytest.approx(ratio, abs=1e-9)


def test_levels_are_found_with_their_period_and_their_number() -> None:
    found = found_in(stairs(0.8))
    assert found is not None
    assert found.period_s == pytest.approx(PERIOD_S, rel=2e-3)
    assert found.levels.count == 5
    assert found.says == f"a body-fixed field that repeats every {found.period_s:.4g} s, in 5 levels"
    truth = np.searchsorted(EDGES, share()) % 5
    together = np.histogram2d(found.levels.number, truth, bins=(5, 5))[0]
    assert together.max(axis=1).sum() > 0.95 * COUNT


def test_a_saw_tooth_is_found_with_its_period() -> None:
    found = found_in(saw(3.0))
    assert found is not None
    assert found.period_s == pytest.approx(PERIOD_S, rel=2e-3)


def test_a_course_as_slow_as_the_spin_is_the_attitudes() -> None:
    """A wave of the spin's rate, and what has that as its second, repeat with the craft's own turn."""
    turns = SPIN_HZ * TIME_S
    for waves in (1, 2):
        found = found_in(3.0 * LEVELS[np.searchsorted(EDGES, np.mod(turns / waves, 1.0))])
        of_spin = 0.0 if found is None else SPIN_HZ * found.period_s
        assert abs(of_spin - waves) > 0.01


@pytest.mark.parametrize("field_nt", [stairs(60.0), stairs(600.0), saw(150.0), saw(600.0)])
def test_what_repeats_in_another_shape_is_no_tone_and_no_duty(field_nt: Array) -> None:
    """Five levels, and a saw tooth, which is nearly a duty with a tone of its second wave: no name, and the best of
    what is left is what it is."""
    explained, left = stands(field_nt)
    assert explained.fit.terms == ()
    assert left[0].shape.name == CYCLE
    assert float(left[0].shape.says.partition("repeats every ")[2].split(" ")[0]) == pytest.approx(PERIOD_S, rel=1e-3)


@pytest.mark.parametrize("size_nt", [40.0, 300.0])
@pytest.mark.parametrize(("make", "name"), [(tone, "tone"), (duty, "torquer")])
def test_a_tone_and_a_duty_stay_what_they_are(make: Callable[[float], Array], name: str, size_nt: float) -> None:
    """And beside the name nothing repeats any more."""
    explained, left = stands(make(1.5 * size_nt))
    assert [term.hypothesis.effect for term in explained.fit.terms] == [name]
    assert all(one.nats < 0.0 for one in left if one.shape.name == CYCLE)


@pytest.mark.parametrize(("field_nt", "name"), [(bent_tone(200.0), "tone"), (soft_duty(300.0), "torquer")])
def test_what_hardly_bends_a_tone_or_a_duty_is_told_beside_it(field_nt: Array, name: str) -> None:
    explained, _ = stands(field_nt)
    assert [term.hypothesis.effect for term in explained.fit.terms] == [name]


def test_noise_does_not_repeat() -> None:
    for seed in range(3):
        explained, left = stands(10.0 * np.random.default_rng([9165, seed]).normal(size=(COUNT, 3)))
        assert explained.fit.terms == ()
        assert all(one.nats < 0.0 for one in left if one.shape.name == CYCLE)


@pytest.mark.parametrize(("name", "tones"), [(CYCLE, True), (TWO_LEVELS, False)])
def test_what_repeats_may_be_several_tones_or_what_nobody_recorded(name: str, tones: bool) -> None:
    """Two lines repeat as their common period does; what goes between two levels has no line."""
    inspection, left = SimpleNamespace(open=()), [SimpleNamespace(shape=SimpleNamespace(name=name))]
    fit = SimpleNamespace(terms=())
    of: Any = SimpleNamespace(inspection=inspection, left=left, fit=fit, effects=catalogue())
    assert ("tone" in result._unrecorded(of)) is tones
    assert {"bias_step", "current_loop", "torquer"} <= set(result._unrecorded(of))
