"""A joint diagnosis in words: the verdict, what is common, how well each recording is predicted, and the summary."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from magcal_service.diagnosis.belief import posterior
from magcal_service.diagnosis.diagnose import Verdict
from magcal_service.diagnosis.doubts import SURE, added_noise_nt
from magcal_service.diagnosis.first import why_first
from magcal_service.diagnosis.joint.compare import Predicted, Shared
from magcal_service.diagnosis.joint.diagnose import Alone, JointDiagnosis
from magcal_service.diagnosis.joint.forms import OF_CHANGES, JointHypothesis, joint
from magcal_service.diagnosis.joint.levels import Levels, bias_moved_nt, levels_of_all, levels_of_each
from magcal_service.diagnosis.joint.light import light_lines
from magcal_service.diagnosis.parameters import fitted_numbers
from magcal_service.diagnosis.summary import reason_lines, verdict_line
from magcal_service.diagnosis.which_driver import drivers_of
from magcal_service.diagnosis.words import (
    IN_DOUBT,
    agreed,
    alternatives,
    chance,
    explained_share,
    listed,
    nameless,
    noise_in_words,
    open_between,
    percent,
    remaining,
    titles,
)
from magcal_service.physics.apply.advice import advice
from magcal_service.physics.interface import START, Effect, Values, by_name

ONE_ALONE: Final = (
    "numbers of one recording alone are of the same form, with the constants of all recordings, fitted to that one; a "
    "diagnosis of it by itself chooses form and constants anew, so its numbers may differ by more than their sigma"
)
"""What stands as a recording's own numbers beside those of all."""


def effect_of(diagnosis: JointDiagnosis, index: int) -> Effect:
    """The catalogue's entry of a term."""
    name = diagnosis.fit.terms[index].hypothesis.effect
    return next(effect for effect in diagnosis.effects if effect.name == name)


def parameters(diagnosis: JointDiagnosis, index: int) -> Values:
    """The numbers of a term with 1 sigma, without start states; an instant on the clock of its own recording.

    A number that differs between recordings is no better known than it differs.
    """
    term = diagnosis.fit.terms[index]
    form = joint(term)
    effect = effect_of(diagnosis, index)
    fitted = fitted_numbers(diagnosis.fit, index, effect)
    found = {**fitted, **derived_of_each(effect, form, fitted)}
    acting = next(k for k, name in enumerate(form.names) if form.acts_on(name))
    times = {number.name for number in form.nonlinear if number.role in OF_CHANGES}
    for name, own in by_name(form.nonlinear, form.theta_of(acting, term.theta)).items():
        if name in times:
            found[name] = replace(found[name], value=np.asarray(own))
    return {
        name: replace(value, sigma=diagnosis.compared.spread(index, name) * value.sigma)
        for name, value in found.items()
        if not name.startswith(START)
    }


def derived_of_each(effect: Effect, form: JointHypothesis, fitted: Values) -> Values:
    """What is derived from a form's numbers; where those are each recording's own, of each, along a first axis."""
    first = [name for name in form.own if not name.startswith(START)]
    if not first:
        return effect.derived(fitted)
    names = fitted[first[0]].labels[0]
    each = [effect.derived(_of_one(fitted, names, number)) for number in range(len(names))]
    return {
        name: replace(
            one,
            value=np.stack([derived[name].value for derived in each]),
            sigma=np.stack([derived[name].sigma for derived in each]),
            labels=(names, *one.labels),
        )
        for name, one in each[0].items()
        if all(name in derived for derived in each)
    }


def _of_one(values: Values, names: tuple[str, ...], number: int) -> Values:
    """Numbers as one recording has them: of those that have a first axis over the recordings ``names``, its own."""
    return {
        name: replace(one, value=one.value[number], sigma=one.sigma[number], labels=one.labels[1:])
        if one.labels[:1] == (names,)
        else one
        for name, one in values.items()
    }


def says(diagnosis: JointDiagnosis, index: int) -> str:
    """What a term is, in a sentence with its numbers, or in one for each recording that has its own."""
    form = joint(diagnosis.fit.terms[index])
    others = [driver for driver, _ in drivers(diagnosis, index) if driver != form.driver]
    effect, values = effect_of(diagnosis, index), parameters(diagnosis, index)
    own = [values[name].labels[0] for name in form.own if name in values]
    if form.common or form.solo or not own:
        sentence = effect.sentence(values, form.driver, others)
        return f"In {form.solo}: {sentence}" if form.solo else sentence
    of_each = (effect.sentence(_of_one(values, own[0], k), form.driver, others) for k in range(len(own[0])))
    return " ".join(f"In {name}: {sentence}" for name, sentence in zip(own[0], of_each, strict=True))


