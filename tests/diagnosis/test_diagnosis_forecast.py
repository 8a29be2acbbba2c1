"""When a diagnosis is said to end."""

import pytest

from magcal_service.diagnosis.forecast import MOST_ROUNDS, USUAL, WRITING_S, Course, Usual
from magcal_service.diagnosis.stages import COMPARING, LEFT, READING, RIVALS, SEARCHING, SIMULATING

FIRST, SECOND, _ = SEARCHING
TABLE = {
    (1, 0, FIRST): Usual(20.0, 8.0),
    (1, 0, RIVALS): Usual(2.0, 1.0),
    (2, 0, SECOND): Usual(3.0, 1.0),
    (2, 0, RIVALS): Usual(2.0, 1.0),
}


def test_what_is_left_is_counted_in_the_searches_that_have_ended() -> None:
    course = Course(TABLE)
    course.begin(READING, 0.0)
    assert course.left_s(0.5) is None
    course.begin(SIMULATING, 1.0)
    assert course.left_s(1.5) is None
    course.begin(FIRST, 2.0)  # the nine errors took 1 s
    assert course.left_s(2.0) == pytest.approx(WRITING_S + 20.0)
    assert course.left_s(8.0) == pytest.approx(WRITING_S + 14.0)
    course.begin(SECOND, 8.0)  # the first search took 6 s
    assert course.left_s(9.0) == pytest.approx(WRITING_S + 18.0 - 1.0)
    course.begin(RIVALS, 12.0)  # the second one 4 s
    assert course.left_s(12.0) == pytest.approx(WRITING_S + 10.0)


def test_a_step_that_takes_longer_than_usual_puts_the_end_off() -> None:
    course = Course(TABLE)
    for step, begins_s in ((SIMULATING, 0.0), (FIRST, 1.0), (SECOND, 3.0)):
        course.begin(step, begins_s)
    said = [course.left_s(3.0 + within_s) for within_s in (0.0, 1.9, 4.0, 40.0)]
    assert said == pytest.approx([WRITING_S + 6.0, WRITING_S + 4.1, WRITING_S + 6.0, WRITING_S + 24.0])


def test_a_step_without_a_row_goes_on_from_what_was_told_before() -> None:
    course = Course(TABLE)
    for step, begins_s in ((SIMULATING, 0.0), (FIRST, 1.0), (RIVALS, 3.0), (COMPARING, 5.0)):
        course.begin(step, begins_s)
    told = WRITING_S + 3.0
    assert course.left_s(5.0) == pytest.approx(told)
    assert course.left_s(6.0) == pytest.approx(told - 1.0)


def test_the_table_knows_every_search_and_what_follows_it() -> None:
    furthest = {(reached, step) for reached, _, step in USUAL}
    assert {(number, step) for number, step in enumerate(SEARCHING, start=1)} <= furthest
    assert {(number, step) for number in (1, 2, 3) for step in (RIVALS, LEFT)} <= furthest
    assert max(rounds for _, rounds, _ in USUAL) <= MOST_ROUNDS
    assert all(usual.left >= usual.own >= 0.0 for usual in USUAL.values())
