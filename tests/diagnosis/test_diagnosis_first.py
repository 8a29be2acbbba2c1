"""A name that stands where a rival of its class is likelier says why, and the headline has the likeliest first."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from magcal_service.diagnosis import first
from magcal_service.diagnosis.blocks import Gain as BlockGain
from magcal_service.diagnosis.explain import LIKELIER, Explained
from magcal_service.diagnosis.first import why_first
from magcal_service.diagnosis.linear import Gain
from magcal_service.diagnosis.problem import Term
from magcal_service.diagnosis.screen import Candidate
from magcal_service.diagnosis.solution import solve
from magcal_service.physics.interface import Hypothesis
from tests.diagnosis.made_up import SLOW, TIME_S, along, body_form, flown, searching

OWN_NATS = 100.0
SAME = along(0, SLOW)
AWAY = along(2, np.cos(TIME_S / 90.0))


def fitted(field: Any, ahead: float) -> Explained:
    """A slow field that was fitted as ``mine``, and a rival along a field that is ahead of it by so many nats."""
    mine, rival = body_form("mine", "", SAME), body_form("rival", "", field)
    search, alone = searching(flown(60.0 * SAME), mine, rival)
    forms = {form.effect: form for form in search.hypotheses}
    fit = solve(search.problem, alone.x, [Term(forms["mine"], np.zeros(0), np.array([60.0]))])
    idle = Gain(0.0, 0.0, 0.0, np.array([60.0]))
    ranked = [
        Candidate(forms["rival"], np.zeros(0), idle, OWN_NATS + ahead),
        Candidate(forms["mine"], np.zeros(0), idle, OWN_NATS),
    ]
    ranked.sort(key=lambda one: -one.nats)
    return Explained(fit, (tuple(ranked),), (OWN_NATS,), (BlockGain(OWN_NATS, 1.0, 10, 10),))


def test_the_likeliest_needs_no_reason() -> None:
    assert why_first(fitted(SAME, -0.5), 0) == ""


def test_one_that_is_hardly_likelier_does_not_take_the_place() -> None:
    assert (
        why_first(fitted(SAME, 0.9 * LIKELIER), 0) == "rival is likelier by less than 3 to 1, and mine was found first"
    )


def test_held_out_blocks_speak_against_what_is_likelier_inside() -> None:
    assert why_first(fitted(AWAY, 2.0), 0) == "held-out blocks speak for mine against rival"


def test_one_that_would_do_as_well_had_the_place_before() -> None:
    assert why_first(fitted(SAME, 2.0), 0) == "rival had that place before, and gave it up"


def test_a_cause_in_no_catalogue_has_no_numbers_to_give() -> None:
    """Three times what the name holds lasts beside it: something else is likelier."""
    alone = fitted(SAME, -30.0)
    assert why_first(alone, 0) == ""
    lasts = replace(alone, lasting_nats=3.0 * OWN_NATS)
    assert why_first(lasts, 0) == "a cause in no catalogue, which is likelier, has none"


def test_what_physics_does_not_allow_takes_no_place(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(first, "all_within_physics", lambda fit: False)
    assert why_first(fitted(SAME, 2.0), 0) == "rival would be beyond what its physics allows"


def test_what_would_be_quicker_than_is_tried_takes_no_place(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Hypothesis, "is_quickest", lambda own, theta: own.effect == "rival")
    assert why_first(fitted(SAME, 2.0), 0) == "rival would be quicker there than any that is tried"
