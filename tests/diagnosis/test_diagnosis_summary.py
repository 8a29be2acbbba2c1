"""The lines of a diagnosis's summary, to the letter."""

from __future__ import annotations

import math
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from magcal_service.diagnosis.aimed import Aimed
from magcal_service.diagnosis.diagnose import Verdict
from magcal_service.diagnosis.empirical.modelled import Modelled
from magcal_service.diagnosis.prepare import Form
from magcal_service.diagnosis.summary import summary
from magcal_service.diagnosis.words import (
    modelled_sentence,
)
from magcal_service.physics.apply.empirical import Empirical, Kind
from magcal_service.physics.apply.model_file import ModelTerm
from magcal_service.physics.catalogue import held_at
from tests.diagnosis.words_of import HELD_OUT, diagnosis, entry

# The summary


def test_a_summary_has_verdict_effects_numbers_and_files() -> None:
    found = [entry("a", "b", share=0.8, probability=0.9), entry("d", share=0.00001)]
    found[0].nats = math.log(7.4)
    files = [Path("out/diagnosis.json"), Path("out/report.html")]
    lines = summary(diagnosis(Verdict.NAMED, terms=2, reasons=("name_uncertain", "brand_new")), found, HELD_OUT, files)
    assert lines == [
        "verdict: named, not trusted",
        "  do not act on this:",
        "    name_uncertain (heat): less than 95 % speak for a name: other names, or a cause in no catalogue, have "
        "the rest;",
        "    make a measurement that tells the names apart: magcal diagnose lists them for each name (next time, what "
        "would",
        "    tell), and report.html (What to measure next)",
        "    brand_new: brand new",
        "  The name is open: 90 % a (heat); or 10 % b (currents). If a: it is hot; beside it a tone; what is left of "
        "the",
        "  mismatch is not seen in the noise.",
        "  a: 80 % of the mismatch; odds of 7 to 1 that something is there, but its name is open: 90 % this, 10 % b",
        "    nearly the same is left by b; what would tell: a heater test",
        "  d: < 0.1 % of the mismatch; odds of 160 000 to 1 that something is there, 99 % that it is this",
        "rms on held-out rows: 950.0 nT simulation, 410.3 nT recalibrated, 101.5 nT with effects; noise 100.0 nT "
        "stated",
        "vectors without these effects: off by 14.04 ± 0.52 nT rms (at most 20.1 nT, at 1234 s); the residual shows "
        "398 nT",
        "bias: (13.0, 16.0, 42.0) nT; by nine errors alone (10.0, 20.0, 30.0) nT",
        "left: nothing that could not be noise",
        "rows: 7 of 10 rows used; left out: 1 with a certain defect, 2 that are single spikes",
        "files: out/diagnosis.json, out/report.html",
    ]


def test_a_bias_beside_an_inferred_temperature_is_said_to_be_of_the_light_that_keeps_it_up() -> None:
    held = held_at(
        [
            ModelTerm("thermal_bias", "inferred:temperature", "answer to light", {}, {}, {}, {"mean_light": 0.6209}),
            ModelTerm("bias_step", "none", "", {}),
        ]
    )
    lines = summary(diagnosis(Verdict.NAMED, terms=1, held=held), [entry("a")], HELD_OUT, [])
    (bias,) = (line for line in lines if line.startswith("bias: "))
    assert bias.startswith("bias: (13.0, 16.0, 42.0) nT, at the temperature that 0.621 of full sunlight keeps up, the")


def test_a_summary_of_many_effects_shows_three_and_counts_the_rest() -> None:
    three = summary(diagnosis(Verdict.NAMED, terms=1), [entry(name) for name in "abc"], HELD_OUT, [])
    five = summary(diagnosis(Verdict.NAMED, terms=1), [entry(name) for name in "abcda"], HELD_OUT, [])
    assert not [line for line in three if "more, in the files" in line]
    assert "  and 2 more, in the files" in five
    assert sum(line.endswith("that it is this") for line in five) == 3


