"""What a diagnosis says in sentences, to the letter."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from magcal_service.diagnosis.diagnose import Verdict
from magcal_service.diagnosis.separation import Separation
from magcal_service.diagnosis.summary import reason_lines, summary
from magcal_service.diagnosis.words import (
    belief,
    cause_sentence,
    chance,
    next_step,
    noise_of,
    not_told_from,
    odds,
    remaining,
    titles,
    verdict_sentence,
)
from magcal_service.physics.apply.advice import REASONS, advice, in_order
from tests.diagnosis.words_of import HELD_OUT, TITLES, diagnosis, entry

# Sentences


def test_a_clean_recording_agrees_to_the_noise() -> None:
    assert verdict_sentence(diagnosis(Verdict.NONE), [], HELD_OUT) == (
        "The calibrated model and the recording agree to the noise: 101.5 nT are left on data that took no part in "
        "the fit, over a noise of 100.0 nT."
    )


def test_noise_with_a_memory_is_said_where_more_is_left_than_its_white_part() -> None:
    """82 nT agreed to the noise over 29 nT."""
    clean = diagnosis(Verdict.NONE)
    clean.noise_nt, clean.memory_nt = 29.04, 81.46
    said = verdict_sentence(clean, [], {**HELD_OUT, "with_effects": 82.0})
    assert said.endswith("over a noise of 29.0 nT that has a memory and makes 81.5 nT with it.")
    assert noise_of(clean).endswith(", 81.5 nT with its memory")


def test_without_a_simulation_none_is_said_to_be_compared_with() -> None:
    """It is the calibration of the recording's own first half."""
    for has_simulation, said in ((True, "950.0 nT simulation,"), (False, "950.0 nT as calibrated on the first half,")):
        of = diagnosis(Verdict.NONE)
        of.has_simulation = has_simulation
        lines = "\n".join(summary(of, [], {**HELD_OUT, "recalibrated": 990.0}, []))
        assert said in lines
        assert ("simulation" in lines) is has_simulation
        compared = "simulation" if has_simulation else "as calibrated on the first half"
        assert f"  recalibrated is worse than {compared} on these rows" in lines


def test_what_the_field_model_may_err_by_is_said_beside_the_noise() -> None:
    clean = diagnosis(Verdict.NONE)
    clean.fit.problem.field_error = SimpleNamespace(may_be_nt=22.46)
    said = verdict_sentence(clean, [], HELD_OUT)
    assert said.endswith("over a noise of 100.0 nT, and 22.5 nT that the field model may err by.")


def test_nothing_agrees_where_more_is_left_than_field_models_err_by() -> None:
    said = verdict_sentence(diagnosis(Verdict.NONE, reasons=("field_model_doubtful",)), [], HELD_OUT)
    assert "agree" not in said
    assert "by more than field models usually err by: 101.5 nT are left" in said


def test_while_the_recording_is_in_doubt_no_physics_is_named() -> None:
    assert verdict_sentence(diagnosis(Verdict.UNKNOWN, unexplained=0.9, doubts="x"), [], HELD_OUT) == (
        "Recording and reference disagree, but the recording itself is in doubt: no physics is named from it."
    )


@pytest.mark.parametrize(
    ("named", "beside"),
    [
        ("a", ""),
        ("ab", "; beside it currents"),
        ("aab", "; beside it currents"),
        ("abc", "; beside it currents and a step"),
        ("abcda", "; beside it currents, a step and a tone"),
        ("acdbz", "; beside it a step, a tone and 2 more"),
    ],
)
def test_the_cause_is_said_with_its_size_and_others_by_name(named: str, beside: str) -> None:
    found = [entry(name) for name in named]
    of = diagnosis(Verdict.NAMED, terms=1, unexplained=0.08)
    of.effects.append(SimpleNamespace(name="z", title="an edge"))
    assert verdict_sentence(of, found, HELD_OUT) == f"It is hot{beside}; 92 % of the mismatch is explained."
    assert verdict_sentence(diagnosis(Verdict.NAMED), found[:1], HELD_OUT) == "It is hot."


def test_a_name_that_is_not_sure_is_said_with_those_it_is_not_told_from() -> None:
    open_name = entry("a", "b", "c", probability=0.6)
    said = verdict_sentence(diagnosis(Verdict.NAMED, terms=1), [open_name], HELD_OUT)
    assert said == (
        "The name is open: 60 % a (heat); 20 % b (currents); or 20 % c (a step). If a: it is hot; "
        "what is left of the mismatch is not seen in the noise."
    )


