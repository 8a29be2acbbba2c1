"""Numbers of physics.toml that the physics of an effect never has are refused where the file is read."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from magcal_service.physics.apply.model_file import ModelError, ModelTerm, PhysicsModel, parse_model, text_of
from magcal_service.physics.catalogue import catalogue
from magcal_service.physics.scene.scene import Scene
from magcal_service.wire.messages import Clock
from tests.physics.scenes import scene

WARM = ModelTerm(
    "thermal_bias",
    "channel:temperature",
    "",
    {"nt_per_k": np.array([8.0, -6.0, 300.0])},
    {"nt_per_k": np.full(3, 0.1)},
    {},
    {"zero_degc": 20.0, "column": 0.0},
)
LOOP = ModelTerm("current_loop", "channel:bus", "", {"nt_per_a": np.full(3, 5000.0)}, constants={"column_0": 0.0})
LATE = replace(
    LOOP,
    variant="recorded late",
    nonlinear={"late_s": 1.0, "held_s": 30.0},
    constants={"column_0": 0.0, "averaged": 1.0},
)
NOISY = replace(LOOP, variant="recorded with noise", constants={"column_0": 0.0, "record_noise_a": 0.0})
LIGHT = ModelTerm(
    "thermal_bias",
    "inferred:temperature",
    "answer to light",
    {"nt_swing": np.full(3, 1e4), "start_nt_swing": np.full(3, -1e4)},
    {},
    {"time_constant_s": 900.0, "skin_s": 0.0},
    {"mean_light": 1.0},
)
LAG = ModelTerm("response_lag", "none", "", {"tau2_s2": np.array(0.0)}, {}, {"expanded_at_s": 0.0}, {"order": 2.0})
FAR = ModelTerm(
    "time_offset", "none", "by minutes", {"share": np.array(1.25)}, {}, {"late_s": 300.0, "late_s_per_h": 0.0}
)
BEHIND = ModelTerm("time_offset", "none", "behind the attitude", {"behind_s": np.array(119.0)})
SUN = ModelTerm("sun_disturbance", "inferred:sun_direction", "", {"nt": np.full((3, 3), 1e6)})
CUBIC = ModelTerm("cubic_response", "none", "", {"per_nt2": np.full(3, 1.3e-10)})
FIELD = ModelTerm("external_field", "none", "uniform", {"mean_nt": np.array(50.0)})

NEXT = "; correct it, or have the file made again by magcal diagnose"


def file_of(term: ModelTerm) -> bytes:
    model = PhysicsModel("flight", 0, Clock.UTC, np.zeros(9), np.zeros(9), 100.0, (term,))
    return text_of(model).encode()


@pytest.mark.parametrize(
    "term",
    [WARM, LOOP, LATE, NOISY, LIGHT, LAG, FAR, BEHIND, SUN, CUBIC, FIELD],
    ids=lambda term: f"{term.effect} {term.variant}",
)
def test_numbers_at_the_edge_of_what_is_possible_are_accepted(term: ModelTerm) -> None:
    assert parse_model(file_of(term)).terms[0].amplitudes.keys() == term.amplitudes.keys()


def amplitude(term: ModelTerm, **numbers: object) -> ModelTerm:
    return replace(term, amplitudes={**term.amplitudes, **{name: np.array(value) for name, value in numbers.items()}})


def sought(term: ModelTerm, **numbers: float) -> ModelTerm:
    return replace(term, nonlinear={**term.nonlinear, **numbers})


def constant(term: ModelTerm, **numbers: float) -> ModelTerm:
    return replace(term, constants={**term.constants, **numbers})


BEYOND = {
    "amplitudes.nt_per_k: [8.0, -6.0, 91700.0]": (amplitude(WARM, nt_per_k=[8.0, -6.0, 91700.0]), "-300 to 300 nT/K"),
    "amplitudes.nt_per_k: [-301.0, 0.0, 0.0]": (amplitude(WARM, nt_per_k=[-301.0, 0.0, 0.0]), "-300 to 300 nT/K"),
    "amplitudes.nt_per_a": (amplitude(LOOP, nt_per_a=[0.0, 5001.0, 0.0]), "-5000 to 5000 nT/A"),
    "amplitudes.start_nt_swing": (amplitude(LIGHT, start_nt_swing=[0.0, 0.0, 2e4]), "-1e+04 to 1e+04 nT"),
    "amplitudes.tau2_s2: -1.0": (amplitude(LAG, tau2_s2=-1.0), "0 to 100 s2"),
    "amplitudes.share: 2.0": (amplitude(FAR, share=2.0), "0.75 to 1.25"),
    "amplitudes.behind_s: 121.0": (amplitude(BEHIND, behind_s=121.0), "0 to 120 s"),
    "amplitudes.nt: ": (amplitude(SUN, nt=np.full((3, 3), 1.1e6)), "-1e+06 to 1e+06 nT"),
    "amplitudes.per_nt2": (amplitude(CUBIC, per_nt2=[0.0, 2e-10, 0.0]), "-1.333e-10 to 1.333e-10 1/nT2"),
    "amplitudes.mean_nt: 51.0": (amplitude(FIELD, mean_nt=51.0), "-1e+06 to 50 nT"),
    "nonlinear.held_s: 61.0": (sought(LATE, held_s=61.0), "0 to 60 s"),
    "nonlinear.time_constant_s: 1000000000000.0": (sought(LIGHT, time_constant_s=1e12), "120 to 14400 s"),
    "nonlinear.late_s_per_h: 7.0": (sought(FAR, late_s_per_h=7.0), "-6 to 6 s/h"),
    "constants.record_noise_a: -3.0": (constant(NOISY, record_noise_a=-3.0), "0 or more"),
    "constants.averaged: 7.0": (constant(LATE, averaged=7.0), "1"),
    "constants.mean_light: 1.5": (constant(LIGHT, mean_light=1.5), "0 to 1"),
    "constants.zero_degc: -300.0": (constant(WARM, zero_degc=-300.0), "-273.15 or more"),
    "constants.order: 3.0": (constant(LAG, order=3.0), "1 to 2"),
}


@pytest.mark.parametrize("where", BEYOND)
def test_a_number_beyond_its_physics_is_refused_with_what_is_accepted(where: str) -> None:
    """File, field, value, effect, range and next step, in one line."""
    term, accepted = BEYOND[where]
    with pytest.raises(ModelError) as caught:
        parse_model(file_of(term))
    (line,) = str(caught.value).splitlines()
    assert line.startswith(f"physics.toml: effect[0].{where}")
    assert f"of {term.effect}" in line
    assert f"{accepted} is accepted" in line
    assert line.endswith(NEXT)


def test_a_refit_may_end_a_little_beyond_the_range() -> None:
    """By three of its own sigma, but not by more than a fifth of the range, however large sigma is said to be."""
    over, wide = [0.0, 0.0, 310.0], {"nt_per_k": np.full(3, 1e6)}
    with pytest.raises(ModelError, match=re.escape("-300 to 300 nT/K is accepted")):
        parse_model(file_of(amplitude(WARM, nt_per_k=over)))
    assert parse_model(file_of(replace(amplitude(WARM, nt_per_k=over), sigma={"nt_per_k": np.full(3, 4.0)})))
    with pytest.raises(ModelError, match=re.escape("-300 to 300 nT/K is accepted")):
        parse_model(file_of(replace(amplitude(WARM, nt_per_k=[0.0, 0.0, 421.0]), sigma=wide)))


def test_a_range_that_is_checked_is_one_of_every_recording() -> None:
    """On a scene of another pace and length each number that is held to its grid has the same one."""
    ranges: dict[tuple[str, str], set[tuple[float, float]]] = {}
    for one in (scene(), shorter(scene())):
        for effect in catalogue():
            for form in effect.hypotheses(one):
                for number in form.nonlinear:
                    if number.spans:
                        ends = (float(number.grid.min()), float(number.grid.max()))
                        kept = form.variant.startswith("gradual") if number.name == "half_width" else form.driver
                        ranges.setdefault((effect.name, f"{number.name} {kept}"), set()).add(ends)
    assert len(ranges) > 10
    assert [key for key, ends in ranges.items() if len(ends) > 1] == []


def shorter(whole: Scene) -> Scene:
    """Every second row of the first half."""
    rows = slice(0, len(whole) // 2, 2)
    parts = {name: replace(one, values=one.values[rows]) for name, one in whole.channels.items()}
    arrays = {name: value[rows] for name in ("time_s", *PER_ROW) if (value := getattr(whole, name)) is not None}
    return replace(whole, channels=parts, **arrays)


PER_ROW = (
    "field_nt",
    "calibrated_nt",
    "clean_field_nt",
    "magnitude_nt",
    "reference_eci_nt",
    "position_ecef_km",
    "body_from_eci",
)