def test_channels_that_cannot_be_told_apart_are_named_together() -> None:
    found = entry("a")
    found.drivers = (("channel:bus", 0.7), ("channel:heater", 0.3))
    lines = summary(diagnosis(Verdict.NAMED, terms=1), [found], HELD_OUT, [])
    assert "    driven by one of bus, heater, which this recording cannot tell apart" in lines
    found.drivers = found.drivers[:1]
    assert not [line for line in summary(diagnosis(Verdict.NAMED, terms=1), [found], HELD_OUT, []) if "one of" in line]


def test_the_mounting_is_said_or_that_the_attitude_was_not_believed() -> None:
    of = diagnosis(Verdict.NONE)
    of.refused, of.prepared.form = (Form.AIMED,), Form.SCALAR
    more = "leave more: the recorded attitude errs, its axes are turned, or samples are tagged apart from it"
    for of.prepared.has_reference_far_off, said in ((False, more), (True, "need a reference far off")):
        assert f"compared by magnitudes, as whole vectors {said}" in summary(of, [], HELD_OUT, [])
    turned = Aimed(np.ones((5, 3)), np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]))
    seen = diagnosis(Verdict.NONE)
    seen.fit.problem.aimed, seen.fit.x = turned, np.zeros(12)
    seen.fit.covariance = np.diag(np.radians([0.0] * 9 + [0.1, 0.25, 0.2]) ** 2)
    said = "mounting: the sensor is turned by 90.00 deg against the body, 1 sigma 0.25 deg"
    assert said in summary(seen, [], HELD_OUT, [])


def test_without_terms_no_bias_is_said_to_have_moved() -> None:
    assert not [line for line in summary(diagnosis(Verdict.NONE), [], HELD_OUT, []) if line.startswith("bias")]


def test_what_is_long_takes_four_lines_of_118_and_no_more() -> None:
    lines = summary(diagnosis(Verdict.NAMED, terms=1), [entry("b"), entry("a", says="word " * 100)], HELD_OUT, [])
    words = [line for line in lines if line.startswith("    word")]
    assert [len(line) for line in words] == [118, 118, 118, 117]
    assert words[0] == "    " + " ".join(["word"] * 23)
    assert words[3].endswith(" ...")


@pytest.mark.parametrize(
    ("curves", "words"),
    [
        (
            (("channel:board", Kind.GAIN, 0),),
            "a gain over the recorded board (3 knots, 10 to 30 degC) takes the held-out residual from 120.0 to 80.0 nT"
            ", 4.2 standard errors beyond its scatter, in 40 of 50 blocks; physics.toml has it, for use inside that "
            "range only.",
        ),
        (
            (("channel:board", Kind.BIAS, 1), ("computed:light", Kind.MAGNITUDE, 0)),
            "a bias over the recorded board, column 2 (3 knots, 10 to 30 degC) and a magnitude over the share of "
            "sunlight (3 knots, 10 to 30) take the held-out residual",
        ),
        (
            (("elapsed_time", Kind.BIAS, 0),),
            "a bias over elapsed time (3 knots, 10 to 30 s) takes the held-out residual from 120.0 to 80.0 nT, 4.2 "
            "standard errors beyond its scatter, in 40 of 50 blocks; it holds for this recording only, and "
            "physics.toml does not have it.",
        ),
    ],
)
def test_what_is_modelled_says_over_what_how_much_and_where(
    curves: tuple[tuple[str, Kind, int], ...], words: str
) -> None:
    knots = np.array([10.0, 20.0, 30.0])
    made = tuple(
        Empirical(driver, kind, "temperature", column, knots, np.zeros((3, 3)), np.zeros((3, 3)), (10.0, 30.0))
        for driver, kind, column in curves
    )
    before, after = SimpleNamespace(held_out_rms_nt=120.0), SimpleNamespace(held_out_rms_nt=80.0)
    modelled = Modelled(before, after, made, 4.2, 40, 50, None, ())  # type: ignore[arg-type]
    assert words in modelled_sentence(modelled)
    assert modelled_sentence(modelled).startswith("Without a name, but modelled: ")
