"""A diagnosis as entries: numbers by name with their sigmas, where a signal lies, and what is said of the rest."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from magcal_service.diagnosis import nearest
from magcal_service.diagnosis.content import as_json
from magcal_service.diagnosis.diagnose import Verdict
from magcal_service.diagnosis.entry import plain
from magcal_service.diagnosis.explain import Explained, Search
from magcal_service.diagnosis.leftover import structures
from magcal_service.diagnosis.linear import Gain
from magcal_service.diagnosis.misled import Misled
from magcal_service.diagnosis.nearest import Nearest
from magcal_service.diagnosis.parameters import _instant_sigma, parameters_of
from magcal_service.diagnosis.prepare import Form
from magcal_service.diagnosis.problem import Fit, Problem, Term
from magcal_service.diagnosis.result import entries, held_out_rms, moved_bias
from magcal_service.diagnosis.screen import Candidate
from magcal_service.diagnosis.solution import solve
from magcal_service.diagnosis.where import direction, lines, span
from magcal_service.model import Array, d_matrix
from magcal_service.physics.catalogue import catalogue, effect_named
from magcal_service.physics.columns import Columns, along_axes
from magcal_service.physics.held import HeldAt
from magcal_service.physics.interface import Block, Finding, Hypothesis, Nonlinear, value_of
from magcal_service.recordings.inspect.account import Account
from tests.diagnosis.made_up import (
    FLOOR_NT,
    OTHER,
    QUICK,
    SLOW,
    TIME_S,
    along,
    body_form,
    flown,
    grown_form,
    searching,
)
from tests.physics.scenes import COUNT, NOISE_NT, PERIOD_S, X, scene


def test_numbers_are_plain_and_what_is_none_is_null() -> None:
    assert plain(np.float64(2.5)) == 2.5
    assert plain(np.float64(np.nan)) is None
    assert plain(np.array([[1.0, np.inf], [3.0, 4.0]])) == [[1.0, None], [3.0, 4.0]]


# Where a signal lies


def timed(times_s: Array) -> Fit:
    return SimpleNamespace(problem=SimpleNamespace(row_time_s=times_s))  # type: ignore[return-value]


def test_a_signal_lies_where_all_but_a_thousandth_of_its_squares_are_on_either_side() -> None:
    times = 10.0 * np.arange(100.0)
    signal = np.zeros(100)
    signal[30:61] = 1.0
    assert span(timed(times), signal) == [300.0, 600.0]
    signal[20] = signal[70] = math.sqrt(31.0 * 0.0009)
    assert span(timed(times), signal) == [300.0, 600.0]
    signal[20] = signal[70] = math.sqrt(31.0 * 0.0012)
    assert span(timed(times), signal) == [200.0, 700.0]


def test_what_begins_within_the_first_fiftieth_begins_at_nought() -> None:
    times = 10.0 * np.arange(101.0)
    for first, begins in ((1, 0.0), (2, 20.0), (3, 30.0)):
        signal = np.zeros(101)
        signal[first:] = 1.0
        assert span(timed(times), signal) == [begins, 1000.0]
    assert span(timed(times), np.zeros(101)) == [0.0, 1000.0]
    assert span(timed(times + 0.04), np.ones(101)) == [0.0, 1000.0]


def term_of(form: Hypothesis, *amplitudes: float) -> Term:
    return Term(form, np.zeros(0), np.array(amplitudes))


def test_a_direction_is_that_of_what_changes_with_its_largest_part_positive() -> None:
    swing = np.outer(QUICK, [0.0, 0.6, 0.8])
    moving = body_form("one", "", swing + np.array([500.0, 0.0, 0.0]))
    assert direction(term_of(moving, 3.0), COUNT) == [0.0, 0.6, 0.8]
    assert direction(term_of(moving, -3.0), COUNT) == [0.0, 0.6, 0.8]
    against = body_form("one", "", np.outer(QUICK, [0.28, -0.96, 0.0]))
    assert direction(term_of(against, 1.0), COUNT) == [-0.28, 0.96, 0.0]
    constant = body_form("one", "", np.tile([0.0, -30.0, 40.0], (COUNT, 1)))
    assert direction(term_of(constant, 2.0), COUNT) == [0.0, -0.6, 0.8]
    assert direction(term_of(grown_form(QUICK), 2.0), COUNT) is None


def test_a_constant_with_next_to_no_change_has_its_own_direction() -> None:
    still = np.tile([30.0, 0.0, 0.0], (COUNT, 1))
    for ripple, axis in ((0.02, [1.0, 0.0, 0.0]), (0.08, [0.0, 1.0, 0.0])):
        form = body_form("one", "", still + along(1, ripple * np.sqrt(2.0) * QUICK))
        assert direction(term_of(form, 1.0), COUNT) == axis


def test_the_strongest_lines_of_a_signal_are_told() -> None:
    """The second where its power is more than a quarter of the first's; never the mean."""
    fit: Any = SimpleNamespace(problem=SimpleNamespace(scene=scene(), is_vector=False))
    bins = 1.0 / (COUNT * PERIOD_S)
    first, second = np.sin(2 * np.pi * 40 * bins * TIME_S), np.cos(2 * np.pi * 90 * bins * TIME_S)
    for share, wanted in ((0.49, [40]), (0.51, [40, 90]), (2.1, [90])):
        found = lines(fit, 7.0 + first + share * second)
        assert found == [float(f"{line * bins:.4g}") for line in wanted]
    assert lines(fit, first + second + np.sin(2 * np.pi * 150 * bins * TIME_S)) != []
    fit.problem.is_vector = True
    assert lines(fit, first) == []


