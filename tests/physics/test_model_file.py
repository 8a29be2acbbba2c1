"""physics.toml: every number comes back, every fault is named, and a model acts on any scene as it did on its own."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from magcal_service.diagnosis.handover import model_term
from magcal_service.model import Array
from magcal_service.physics.apply.accepted import _check_places
from magcal_service.physics.apply.forward import DriverMissingError, MisfitError, bind, less
from magcal_service.physics.apply.model_file import (
    ModelError,
    ModelSpin,
    ModelTerm,
    Note,
    PhysicsModel,
    parse_model,
    text_of,
)
from magcal_service.physics.catalogue import catalogue, effect_named
from magcal_service.physics.interface import Hypothesis
from magcal_service.wire.messages import Clock
from tests.physics.given_scene import ROWS, X, cut, flight
from tests.physics.modelled import effects_on


@cache
def forms() -> tuple[Hypothesis, ...]:
    return tuple(h for effect in catalogue() for h in effect.hypotheses(flight()))


def model(*terms: ModelTerm, **more: object) -> PhysicsModel:
    made = PhysicsModel("flight", flight().origin_ns, Clock.UTC, X, np.abs(X) / 7.0, 100.0, tuple(terms))
    return replace(made, **more)  # type: ignore[arg-type]


def theta_of(hypothesis: Hypothesis) -> Array:
    """Nonlinear numbers in the middle of what is tried; a line where nothing is."""
    lines = {"frequency": 0.0123456789, "period": 271.8281828}
    found = [lines.get(n.role) or float(n.grid[len(n.grid) // 2]) for n in hypothesis.nonlinear]
    return np.array(found, dtype=np.float64)


def drawn(hypothesis: Hypothesis) -> tuple[ModelTerm, Array, Array]:
    """A term with random amplitudes of 100 nT or of what its physics allows, and what it adds to its own scene."""
    theta = theta_of(hypothesis)
    columns, blocks = hypothesis.columns(theta), hypothesis.blocks
    rng = np.random.default_rng(len(hypothesis.label))
    ones = np.eye(hypothesis.size)
    size = [np.abs(columns.field(one)).max() + np.abs(columns.growth(one)).max() for one in ones]
    amplitudes = (1.0 + rng.random(hypothesis.size)) * 100.0 / np.maximum(size, 1e-12)
    sizes = [b.size for b in blocks]
    amplitudes *= np.repeat([-1.0 if b.highest == 0.0 else 1.0 for b in blocks], sizes)
    amplitudes = np.clip(amplitudes, *np.repeat([(-b.most, min(b.most, b.highest)) for b in blocks], sizes, axis=0).T)
    if hypothesis.is_whole:
        amplitudes[0] = 1.0
    if hypothesis.moves_s is not None:  # expanded where these amplitudes move the reference
        moved = replace(flight(), moved_s=hypothesis.moves_s(amplitudes) + np.zeros(ROWS))
        there = effect_named(hypothesis.effect).hypotheses(moved)
        columns = next(one for one in there if one.label == hypothesis.label).columns(theta)
    if effect_named(hypothesis.effect).bends:  # columns of the field as it would be without these amplitudes
        there = effect_named(hypothesis.effect).hypotheses(less(flight(), columns.field(amplitudes), X))
        columns = next(one for one in there if one.label == hypothesis.label).columns(theta)
    growth = columns.growth(amplitudes) + np.zeros(ROWS)
    return model_term(hypothesis, theta, amplitudes), columns.field(amplitudes), growth


def ids(hypothesis: Hypothesis) -> str:
    return hypothesis.label


def error(found: tuple[Array, Array], body: Array, growth: Array) -> float:
    """Largest difference over the largest value."""
    largest = max(float(np.abs(body).max()), float(np.abs(growth).max()))
    assert largest > 1.0
    return max(float(np.abs(found[0] - body).max()), float(np.abs(found[1] - growth).max())) / largest


def test_doubts_of_the_diagnosis_come_along() -> None:
    for doubts in ("", "name_uncertain, poor_coverage"):
        assert parse_model(text_of(model(doubts=doubts)).encode()).doubts == doubts


def test_the_craft_comes_along() -> None:
    for craft in ("", "demo"):
        assert parse_model(text_of(model(craft=craft)).encode()).craft == craft


def test_every_effect_that_is_a_field_has_a_form_here() -> None:
    """The scene of these tests drives the whole catalogue."""
    silent = {"coloured_noise", "nutation", "quantisation", "spin_rate", "stuck_axis"}
    assert {h.effect for h in forms()} == {effect.name for effect in catalogue()} - silent


@pytest.mark.parametrize("hypothesis", forms(), ids=ids)
def test_a_file_makes_the_same_disturbance_on_the_same_scene(hypothesis: Hypothesis) -> None:
    """Each form, through the text of a file, adds what it was fitted with to 1e-9."""
    term, body, growth = drawn(hypothesis)
    again = parse_model(text_of(model(term)).encode())
    assert error(effects_on(flight(), again), body, growth) < 1e-9


_SETTLES = {
    "hysteresis": 1500,
    "position_offset": 130,
    "thermal_bias": 2500,
    "thermal_scale": 2500,
    "time_offset": 130,
    "torquer": 500,
}
"""Rows after which an effect with a past has forgotten that it was not there before; second derivatives are one-sided
for a minute."""


@pytest.mark.parametrize("hypothesis", forms(), ids=ids)
def test_a_later_part_of_the_flight_has_what_the_whole_flight_has_there(hypothesis: Hypothesis) -> None:
    """Constants and the origin of time are the model's: a recording that begins later gets the same disturbance."""
    first = 250
    term, body, growth = drawn(hypothesis)
    if "skin_s" in term.nonlinear:  # short enough to forget within the flight
        term = replace(term, nonlinear={"time_constant_s": 200.0, "skin_s": 60.0})
        body, growth = effects_on(flight(), model(term))
    found = effects_on(cut(flight(), first, ROWS), model(term))
    part = slice(5 + _SETTLES.get(hypothesis.effect, 0), -10)  # slopes are one-sided at a cut
    most = 0.03 if hypothesis.variant.endswith("with noise") else 1e-5  # how noisy a record is, each tells of itself
    assert error((found[0][part], found[1][part]), body[first:][part], growth[first:][part]) < most


