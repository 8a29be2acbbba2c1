"""Lines that fit a terminal, and whether results still come."""

from __future__ import annotations

import math

from magcal_service.views.pulse import STALE_S, Pulse
from magcal_service.views.text import BARS, Span, Style, bars, columns, cut, fitted, painted, wrapped


def test_results_are_stale_after_a_silence_that_is_long_for_the_craft() -> None:
    pulse = Pulse()
    assert pulse.is_stale(0.0)
    for second in range(10):
        pulse.beat(float(second))
    assert [pulse.is_stale(9.0 + silence) for silence in (STALE_S, STALE_S + 0.1)] == [False, True]
    pulse.beat(29.0)  # one gap of 20 s
    assert [pulse.is_stale(29.0 + silence) for silence in (60.0, 60.1)] == [False, True]


def test_what_is_wider_than_the_screen_is_cut_by_columns_and_shown_as_text() -> None:
    assert cut("abcdef", 6) == "abcdef"
    assert cut("abcdefg", 6) == "abcd.."
    assert cut("磁力計の値", 6) == "磁力.."
    assert cut("a\x1b[2Jb", 20) == "a\\x1b[2Jb"
    assert sum(columns(span.text) for span in fitted([Span("ab" * 20), Span("cd" * 30)], 50)) == 50
    assert wrapped("one two three four", 9, 2) == ["one two", "three f.."]
    assert wrapped("", 9, 2) == []


def test_colours_are_left_out_where_they_are_not_wanted() -> None:
    line = [Span("good", Style.GOOD), Span(" plain")]
    assert painted(line, colour=True) == "\x1b[1;32mgood\x1b[0m plain"
    assert painted(line, colour=False) == "good plain"


def test_bars_go_from_low_to_high_and_a_missing_value_is_a_space() -> None:
    assert (
        bars([0.0, math.nan, 50.0, 100.0, 200.0, -1.0], 0.0, 100.0) == BARS[0] + " " + BARS[4] + BARS[7] * 2 + BARS[0]
    )
    assert bars([5.0, 5.0], 5.0, 5.0) == BARS[0] * 2
