"""A diagnosis in plain words, the same in the terminal and in the report."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Final, Protocol

from magcal_service.diagnosis.diagnose import Diagnosis, Verdict
from magcal_service.diagnosis.doubts import LITTLE_LEFT, SURE
from magcal_service.diagnosis.empirical.curves import unit_of
from magcal_service.diagnosis.empirical.modelled import Modelled
from magcal_service.diagnosis.entry import Entry
from magcal_service.diagnosis.reference_off import reference_off_of
from magcal_service.diagnosis.separation import Separation
from magcal_service.physics.apply.advice import RECORDING
from magcal_service.physics.apply.empirical import Empirical
from magcal_service.physics.drivers.computed import COMPUTED
from magcal_service.physics.interface import UNLISTED, Effect

_NATS_PER_DECADE: Final = math.log(10.0)
_MOST_DECADES: Final = 12
"""Odds are not stated beyond 10^12: no model of the noise holds so far out."""

_MOST_LISTED: Final = 3
"""Names in one sentence; choice: more are a list, and it is elsewhere."""


def odds(nats: float) -> str:
    """Evidence [nats] as odds: ``"odds of 160 000 to 1"``, from 10^12 on ``"odds beyond 10^12 to 1"``."""
    decades = nats / _NATS_PER_DECADE
    if decades >= _MOST_DECADES:
        return f"odds beyond 10^{_MOST_DECADES} to 1"
    if decades >= 6.0:
        return f"odds of about 10^{decades:.0f} to 1"
    value = math.exp(max(nats, 0.0))
    digits = max(0, int(math.log10(value)) - 1)
    return f"odds of {round(value, -digits):,.0f} to 1".replace(",", " ")


def strength(nats: float) -> str:
    """Significance [nats] in a word."""
    if nats > _MOST_DECADES * _NATS_PER_DECADE:
        return "beyond doubt"
    if nats > 12.0:
        return "very strong"
    return "clear" if nats > 7.0 else "weak"


def percent(share: float) -> str:
    """A share from 0 to 1 as a percentage that never rounds to a certainty."""
    if 0.0 < share < 0.001:
        return "< 0.1 %"
    if 0.999 < share < 1.0:
        return "> 99.9 %"
    return f"{100.0 * share:.3g} %"


def chance(probability: float) -> str:
    """A probability as a percentage that is never a certainty."""
    return percent(min(probability, 0.99999))


def titles(effects: Sequence[Effect]) -> dict[str, str]:
    """What each effect of the catalogue is, by name, and what is in none."""
    return {effect.name: effect.title for effect in effects} | {UNLISTED: "something that is in no catalogue"}


IN_DOUBT: Final = "Recording and reference disagree, but the recording itself is in doubt: no physics is named from it."
"""The verdict while something has to be answered about the recording."""


def agreed(
    left_nt: float,
    noise_nt: float,
    model_nt: float | None,
    reasons: Sequence[str],
    compared: str = "recording",
    memory_nt: float | None = None,
) -> str:
    """The verdict where nothing is left out.

    Parameters
    ----------
    left_nt: rms on data that took no part in the fit [nT].
    noise_nt, model_nt: noise of the sensor, and rms that the field model may err by, where that counts [nT].
    reasons: what speaks against acting on it: more may be left than the noise, or than field models usually err by.
    compared: what the model agrees with.
    memory_nt: rms of the noise with its memory [nT], where it has one.
    """
    model = "" if model_nt is None else f", and {model_nt:.1f} nT that the field model may err by"
    over = f"a noise of {noise_nt:.1f} nT"
    if memory_nt is not None:
        over += f" that has a memory and makes {memory_nt:.1f} nT with it"
    if "noisier_than_stated" in reasons:
        return (
            f"The calibrated model and the {compared} differ by more than the stated noise, and nothing shows by what: "
            f"{left_nt:.1f} nT are left on data that took no part in the fit, over {over}{model}."
        )
    if "field_model_doubtful" in reasons:
        return (
            f"Nothing that has a form was left out, and the calibrated model and the {compared} differ by more than "
            f"field models usually err by: {left_nt:.1f} nT are left on data that took no part in the fit, over {over}."
        )
    return (
        f"The calibrated model and the {compared} agree to the noise: {left_nt:.1f} nT are left on data that "
        f"took no part in the fit, over {over}{model}."
    )


def nameless(unexplained: float, sized: str, titles: Sequence[str]) -> str:
    """The verdict where most has no name: the share without one, how large that is, and what has a name besides."""
    besides = f"; named beside it: {listed(titles)}" if titles else ""
    return (
        f"Something without a name makes {percent(unexplained)} of the mismatch{sized}: "
        f"no effect of the catalogue explains it{besides}."
    )


def noise_in_words(noise_nt: float, is_stated: bool, added_nt: float = 0.0, memory_nt: float | None = None) -> str:
    """The noise that residuals are held against, whose it is, and what rounding has to do with it.

    Parameters
    ----------
    noise_nt: 1 sigma per axis [nT].
    is_stated: whether the descriptor states it; else it is the white part of what is left, of which rounding is one.
    added_nt: what rounding that was found adds [nT per axis].
    memory_nt: its rms with its memory [nT], where it has one.
    """
    memory = "" if memory_nt is None else f", {memory_nt:.1f} nT with its memory"
    if not is_stated:
        return f"{noise_nt:.1f} nT estimated{', rounding included' * (added_nt > 0.0)}{memory}"
    more = f"; rounding adds up to {added_nt:.1f} nT to it" if added_nt > 0.0 else ""
    return f"{noise_nt:.1f} nT stated{more}{memory}"


def noise_of(diagnosis: Diagnosis) -> str:
    """The same of a diagnosis of one recording."""
    is_stated, added_nt = diagnosis.prepared.view.stated_noise_nt is not None, diagnosis.added_noise_nt
    return noise_in_words(diagnosis.noise_nt, is_stated, added_nt, diagnosis.memory_nt)


def compared_with(*, has_simulation: bool) -> str:
    """What is neither calibrated anew nor has effects, as it stands behind its level."""
    return "simulation" if has_simulation else "as calibrated on the first half"


def not_borne_out(diagnosis: Diagnosis) -> str:
    """By what was compared where whole vectors were not borne out, and why; empty where they were, or there are none.

    An attitude that errs and samples of another time than the attitude beside them leave the same.
    """
    if not diagnosis.refused:
        return ""
    if diagnosis.prepared.has_reference_far_off:
        return f"{diagnosis.prepared.form}, as whole vectors need a reference far off"
    why = "the recorded attitude errs, its axes are turned, or samples are tagged apart from it"
    return f"{diagnosis.prepared.form}, as whole vectors leave more: {why}"


def explained_share(unexplained: float) -> str:
    """How much of the mismatch the names explain; where nothing is seen beside them, no share is claimed."""
    if unexplained == 0.0:
        return "what is left of the mismatch is not seen in the noise"
    return f"{percent(1.0 - unexplained)} of the mismatch is explained"


def verdict_sentence(diagnosis: Diagnosis, found: Sequence[Entry], held_out: Mapping[str, float]) -> str:
    """The verdict in one plain sentence: the cause and its size, or what is left without a name; and in a second one
    what the reference vector is off by, where that is certain."""
    said, off = _verdict_alone(diagnosis, found, held_out), reference_off_of(diagnosis.fit)
    return said if off is None or not off.is_certain or diagnosis.inspection.open else f"{said} {off}"


def _verdict_alone(diagnosis: Diagnosis, found: Sequence[Entry], held_out: Mapping[str, float]) -> str:
    if diagnosis.verdict is Verdict.NONE:
        problem = diagnosis.fit.problem
        error = problem.field_error
        model_nt = None if error is None else error.may_be_nt
        left_nt, memory_nt = held_out["with_effects"], diagnosis.memory_nt
        return agreed(left_nt, diagnosis.noise_nt, model_nt, diagnosis.reasons, memory_nt=memory_nt)
    known = titles(diagnosis.effects)
    named = [entry for entry in found if entry.effect != UNLISTED]
    if diagnosis.verdict is Verdict.UNKNOWN:
        if diagnosis.inspection.open:
            return IN_DOUBT
        besides = list(dict.fromkeys(known[entry.effect] for entry in named))
        return nameless(diagnosis.unexplained, _sized(found), besides)
    first, others = named[0], named[1:]
    beside = listed(list(dict.fromkeys(_beside(entry, known) for entry in others if entry.effect != first.effect)))
    unsized = first.effect in diagnosis.concerned.get("size_uncertain", ())
    cause = cause_sentence(first, known).removesuffix(".") + (", a size that this recording does not fix" * unsized)
    cause += f"; beside it {beside}" if beside else ""
    if not diagnosis.fit.terms:
        return f"{cause}."
    return f"{cause}; {explained_share(diagnosis.left_share)}."


def _beside(entry: Entry, known: Mapping[str, str]) -> str:
    """What an effect is, where another is the first; where its name is not sure, how sure and what is likelier."""
    if entry.probability >= SURE:
        return known[entry.effect]
    rival, probability = _likeliest(entry)
    likelier = f"; {chance(probability)} {rival}" if probability > entry.probability else ""
    return f"{known[entry.effect]} (name open: {chance(entry.probability)}{likelier})"


def cause_sentence(entry: Entry, known: Mapping[str, str]) -> str:
    """What an effect is and how large; where its name is not sure, all that it may be, the likeliest first."""
    known = {**known, UNLISTED: entry.unlisted or known.get(UNLISTED, UNLISTED)}
    may_be = alternatives(entry.effect, entry.probability, entry.rivals, entry.members)
    if entry.probability >= SURE or len(may_be) == 1:
        return entry.says
    says = f"{entry.says[:1].lower()}{entry.says[1:]}"
    why = f"The numbers are those of {entry.effect}: {entry.why_first}. " if entry.why_first else ""
    return f"The name is open: {open_between(may_be, known)}. {why}If {entry.effect}: {says}"


def alternatives(
    effect: str, probability: float, rivals: Sequence[tuple[str, float]], members: Sequence[str]
) -> list[tuple[str, float]]:
    """All that an effect may be, with probabilities, likeliest first: it, its class, and rivals that make it unsure."""
    likeliest = max((p for _, p in rivals), default=0.0)
    others = [pair for pair in rivals if pair[0] in members or pair[1] >= min(likeliest, probability, 1.0 - SURE)]
    return sorted([(effect, probability), *others], key=lambda pair: -pair[1])


def open_between(may_be: Sequence[tuple[str, float]], known: Mapping[str, str]) -> str:
    """``60 % a (heat); or 40 % b (currents)``: what ``alternatives`` gave, in words."""
    said = {name: f"{name} ({title})" for name, title in known.items()} | {UNLISTED: known[UNLISTED]}
    parts = [f"{chance(p)} {said.get(name, name)}" for name, p in may_be]
    return "; ".join([*parts[:-1], f"or {parts[-1]}"])


def _likeliest(entry: Entry) -> tuple[str, float]:
    """The likeliest rival of an effect with its probability; none has 0."""
    return max(entry.rivals, key=lambda pair: pair[1], default=("", 0.0))


def belief(entry: Entry) -> str:
    """How sure a name is among its rivals, and how sure it is that there is anything: two questions, two numbers."""
    something = f"{odds(entry.nats)} that something is there"
    if entry.effect == UNLISTED:  # what it is has no name, and no probability: it may be a listed cause, too faint
        return something
    if entry.probability < SURE and entry.rivals:
        rival, probability = _likeliest(entry)
        return f"{something}, but its name is open: {chance(entry.probability)} this, {chance(probability)} {rival}"
    return f"{something}, {chance(entry.probability)} that it is this" + (
        " rather than a rival" if entry.rivals else ""
    )


def members(entry: Entry, names: Sequence[str] | None = None) -> list[str]:
    """The other names of an effect's class, or those of them; for a cause in no catalogue what it would be."""
    others = [name for name in entry.members if name != entry.effect and (names is None or name in names)]
    return [entry.unlisted if name == UNLISTED and entry.unlisted else name for name in others]