@pytest.mark.parametrize(("count", "told"), [(15, 0), (16, 1)])
def test_lines_need_sixteen_samples(count: int, told: int) -> None:
    short = SimpleNamespace(time_s=np.arange(float(count)), period_s=1.0)
    fit: Any = SimpleNamespace(problem=SimpleNamespace(scene=short, is_vector=False))
    assert len(lines(fit, np.sin(2 * np.pi * np.arange(count) / 4.0))) == told


# Parameters


def numbered(*names: tuple[str, str], most: float = 5000.0) -> Hypothesis:
    """Two blocks, and nonlinear numbers of these names and roles."""
    return Hypothesis(
        "one",
        "none",
        lambda _: along_axes(np.zeros((COUNT, 4))),
        (Block("matrix", "nT", (2, 3)), Block("vector", "1/K"), Block("one", "s", ())),
        nonlinear=tuple(Nonlinear(name, "s", np.array([1.0, most]), role) for name, role in names),
        constants={"zero_degc": 20.0, "held_s": 7.0},
    )


def test_a_number_is_off_by_no_more_than_it_was_searched_over() -> None:
    form = numbered(("a_s", ""), most=3.0)
    term = Term(form, np.array([2.5]), np.arange(10.0))
    fit: Any = SimpleNamespace(
        terms=[term], covariance=np.diag(np.full(20, 1e12)), problem=SimpleNamespace(size=9), linear_size=19
    )
    assert float(parameters_of(fit, 0, effect_named("bias_drift"))["a_s"].sigma) == 2.0


def test_parameters_are_taken_from_their_places_with_their_sigmas() -> None:
    """Amplitudes of the second term stand behind those of the first; its free numbers behind the first's."""
    first, second = numbered(("a_s", "")), numbered(("held_s", "held"), ("b_s", ""), ("c_s", "frequency"))
    terms = [
        Term(first, np.array([5.0]), np.arange(10.0)),
        Term(second, np.array([1.0, 2.0, 3.0]), 100.0 + np.arange(10.0)),
    ]
    sigmas = np.arange(9 + 20 + 3) + 1000.0
    fit: Any = SimpleNamespace(
        terms=terms, covariance=np.diag(sigmas**2), problem=SimpleNamespace(size=9), linear_size=29
    )
    effect = replace(
        effect_named("bias_drift"),
        units={"zero_degc": "degC"},
        derived=lambda found: {"double": value_of(2.0 * found["one"].value, np.nan, "s")},
    )
    found = parameters_of(fit, 1, effect)
    assert found["matrix"].value.tolist() == [[100.0, 101.0, 102.0], [103.0, 104.0, 105.0]]
    assert found["matrix"].sigma == pytest.approx(1019.0 + np.arange(6.0).reshape(2, 3))
    assert found["vector"].value.tolist() == [106.0, 107.0, 108.0]
    assert found["vector"].sigma == pytest.approx([1025.0, 1026.0, 1027.0])
    assert (float(found["one"].value), float(found["one"].sigma)) == pytest.approx((109.0, 1028.0))
    assert [float(found[name].value) for name in ("held_s", "b_s", "c_s")] == [1.0, 2.0, 3.0]
    assert math.isnan(float(found["held_s"].sigma))
    assert [float(found[name].sigma) for name in ("b_s", "c_s")] == pytest.approx([1030.0, 1031.0])
    assert (float(found["zero_degc"].value), found["zero_degc"].unit) == (20.0, "degC")
    assert float(found["double"].value) == 218.0
    assert [value.unit for value in found.values()][:3] == ["nT", "1/K", "s"]


