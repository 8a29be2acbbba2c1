"""The direct form of a recorded driver, and what drivers may stand for."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from magcal_service.diagnosis.plausible import has_its_sign
from magcal_service.model import Array
from magcal_service.physics.catalogue import effect_named
from magcal_service.physics.drivers.temperature import direct_by_temperature
from magcal_service.physics.scene.scene import Telemetry
from tests.physics.effect_forms import TIME_S, forms
from tests.physics.scenes import scene

# The direct form of a recorded driver


def term(**changes: object) -> SimpleNamespace:
    made = {
        "driver": "channel:board",
        "variant": "column 2",
        "amplitudes": {"nt_per_k": np.array([1.0, 2.0, 3.0])},
        "nonlinear": {},
        "constants": {"zero_degc": 20.0, "column": 1.0},
    }
    return SimpleNamespace(**made | changes)


def test_a_temperature_has_a_direct_form() -> None:
    found = direct_by_temperature(term(), "nt_per_k")  # type: ignore[arg-type]
    assert found is not None
    assert (found.channel, found.quantity, found.columns, found.zero) == ("board", "temperature", (1,), 20.0)
    assert found.field((0.0, 25.0), (1.0, 1.0, 1.0)) == [5.0, 10.0, 15.0]
    gain = direct_by_temperature(term(), "nt_per_k", is_gain=True)  # type: ignore[arg-type]
    assert gain is not None
    assert gain.field((0.0, 25.0), (10.0, 20.0, -30.0)) == [-50.0, -200.0, 450.0]
    plain = direct_by_temperature(term(variant="", constants={"zero_degc": 20.0}), "nt_per_k")  # type: ignore[arg-type]
    assert plain is not None
    assert plain.columns == (0,)


@pytest.mark.parametrize(
    "changes",
    [
        {"driver": "inferred:temperature"},
        {"variant": "answer to light"},
        {"constants": {}},
        {"constants": {"zero_degc": 20.0, "column": -1.0}},
        {"nonlinear": {"time_constant_s": 5.0}},
        {"amplitudes": {"per_k": np.ones(3)}},
        {"amplitudes": {"nt_per_k": np.ones(3), "more": np.ones(3)}},
        {"amplitudes": {"nt_per_k": np.ones((2, 3))}},
        {"amplitudes": {"nt_per_k": np.ones(2)}},
    ],
    ids=str,
)
def test_what_does_not_fit_has_no_direct_form(changes: dict[str, object]) -> None:
    assert direct_by_temperature(term(**changes), "nt_per_k") is None  # type: ignore[arg-type]


def test_circuits_have_a_direct_form_each_and_together() -> None:
    direct = effect_named("current_loop").direct
    both = term(
        variant="",
        amplitudes={"nt_per_a": np.arange(6.0).reshape(2, 3)},
        constants={"column_0": 2.0, "column_1": 0.0},
    )
    found = direct(both)  # type: ignore[arg-type]
    assert found is not None
    assert (found.quantity, found.columns, found.zero, found.is_gain) == ("current", (2, 0), 0.0, False)
    assert found.field((10.0, 5.0, 1.0), (0.0, 0.0, 0.0)) == [30.0, 41.0, 52.0]
    one = replace_amplitudes(both, np.ones((1, 3)), {"column_0": 1.0})
    assert direct(one) is not None  # type: ignore[arg-type]
    assert direct(replace_amplitudes(both, np.ones(3), {"column_0": 1.0})) is not None  # type: ignore[arg-type]
    assert direct(replace_amplitudes(both, np.ones(3), both.constants)) is None  # type: ignore[arg-type]
    both.driver = "channel:a+b"
    assert direct(both) is None  # type: ignore[arg-type]


def replace_amplitudes(of: SimpleNamespace, amplitudes: Array, constants: dict[str, float]) -> SimpleNamespace:
    return SimpleNamespace(**{**vars(of), "amplitudes": {"nt_per_a": amplitudes}, "constants": constants})


@pytest.mark.parametrize(("mean_nt", "possible"), [(-400.0, True), (49.0, True), (51.0, False)])
def test_currents_above_add_little_to_the_north(mean_nt: float, possible: bool) -> None:
    """The ring current's field is southward, however large; how it changes has either sign."""
    for form in (h for (driver, _), h in forms("external_field", scene()).items() if driver == "none"):
        course = 200.0 * np.where(np.arange(form.size - 1) % 2, 1.0, -1.0)
        assert has_its_sign(form, np.concatenate([[mean_nt], course])) is possible


@pytest.mark.parametrize(
    ("course", "warmth"),
    [(np.sin(TIME_S / 900.0), True), (np.sign(np.sin(TIME_S / 900.0)), False), (np.sin(TIME_S / 40.0), False)],
)
def test_what_changes_as_slowly_as_warmth_in_counts_may_be_warmth(course: Array, warmth: bool) -> None:
    """A load switches, and a panel turns through the Sun; counts tell no heat from a current, ampere do."""
    for kind, expected in (("counts", warmth), ("current", False)):
        channels = {"one": Telemetry("one", kind, 500.0 + 80.0 * course[:, None])}
        found = forms("current_loop", replace(scene(), channels=channels))
        recorded = [form for (driver, _), form in found.items() if driver == "channel:one"]
        assert {form.as_well == ("thermal_bias",) for form in recorded} == {expected}
        assert {form.variant for form in recorded} == {"", "lagging", "recorded late"}