def drivers(diagnosis: JointDiagnosis, index: int) -> tuple[tuple[str, float], ...]:
    """Drivers of a term that the recordings cannot tell apart, with their probabilities; empty where it has none."""
    has_none = diagnosis.fit.terms[index].hypothesis.driver == "none"
    return () if has_none else drivers_of(diagnosis.explained, index)


def record_next(diagnosis: JointDiagnosis, index: int) -> str:
    """What to record otherwise of a term's driver, as a request; empty where nothing."""
    driver = diagnosis.fit.terms[index].hypothesis.driver
    return effect_of(diagnosis, index).next_record(parameters(diagnosis, index), driver)


def separated_by(diagnosis: JointDiagnosis, index: int) -> str:
    """What would tell a term from its rivals, beside what every recording has."""
    of_each = (one.prepared.problem.scene.quantities for one in diagnosis.recordings)
    return effect_of(diagnosis, index).separation(set.intersection(*of_each))


def sentence(diagnosis: JointDiagnosis) -> str:
    """The verdict in one plain sentence: what is common, and what each recording has itself."""
    if diagnosis.verdict is Verdict.NONE:
        levels = levels_of_all(diagnosis)
        model_nt = _field_model_nt(diagnosis)
        left_nt = levels.held_out_nt[1]
        memory_nt = levels.in_sample_nt[1] if any(one.memory_nt for one in diagnosis.recordings) else None
        return agreed(left_nt, levels.noise_nt, model_nt, diagnosis.reasons, "recordings", memory_nt)
    terms = list(enumerate(diagnosis.fit.terms))
    if diagnosis.verdict is Verdict.UNKNOWN:
        doubted = [one.name for one in diagnosis.recordings if one.inspection.open]
        if doubted:
            return f"{IN_DOUBT} It is {listed(doubted)}."
        titles = [effect_of(diagnosis, k).title for k, _ in terms]
        return nameless(diagnosis.unexplained, "", list(dict.fromkeys(titles)))
    common = [_title(diagnosis, k) for k, term in terms if joint(term).common]
    own = [_title(diagnosis, k) for k, term in terms if not joint(term).common and not joint(term).solo]
    alone = [f"in {joint(term).solo} alone: {_title(diagnosis, k)}" for k, term in terms if joint(term).solo]
    parts = [f"{len(diagnosis.recordings)} recordings have in common {listed(common)}"] if common else []
    parts += [f"each recording has numbers of its own for {listed(own)}"] if own else []
    share = [explained_share(diagnosis.left_share)] if terms else []
    text = "; ".join([*parts, *alone, *_seen(diagnosis), *share])
    return f"{text[0].upper()}{text[1:]}."


def _seen(diagnosis: JointDiagnosis) -> list[str]:
    """What samples show by themselves, each with the recordings that show it."""
    known, each = titles(diagnosis.effects), diagnosis.recordings
    names = dict.fromkeys(name for one in each for name in one.prepared.findings)
    return [
        f"in {listed([one.name for one in each if name in one.prepared.findings])}: {known[name]}" for name in names
    ]


def _title(diagnosis: JointDiagnosis, index: int) -> str:
    """What a term is; where its name is not sure, all that it may be."""
    known, name = titles(diagnosis.effects), diagnosis.fit.terms[index].hypothesis.effect
    believed = posterior(diagnosis.explained, index)
    may_be = alternatives(name, believed.own, believed.rivals, believed.members)
    if believed.own >= SURE or len(may_be) == 1:
        return known[name]
    return f"something whose name is open, {open_between(may_be, known)}"


def _field_model_nt(diagnosis: JointDiagnosis) -> float | None:
    """rms that the field model may err by [nT], the largest of the recordings; None where that counts in none."""
    errors = [one.baseline.problem.field_error for one in diagnosis.recordings]
    return max((error.may_be_nt for error in errors if error is not None), default=None)


def summary(diagnosis: JointDiagnosis, files: Sequence[Path]) -> list[str]:
    """What was found, what is common, how well each recording is predicted, and where the files are."""
    against = advice(diagnosis.reasons, diagnosis.concerned)
    lines = [
        verdict_line(diagnosis.verdict, diagnosis.reasons),
        *reason_lines(against),
        f"  {sentence(diagnosis)}",
    ]
    for index, term in enumerate(diagnosis.fit.terms):
        lines.append(f"  {term.hypothesis.effect}: {commonness(diagnosis, index)}; {name_in_words(diagnosis, index)}")
        lines.append(f"    {says(diagnosis, index)}")
    lines += [f"  {line}" for line in shared_lines(diagnosis)]
    lines += [f"  {line}" for line in predicted_lines(diagnosis) if diagnosis.fit.terms]
    lines += [f"  {one.name}: {line}" for one in diagnosis.recordings for line in one.made_where]
    lines += [f"  {line}" for line in samples_lines(diagnosis)]
    lines += [f"  {line}" for line in light_lines(diagnosis.recordings, diagnosis.explained)]
    lines += _level_lines(diagnosis)
    if diagnosis.verdict is not Verdict.UNKNOWN or sentence(diagnosis) == IN_DOUBT:  # else the sentence has said it
        lines.append(f"left: {remaining(diagnosis)}")
    lines += ["files: " + ", ".join(str(path) for path in files)] if files else []
    return lines