def test_a_recording_at_one_temperature_gets_the_bias_of_that_temperature() -> None:
    """Nothing is left out for want of change: 30 degC against a zero of 20 degC at 8 nT/K is 80 nT."""
    scene = flight()
    steady = {"temperature": replace(scene.channels["temperature"], values=np.full((ROWS, 1), 30.0))}
    term = ModelTerm(
        "thermal_bias",
        "channel:temperature",
        "",
        {"nt_per_k": np.array([8.0, 0.0, -1.0])},
        constants={"zero_degc": 20.0, "column": 0.0},
    )
    body, _ = effects_on(replace(scene, channels=steady), model(term))
    assert body == pytest.approx(np.tile([80.0, 0.0, -10.0], (ROWS, 1)))


def test_a_step_stays_at_its_instant() -> None:
    """A step at 100 s of its own recording is long past in one that begins at 500 s."""
    term = ModelTerm("bias_step", "none", "", {"step_nt": np.array([1.0, 2.0, 3.0])}, nonlinear={"at_s": 100.0})
    body, _ = effects_on(cut(flight(), 250, 300), model(term))
    assert body == pytest.approx(np.tile([1.0, 2.0, 3.0], (50, 1)))


SWITCHED = ModelTerm(
    "bias_step",
    "none",
    "switched at 3 instants",
    {"switched_nt": np.array([1.0, 2.0, 3.0])},
    nonlinear={"at_s": np.array([10.0, 1.0 / 3.0 + 20.0, 40.0])},
)