def test_the_likeliest_is_said_first_whichever_was_fitted() -> None:
    """With all of the class, however unlikely, and every rival that makes the name unsure."""
    found = entry("a", "b", probability=0.3)
    found.rivals = (("c", 0.5), ("d", 0.17), ("b", 0.03), ("z", 0.0001))
    said = cause_sentence(found, titles(diagnosis(Verdict.NAMED).effects))
    assert said.startswith("The name is open: 50 % c (a step); 30 % a (heat); 17 % d (a tone); or 3 % b (currents).")
    assert " If a: it is hot." in said
    found.why_first = "c is likelier by less than 3 to 1, and a was found first"
    told = cause_sentence(found, titles(diagnosis(Verdict.NAMED).effects))
    assert told == said.replace(" If a:", f" The numbers are those of a: {found.why_first}. If a:")
    sure = entry("a", "b", probability=0.96)
    assert cause_sentence(sure, titles(diagnosis(Verdict.NAMED).effects)) == "It is hot."


def test_a_name_beside_another_says_where_it_is_open() -> None:
    found = [entry("a"), entry("b", "c", probability=0.7)]
    said = verdict_sentence(diagnosis(Verdict.NAMED), found, HELD_OUT)
    assert said == "It is hot; beside it currents (name open: 70 %)."
    found[1].probability, found[1].rivals = 0.3, (("c", 0.6),)
    said = verdict_sentence(diagnosis(Verdict.NAMED), found, HELD_OUT)
    assert said == "It is hot; beside it currents (name open: 30 %; 60 % c)."


def test_a_size_that_is_not_fixed_is_not_said_as_one() -> None:
    """An engineer who reads but the headline took "swings by -1212 ± 2179 nT" for what to compensate."""
    of = diagnosis(Verdict.NAMED)
    of.concerned = {"size_uncertain": ("a",)}
    assert verdict_sentence(of, [entry("a")], HELD_OUT) == "It is hot, a size that this recording does not fix."


# One number does not contradict another


def drawn(count: int) -> list[Any]:
    """Entries of every kind of evidence, probability and rivals, drawn at random."""
    rng = np.random.default_rng(7)
    found = []
    for _ in range(count):
        own = float(rng.choice([rng.uniform(), 1.0 - 10.0 ** -rng.uniform(1, 9), 10.0 ** -rng.uniform(1, 300)]))
        names = rng.permutation(list("bcd"))[: rng.integers(1, 4)]
        shares = rng.dirichlet(np.ones(len(names))) * (1.0 - own)
        close = tuple(str(n) for n, share in zip(names, shares, strict=True) if share > own / 20.0)
        drawn_entry = entry("a", *close, probability=own)
        drawn_entry.rivals = tuple((str(n), float(share)) for n, share in zip(names, shares, strict=True))
        drawn_entry.nats = float(10.0 ** rng.uniform(0.0, 4.0))
        found.append(drawn_entry)
    return found


def test_no_sentence_contradicts_another() -> None:
    """What is likely is never said of a name that is not: odds are of something, the probability is of the name."""
    kinds = {True: 0, False: 0}
    for one in drawn(400):
        sure = one.probability >= 0.95
        kinds[sure] += 1
        said = belief(one)
        head = verdict_sentence(diagnosis(Verdict.NAMED, terms=1), [one], HELD_OUT)
        assert f"{odds(one.nats)} that something is there" in said
        assert ("but its name is open" in said) is not sure
        assert ("that it is this rather than a rival" in said) is sure
        assert head.startswith("The name is open: ") is not sure
        if not sure:
            best = max(one.rivals, key=lambda pair: pair[1])
            assert said.endswith(f"{chance(one.probability)} this, {chance(best[1])} {best[0]}")
            said = {one.effect: one.probability, **dict(one.rivals)}
            assert all(f"{chance(said[name])} {name} ({TITLES[name]})" in head for name in one.members)
            first = max(said, key=lambda name: said[name])
            assert head.startswith(f"The name is open: {chance(said[first])} {first} ")
            assert "If a: it is hot" in head
        for text in summary(diagnosis(Verdict.NAMED, terms=1), [one], HELD_OUT, []):
            assert "that it is there" not in text
    assert min(kinds.values()) > 50


