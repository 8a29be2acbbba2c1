"""What every entry of the catalogue keeps to, asked of each one on a scene that has everything recorded."""

from __future__ import annotations

import importlib
import pkgutil
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from magcal_service import physics
from magcal_service.diagnosis.problem import Fit, Problem, Term, evaluate, free_numbers
from magcal_service.model import STATE_SIZE, Array
from magcal_service.physics import effects
from magcal_service.physics.catalogue import catalogue, effect_named
from magcal_service.physics.columns import Columns
from magcal_service.physics.interface import Effect, Hypothesis, Nonlinear, Value, Values, value_of
from magcal_service.physics.scene.vectors import Vectors
from tests.physics.scenes import NOISE_NT, X, arrays, scene, some_numbers, view

NAMES = (
    "thermal_bias",
    "thermal_scale",
    "current_loop",
    "torquer",
    "time_offset",
    "reference_epoch",
    "external_field",
    "position_offset",
    "bias_step",
    "scale_step",
    "bias_drift",
    "scale_drift",
    "tone",
    "cubic_response",
    "saturation",
    "quantisation",
    "sun_disturbance",
    "response_lag",
    "axis_skew",
    "nutation",
    "spin_rate",
    "coloured_noise",
    "hysteresis",
    "stuck_axis",
)
"""What results may hold."""

EFFECTS = pytest.mark.parametrize("effect", catalogue(), ids=lambda effect: effect.name)
FIELDS = pytest.mark.parametrize(
    "effect", [e for e in catalogue() if e.hypotheses(scene())], ids=lambda effect: effect.name
)
NO_FIELD = ("quantisation", "nutation", "spin_rate", "coloured_noise", "stuck_axis")
"""Those of ``NAMES`` that give ``find`` and no columns."""

SUFFIXES = {"nt": "nT", "degc": "degC", "s": "s", "hz": "Hz", "km": "km"}


@cache
def hypotheses(name: str) -> tuple[Hypothesis, ...]:
    """Every way an effect may act on the scene."""
    return tuple(effect_named(name).hypotheses(scene()))


def problem() -> Problem:
    """The scene without noise, so that derivatives are taken where the residual is."""
    return Problem(scene(), 0.0)


def unit_amplitudes(hypothesis: Hypothesis, columns: Columns) -> Array:
    """Amplitudes (k,) of random sign and size, each of about 2 nT in the residual."""
    sizes = np.sqrt(np.mean(columns.along(scene().unit) ** 2, axis=0))
    draws = np.random.default_rng(hypothesis.size).uniform(1.0, 3.0, hypothesis.size)
    return np.asarray(draws * np.where(np.arange(hypothesis.size) % 2, -1.0, 1.0) / np.where(sizes > 0.0, sizes, 1.0))


def with_term(hypothesis: Hypothesis, theta: Array, amplitudes: Array, of: Problem | None = None) -> Fit:
    """The problem at its true nine errors, with one effect."""
    return evaluate(of or problem(), X, [Term(hypothesis, theta, amplitudes)])


def close(found: Array, expected: Array, share: float) -> bool:
    """Whether two arrays differ by less than a share of the second, in the mean square."""
    return float(np.linalg.norm(found - expected)) < share * float(np.linalg.norm(expected))


def test_catalogue_holds_the_names_of_the_list_and_no_other() -> None:
    """Discovery finds the names that results may hold: an effect that is lost, or renamed, is seen."""
    found = {effect.name for effect in catalogue()}
    assert len(found) == len(catalogue()), "two effects have the same name"
    assert found - set(NAMES) == set(), "a new effect: add the name to NAMES here"
    assert set(NAMES) - found == set(), "no file of physics/effects/ defines it: remove the name from NAMES here"


def test_every_effect_lives_in_the_file_of_its_name() -> None:
    """An entry is found where its name says."""
    files = {entry.name for entry in pkgutil.iter_modules(effects.__path__)}
    names = {effect.name for effect in catalogue()}
    assert files == names, "name each file of physics/effects/ as its EFFECT's name, and keep other modules elsewhere"


def test_no_module_of_physics_outside_effects_defines_an_effect() -> None:
    """It would be in no catalogue, and nothing would say so."""
    modules = [entry.name for entry in pkgutil.walk_packages(physics.__path__, f"{physics.__name__}.")]
    elsewhere = [name for name in modules if not name.startswith(f"{effects.__name__}.")]
    assert len(elsewhere) > 10
    strays = [name for name in elsewhere if hasattr(importlib.import_module(name), "EFFECT")]
    assert strays == [], "move the file to physics/effects/, where the catalogue looks"


def test_an_unknown_name_is_refused() -> None:
    """``effect_named`` raises KeyError for what is in no catalogue."""
    with pytest.raises(KeyError):
        effect_named("gremlins")