def jumping(course: Array, residual: Array) -> Callable[[float, float], float]:
    """Sigma of a jump's instant by its time and size, where it shows as ``course`` (n,), beside a residual (n,)."""
    form = Hypothesis(
        "one",
        "none",
        lambda theta: Columns(magnitude=(course * (theta[0] <= TIME_S))[None]),
        (Block("nt", "nT", ()),),
        nonlinear=(Nonlinear("at_s", "s", TIME_S[::100], "instant"),),
    )

    def sigma(at_s: float, size_nt: float) -> float:
        term = Term(form, np.array([at_s]), np.array([size_nt]))
        fit = Fit(
            Problem(scene(), NOISE_NT), X, (term,), residual, np.zeros((COUNT, 0)), scene().unit, FIELD, np.zeros(0)
        )
        return _instant_sigma(fit, term, 0)

    return sigma


def test_an_instant_is_as_sure_as_its_likelihood_is_narrow() -> None:
    """Even over what shows nothing; exponential on either side where each sample says the same."""
    noise = 10.0 * (-1.0) ** np.arange(COUNT)
    blind = np.where((TIME_S > 3960.0) & (TIME_S < 4100.0), 0.0, 1.0)
    sigma = jumping(blind, noise)
    assert sigma(2002.0, 1000.0) == pytest.approx(PERIOD_S / math.sqrt(12.0))
    assert sigma(4030.0, 1000.0) == pytest.approx(70.0 / math.sqrt(3.0), rel=0.06)
    assert sigma(0.0, 1e-6) == pytest.approx(TIME_S[-1] / math.sqrt(3.0), rel=0.01)
    # costs of size^2 / 2 noise^2 a sample: a density of exp(-|k| / 25) in samples, by which sigma is 25 sqrt(2)
    assert sigma(2002.0, 10.0 * math.sqrt(2.0 / 25.0)) == pytest.approx(25.0 * math.sqrt(2.0) * PERIOD_S, rel=0.05)


def test_an_instant_errs_by_its_sigma() -> None:
    """In noise, at the likeliest instant of each draw: of 1500 draws 78 % are within one sigma, 90 % within two."""
    rng, size, jump_at = np.random.default_rng(97), 4.0, 1000
    distances = []
    for _ in range(200):
        data = 10.0 * rng.normal(size=COUNT) - size * (np.arange(COUNT) >= jump_at)
        # sum of (data + size)^2 over the rows after k: the likeliest k is where its cumulated excess is least
        excess = np.concatenate([np.cumsum(((data + size) ** 2 - data**2)[::-1])[::-1], [0.0]])
        row = int(np.argmin(excess[1:-1])) + 1
        at_s = 0.5 * float(TIME_S[row] + TIME_S[row - 1])
        sigma = jumping(np.ones(COUNT), data + size * (np.arange(COUNT) >= row))(at_s, size)
        distances.append(abs(at_s - 0.5 * float(TIME_S[jump_at] + TIME_S[jump_at - 1])) / sigma)
    assert 0.68 < float(np.mean(np.array(distances) < 1.0)) < 0.88
    assert float(np.mean(np.array(distances) < 2.0)) > 0.83


FIELD = scene().calibrated_nt


# A whole one