def not_told_from(entry: Entry) -> str:
    """What would leave the same as an effect here, exactly or nearly; empty where nothing would."""
    exact, near = members(entry, entry.as_well), members(entry, [n for n in entry.members if n not in entry.as_well])
    parts = [f"exactly the same is left by {' or '.join(exact)}"] if exact else []
    parts += [f"nearly the same by {' or '.join(near)}" if exact else f"nearly the same is left by {' or '.join(near)}"]
    return "; ".join(parts if near else parts[:-1])


def next_step(entry: Entry) -> str:
    """What would tell an effect from its class: the measurement that promises most, or else what does in general."""
    if not entry.measure:
        return entry.separated_by
    best = entry.measure[0]
    return f"{best.do} ({expected(best)} against {best.against})"


def expected(one: Separation) -> str:
    """How far a measurement is expected to tell two names apart."""
    return f"{one.sigma:.0f} sigma, {odds(one.nats)} expected"


def _sized(found: Sequence[Entry]) -> str:
    rms_nt = next((entry.where.get("rms_nt") for entry in found if entry.effect == UNLISTED), None)
    return "" if rms_nt is None else f", {rms_nt:.1f} nT rms of it in the shape that fits best"


def listed(parts: Sequence[str]) -> str:
    """``a, b and c``; of more than three the first two and how many more."""
    if len(parts) > _MOST_LISTED:
        parts = [*parts[: _MOST_LISTED - 1], f"{len(parts) - _MOST_LISTED + 1} more"]
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}" if parts else ""