def test_all_but_a_few_effects_act_as_a_field_here() -> None:
    """On a scene with everything recorded, only what shows in samples, attitude or noise has no columns."""
    without = {effect.name for effect in catalogue() if not hypotheses(effect.name)}
    assert without - set(NO_FIELD) == set(), "no columns on tests/physics/scenes.py: add the name to NO_FIELD here"
    assert set(NO_FIELD) - without == set(), "it has columns: remove the name from NO_FIELD here"


@EFFECTS
def test_entry_says_what_a_reader_needs(effect: Effect) -> None:
    """Title, equation, validity, the separating observation, source and sentences are words; the prior is a range."""
    records = [what for _, what in effect.or_record]
    texts = (effect.title, effect.equation, effect.valid, effect.separated_by, effect.source, *records, *effect.says)
    assert all(text.strip() for text in texts)
    assert effect.says
    assert 0.0 < effect.prior[0] < effect.prior[1]
    assert effect.units
    assert all(effect.units.values())


@EFFECTS
def test_entry_is_confused_with_others_of_the_catalogue(effect: Effect) -> None:
    """Rivals are names of the catalogue, at least one and never the effect's own."""
    others = {other.name for other in catalogue()} - {effect.name}
    assert effect.confused_with, "confused_with needs the name of another effect"
    assert set(effect.confused_with) <= others, "confused_with holds names of other effects only"


@EFFECTS
def test_entry_acts_somewhere(effect: Effect) -> None:
    """An effect is a field, or something that ``find`` looks for."""
    assert hypotheses(effect.name) or effect.find is not None


@FIELDS
def test_every_form_belongs_to_its_effect_and_has_a_label_of_its_own(effect: Effect) -> None:
    """Forms carry the effect's name, a driver of the three kinds, and labels that differ."""
    forms = hypotheses(effect.name)
    assert {form.effect for form in forms} == {effect.name}
    assert all(form.driver == "none" or form.driver.partition(":")[0] in ("channel", "inferred") for form in forms)
    assert len({form.label for form in forms}) == len(forms)


@FIELDS
def test_blocks_take_every_column_once(effect: Effect) -> None:
    """Block sizes sum to the number of columns, for every form; rows are as many as samples, all finite."""
    for form in hypotheses(effect.name):
        columns = form.columns(some_numbers(form))
        assert columns.along(scene().unit).shape == (len(scene()), form.size)
        assert np.isfinite(columns.along(scene().unit)).all()
        assert columns.field(np.ones(form.size)).shape == (len(scene()), 3)


@FIELDS
def test_zero_amplitudes_change_nothing(effect: Effect) -> None:
    """With all amplitudes zero the residual is that of the nine errors, bit for bit."""
    before = evaluate(problem(), X, []).residual
    for form in hypotheses(effect.name):
        fit = with_term(form, some_numbers(form), np.zeros(form.size))
        assert np.array_equal(fit.residual, before)


@FIELDS
def test_columns_are_the_derivative_of_the_residual(effect: Effect) -> None:
    """A few nT of each amplitude move the residual by minus the columns, to a thousandth."""
    for form in hypotheses(effect.name):
        theta = some_numbers(form)
        columns = form.columns(theta)
        amplitudes = unit_amplitudes(form, columns)
        up, down = (with_term(form, theta, sign * amplitudes).residual for sign in (1.0, -1.0))
        assert close((down - up) / 2.0, columns.along(scene().unit) @ amplitudes, 1e-3), form.label


@FIELDS
def test_fit_holds_the_columns_as_derivatives(effect: Effect) -> None:
    """``Fit.columns`` are the nine errors' derivatives, then the effect's columns."""
    for form in hypotheses(effect.name):
        theta = some_numbers(form)
        fit = with_term(form, theta, np.zeros(form.size))
        expected = form.columns(theta).along(scene().unit)
        assert close(fit.columns[:, STATE_SIZE : STATE_SIZE + form.size], expected, 1e-6), form.label


@FIELDS
def test_components_are_the_derivative_of_the_vector_residual(effect: Effect) -> None:
    """In a room, where the residual has three rows a sample, a body field's columns are its components."""
    room = np.broadcast_to(np.eye(3), (len(scene()), 3, 3))
    vector, x = Problem(scene(), 0.0, room), np.concatenate([X, [20e3, 0.0, 30e3]])
    for form in hypotheses(effect.name):
        theta = some_numbers(form)
        columns = form.columns(theta)
        rows = columns.components()
        if rows is None:
            assert columns.magnitude is not None
            continue
        amplitudes = unit_amplitudes(form, columns)
        with_it = evaluate(vector, x, [Term(form, theta, amplitudes)], derivatives=False).residual
        without = evaluate(vector, x, [], derivatives=False).residual
        assert close(without - with_it, rows @ amplitudes, 1e-9), form.label