def test_the_measurement_that_promises_most_is_asked_for() -> None:
    alike = entry("a", "b", probability=0.6)
    assert next_step(alike) == "a heater test"
    alike.measure = (Separation("spin faster", "b", 32.0), Separation("record longer", "b", 8.0))
    assert next_step(alike) == "spin faster (8 sigma, odds beyond 10^12 to 1 expected against b)"
    lines = summary(diagnosis(Verdict.NAMED, terms=1), [alike], HELD_OUT, [])
    assert f"    nearly the same is left by b; what would tell: {next_step(alike)}" in lines
    assert not [line for line in lines if "next time" in line]
    alike.record_next = "read channel bus out with every sample"
    lines = summary(diagnosis(Verdict.NAMED, terms=1), [alike], HELD_OUT, [])
    (first,) = [at for at, line in enumerate(lines) if line == f"    next time: {alike.record_next}"]
    assert "what would tell: " in lines[first + 1]  # what costs no manoeuvre comes first


def test_what_leaves_exactly_the_same_is_not_said_to_do_so_nearly() -> None:
    """And the other way round; nothing where an effect stands alone."""
    found = entry("a", "b", "c", "unknown", probability=0.3)
    found.unlisted = "a drift of something else"
    assert not_told_from(found) == "nearly the same is left by b or c or a drift of something else"
    found.as_well = ("c",)
    assert not_told_from(found) == ("exactly the same is left by c; nearly the same by b or a drift of something else")
    found.as_well = ("b", "c", "unknown")
    assert not_told_from(found) == "exactly the same is left by b or c or a drift of something else"
    assert not_told_from(entry("a")) == ""
    words, _ = REASONS["name_uncertain"]
    assert "nearly" not in words


def test_what_has_no_rival_is_told_from_none() -> None:
    weak = entry("a", probability=0.8)
    assert belief(weak) == "odds of 160 000 to 1 that something is there, 80 % that it is this"
    assert verdict_sentence(diagnosis(Verdict.NAMED), [weak], HELD_OUT) == "It is hot."


def test_what_has_no_name_is_said_beside_what_has() -> None:
    unknown = diagnosis(Verdict.UNKNOWN, unexplained=0.61)
    tail = "no effect of the catalogue explains it."
    alone = verdict_sentence(unknown, [entry("unknown")], HELD_OUT)
    assert alone == f"Something without a name makes 61 % of the mismatch: {tail}"
    makes = "makes 61 % of the mismatch, 310.4 nT rms of it in the shape that fits best"
    beside = verdict_sentence(unknown, [entry("unknown", rms=310.44), entry("b")], HELD_OUT)
    assert beside == f"Something without a name {makes}: {tail.removesuffix('.')}; named beside it: currents."


@pytest.mark.parametrize(
    ("verdict", "unexplained", "words"),
    [
        (Verdict.UNKNOWN, 0.3, "30 % of the mismatch, which no effect of the catalogue explains"),
        (Verdict.NAMED, 0.05, "5 % of the mismatch, more than noise but little beside what was named"),
        (Verdict.NAMED, 0.0, "nothing that could not be noise"),
    ],
)
def test_what_remains_is_said_in_one_sentence(verdict: Verdict, unexplained: float, words: str) -> None:
    assert remaining(diagnosis(verdict, unexplained=unexplained)) == words


def test_what_lasts_without_a_shape_remains_too() -> None:
    """It is neither explained nor noise, and no sentence says so."""
    much = diagnosis(Verdict.NAMED, terms=1, lasting=0.14, reasons=("mismatch_lasts",))
    assert remaining(much) == "14 % of the mismatch lasts, in no shape that could be told: too much to act on"
    assert verdict_sentence(much, [entry("a")], HELD_OUT).endswith("86 % of the mismatch is explained.")
    little = diagnosis(Verdict.NAMED, terms=1, lasting=0.01)
    assert remaining(little).endswith("in no shape that could be told: little")
    excused = diagnosis(Verdict.NONE, lasting=0.83)
    assert remaining(excused).endswith("told: no more than noise and a field model may leave")
    far = diagnosis(Verdict.NONE, lasting=0.83, reasons=("field_model_doubtful",))
    assert remaining(far).endswith("told: no more than noise and a reference that errs by more than usual may leave")


