"""What a diagnosis says in words: sentences, odds, and lines of the summary, to the letter."""

from __future__ import annotations

import math

import pytest

from magcal_service.diagnosis.words import (
    chance,
    driver_in_words,
    odds,
    percent,
    strength,
)
from magcal_service.physics.apply.advice import REASONS, reason_in_words, remedy

# Numbers


@pytest.mark.parametrize(
    ("nats", "words"),
    [
        (-3.0, "odds of 1 to 1"),
        (math.log(7.4), "odds of 7 to 1"),
        (math.log(74.4), "odds of 74 to 1"),
        (math.log(744.0), "odds of 740 to 1"),
        (math.log(999_499.0), "odds of 1 000 000 to 1"),
        (math.log(1e6) + 1e-9, "odds of about 10^6 to 1"),
        (math.log(3.3e11), "odds of about 10^12 to 1"),
        (math.log(1e12) - 1e-6, "odds of about 10^12 to 1"),
        (math.log(1e12) + 1e-6, "odds beyond 10^12 to 1"),
    ],
)
def test_odds_have_two_digits_up_to_a_million_and_powers_of_ten_beyond(nats: float, words: str) -> None:
    assert odds(nats) == words


@pytest.mark.parametrize(
    ("nats", "word"),
    [
        (7.0, "weak"),
        (7.01, "clear"),
        (12.0, "clear"),
        (12.01, "very strong"),
        (27.6, "very strong"),
        (27.7, "beyond doubt"),
    ],
)
def test_significance_has_its_word_from_each_limit_on(nats: float, word: str) -> None:
    assert strength(nats) == word


@pytest.mark.parametrize(
    ("share", "words"),
    [
        (0.0, "0 %"),
        (1e-9, "< 0.1 %"),
        (0.00099, "< 0.1 %"),
        (0.001, "0.1 %"),
        (0.12345, "12.3 %"),
        (0.999, "99.9 %"),
        (0.9991, "> 99.9 %"),
        (1.0, "100 %"),
    ],
)
def test_a_share_is_a_percentage_that_never_rounds_to_a_certainty(share: float, words: str) -> None:
    assert percent(share) == words


def test_a_chance_is_never_a_certainty() -> None:
    assert (chance(1.0), chance(0.5), chance(0.99999)) == ("> 99.9 %", "50 %", "> 99.9 %")


# Reasons and drivers


def test_every_reason_is_a_clause_and_a_new_one_its_own_name() -> None:
    assert (reason_in_words("poor_coverage"), remedy("poor_coverage")) == REASONS["poor_coverage"]
    assert remedy("brand_new") == ""
    assert reason_in_words("brand_new") == "brand new"


@pytest.mark.parametrize(
    ("driver", "words"),
    [
        ("channel:temp_2", "the recorded channel temp_2"),
        ("channel:a:b", "the recorded channel a:b"),
        ("inferred:array_current", "array current, inferred because it was not recorded"),
        ("none", ""),
    ],
)
def test_drivers_are_told_in_words(driver: str, words: str) -> None:
    assert driver_in_words(driver) == words
