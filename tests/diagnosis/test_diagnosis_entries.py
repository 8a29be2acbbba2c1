"""A diagnosis as entries, with rivals and findings, in words and as JSON."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from magcal_service.diagnosis import nearest
from magcal_service.diagnosis.content import as_json
from magcal_service.diagnosis.diagnose import Verdict
from magcal_service.diagnosis.explain import Explained, Search
from magcal_service.diagnosis.leftover import structures
from magcal_service.diagnosis.linear import Gain
from magcal_service.diagnosis.misled import Misled
from magcal_service.diagnosis.nearest import Nearest
from magcal_service.diagnosis.prepare import Form
from magcal_service.diagnosis.problem import Problem, Term
from magcal_service.diagnosis.result import entries, held_out_rms, moved_bias
from magcal_service.diagnosis.screen import Candidate
from magcal_service.diagnosis.solution import solve
from magcal_service.model import d_matrix
from magcal_service.physics.catalogue import catalogue
from magcal_service.physics.columns import Columns
from magcal_service.physics.held import HeldAt
from magcal_service.physics.interface import Finding, Nonlinear, value_of
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
    searching,
)
from tests.physics.scenes import COUNT, NOISE_NT, X


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
