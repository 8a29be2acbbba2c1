"""What a form of several recordings takes over from those that each recording has itself."""

from __future__ import annotations

from dataclasses import fields, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from magcal_service.diagnosis.belief import posterior
from magcal_service.diagnosis.blocks import Gain
from magcal_service.diagnosis.explain import Explained
from magcal_service.diagnosis.joint.catalogue import Forms
from magcal_service.diagnosis.joint.forms import EACH_ITS_OWN, OF_THE_FORM, JointHypothesis, joined
from magcal_service.diagnosis.joint.frozen import frozen
from magcal_service.diagnosis.joint.problem import JointProblem
from magcal_service.diagnosis.joint.words import derived_of_each
from magcal_service.diagnosis.prepare import Form, prepare
from magcal_service.diagnosis.problem import Problem, Term, evaluate, free_numbers
from magcal_service.model import Array
from magcal_service.physics.catalogue import catalogue, effect_named
from magcal_service.physics.columns import Columns
from magcal_service.physics.interface import Block, Effect, Hypothesis, Nonlinear, value_of
from magcal_service.physics.saying import AXES
from magcal_service.recordings.inspect.inspection import inspect
from tests.diagnosis.joint_days import day

COUNTS, OFFSETS, NAMES = (300, 100), (0.0, 5000.0), ("a", "b")
MADE = {"columns", "blocks", "variant", "nonlinear", "proposals", "refines", "samples_in", "moves_s"}
"""What is made anew of the recordings' own columns, amplitudes and times."""

OF_EACH = {"odds", "largest_nt", "least_nt", "inexact", "imitated_by", "as_well", "if_completed", "if_along", "if_none"}
"""What each recording may say otherwise, and is put together: every one of them is tested below."""


def form(count: int, *numbers: Nonlinear, **changes: object) -> Hypothesis:
    """A form of one field of 1 nT along x."""
    columns = Columns(body=np.tile([1.0, 0.0, 0.0], (count, 1))[None])
    return Hypothesis("lag", "channel:bus", lambda _: columns, (Block("nt", "nT", (1,)),), "slow", numbers, **changes)  # type: ignore[arg-type]


def together(
    first: dict[str, object], second: dict[str, object], *numbers: Nonlinear, said: str = ""
) -> JointHypothesis:
    each = [form(n, *numbers, **changes) for n, changes in zip(COUNTS, (first, second), strict=True)]
    return joined(each[0], each, NAMES, COUNTS, OFFSETS, said)


def test_every_field_of_a_form_is_carried_over_made_or_put_together() -> None:
    """A field that is in none of them is one that a joint diagnosis forgets."""
    assert {one.name for one in fields(Hypothesis)} == {*OF_THE_FORM, *MADE, *OF_EACH}
    assert len(OF_THE_FORM) + len(MADE) + len(OF_EACH) == len(fields(Hypothesis))


@pytest.mark.parametrize("name", OF_THE_FORM)
def test_what_a_form_has_by_itself_is_taken_over(name: str) -> None:
    given = "x" if name in ("effect", "driver", "at_once") else {"zero": 1.0} if name == "constants" else True
    each = [replace(form(n), **{name: given}) for n in COUNTS]  # type: ignore[arg-type]
    assert getattr(joined(each[0], each, NAMES, COUNTS, OFFSETS), name) == given


@pytest.mark.parametrize("name", ["as_well", "if_completed", "if_along"])
def test_what_acts_alike_in_any_recording_acts_alike_in_all(name: str) -> None:
    found = together({name: ("heat", "loop")}, {name: ("loop", "sun")})
    assert getattr(found, name) == ("heat", "loop", "sun")


def test_sums_that_tell_a_form_from_another_are_those_of_one_recording() -> None:
    weights = (("sun", np.eye(1)),)
    assert together({"if_none": weights}, {"if_none": weights}).if_none == weights


def test_what_imitates_a_form_in_any_recording_is_said_once() -> None:
    assert together({}, {"imitated_by": "a room"}).exactly_alike == ("unknown",)
    assert together({"imitated_by": "a room"}, {"imitated_by": "a room"}).imitated_by == "a room"
    assert together({"imitated_by": "a room"}, {"imitated_by": "a coil"}).imitated_by == "a room or a coil"


def test_a_form_is_as_unlikely_as_inexact_and_as_large_as_in_any_recording() -> None:
    found = together(
        {"odds": 2.0, "inexact": 0.1, "largest_nt": 50.0}, {"odds": 3.0, "inexact": 0.3, "largest_nt": 70.0}
    )
    assert (found.odds, found.inexact, found.largest_nt) == (3.0, 0.3, 70.0)


def test_what_a_form_has_at_least_is_that_over_the_samples_of_all() -> None:
    assert together({"least_nt": 20.0}, {}).least_nt == pytest.approx(20.0 * np.sqrt(0.75))
    assert together({"least_nt": 20.0}, {"least_nt": 20.0}).least_nt == pytest.approx(20.0)