def driver_in_words(driver: str) -> str:
    """``channel:temp`` as ``the recorded channel temp``, and so on; empty where no driver is needed."""
    kind, _, name = driver.partition(":")
    if kind == "channel":
        return f"the recorded channel {name}"
    return f"{name.replace('_', ' ')}, inferred because it was not recorded" if kind == "inferred" else ""


def modelled_sentence(modelled: Modelled) -> str:
    """What has no name as curves: over what, by how much they lower the residual, and where they may be used."""
    before_nt, after_nt = modelled.held_out_rms_nt
    curves = listed([curve_in_words(curve) for curve in modelled.curves])
    takes = "takes" if len(modelled.curves) == 1 else "take"
    use = (
        "physics.toml has it, for use inside that range only"
        if modelled.is_usable
        else "it holds for this recording only, and physics.toml does not have it"
    )
    return (
        f"Without a name, but modelled: {curves} {takes} the held-out residual from {before_nt:.1f} to "
        f"{after_nt:.1f} nT, {modelled.standard_errors:.1f} standard errors beyond its scatter, in {modelled.seen} of "
        f"{modelled.blocks} blocks; {use}."
    )


def curve_in_words(curve: Empirical) -> str:
    """A curve with its driver and range."""
    low, high = curve.span
    unit = unit_of(curve)
    return (
        f"a {curve.kind} over {curve_driver(curve)} ({len(curve.knots)} knots, {low:.4g} to {high:.4g}"
        f"{'' if unit == '1' else f' {unit}'})"
    )