@cache
def made() -> Any:
    """A search that has found two causes, with as much around it as entries are made of."""
    forms = (
        body_form("one", "", along(0, SLOW)),
        body_form("near", "", along(0, np.sin(TIME_S / 690.0))),
        body_form("other", "", along(1, QUICK)),
        body_form("idle", "", along(2, OTHER)),
    )
    search, fit = searching(flown(along(0, 60.0 * SLOW) + along(1, 200.0 * QUICK)), *forms)
    explained = search.run(fit, FLOOR_NT)
    left = structures(search, explained.fit, None, FLOOR_NT)
    return SimpleNamespace(
        inspection=SimpleNamespace(open=(), findings=(), account_to_diagnose=Account(COUNT + 7, {"unreadable": 4})),
        search=search,
        explained=explained,
        fit=explained.fit,
        prepared=SimpleNamespace(
            baseline=fit,
            problem=search.problem,
            left_out={"spikes": 3},
            form=Form.SCALAR,
            sun=None,
            view=SimpleNamespace(stated_noise_nt=None),
        ),
        refused=(),
        modelled=None,
        findings={},
        left=tuple(left),
        unexplained=0.0,
        left_share=0.0123456,
        verdict=Verdict.NAMED,
        effects=tuple(search.effects),
        simulation_residual_nt=np.array([3.0, 4.0]),
        spin=None,
        seconds=1.234,
        trusted=True,
        reasons=(),
        concerned={},
        noise_nt=31.4,
        added_noise_nt=28.9,
        misled=Misled.of(fit, explained.fit),
        held_at=(HeldAt("channel:board", 21.5, "degC", "21.5 degC of channel board"),),
        memory_nt=None,
        has_simulation=False,
        whitening=np.zeros(0),
    )


def test_entries_come_by_the_share_that_they_explain() -> None:
    """Of the drop from the nine errors alone: each what its own columns take in the other's presence."""
    other, one = entries(made())
    assert (other.effect, one.effect) == ("other", "one")
    baseline, fit = made().prepared.baseline, made().fit
    drop = float(baseline.residual @ baseline.residual) - float(fit.residual @ fit.residual)
    for entry in (other, one):
        index = [term.hypothesis.effect for term in fit.terms].index(entry.effect)
        rest = [term for number, term in enumerate(fit.terms) if number != index]
        without = solve(made().search.problem, X, rest)
        own = float(without.residual @ without.residual) - float(fit.residual @ fit.residual)
        assert entry.where["share_of_mismatch"] == pytest.approx(own / drop, rel=0.05)
    assert other.where["axis"] == [0.0, 1.0, 0.0]
    assert one.where["axis"] == [1.0, 0.0, 0.0]
    assert one.where["time_s"][1] == pytest.approx(TIME_S[-1], abs=200.0)
    assert one.nats == pytest.approx(made().explained.nats[1])


LISTED = 0.97
"""Share of the probability that names have at the most where no recorded channel drives them."""


def test_probability_is_shared_with_rivals_by_their_evidence() -> None:
    _, one = entries(made())
    ranked = made().explained.rivals[1]
    nats = {candidate.hypothesis.effect: candidate.nats for candidate in ranked}
    odds = {name: math.exp(value - nats["one"]) for name, value in nats.items()}
    assert set(odds) >= {"one", "near"}
    assert one.probability == pytest.approx(LISTED / sum(odds.values()))
    rivals = dict(one.rivals)
    assert rivals["near"] == pytest.approx(LISTED * odds["near"] / sum(odds.values()))
    assert "one" not in rivals
    near = nats["near"] > nats["one"] - 3.0
    assert one.members == (("one", "near") if near else ("one",))


def candidates(**nats: float) -> tuple[Candidate, ...]:
    return tuple(
        Candidate(body_form(name, "", along(0, SLOW)), np.zeros(0), Gain(0.0, 0.0, 1.0, np.ones(1)), value)
        for name, value in nats.items()
    )


def with_rivals(ranked: tuple[Candidate, ...]) -> Any:
    base = made().explained
    rivals = (base.rivals[0], ranked)
    explained = Explained(made().fit, rivals, base.nats, base.gains)
    return SimpleNamespace(**{**vars(made()), "explained": explained})