@pytest.mark.parametrize(
    ("refines", "said", "label"),
    [
        ("", EACH_ITS_OWN, ""),
        ("lag by channel:bus", "", "lag by channel:bus"),
        ("lag by channel:bus", EACH_ITS_OWN, "lag[each its own] by channel:bus"),
        ("lag[plain, by steps] by channel:bus", EACH_ITS_OWN, "lag[plain, by steps, each its own] by channel:bus"),
        ("lag[plain]", EACH_ITS_OWN, "lag[plain, each its own]"),
    ],
)
def test_the_form_that_one_refines_is_that_of_all_recordings(refines: str, said: str, label: str) -> None:
    assert together({"refines": refines}, {"refines": refines}, said=said).refines == label


def test_samples_that_see_a_change_are_those_of_its_own_recording() -> None:
    edges = [Nonlinear(name, "s", np.array([10.0, 90.0]), role="edge") for name in ("from_s", "to_s")]

    def between(theta: Array) -> int:
        return round(theta[1] - theta[0]) if theta[1] < 100.0 else 0

    part = form(COUNTS[1], *edges, samples_in=between, in_place=True)
    found = joined(part, [None, part], NAMES, COUNTS, OFFSETS, "in b", solo="b")
    assert found.samples_in is not None
    assert found.samples_in(np.array([5020.0, 5023.0])) == 3
    assert found.is_quickest(np.array([5020.0, 5023.0]))
    assert not found.is_quickest(np.array([5020.0, 5060.0]))
    assert together({}, {}).samples_in is None


def test_a_reference_is_moved_in_each_recording_by_its_own_amplitudes() -> None:
    given = {"moves_s": lambda a: 2.0 * a[0]}
    own = together(given, given, said=EACH_ITS_OWN).moves_s
    assert own is not None
    assert own(np.array([1.0, 3.0])).tolist() == [2.0] * 300 + [6.0] * 100
    one = together(given, {}).moves_s
    assert one is not None
    assert one(np.array([1.0])).tolist() == [2.0] * 300 + [0.0] * 100
    assert together({}, {}).moves_s is None


def test_a_reference_that_known_numbers_move_is_moved_by_them() -> None:
    part = form(COUNTS[0], moves_s=lambda a: 2.0 * a[0])
    alone = joined(part, [part], NAMES[:1], COUNTS[:1], OFFSETS[:1])
    (held,) = frozen(alone, Term(alone, np.zeros(0), np.array([4.0]))).parts
    assert held is not None
    assert held.moves_s is not None
    assert held.moves_s(np.zeros(0)) == 8.0


def test_a_time_constant_stays_one_where_a_refit_moves_it() -> None:
    """A change is moved to the clock of its recording; how long it takes is the same on every clock."""
    numbers = (
        Nonlinear("from_s", "s", np.array([10.0, 90.0]), role="edge"),
        Nonlinear("time_constant_s", "s", np.array([5.0, 50.0])),
    )
    part = form(COUNTS[1], *numbers)
    found = joined(part, [None, part], NAMES, COUNTS, OFFSETS, "in b", solo="b")
    for one in (found, found.loosened(), found.holding(1)):
        assert one.theta_of(1, np.array([5020.0, 30.0])).tolist() == [20.0, 30.0]


def test_a_number_that_is_held_is_held_in_every_recording() -> None:
    lag = Nonlinear("lag_s", "s", np.array([1.0, 2.0]))
    found = together({}, {}, lag).holding(0)
    for number in range(2):
        own = found.term_of(number, Term(found, np.ones(1), np.ones(1)))
        assert own is not None
        assert free_numbers(own) == free_numbers(Term(found, np.ones(1), np.ones(1))) == []


@pytest.fixture(scope="module")
def parts() -> list[Problem]:
    days = [day(k, np.zeros(3), np.zeros(3), seed=975) for k in range(2)]
    inspections = [inspect(one.recording) for one in days]
    return [prepare(one.to_diagnose, catalogue(), (Form.ROOM, Form.SCALAR), 1).problem for one in inspections]


def test_every_form_that_another_refines_is_one_of_all_recordings(parts: list[Problem]) -> None:
    found = Forms.of(catalogue(), parts).on(parts, NAMES)
    refining = [one for one in found if one.refines]
    assert {one.variant for one in refining} >= {"recorded late", "recorded late, each its own"}
    assert {one.refines for one in refining} <= {one.label for one in found}


def test_what_forms_say_by_the_data_is_said_under_constants_of_all_as_well(parts: list[Problem]) -> None:
    """A record in percent that changes as slowly as warmth does."""
    slow = [replace(next(iter(part.scene.channels.values())), name="fan", quantity="fraction") for part in parts]
    given = [
        replace(part, scene=replace(part.scene, channels={**part.scene.channels, "fan": one}))
        for part, one in zip(parts, slow, strict=True)
    ]
    found = Forms.of(catalogue(), given).on(given, NAMES)
    (fan,) = [one for one in found if (one.driver, one.variant) == ("channel:fan", "")]
    assert fan.as_well == ("thermal_bias",)