@FIELDS
def test_derivatives_by_the_nonlinear_numbers_are_those_of_the_residual(effect: Effect) -> None:
    """Moved a little both ways, each free number moves the residual by minus its column.

    To a tenth: a play operator and a knee have corners, which a finite step sees one by one.
    """
    for form in hypotheses(effect.name):
        theta = some_numbers(form)
        amplitudes = unit_amplitudes(form, form.columns(theta))
        term = Term(form, theta, amplitudes)
        fit = with_term(form, theta, amplitudes)
        for number, index in enumerate(free_numbers(term)):
            step = np.zeros(len(theta))
            step[index] = small_step(form.nonlinear[index], float(theta[index]))
            up, down = (with_term(form, theta + sign * step, amplitudes).residual for sign in (1.0, -1.0))
            slope = (down - up) / (2.0 * float(step[index]))
            assert close(fit.columns[:, fit.linear_size + number], slope, 0.1), f"{form.label} {index}"


def small_step(number: Nonlinear, value: float) -> float:
    """A step of a nonlinear number: 0.7 % of it (of one, at zero), or a fiftieth of a turn over the recording."""
    span = float(np.ptp(scene().time_s))
    return {"frequency": 0.02 / span, "period": 0.02 * value**2 / span}.get(number.role, 7e-3 * (value or 1.0))


@FIELDS
def test_every_number_that_may_be_reported_has_its_unit(effect: Effect) -> None:
    """Blocks, nonlinear numbers, derived numbers and constants named after a unit agree with ``Effect.units``."""
    for form in hypotheses(effect.name):
        for block in form.blocks:
            assert effect.units.get(block.name) == block.unit, f"{form.label}: {block.name}"
        for number in form.nonlinear:
            assert effect.units.get(number.name) == number.unit, f"{form.label}: {number.name}"
        for name in form.constants:
            unit = SUFFIXES.get(name.rpartition("_")[2], "1")
            assert effect.units.get(name, "1") == unit, f"{form.label}: {name}"
        for name, value in effect.derived(parameters(form)).items():
            assert effect.units.get(name) == value.unit, f"{form.label}: {name}"


def parameters(form: Hypothesis) -> Values:
    """Parameters as a fit would report them, every amplitude 2 with a sigma of 0.1."""
    found = {b.name: Value(np.full(b.shape, 2.0), np.full(b.shape, 0.1), b.unit, b.labels) for b in form.blocks}
    numbers = some_numbers(form)
    found |= {n.name: value_of(float(v), 0.01, n.unit) for n, v in zip(form.nonlinear, numbers, strict=True)}
    return found | {name: value_of(value, np.nan, "1") for name, value in form.constants.items()}


@FIELDS
def test_every_form_has_a_sentence_with_its_numbers(effect: Effect) -> None:
    """What is said of a form holds numbers, and no brace is left."""
    for form in hypotheses(effect.name):
        given = parameters(form)
        text = effect.sentence({**given, **effect.derived(given)}, form.driver)
        assert any(digit in text for digit in "0123456789"), f"{form.label}: {text}"
        assert "{" not in text


@EFFECTS
def test_scene_is_left_as_it_was(effect: Effect) -> None:
    """Columns, fields and searches write to no array of the scene, nor to the numbers they are given."""
    before = [array.tobytes() for array in arrays(scene())]
    for form in hypotheses(effect.name):
        theta = some_numbers(form)
        theta.flags.writeable = False
        form.columns(theta).field(np.ones(form.size))
    if effect.find is not None:
        effect.find(view(scene()))
    assert [array.tobytes() for array in arrays(scene())] == before


@EFFECTS
def test_same_scene_same_answer(effect: Effect) -> None:
    """A copy of the scene gives the same forms and the same columns, bit for bit."""
    copies = hypotheses(effect.name), tuple(effect.hypotheses(replace(scene())))
    assert [form.label for form in copies[0]] == [form.label for form in copies[1]]
    for one, other in zip(*copies, strict=True):
        rows = [form.columns(some_numbers(form)).along(scene().unit) for form in (one, other)]
        assert np.array_equal(*rows), one.label


@EFFECTS
def test_bare_samples_are_no_fault(effect: Effect) -> None:
    """With samples and magnitudes alone an effect offers what it still can, and looks without failing."""
    bare = replace(
        scene(NOISE_NT), utc=False, reference_eci_nt=None, position_ecef_km=None, channels={}, body_from_eci=None
    )
    for form in effect.hypotheses(bare):
        assert form.driver.partition(":")[0] != "channel"
        assert np.isfinite(form.columns(some_numbers(form)).along(bare.unit)).all()
    assert effect.find is None or effect.find(view(bare)) is None


def test_what_is_worked_out_once_belongs_to_one_recording() -> None:
    """It stays with the scene when that is calibrated anew, and goes when anything else is replaced."""
    first = replace(scene())
    assert first.once("answer", lambda: 42) == 42
    again = first.recalibrated(Vectors(first.calibrated_nt, first.clean_field_nt))
    assert again.once("answer", lambda: 0) == 42
    assert replace(first, magnitude_nt=2.0 * first.magnitude_nt).once("answer", lambda: 0) == 0