def test_a_list_of_instants_comes_back_and_acts() -> None:
    """On from the first to the second and from the third on; every number to the last bit."""
    (again,) = parse_model(text_of(model(SWITCHED)).encode()).terms
    assert np.array_equal(again.nonlinear["at_s"], SWITCHED.nonlinear["at_s"])
    scene = flight()
    body, _ = effects_on(scene, model(again))
    on = ((scene.time_s >= 10.0) & (scene.time_s < 20.0 + 1.0 / 3.0)) | (scene.time_s >= 40.0)
    assert body == pytest.approx(np.outer(on, [1.0, 2.0, 3.0]))


def test_a_list_of_another_length_does_not_fit_its_form() -> None:
    for given in (20.0, np.array([10.0, 20.0])):
        with pytest.raises(MisfitError, match=r"at_s has . numbers; 3 are accepted for this form"):
            bind(replace(SWITCHED, nonlinear={"at_s": given}), flight())


def test_a_list_of_lists_is_refused() -> None:
    text = text_of(model(SWITCHED)).replace("at_s = [", "at_s = [[1.0], [2.0]]  # [")
    with pytest.raises(ModelError, match="one number or a list of them is accepted"):
        parse_model(text.encode())


def test_a_file_keeps_every_bit() -> None:
    """Nine errors, sigmas, spin, notes and effects come back as they were, and the text is the same again."""
    term = replace(drawn(forms()[0])[0], sigma={name: v / 3.0 for name, v in drawn(forms()[0])[0].amplitudes.items()})
    note = Note("nutation", 'says "so"\n\x7f', {"angle_deg": np.array(1.0 / 3.0)})
    whole = model(term, notes=(note,), spin=ModelSpin((0.0, 0.6, 0.8), (1.0, 0.0, 0.0), 0.1 + 0.2))
    again = parse_model(text_of(whole).encode())
    assert text_of(again) == text_of(whole)
    assert (again.x == whole.x).all()
    assert (again.sigma == whole.sigma).all()
    assert (again.origin_ns, again.clock, again.spin, again.notes[0].says) == (
        whole.origin_ns,
        whole.clock,
        whole.spin,
        note.says,
    )


GOOD = text_of(model(drawn(next(h for h in forms() if h.label == "thermal_bias by channel:temperature"))[0]))

FAULTS = (
    ('name = "thermal_bias"', 'name = "thermal_bais"', "effect[0].name", "did you mean 'thermal_bias'?"),
    (
        'driver = "channel:temperature"',
        'driver = "chanel:x"',
        "effect[0].driver",
        'did you mean \'channel:x\'? "none", "channel:NAME"',
    ),
    ('driver = "channel:temperature"', 'driver = "board"', "effect[0].driver", "did you mean 'channel:board'?"),
    ('driver = "channel:temperature"', 'driver = "Infered: temp"', "effect[0].driver", "did you mean 'inferred:temp'?"),
    ('driver = "channel:temperature"', 'driver = "None"', "effect[0].driver", "did you mean 'none'?"),
    ('driver = "channel:temperature"', 'driver = "a:b"', "effect[0].driver", ": 'a:b' is refused; \"none\""),
    ("nt_per_k =", "nt_per_kk =", "effect[0].amplitudes.nt_per_kk", "did you mean 'nt_per_k'?"),
    ("version = 1", "version = 2", "version", "1 is accepted"),
    ('clock = "utc"', 'clock = "gps"', "recording.clock", "utc"),
    ("origin_ns = ", "origin_ns = 1.5 # ", "recording.origin_ns", "whole number"),
    ("origin_ns = ", "origin_ns = 9223372036854775808 # ", "recording.origin_ns", "whole number"),
    ("bias_nt = [", "bias_nt = [7.0, ", "errors.bias_nt", "an array of 3"),
    ("D = [0.05", "D = [-0.99", "errors.D", "eigenvalues"),
    ("column = 0.0", "column = inf", "effect[0].constants.column", "finite"),
    ("column = 0.0", "column = [0.0, 1.0]", "effect[0].constants.column", "one finite number"),
    ("zero_degc", "zero-degc", "effect[0].constants.zero-degc", "a-z"),
    ("[recording]", "colour = 1\n[recording]", "colour", "unknown key"),
)