@pytest.mark.parametrize(("span_s", "is_open"), [(5000.0, True), (6000.0, False)])
def test_a_drift_of_less_than_an_orbit_may_be_the_warmth_that_nobody_recorded(span_s: float, is_open: bool) -> None:
    """A sensor that was switched on settles for as long; over more an orbit tells the course of its warmth."""
    short = replace(scene(), time_s=TIME_S * (span_s / float(np.ptp(TIME_S))))
    for effect, warmth in (("bias_drift", "thermal_bias"), ("scale_drift", "thermal_scale")):
        alone = forms(effect, replace(short, channels={})).values()
        assert {form.as_well for form in alone} == {(warmth,) if is_open else ()}
        seen = Telemetry("t", "temperature", 20.0 + short.time_s[:, None] / 900.0)
        assert {form.as_well for form in forms(effect, replace(short, channels={"t": seen})).values()} == {()}


def test_panels_of_both_sides_are_told_from_the_suns_direction_by_their_sums() -> None:
    """What is linear in the Sun's direction has amplitudes of opposite signs there, and none of the sums."""
    (panels,) = (h for h in forms("current_loop", scene()).values() if h.variant == "every panel its own circuit")
    ((effect, weights),) = panels.if_none
    faces = [int(panels.constants[f"face_{index}"]) for index in range(len(panels.constants))]
    linear = np.random.default_rng(9152).normal(size=(3, 3))
    amplitudes = np.concatenate([linear[face % 3] * (1.0 if face < 3 else -1.0) for face in faces])
    assert effect == "sun_disturbance"
    assert weights.shape == (3 * (len(faces) - 3), panels.size)
    assert np.abs(weights @ amplitudes).max() < 1e-12
    assert np.abs(weights @ np.ones(panels.size)).min() == 2.0


def test_a_drift_swings_by_what_a_warming_sensor_may_at_the_most() -> None:
    """3000 nT over the recording; a parabola that comes back has four times the slope; none where a model is given."""
    span_s = float(np.ptp(TIME_S))
    found = forms("bias_drift")
    assert found["none", ""].blocks[0].most * span_s == pytest.approx(3000.0)
    slope, bend = found["none", "quadratic"].blocks
    share = np.linspace(0.0, 1.0, 101)
    swing_nt = slope.most * span_s * share - bend.most * span_s**2 * share**2
    assert np.ptp(swing_nt) == pytest.approx(3000.0, rel=1e-3)
    assert found["none", "relaxing"].blocks[0].most == pytest.approx(3000.0)
    given = forms("bias_drift", replace(scene(), given={}))
    assert {block.most for form in given.values() for block in form.blocks} == {math.inf}


@pytest.mark.parametrize(
    ("faces", "quantity", "sun", "as_well"),
    [
        (4, "current", False, ("sun_disturbance",)),
        (4, "counts", False, ("sun_disturbance",)),
        (2, "current", False, ()),
        (4, "current", True, ()),
    ],
)
def test_cells_of_three_faces_and_more_may_stand_for_the_suns_direction(
    faces: int, quantity: str, sun: bool, as_well: tuple[str, ...]
) -> None:
    """A field that turns with the Sun follows them, too; where the Sun's direction is known, that one is told."""
    angle = 0.2 * TIME_S[:, None] + 0.5 * np.pi * np.arange(faces)
    cells = Telemetry("cells", quantity, 0.4 * np.maximum(np.cos(angle), 0.0))
    load = Telemetry("load", "current", 0.5 + 0.1 * np.sin(TIME_S / 700.0)[:, None])
    found = {"cells": cells, "load": load, **({"sun": scene().channels["sun"]} if sun else {})}
    blind = replace(scene(), channels=found, body_from_eci=None, position_ecef_km=None)
    without_shadow = replace(scene(), channels=found, position_ecef_km=None)
    for of in (blind, without_shadow):
        by = [h for h in effect_named("current_loop").hypotheses(of) if h.driver == "channel:cells"]
        assert by
        assert {h.as_well for h in by} == {as_well}
    dark = replace(cells, values=cells.values * (scene().lit > 0.5)[:, None])
    for one, may_be in ((dark, as_well), (cells, ())):
        placed = replace(scene(), channels={**found, "cells": one}, body_from_eci=None)
        by = [h for h in effect_named("current_loop").hypotheses(placed) if h.driver == "channel:cells"]
        assert {h.as_well for h in by} == {may_be}, "a cell is dark in the Earth's shadow, a load is not"
    whole = replace(scene(), channels=found)
    assert {h.as_well for h in forms("current_loop", whole).values() if h.driver == "channel:cells"} == {()}
    assert {h.as_well for h in forms("current_loop", blind).values() if h.driver == "channel:load"} == {()}