def test_of_rivals_the_best_is_always_named_and_others_from_a_ten_thousandth_on() -> None:
    far = entries(with_rivals(candidates(one=50.0, near=20.0, idle=19.0)))[1]
    assert [name for name, _ in far.rivals] == ["unknown", "near"]
    assert far.rivals[1][1] == pytest.approx(LISTED * math.exp(-30.0))
    some = entries(with_rivals(candidates(one=50.0, near=41.0, idle=40.5)))[1]
    assert [name for name, _ in some.rivals] == ["unknown", "near"]
    more = entries(with_rivals(candidates(one=50.0, near=41.0, idle=40.9)))[1]
    assert [name for name, _ in more.rivals] == ["unknown", "near", "idle"]
    many = entries(with_rivals(candidates(one=50.0, a=49.0, b=48.0, c=47.5, d=46.0, e=45.0)))[1]
    assert [name for name, _ in many.rivals] == ["a", "b", "c", "unknown"]
    assert many.members == ("one", "a", "b", "c")
    alone = entries(with_rivals(candidates(one=50.0)))[1]
    assert (alone.rivals, alone.probability) == ((("unknown", pytest.approx(1.0 - LISTED)),), pytest.approx(LISTED))
    beyond = entries(with_rivals(candidates(near=2000.0, one=50.0)))[1]
    assert beyond.probability < 1e-300


def test_an_entry_that_is_no_rival_of_itself_counts_by_its_worth() -> None:
    """Where its own form was not looked at again, its evidence is that of the fit."""
    own = made().explained.nats[1]
    entry = entries(with_rivals(candidates(near=own - 1.0)))[1]
    assert entry.probability == pytest.approx(LISTED / (1.0 + math.exp(-1.0)))


def finding(nats: float, share: float, **parameters: Any) -> Finding:
    return Finding(parameters, nats, share)


def test_findings_follow_by_their_kind_samples_among_the_terms() -> None:
    """What shows in samples is sorted in by its share; attitude and noise come behind, by name."""
    axis = value_of([0.0, 1.0, 0.0], [0.0] * 3, "1")
    found = {
        "spin_rate": finding(20.0, 1.0, rate_rpm=value_of(2.0, 0.1, "rpm")),
        "nutation": finding(30.0, 0.5, frequency_hz=value_of(0.02, 1e-4, "Hz")),
        "coloured_noise": finding(20.0, 0.9),
        "stuck_axis": replace(finding(2.0, 0.30004, axis=axis), time_s=(10.0, 20.0)),
    }
    diagnosis = SimpleNamespace(**{**vars(made()), "findings": found, "effects": (*made().effects, *catalogue())})
    names = [entry.effect for entry in entries(diagnosis)]
    assert names == ["other", "stuck_axis", "one", "nutation", "spin_rate", "coloured_noise"]
    by_name = {entry.effect: entry for entry in entries(diagnosis)}
    stuck = by_name["stuck_axis"]
    assert stuck.where == {
        "time_s": [10.0, 20.0],
        "axis": [0.0, 1.0, 0.0],
        "frequency_hz": [],
        "share_of_mismatch": 0.3,
    }
    assert stuck.probability == pytest.approx(1.0 - math.exp(-2.0))
    assert (stuck.driver, stuck.members, stuck.rivals) == ("none", ("stuck_axis",), ())
    assert by_name["nutation"].where["frequency_hz"] == [0.02]
    assert by_name["nutation"].where["time_s"] == [0.0, TIME_S[-1]]
    assert by_name["nutation"].where["axis"] is None
    assert by_name["coloured_noise"].probability == pytest.approx(1.0 - math.exp(-20.0), abs=1e-12)


def unknown() -> Any:
    """A slow swing along z that no hypothesis but an idle one could have."""
    idle = body_form("idle", "", along(2, SLOW + 0.9 * OTHER))
    search, fit = searching(flown(along(2, 60.0 * SLOW)), idle)
    left = structures(search, fit, None, FLOOR_NT)
    explained = SimpleNamespace(fit=fit, rivals=(), nats=())
    return SimpleNamespace(
        **{
            **vars(made()),
            "search": search,
            "explained": explained,
            "fit": fit,
            "left": tuple(left),
            "unexplained": 0.81234,
            "verdict": Verdict.UNKNOWN,
            "prepared": SimpleNamespace(
                baseline=fit, problem=search.problem, left_out={}, form=Form.SCALAR, sun=None, spin=None
            ),
            "effects": tuple(search.effects),
        }
    )