@pytest.mark.parametrize(("old", "new", "where", "accepted"), FAULTS, ids=[fault[1] for fault in FAULTS])
def test_a_fault_is_named_with_what_is_accepted(old: str, new: str, where: str, accepted: str) -> None:
    """File, field, value and what is accepted, in one line."""
    assert GOOD.count(old) >= 1
    with pytest.raises(ModelError) as caught:
        parse_model(GOOD.replace(old, new, 1).encode())
    lines = [line for line in str(caught.value).splitlines() if line.startswith(f"physics.toml: {where}: ")]
    assert len(lines) == 1
    assert accepted in lines[0]


SPUN = text_of(replace(parse_model(GOOD.encode()), spin=ModelSpin((0.0, 0.6, 0.8), (1.0, 0.0, 0.0), 0.1)))
BEYOND = {
    "spin.axis_body": (SPUN, "axis_body = [0.0, 0.6, 0.8]", "axis_body = [0.0, 0.6, 0.80001]"),
    "spin.axis_eci": (SPUN, "axis_eci = [1.0,", "axis_eci = [2.0,"),
    "spin.rate_rad_s": (SPUN, "rate_rad_s = 0.1", "rate_rad_s = -320.1"),
    "errors.bias_nt": (GOOD, "bias_nt = [", "bias_nt = [1000000.1, 0.0, 0.0] # ["),
    "errors.noise_nt": (GOOD, "noise_nt = ", "noise_nt = -1.0 # "),
    "effect[0].amplitudes.nt_per_k": (GOOD, "nt_per_k = [", f"nt_per_k = {[0.0] * 65} # ["),
}


@pytest.mark.parametrize("where", BEYOND)
def test_a_number_beyond_its_bounds_is_refused(where: str) -> None:
    text, old, new = BEYOND[where]
    assert text.count(old) == 1
    with pytest.raises(ModelError, match=rf"physics.toml: {re.escape(where)}: "):
        parse_model(text.replace(old, new).encode())


def test_an_effect_without_amplitudes_is_refused() -> None:
    with pytest.raises(ModelError, match=r"effect\[0\]\.amplitudes: missing"):
        parse_model(GOOD.partition("[effect.amplitudes]\n")[0].encode())


@pytest.mark.parametrize(("count", "accepted"), [(32, True), (33, False)])
def test_a_file_has_at_most_32_effects(count: int, accepted: bool) -> None:
    term = parse_model(GOOD.encode()).terms[0]
    text = text_of(model(*[term] * count)).encode()
    if accepted:
        assert len(parse_model(text).terms) == count
    else:
        with pytest.raises(ModelError, match=r"^physics.toml: effect: 33 is refused; at most 32"):
            parse_model(text)


def test_a_scene_without_the_driver_is_refused_by_name() -> None:
    """The effect and its driver are said."""
    with pytest.raises(DriverMissingError, match="thermal_bias: driver 'channel:temperature'"):
        effects_on(replace(flight(), channels={}), parse_model(GOOD.encode()))


def test_numbers_of_another_shape_are_refused() -> None:
    """Two amplitudes do not stand for three axes."""
    term = parse_model(GOOD.encode()).terms[0]
    with pytest.raises(MisfitError, match=r"nt_per_k has shape \(2,\); \(3,\) is accepted"):
        effects_on(flight(), model(replace(term, amplitudes={"nt_per_k": np.array([1.0, 2.0])})))


def test_an_external_field_of_before_its_induced_part_was_right_is_refused_with_a_way_on() -> None:
    """What it was fitted with stands in the file; without it its numbers meant another field.  Uniform is taken."""
    induced = next(form for form in forms() if form.label == "external_field")
    text = text_of(model(drawn(induced)[0]))
    assert parse_model(text.encode()).terms[0].constants == {"induced": 0.27}
    old = re.sub(r"\[effect\.constants\]\ninduced = .*\n", "", text)
    with pytest.raises(ModelError, match=r"effect\[0\]\.constants.*induced is required.*diagnose the recording again"):
        parse_model(old.encode())
    uniform = old.replace('driver = "none"\n', 'driver = "none"\nvariant = "uniform"\n')
    assert parse_model(uniform.encode()).terms[0].variant == "uniform"