@pytest.mark.parametrize("effect", catalogue(), ids=lambda one: one.name)
def test_what_is_of_one_recording_is_never_common(parts: list[Problem], effect: Effect) -> None:
    """A drift begins with the first sample, and the ring current has another strength every day."""
    found = [one for one in Forms.of([effect], parts).on(parts, NAMES) if not one.solo]
    common = [one.label for one in found if not one.is_each_its_own]
    assert effect.of_one_recording is (effect.name in ("bias_drift", "scale_drift", "external_field"))
    assert bool(common) is (bool(found) and not effect.of_one_recording)
    alone = Forms.of([effect], parts[:1]).on(parts[:1], NAMES[:1])
    assert not any(one.is_each_its_own for one in alone)


@pytest.mark.parametrize(
    ("first", "second", "share"),
    [
        ("bias_step[in a]", "scale_step[in a]", True),
        ("bias_step[in a]", "scale_step[in b]", False),
        ("bias_step[in a]", "bias_drift[each its own]", True),
        ("bias_drift[each its own]", "bias_step[in a]", False),
        ("bias_step[in a]", "thermal_bias by channel:board", False),
    ],
)
def test_two_names_without_a_record_share_an_orbit_in_their_recordings(
    parts: list[Problem], first: str, second: str, share: bool
) -> None:
    """Each recording takes 5000 s, two of them more than an orbit of 5700 s."""
    known = {one.label: one for one in Forms.of(catalogue(), parts).on(parts, NAMES)}
    terms = [
        Term(form, np.array([number.grid[3] for number in form.nonlinear]), np.ones(form.size))
        for form in (known[first], known[second])
    ]
    fit = evaluate(JointProblem.of(parts), np.zeros(18), terms)
    steady = (Gain(100.0, 1.0, 50, 50),) * 2
    believed = posterior(Explained(fit, ((), ()), (100.0, 100.0), steady), 0)
    assert (dict(believed.rivals)["unknown"] >= 0.3) is share


# What is derived from numbers that each recording has its own

DERIVED: dict[str, dict[str, tuple[list[float], str]]] = {
    "axis_skew": {"after_x_s": ([0.01, 0.02], "s")},
    "tone": {"cosine_nt": ([3.0, 0.0, 4.0], "nT"), "sine_nt": ([0.0, 12.0, 0.0], "nT")},
    "response_lag": {"tau2_s2": ([0.04], "s2")},
    "torquer": {"nt_per_am2": ([1.0, 2.0, 3.0], "nT/(A m2)")},
}


@pytest.mark.parametrize("name", DERIVED)
def test_what_is_derived_is_derived_of_each_recording(name: str) -> None:
    """It is what each has by itself, along a first axis; an effect knows nothing of several recordings."""
    effect = effect_named(name)
    blocks = {key: (np.squeeze(np.array(numbers)), unit) for key, (numbers, unit) in DERIVED[name].items()}
    if name == "torquer":
        blocks = {key: (np.arange(9.0).reshape(3, 3), unit) for key, (_, unit) in blocks.items()}
    labels = (AXES[1:],) if name == "axis_skew" else ()
    own = (
        {
            key: replace(value_of(k * numbers, 0.1 * k * numbers + 0.1, unit), labels=labels)
            for key, (numbers, unit) in blocks.items()
        }
        for k in (1.0, 2.0)
    )
    single = [effect.derived(each) for each in own]
    fitted = {
        key: replace(
            value_of(np.stack([numbers, 2.0 * numbers]), np.stack([0.1 * numbers + 0.1, 0.2 * numbers + 0.1]), unit),
            labels=(("one", "other"), *labels),
        )
        for key, (numbers, unit) in blocks.items()
    }
    form: Any = SimpleNamespace(own=frozenset(blocks))
    found = derived_of_each(effect, form, fitted)
    assert set(found) == set(single[0])
    for key, value in found.items():
        assert value.value == pytest.approx(np.stack([each[key].value for each in single]))
        assert value.sigma == pytest.approx(np.stack([each[key].sigma for each in single]))
        assert value.labels[0] == ("one", "other")


def test_what_is_derived_of_common_numbers_is_as_of_one_recording() -> None:
    effect = effect_named("axis_skew")
    fitted = {"after_x_s": replace(value_of([0.01, 0.02], [1e-3, 2e-3], "s"), labels=(AXES[1:],))}
    form: Any = SimpleNamespace(own=frozenset({"start_nt"}))
    assert derived_of_each(effect, form, fitted)["delay_s"].value.tolist() == [0.0, 0.01, 0.02]