def _level_lines(diagnosis: JointDiagnosis) -> list[str]:
    """How much better each recording fits by the effects, and all of them."""
    each, total = levels_of_each(diagnosis), levels_of_all(diagnosis)
    moved = [f"; the effects move its bias by {nt:.1f} nT" for nt in bias_moved_nt(diagnosis)]
    lines = [
        f"{_levels(one.name, levels)} {noise_of_one(one)}{more if diagnosis.fit.terms else ''}"
        for one, levels, more in zip(diagnosis.recordings, each, moved, strict=True)
    ]
    return [*lines, f"{_levels('all', total)} {total.noise_nt:.1f} nT"]


def _levels(name: str, levels: Levels) -> str:
    before_nt, after_nt = levels.held_out_nt
    return f"{name}: rms on held-out rows {before_nt:.1f} nT recalibrated, {after_nt:.1f} nT with effects; noise"


def noise_of_one(one: Alone) -> str:
    """The noise of a recording, and whose it is."""
    prepared = one.prepared
    added_nt = added_noise_nt(prepared.findings)
    return noise_in_words(one.noise_nt, prepared.view.stated_noise_nt is not None, added_nt, one.memory_nt)


def name_in_words(diagnosis: JointDiagnosis, index: int) -> str:
    """How sure a term's name is; where it is not, with the probabilities of what else it may be, and why the likeliest
    did not take its place where that is another."""
    name, believed = diagnosis.fit.terms[index].hypothesis.effect, posterior(diagnosis.explained, index)
    if believed.own >= SURE:
        return f"probability {chance(believed.own)}"
    others = [pair for pair in alternatives(name, believed.own, believed.rivals, believed.members) if pair[0] != name]
    may_be = ", ".join([f"name open: {chance(believed.own)} this", *(f"{chance(p)} {other}" for other, p in others)])
    return "; ".join(filter(None, (may_be, why_first(diagnosis.explained, index))))


def commonness(diagnosis: JointDiagnosis, index: int) -> str:
    """Whether an effect is common to all recordings."""
    form: JointHypothesis = joint(diagnosis.fit.terms[index])
    if form.solo:
        return f"in {form.solo} alone"
    return "common to all" if form.common else "not common: each recording has numbers of its own"


def shared_lines(diagnosis: JointDiagnosis) -> list[str]:
    """One line for each number: whether the recordings agree in it."""
    return [f"{one.effect} {one.parameter}: {agreement(diagnosis, one)}" for one in diagnosis.compared.shared]


def agreement(diagnosis: JointDiagnosis, one: Shared) -> str:
    """Whether the recordings agree in a number, with the evidence."""
    by_chance = f"the largest difference comes by chance in {percent(one.probability)}"
    if one.agrees:
        return f"shared ({by_chance})"
    if not diagnosis.compared.is_common(one.index):
        return f"not shared ({by_chance})"
    return (
        f"shared, but the recordings differ by more than their sigma ({by_chance}); the others' numbers do "
        f"{percent(diagnosis.compared.kept(one.index))} of what the recordings' own would"
    )


def samples_lines(diagnosis: JointDiagnosis) -> list[str]:
    """One line for each thing that a recording's own samples, turn or noise show, whatever the verdict is."""
    effects = {effect.name: effect for effect in diagnosis.effects}
    seen = [(one.name, name, found) for one in diagnosis.recordings for name, found in one.prepared.findings.items()]
    return [f"{of}: {name}: {effects[name].sentence(found.parameters, found.driver)}" for of, name, found in seen]


def predicted_lines(diagnosis: JointDiagnosis) -> list[str]:
    """One line for each recording: what the others' numbers do for it."""
    return [f"{one.name}: {prediction(one)}" for one in diagnosis.compared.predicted]


def prediction(one: Predicted) -> str:
    """What the other recordings' numbers do for one, in words."""
    besides = "" if one.without_nt == one.nine_nt else f", {one.without_nt:.0f} with what is not common besides"
    levels = (
        f"{one.nine_nt:.0f} nT with nine errors{besides}, {one.predicted_nt:.0f} predicted, "
        f"{one.own_nt:.0f} by its own fit"
    )
    if one.predicted_nt > one.without_nt:
        return f"{levels}; the others' numbers make it worse"
    if not one.shows:
        return f"{levels}; it shows too little to be predicted"
    return f"{levels}; predicted from the others, {percent(max(one.kept, 0.0))} of its own fit's gain is kept"