# A term that is no form of the catalogue is refused where it is read


def refused(term: ModelTerm) -> list[str]:
    with pytest.raises(ModelError) as caught:
        parse_model(text_of(model(term)).encode())
    return str(caught.value).splitlines()


_MAY_BE_MISSING = {"averaged", "turns_between", "smoothed_over", "induced"}
"""Not there stands for 0; and what is refused with words of its own."""


def _is_last(name: str, numbers: Mapping[str, object]) -> bool:
    numbered = [one for one in numbers if re.search(r"_\d+$", one)]
    return bool(numbered) and name == numbered[-1]


@pytest.mark.parametrize("hypothesis", forms(), ids=ids)
def test_a_number_that_a_form_needs_is_missed(hypothesis: Hypothesis) -> None:
    """Each amplitude, nonlinear number and constant by its name, with the effect and the next step.

    Of numbered ones, the columns or faces that a form is of, the last may be missing: it is then a form of fewer.
    """
    term = model_term(hypothesis, theta_of(hypothesis), np.ones(hypothesis.size))
    parts = {"amplitudes": term.amplitudes, "nonlinear": term.nonlinear, "constants": term.constants}
    for part, numbers in parts.items():
        for name in numbers.keys() - _MAY_BE_MISSING:
            left = {one: value for one, value in numbers.items() if one != name}
            if (part == "amplitudes" and not left) or _is_last(name, numbers):
                continue  # a file without any amplitudes is refused before
            lines = refused(replace(term, **{part: left}))
            lacked = [line for line in lines if line.startswith(f"physics.toml: effect[0].{part}.{name}: missing; ")]
            assert lacked or re.search(r"_\d+$", name), lines
            assert all(term.effect in line and line.endswith("made again by magcal diagnose") for line in lines)


@pytest.mark.parametrize("hypothesis", [h for h in forms() if h.variant], ids=ids)
def test_a_form_that_is_not_there_is_refused_with_the_nearest(hypothesis: Hypothesis) -> None:
    """A sign too many stands in its middle."""
    term = model_term(hypothesis, theta_of(hypothesis), np.ones(hypothesis.size))
    half = len(term.variant) // 2
    wrong = f"{term.variant[:half]}~{term.variant[half:]}"
    if wrong == "uni~form":  # what is not uniform needs what it induces, which is asked for first
        term = replace(term, constants={"induced": 0.27})
    (line,) = refused(replace(term, variant=wrong))
    assert line.startswith(f"physics.toml: effect[0].variant: {wrong!r} is refused; of {term.effect}")
    assert "did you mean" in line
    assert term.variant in line


LATE = ModelTerm(
    "current_loop",
    "channel:bus",
    "recorded late",
    {"nt_per_a": np.ones(3)},
    {},
    {"late_s": 1.0, "held_s": 30.0},
    {"column_0": 0.0},
)
SETTLES = ModelTerm(
    "thermal_bias", "inferred:temperature", "settling", {"start_nt_swing": np.ones(3)}, {}, {"time_constant_s": 900.0}
)