def test_what_has_no_name_is_described_with_the_nearest_that_has() -> None:
    of = unknown()
    (entry,) = entries(of)
    near = Nearest.of(of)
    assert near is not None
    space = of.search.workspace(of.fit)
    rows = of.search.hypotheses[0].columns(np.zeros(0)).along(of.fit.unit)
    share = space.gain(rows, of.fit.rms_nt).squares / of.left[0].squares
    assert (near.effect, near.share) == ("idle", pytest.approx(share))
    assert 0.2 < share < 0.95
    shape = of.left[0].shape
    assert entry.says == (
        f"Something without a name is left, most like {shape.says}."
        f" Nearest is idle: it would take {100.0 * share:.0f} % of it, but shapes without a name do more in its place."
    )
    assert (entry.effect, entry.variant, entry.rivals) == ("unknown", shape.name, ())
    assert entry.where["share_of_mismatch"] == 0.8123
    assert entry.where["nearest"] == {
        "effect": "idle",
        "explains": round(share, 4),
        "against": "shapes without a name do more in its place",
    }
    assert entry.where["fitted_shape"] == shape.name
    assert 0 < len(entry.where["correlates_with"]) <= 6
    assert entry.nats == of.left[0].nats
    assert entry.probability == pytest.approx(1.0 - math.exp(-min(entry.nats, 50.0)))


@pytest.mark.parametrize(
    ("of", "name", "stands_in", "said"),
    [
        (nearest, "all_within_physics", lambda *_: False, "it would be larger than its physics allows"),
        (Search, "agrees", lambda *_: False, "held-out blocks gain too little by it"),
        (nearest, "NEEDED_SHARES", (0.0,), "what else is asked"),
        (nearest, "are_rather_unlisted", lambda *_: True, "what it leaves makes a cause in no catalogue likelier"),
        (nearest, "are_rather_unlisted", lambda *_: False, "it did not hold beside what else was tried"),
    ],
)
def test_what_speaks_against_the_nearest_is_said(
    monkeypatch: pytest.MonkeyPatch, of: Any, name: str, stands_in: Any, said: str
) -> None:
    """One thing, the first that a search would have found, and not all that may."""
    monkeypatch.setattr(of, name, stands_in)
    monkeypatch.setattr(nearest, "spoken_against", lambda *_: said if said == "what else is asked" else "")
    if of is nearest and name != "all_within_physics":
        monkeypatch.setattr(nearest, "NEEDED_SHARES", (0.0,))
    (entry,) = entries(unknown())
    assert entry.says.endswith(f" % of it, but {said}.")
    assert entry.where["nearest"]["against"] == said


def test_while_the_recording_is_in_doubt_what_was_found_on_it_is_asked_for() -> None:
    asked = SimpleNamespace(open=(SimpleNamespace(code="wraps"), SimpleNamespace(code="clipped")), findings=())
    (entry,) = entries(SimpleNamespace(**{**vars(unknown()), "inspection": asked}))
    assert entry.says.startswith(
        "Recording and reference disagree; no physics is named before the recording is answered for: wraps, clipped."
    )
    assert "telemetry" not in entry.separated_by


def test_what_nothing_comes_near_has_no_nearest() -> None:
    of = unknown()
    away = replace(of.search, problem=of.search.problem, hypotheses=[body_form("idle", "", along(0, OTHER))])
    (entry,) = entries(SimpleNamespace(**{**vars(of), "search": away}))
    assert (entry.rivals, entry.where["nearest"]) == ((), None)
    assert "Nearest" not in entry.says


def test_sums_of_a_diagnosis() -> None:
    """rms of each stage, and how far the bias moved."""
    assert held_out_rms(made()) == {
        "simulation": pytest.approx(math.sqrt(12.5)),
        "recalibrated": made().prepared.baseline.held_out_rms_nt,
        "with_effects": made().fit.held_out_rms_nt,
    }
    off = made().fit.x[:3] - made().prepared.baseline.x[:3]
    moved_nt, sigma_nt = moved_bias(made())
    assert moved_nt == pytest.approx(math.sqrt(sum(off**2)))
    assert sigma_nt**2 == pytest.approx(off @ made().fit.covariance[:3, :3] @ off / moved_nt**2)