def test_while_the_recording_is_in_doubt_nothing_else_is_advised() -> None:
    """Other reasons may be its consequences: "record longer" stood beside a wrong unit."""
    reasons = ("recording_doubtful", "not_converged", "unexplained_structure")
    doubtful, others = in_order(advice(reasons, {}))
    assert doubtful["remedy"] == REASONS["recording_doubtful"][1]
    assert (others["reason"], others["remedy"]) == ("not_converged, unexplained_structure", "")
    assert in_order(advice(reasons[1:], {})) == advice(reasons[1:], {})
    assert in_order(advice(reasons[:1], {})) == advice(reasons[:1], {})
    left = remaining(diagnosis(Verdict.UNKNOWN, unexplained=1.0, reasons=reasons, doubts="x"))
    assert left == "not looked into: the recording has to be answered for first"


def test_what_may_last_unseen_is_not_called_noise() -> None:
    """A result was not to be acted on because too much lasts, and "nothing that could not be noise" was left."""
    of = diagnosis(Verdict.NAMED, terms=1, reasons=("mismatch_lasts",))
    assert remaining(of) == "nothing stands out of the noise, but 26 % of the mismatch could last unseen"
    of.reasons = ("name_uncertain",)
    assert remaining(of) == "nothing that could not be noise"


def test_a_guess_at_where_it_was_made_is_said() -> None:
    of = diagnosis(Verdict.NONE)
    held_out = {"simulation": 300.0, "recalibrated": 200.0, "with_effects": 100.0}
    assert "made in orbit: guessed" not in "\n".join(summary(of, [], held_out, []))
    of.made_where = ["made in orbit: guessed", "places: 12 rows have none"]
    assert of.made_where == [line for line in summary(of, [], held_out, []) if line in of.made_where]


def test_the_noise_is_said_with_whose_it_is_and_what_rounding_adds() -> None:
    of = diagnosis(Verdict.NAMED)
    assert noise_of(of) == "100.0 nT stated"
    of.added_noise_nt = 57.74
    assert noise_of(of) == "100.0 nT stated; rounding adds up to 57.7 nT to it"
    of.prepared.view.stated_noise_nt = None
    assert noise_of(of) == "100.0 nT estimated, rounding included"
    of.added_noise_nt = 0.0
    assert noise_of(of) == "100.0 nT estimated"


def test_what_remains_is_what_the_names_do_not_explain() -> None:
    """64.4 % explained stood beside 2.65 % left."""
    both = diagnosis(Verdict.NAMED, terms=1, unexplained=0.0265, lasting=0.356, reasons=("mismatch_lasts",))
    assert verdict_sentence(both, [entry("a")], HELD_OUT).endswith("64.4 % of the mismatch is explained.")
    assert remaining(both) == (
        "35.6 % of the mismatch (2.65 % in a shape that could be told), more than noise and too much to act on beside "
        "what was named"
    )


def test_no_remedy_is_cut_off() -> None:
    """It was, at two lines of the terminal, where it said what to do."""
    lines = [line for reason in REASONS for line in reason_lines(advice([reason], {reason: ("thermal_scale",)}))]
    assert not any(line.endswith(" ...") for line in lines)


def test_a_name_beside_a_cause_in_no_catalogue_says_so() -> None:
    """In words that are no name of an effect."""
    found = entry("a", share=0.8, probability=0.86)
    found.rivals = (("unknown", 0.14),)
    said = cause_sentence(found, titles(diagnosis(Verdict.NAMED).effects))
    assert said == "The name is open: 86 % a (heat); or 14 % something that is in no catalogue. If a: it is hot."


def test_a_cause_in_no_catalogue_that_is_likelier_than_the_name_is_said_first() -> None:
    """Odds beyond all doubt that something is there, and a thousandth that it is this, were the whole answer."""
    found = entry("a", probability=0.001)
    found.rivals = (("unknown", 0.999),)
    said = cause_sentence(found, titles(diagnosis(Verdict.NAMED).effects))
    assert said == "The name is open: 99.9 % something that is in no catalogue; or 0.1 % a (heat). If a: it is hot."


def test_what_has_no_name_is_given_no_probability() -> None:
    """It may be a listed cause that is too faint to be named: that something is there is all that is sure."""
    found = entry("unknown", probability=0.9999)
    found.nats = 100.0
    assert belief(found) == "odds beyond 10^12 to 1 that something is there"


def test_what_is_too_much_to_act_on_is_not_called_little() -> None:
    of = diagnosis(Verdict.NAMED, unexplained=0.15, reasons=("unexplained_structure",))
    assert remaining(of) == "15 % of the mismatch, more than noise and too much to act on beside what was named"
