"""Where nine errors hold: at the value of a driver at which the effect beside them adds nothing, for every form."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from magcal_service.diagnosis.handover import model_term
from magcal_service.physics.apply.forward import bind
from magcal_service.physics.apply.model_file import ModelTerm
from magcal_service.physics.catalogue import held_at
from magcal_service.physics.held import held_in_words
from magcal_service.physics.interface import Hypothesis
from magcal_service.physics.scene.scene import Scene
from tests.physics.given_scene import flight
from tests.physics.test_model_file import forms, ids, theta_of

BY_CHANNEL = [form for form in forms() if form.driver.startswith("channel:")]
IN_SHADOW = [form for form in forms() if form.driver in ("inferred:array_current", "inferred:sun_direction")]


def term_of(form: Hypothesis) -> ModelTerm:
    return model_term(form, theta_of(form), np.ones(form.size))


def at(value: float, driver: str) -> Scene:
    """The flight with a channel, or several, steady at a value."""
    names = driver.partition(":")[2].split("+")
    steady = {name: replace(one, values=np.full_like(one.values, value)) for name, one in flight().channels.items()}
    return replace(flight(), channels={**flight().channels, **{name: steady[name] for name in names}})


@pytest.mark.parametrize("form", BY_CHANNEL, ids=ids)
def test_what_follows_a_record_adds_nothing_there_and_something_elsewhere(form: Hypothesis) -> None:
    (held,) = held_at([form])
    assert held_at([term_of(form)]) == (held,)  # a file knows as much
    assert held.driver == form.driver
    there, elsewhere = (bind(term_of(form), at(held.value + more, form.driver)).disturbance()[0] for more in (0.0, 2.0))
    assert np.abs(there).max() == 0.0
    assert np.abs(elsewhere).max() > 0.0


@pytest.mark.parametrize("form", IN_SHADOW, ids=ids)
def test_what_follows_the_light_adds_nothing_in_shadow(form: Hypothesis) -> None:
    (held,) = held_at([form])
    added, lit = bind(term_of(form), flight()).disturbance()[0], flight().lit
    assert lit is not None
    assert held.value == 0.0
    dark = lit == 0.0
    dark[1:] &= np.cumsum(dark)[1:] > 60 if "late" in form.variant else True  # what lags goes on for a while
    assert dark.sum() > 100
    assert np.abs(added[lit == 1.0]).max() > 0.0
    if "late" not in form.variant:
        assert np.abs(added[dark]).max() == 0.0


SAID = [
    (("current_loop", "channel:bus", "", "nt_per_a"), "0 A in the fitted columns of channel bus"),
    (
        ("current_loop", "channel:bus", "circuit 2, recorded late", "nt_per_a"),
        "0 A in the fitted columns of channel bus",
    ),
    (("current_loop", "channel:a+b", "all circuits", "nt_per_a"), "0 A in the fitted columns of channels a and b"),
    (("current_loop", "channel:a+b", "", "nt_per_unit"), "0 in the fitted columns of channel a+b"),
    (("current_loop", "inferred:array_current", "lit or not", "nt_full_sun"), "no current of the solar arrays"),
    (("torquer", "channel:coils", "", "nt_per_am2"), "0 A m2 in the fitted columns of channel coils"),
    (("torquer", "inferred:duty", "regular duty", "on_nt"), "torquers that are off"),
    (("sun_disturbance", "channel:sun", "", "nt"), "0 in the fitted columns of channel sun"),
    (("sun_disturbance", "inferred:sun_direction", "", "nt"), "no sunlight"),
    (("thermal_scale", "inferred:temperature", "settling", "start_swing"), "the temperature that it settles at"),
    (("bias_step", "none", "", "step_nt"), ""),
    (("empirical", "channel:bus", "", "magnitude"), ""),
]


@pytest.mark.parametrize(("term", "says"), SAID, ids=[f"{term[0]} {term[2]} by {term[1]}" for term, _ in SAID])
def test_it_is_said_in_the_drivers_unit(term: tuple[str, str, str, str], says: str) -> None:
    effect, driver, form, block = term
    assert held_in_words(held_at([ModelTerm(effect, driver, form, {block: np.ones(3)})])) == says


def test_a_remanence_is_none_of_the_nine() -> None:
    blocks = {"nt_per_am2": np.ones((1, 3)), "remanence_nt": np.ones((1, 3))}
    (held,) = held_at([ModelTerm("torquer", "channel:coils", "with remanence", blocks)])
    assert held.says == "0 A m2 in the fitted columns of channel coils, its cores without remanence"


def test_each_driver_is_said_once_and_several_together() -> None:
    zero = {"zero_degc": 21.5, "column": 0.0}
    terms = [ModelTerm(name, "channel:board", "", {}, {}, {}, zero) for name in ("thermal_bias", "thermal_scale")]
    bus = ModelTerm("current_loop", "channel:bus", "", {"nt_per_a": np.ones(3)})
    assert (
        held_in_words(held_at([*terms, bus]))
        == "21.5 degC of channel board and 0 A in the fitted columns of channel bus"
    )