def curve_driver(curve: Empirical) -> str:
    """A curve's driver in words."""
    kind, _, name = curve.driver.partition(":")
    if kind == "computed":
        return COMPUTED[name].says
    if kind != "channel":
        return curve.driver.replace("_", " ")
    return f"the recorded {name}" + (f", column {curve.column + 1}" if curve.column else "")


class Ended(Protocol):
    """What ``remaining`` asks of a diagnosis, of one recording or of several."""

    @property
    def verdict(self) -> Verdict:
        """What it comes to."""

    @property
    def unexplained(self) -> float:
        """Share of the mismatch that no effect explains."""

    @property
    def left_share(self) -> float:
        """Share of the mismatch that is left beside the names, in a shape or without one."""

    @property
    def may_last(self) -> float:
        """Share of the mismatch that cannot be excluded to last beside the names."""

    @property
    def reasons(self) -> tuple[str, ...]:
        """What speaks against acting on it."""


def remaining(diagnosis: Ended) -> str:
    """What is left after the effects, in one sentence."""
    if RECORDING in diagnosis.reasons:
        return "not looked into: the recording has to be answered for first"
    if diagnosis.verdict is Verdict.UNKNOWN:
        return f"{percent(diagnosis.unexplained)} of the mismatch, which no effect of the catalogue explains"
    if diagnosis.unexplained > 0.0:
        much = "too much to act on" if {"unexplained_structure", "mismatch_lasts"} & {*diagnosis.reasons} else "little"
        told, left = percent(diagnosis.unexplained), percent(diagnosis.left_share)
        shaped = "" if told == left else f" ({told} in a shape that could be told)"
        joined = "but little" if much == "little" else f"and {much}"
        return f"{left} of the mismatch{shaped}, more than noise {joined} beside what was named"
    if diagnosis.left_share > 0.0:
        errs = (
            "a reference that errs by more than usual"
            if "field_model_doubtful" in diagnosis.reasons
            else "a field model"
        )
        much = "little" if diagnosis.left_share < LITTLE_LEFT else f"no more than noise and {errs} may leave"
        much = "too much to act on" if "mismatch_lasts" in diagnosis.reasons else much
        return f"{percent(diagnosis.left_share)} of the mismatch lasts, in no shape that could be told: {much}"
    if "mismatch_lasts" in diagnosis.reasons:
        return f"nothing stands out of the noise, but {percent(diagnosis.may_last)} of the mismatch could last unseen"
    return "nothing that could not be noise"
