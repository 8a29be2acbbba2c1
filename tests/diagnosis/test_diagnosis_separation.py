"""What would tell two names apart: predictions against recordings that are then made, and what is left out."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from magcal_service.diagnosis.blocks import Gain
from magcal_service.diagnosis.imagined import about, continued, spun, steady, tilted
from magcal_service.diagnosis.linear import Gain as Fitted
from magcal_service.diagnosis.problem import Fit, Problem, Term, disturbances, evaluate
from magcal_service.diagnosis.screen import Candidate
from magcal_service.diagnosis.separation import Separation, separations
from magcal_service.diagnosis.solution import solve
from magcal_service.model import Array, measure
from magcal_service.physics.catalogue import catalogue, effect_named
from magcal_service.physics.interface import Hypothesis
from magcal_service.physics.scene.scene import Scene
from tests.physics.scenes import AXIS_BODY, COUNT, NOISE_NT, RATE_RAD_S, X, scene

AGAIN = "record as long again as it was"
FASTER = "spin the craft twice as fast and record as long again"


def form(effect: str, driver: str = "none", variant: str = "", of: Scene | None = None) -> Hypothesis:
    found = effect_named(effect).hypotheses(of or scene())
    return next(h for h in found if (h.driver, h.variant) == (driver, variant))


def term(hypothesis: Hypothesis, rms_nt: float, theta: Array | None = None) -> Term:
    """A term of so much rms as a field, along (1, 2, 2) where it is a vector."""
    theta = np.zeros(0) if theta is None else theta
    amplitudes = np.resize([1.0, 2.0, 2.0], hypothesis.size)
    field = hypothesis.columns(theta).field(amplitudes)
    return Term(hypothesis, theta, amplitudes * rms_nt / np.sqrt(np.mean((field**2).sum(axis=1))))


@cache
def warmth() -> tuple[Hypothesis, ...]:
    """Every way in which a bias may follow a temperature."""
    return tuple(effect_named("thermal_bias").hypotheses(scene()))


def diagnosis(own: Term, *rivals: Term, spins: bool = True, effects: Any = None, dispersion: float = 1.0) -> Any:
    """As much of a diagnosis as is asked: noise of the usual size as its residual."""
    clean = scene()
    body, _ = disturbances([own], clean)
    noise = np.random.default_rng(3).normal(0.0, NOISE_NT, (COUNT, 3))
    problem = Problem(clean, NOISE_NT)
    seen = replace(problem, scene=replace(clean, field_nt=measure(X, clean.calibrated_nt + body + noise)))
    fit = evaluate(seen, X, [own])
    gain = Fitted(0.0, 0.0, 0.0, np.zeros(0))
    ranked = tuple(
        Candidate(t.hypothesis, t.theta, replace(gain, amplitudes=t.amplitudes), 0.0) for t in (own, *rivals)
    )
    spin = SimpleNamespace(axis_body=AXIS_BODY, rate_rad_s=RATE_RAD_S) if spins else None
    return SimpleNamespace(
        fit=fit,
        search=SimpleNamespace(problem=problem, whitening=np.zeros(0), hypotheses=warmth()),
        explained=SimpleNamespace(rivals=(ranked,), gains=(Gain(0.0, dispersion, 0, 0),)),
        effects=catalogue() if effects is None else effects,
        spin=spin,
    )


def told(of: Any) -> dict[str, Separation]:
    names = [candidate.hypothesis.effect for candidate in of.explained.rivals[0]]
    return {one.do: one for one in separations(of, 0, names)}


@cache
def heat_or_drift() -> Any:
    """A bias that follows a temperature, or drifts."""
    return diagnosis(HEAT, DRIFT)


@cache
def told_of_heat() -> dict[str, Separation]:
    return told(heat_or_drift())


HEAT = term(form("thermal_bias", "channel:temperature"), 120.0)
DRIFT = term(form("bias_drift", variant="quadratic"), 60.0)
LATE = Term(form("time_offset"), np.zeros(0), np.array([2.0]))


def fitted(on: Scene, truth: Term, model: Term) -> Fit:
    """The wrong model on a recording of the right one that is free of noise."""
    body, grown = disturbances([truth], on)
    seen = on.calibrated_nt * (1.0 + grown / on.magnitude_nt)[:, None] + body
    return solve(Problem(replace(on, field_nt=measure(X, seen)), NOISE_NT), X, [model])


@pytest.mark.parametrize("rival", [DRIFT, LATE], ids=["drift", "late"])
@pytest.mark.parametrize("what", [AGAIN, "turn"])
def test_what_is_predicted_is_what_a_fit_of_the_wrong_model_then_finds(what: str, rival: Term) -> None:
    """The recording is made, and the rival fitted to it with the nine errors: nats as predicted, to a tenth."""
    of = heat_or_drift() if rival is DRIFT else diagnosis(HEAT, rival)
    do, one = next((do, one) for do, one in told(of).items() if do.startswith(what))
    turn = steady(scene())
    if what == "turn":
        axis = np.eye(3)["xyz".index(do.partition(" axis")[0][-1])]
        turn = tilted(scene(), axis, 0.5 * np.pi)
    longer = continued(scene(), turn, X)
    sigma2 = of.fit.rms_nt**2
    left = []
    for truth, model in ((HEAT, rival), (rival, HEAT)):
        on = [
            replace(t, hypothesis=form(t.hypothesis.effect, t.hypothesis.driver, t.hypothesis.variant,
                                       replace(longer, given=t.hypothesis.constants)))
            for t in (truth, model)
        ]  # fmt: skip
        residual = fitted(longer, *on).residual
        left.append(float(residual @ residual) / (2.0 * sigma2))
    assert one.nats == pytest.approx(min(left), rel=0.1)
    assert one.against == rival.hypothesis.effect
    assert one.sigma == pytest.approx(np.sqrt(2.0 * one.nats))


def test_scatter_over_blocks_makes_less_of_it() -> None:
    plain, scattered = told_of_heat(), told(diagnosis(HEAT, DRIFT, dispersion=4.0))
    assert scattered[AGAIN].nats == pytest.approx(plain[AGAIN].nats / 4.0)


def test_a_lag_and_a_skew_are_told_apart_by_another_spin_rate() -> None:
    lag, skew = term(form("response_lag"), 300.0, np.zeros(1)), term(form("axis_skew"), 300.0)
    found = told(diagnosis(lag, skew))
    assert found[FASTER].nats > 20.0 * max((one.nats for do, one in found.items() if do == AGAIN), default=3.0)


def test_a_craft_that_does_not_spin_is_asked_to() -> None:
    found = told(diagnosis(HEAT, DRIFT, spins=False))
    assert FASTER not in found
    assert [do for do in found if "once a minute" in do]


def test_what_can_be_switched_off_is() -> None:
    """A current that is switched off takes its field along, and warmth does not."""
    current = term(form("current_loop", "channel:battery"), 150.0)
    found = told(diagnosis(current, term(form("thermal_bias", "channel:temperature"), 150.0)))
    off = next(one for do, one in found.items() if do.startswith("switch off the suspected load"))
    assert off.nats > 1.2 * found[AGAIN].nats


def test_what_acts_exactly_alike_is_told_by_switching_it_off_alone() -> None:
    """Nothing that goes on as it did tells it, however long: odds are between two fitted courses only."""
    current = term(form("current_loop", "channel:battery"), 150.0)
    warm = form("thermal_bias", "channel:temperature")
    alike = term(replace(warm, as_well=("current_loop",)), 150.0)
    assert {do.partition(" the ")[0] for do in told(diagnosis(alike, current))} == {"switch off"}


def test_no_turn_is_foretold_where_a_channel_would_change_with_it() -> None:
    """A panel's current in another attitude is not known; a temperature is taken to go on as it was."""
    current = term(form("current_loop", "channel:battery"), 150.0)
    assert not [do for do in told(diagnosis(current, HEAT)) if "the craft" in do]
    assert [do for do in told_of_heat() if "the craft" in do]