NO_FORMS = {
    "a number below those that are sought": (
        replace(LATE, nonlinear={"late_s": 1.0, "held_s": -1.0}),
        "nonlinear.held_s: -1.0 is refused; of current_loop by channel:bus, form 'recorded late', 0 to 60 s is ",
    ),
    "a time constant of 0": (
        replace(SETTLES, nonlinear={"time_constant_s": 0.0}),
        "nonlinear.time_constant_s: 0.0 is refused; of thermal_bias by inferred:temperature, form 'settling', 120 "
        "to 14400 s is ",
    ),
    "a number of another form": (
        replace(LATE, variant=""),
        "nonlinear.late_s: 1.0 is refused; of current_loop by channel:bus, none is accepted",
    ),
    "a constant that nobody reads": (
        replace(LATE, constants={"column_0": 0.0, "colour": 1.0}),
        "constants.colour: 1.0 is refused; of current_loop by channel:bus, form 'recorded late', column_0 is accepted",
    ),
    "another shape": (
        replace(LATE, amplitudes={"nt_per_a": np.ones(4)}),
        "amplitudes.nt_per_a: [1.0, 1.0, 1.0, 1.0] is refused; of current_loop by channel:bus, form 'recorded late', "
        "an array of 3 numbers is accepted",
    ),
    "torquers without the constants that count them": (
        ModelTerm("torquer", "channel:coils", "", {"nt_per_am2": np.ones((2, 3))}, {}, {"decay_s": 0.0}),
        "amplitudes.nt_per_am2: [[1.0, 1.0, 1.0], [1.0, 1.0, 1.0]] is refused; of torquer by channel:coils, "
        "an array of 1 row of 3 numbers is accepted; a row for each of the constants column_0, column_1 ...",
    ),
    "a sigma of another shape": (
        replace(LATE, sigma={"nt_per_a": np.ones(2)}),
        "sigma.nt_per_a: [1.0, 1.0] is refused; of current_loop by channel:bus, form 'recorded late', an array of 3",
    ),
    "a negative sigma": (
        replace(LATE, sigma={"nt_per_a": -np.ones(3)}),
        "sigma.nt_per_a: [-1.0, -1.0, -1.0] is refused; of current_loop by channel:bus, form 'recorded late', a sigma",
    ),
    "a column that no channel has": (
        replace(LATE, constants={"column_0": 16.0}),
        "constants.column_0: 16.0 is refused; a whole number from 0 to 15 is accepted",
    ),
    "a column that is not the form's": (
        replace(LATE, effect="thermal_bias", variant="column 2", nonlinear={}, amplitudes={"nt_per_k": np.ones(3)},
                constants={"zero_degc": 20.0, "column": 0.0}),
        "constants.column: 0.0 is refused; of thermal_bias by channel:bus, form 'column 2', 1 is accepted",
    ),
    "a plain form that is not there": (
        replace(SETTLES, variant=""),
        "variant: missing; of thermal_bias by inferred:temperature, known: answer to light, settling",
    ),
    "a driver that it does not follow": (
        replace(LATE, driver="none"),
        "driver: 'none' is refused; current_loop follows channel:NAME or inferred:array_current",
    ),
    "an effect that is no field": (
        ModelTerm("nutation", "none", "", {"angle_deg": np.array(1.0)}),
        "name: 'nutation' is refused; an effect that acts as a field is accepted; nutation can be a [[note]]",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", NO_FORMS)
def test_what_is_no_form_is_refused_with_what_is(case: str) -> None:
    term, said = NO_FORMS[case]
    (line,) = [line for line in refused(term) if line.startswith(f"physics.toml: effect[0].{said}")]
    assert line.endswith("; correct it, or have the file made again by magcal diagnose")


@pytest.mark.parametrize("term", [LATE, SETTLES], ids=["late", "settles"])
def test_the_forms_that_those_faults_are_made_of_are_accepted(term: ModelTerm) -> None:
    (again,) = parse_model(text_of(model(term)).encode()).terms
    assert again.nonlinear == term.nonlinear


@pytest.mark.parametrize(("driver", "column", "accepted"), [("a", 15, True), ("a", 16, False), ("a+b", 17, True)])
def test_columns_of_several_channels_are_counted_through(driver: str, column: int, accepted: bool) -> None:
    """A file of two channels, of 12 columns and 6, was refused where it is read, whoever made it."""
    told: list[str] = []
    table: Any = SimpleNamespace(refuse=lambda *fault: told.append(str(fault)))
    term: Any = SimpleNamespace(driver=f"channel:{driver}", constants={"column_0": 0.0, "column_1": float(column)})
    assert _check_places(table, term) is accepted
    assert bool(told) is not accepted
