"""The live table: what it says, and where."""

from __future__ import annotations

import io
from dataclasses import replace

import pytest
from rich.console import Console

from magcal_service.wire.messages import Verdict
from sim_sensor.view.terminal import LiveTable, Screen, plain_line, render
from tests.sim_sensor.view.view_estimates import FINAL_SIGMA, TRUTH, estimate

GOOD = Screen(estimate(TRUTH, FINAL_SIGMA), TRUTH, 9000.0, 18000.0, 300.0, {"sent": 9001, "lost": 2})


def shown(screen: Screen, width: int = 80) -> str:
    console = Console(file=io.StringIO(), width=width, force_terminal=False)
    console.print(render(screen))
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue()


class Clock:
    """A wall clock that stands still until it is moved."""

    def __init__(self) -> None:
        self.now_s = 50.0

    def __call__(self) -> float:
        return self.now_s


@pytest.mark.parametrize(
    "text",
    ["5000.0", "9.0", "0.10000", "0.00060", "ukf", "trusted", "301.0 nT", "9001", "lost 2", "x300", "9000 of 18000"],
)
def test_picture_contains(text: str) -> None:
    assert text in shown(GOOD)


def test_picture_fits_80_columns_with_large_values() -> None:
    x = (-123456.7, 98765.4, -55555.5, -0.98765, 1.2, -0.5, 0.4, -0.3, 0.2)
    screen = replace(GOOD, estimate=estimate(x, tuple(1e4 for _ in x), remedy="turn the craft about another axis " * 4))
    lines = shown(screen).splitlines()
    assert max(map(len, lines)) <= 80
    assert sum("(" in line for line in lines) >= 9


def test_error_outside_its_limit_is_marked_in_words() -> None:
    x = (*TRUTH[:2], TRUTH[2] + 5.0 * FINAL_SIGMA[2], *TRUTH[3:])
    lines = shown(replace(GOOD, estimate=estimate(x, FINAL_SIGMA))).splitlines()
    marked = [line for line in lines if "NO (5.0)" in line]
    assert len(marked) == 1
    assert "bz" in marked[0]


def test_without_truth_there_is_no_error_column() -> None:
    text = shown(replace(GOOD, truth=None))
    assert "off by" not in text
    assert "3 sigma" in text


def test_doubt_comes_with_reason_and_remedy() -> None:
    doubtful = estimate(
        TRUTH, FINAL_SIGMA, verdict=Verdict.DOUBTFUL, reasons=("coverage_poor",), remedy="tilt the spin axis"
    )
    text = shown(replace(GOOD, estimate=doubtful))
    assert "doubtful: coverage_poor" in text
    assert "tilt the spin axis" in text


def test_markup_in_a_message_is_shown_and_not_obeyed() -> None:
    doubtful = estimate(TRUTH, FINAL_SIGMA, verdict=Verdict.DOUBTFUL, reasons=("[red]x",), remedy="[bold]y[/bold]")
    text = shown(replace(GOOD, estimate=doubtful))
    assert "[red]x" in text
    assert "[bold]y[/bold]" in text


@pytest.mark.parametrize("screen", [Screen(), Screen(estimate(TRUTH, FINAL_SIGMA, verdict=Verdict.NOT_STARTED), TRUTH)])
def test_before_the_start_no_number_is_invented(screen: Screen) -> None:
    rows = [line for line in shown(screen).splitlines() if "bx" in line]
    assert len(rows) == 1
    assert rows[0].count("...") >= 2


def test_plain_line_says_how_many_errors_are_inside() -> None:
    x = (*TRUTH[:8], TRUTH[8] + 1.0)
    assert "in 3s 8/9" in plain_line(replace(GOOD, estimate=estimate(x, FINAL_SIGMA)))


def test_a_log_gets_one_line_every_ten_seconds() -> None:
    console, clock = Console(file=io.StringIO(), width=80, force_terminal=False), Clock()
    assert isinstance(console.file, io.StringIO)
    with LiveTable(100.0, console, clock) as table:
        for second in range(25):
            clock.now_s = 50.0 + second
            table.update(float(second), estimate(TRUTH, FINAL_SIGMA), TRUTH)
        lines = console.file.getvalue().splitlines()
    assert [line.split("/")[0] for line in lines] == ["0", "10", "20"]


def test_speed_is_sample_seconds_per_wall_second() -> None:
    clock = Clock()
    table = LiveTable(None, Console(file=io.StringIO()), clock)
    table.update(0.0, None)
    clock.now_s += 2.0
    table.update(600.0, None)
    assert table.screen.speed == 300.0


def test_final_picture_stays_and_is_printed_once() -> None:
    console = Console(file=io.StringIO(), width=80, force_terminal=False)
    assert isinstance(console.file, io.StringIO)
    with LiveTable(100.0, console, Clock()) as table:
        table.update(1.0, estimate(TRUTH, FINAL_SIGMA), TRUTH)
        table.finish()
    assert console.file.getvalue().count("bx") == 1


def test_a_terminal_gets_a_picture_that_is_redrawn() -> None:
    console = Console(file=io.StringIO(), width=80, force_terminal=True)
    assert isinstance(console.file, io.StringIO)
    with LiveTable(100.0, console, Clock()) as table:
        table.update(1.0, estimate(TRUTH, FINAL_SIGMA), TRUTH)
    text = console.file.getvalue()
    assert "\x1b[" in text
    assert text.rstrip().splitlines()[-1].strip().endswith("x0")