def test_a_driver_that_nobody_recorded_is_asked_for() -> None:
    inferred = form("thermal_bias", "inferred:temperature", "answer to light")
    warm = term(inferred, 150.0, np.array([1200.0, 300.0]))
    found = told(diagnosis(DRIFT, warm))
    assert "record what drives thermal_bias (temperature), which shows whether it is that" in found


def test_a_name_that_stands_alone_needs_nothing() -> None:
    assert separations(heat_or_drift(), 0, ["thermal_bias"]) == ()


def test_what_no_catalogue_has_is_left_out() -> None:
    of = diagnosis(HEAT, DRIFT, effects=[effect for effect in catalogue() if effect.name != "bias_drift"])
    assert told(of) == {}


def test_a_recording_goes_on_along_the_same_orbit() -> None:
    """In space the places repeat; over the Earth they have moved on by its turning."""
    clean = scene()
    longer = continued(clean, steady(clean), X)
    assert len(longer) == 2 * COUNT
    assert longer.pauses.tolist() == [0, COUNT]
    assert np.allclose(longer.position_eci_km[COUNT:], clean.position_eci_km, atol=1e-6)  # type: ignore[index]
    assert not np.allclose(longer.position_ecef_km[COUNT:], clean.position_ecef_km, atol=100.0)  # type: ignore[index]
    assert np.allclose(longer.channels["temperature"].values[COUNT:], clean.channels["temperature"].values)


def test_a_craft_that_is_turned_sees_field_sun_and_rate_in_other_axes() -> None:
    clean = scene()
    turned = continued(clean, tilted(clean, np.array([0.0, 0.0, 1.0]), 0.5 * np.pi), X)
    x, y, z = clean.calibrated_nt.T
    assert np.allclose(turned.calibrated_nt[COUNT:], np.stack([y, -x, z], axis=1))
    sun = clean.sun_body
    assert sun is not None
    assert turned.sun_body is not None
    assert np.allclose(turned.sun_body[COUNT:], np.stack([sun[:, 1], -sun[:, 0], sun[:, 2]], axis=1), atol=3e-3)
    faster = continued(clean, spun(clean, AXIS_BODY, RATE_RAD_S), X)
    assert faster.rate_body is not None
    assert np.allclose(faster.rate_body[COUNT + 2 : -2], 2.0 * RATE_RAD_S * AXIS_BODY, atol=1e-6)
    assert np.allclose(faster.channels["gyro"].values[COUNT:], 2.0 * RATE_RAD_S * AXIS_BODY)


def test_a_turn_of_the_axes_takes_a_fixed_vector_back() -> None:
    turned = about(np.array([1.0, 0.0, 0.0]), np.array([np.pi / 6.0]))[0] @ [0.0, 1.0, 0.0]
    assert np.allclose(turned, [0.0, np.cos(np.pi / 6.0), -0.5])