def test_how_far_vectors_are_off_without_the_effects_is_said_before_and_after_a_jump() -> None:
    """Against the disturbance itself: its change is the whole difference of the two, and a bias is no answer alone."""
    jump, at_s = 200.0, 0.5 * float(TIME_S[-1])
    after = at_s <= TIME_S

    def columns(theta: Any) -> Columns:
        return Columns(body=along(0, (float(theta[0]) <= TIME_S).astype(float))[None])

    form = replace(
        body_form("jump", "", along(0, after)),
        columns=columns,
        nonlinear=(Nonlinear("at_s", "s", np.array([at_s]), role="instant"),),
    )
    problem = Problem(flown(jump * along(0, after.astype(float))), NOISE_NT)
    alone = solve(problem, X)
    fit = solve(problem, X, [Term(form, np.array([at_s]), np.array([jump]))])
    off = Misled.of(alone, fit)
    assert off.change_s == at_s
    assert off.before_nt is not None
    assert off.after_nt is not None
    assert off.before_nt + off.after_nt == pytest.approx(jump, rel=0.25)
    assert off.rms_nt == pytest.approx(math.sqrt(0.5 * (off.before_nt**2 + off.after_nt**2)), rel=0.05)
    assert off.from_start
    assert f" nT before {at_s:.1f} s, " in str(off)
    sigma = np.sqrt(np.diagonal(fit.covariance)[:9])
    assert 0.5 * np.linalg.norm(sigma[:3]) < off.sigma_nt < np.linalg.norm(sigma[:3]) + 1e5 * np.linalg.norm(sigma[3:])
    steady = made().misled
    assert (steady.change_s, steady.most_nt >= steady.rms_nt > 0.0) == (None, True)
    assert "at most" in str(steady)


def test_the_json_holds_the_fit_with_its_sigmas() -> None:
    content = json.loads(as_json(made()))
    fit = made().fit
    assert content["verdict"] == "named"
    assert content["compared_with"] == "as calibrated on the first half"
    assert content["fit"]["noise_with_memory_nt"] is None
    assert content["fit"]["noise_floor_nt"] == 31.4
    assert (content["fit"]["noise_is_stated"], content["fit"]["added_noise_nt"]) == (False, 28.9)
    assert content["fit"]["bias_nt"] == fit.x[:3].tolist()
    assert content["fit"]["D"] == d_matrix(fit.x[:9]).tolist()
    sigma = np.sqrt(np.diagonal(fit.covariance))[:9]
    assert content["fit"]["sigma"]["bias_nt"] == pytest.approx(sigma[:3].tolist())
    assert content["fit"]["sigma"]["D"][0][0] == pytest.approx(sigma[3])
    assert content["fit"]["bias_before_nt"] == made().prepared.baseline.x[:3].tolist()
    held = {"driver": "channel:board", "value": 21.5, "unit": "degC", "says": "21.5 degC of channel board"}
    assert content["fit"]["errors_hold_at"] == [held]
    assert content["fit"]["vectors_off_nt"] == made().misled.to_dict()
    assert [effect["effect"] for effect in content["effects"]] == ["other", "one"]
    assert content["effects"][0]["evidence_nats"] == round(made().explained.nats[0], 2)
    assert (content["seconds"], content["spin"]) == (1.23, None)
    assert (content["unexplained_share"], content["left_share"]) == (0.0, 0.0123)
    assert content["rows"] == {"rows": COUNT + 7, "used": COUNT, "left_out": {"unreadable": 4, "spikes": 3}}
    assert (content["residual"], content["not_borne_out"], content["mounting"]) == ("magnitudes", [], None)
    late = json.loads(as_json(SimpleNamespace(**{**vars(made()), "refused": (Form.AIMED,)})))
    assert late["not_borne_out"] == ["vectors"]
    spun = SimpleNamespace(axis_body=np.array([0.0, 0.0, 1.0]), axis_eci=np.array([1.0, 0.0, 0.0]), rate_rpm=7.5)
    turning = json.loads(as_json(SimpleNamespace(**{**vars(made()), "spin": spun})))
    assert turning["spin"] == {"axis_body": [0.0, 0.0, 1.0], "axis_eci": [1.0, 0.0, 0.0], "rate_rpm": 7.5}


def test_an_entry_as_json_is_rounded_and_has_its_class() -> None:
    one = entries(made())[1].as_json()
    assert one["probability"] == round(one["probability"], 6)
    assert one["class"][0] == "one"
    assert set(one["parameters"]["nt"]) == {"value", "sigma", "unit", "labels", "range"}
    assert one["parameters"]["nt"]["labels"] == [["1"]]
    assert one["parameters"]["nt"]["value"][0] == pytest.approx(60.0, abs=10.0)
    assert one["parameters"]["nt"]["sigma"][0] == pytest.approx(float(np.sqrt(made().fit.covariance[10, 10])), rel=1e-6)
