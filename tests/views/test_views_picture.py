"""What a screen of 80 by 24 says of the messages that came."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import pytest

from magcal_service.views.picture import HEIGHT, WIDTH, Frame, duration, picture
from magcal_service.views.result import Replayed
from magcal_service.views.state import Magnetometer, Views
from magcal_service.views.text import ASCII_BARS, columns, painted
from magcal_service.wire.messages import CommandReply, Message, Status, Verdict
from tests.views.view_messages import estimate, second_of, status

TEXT = (
    "model doubtful: looks like thermal_bias (channel temperature), 34 nats over 46 min; "
    "run: magcal diagnose RECORDING; doubtful (model_doubtful), 9 ticks; last event: reset (command; by ops)"
)
COUNTED = replace(
    status(9, "trusted, 9 ticks"),
    counters={"accepted": 9, "ticks": 8, "late": 1, "doubled": 0, "tick_late_p99_us": 1500, "troubles": 2},
)
TRUSTED = replace(estimate(9), residual_rms_nt=295.25, noise_nt=300.0, protection_nt=208.2)


def fed(*more: Message, recording: Replayed | None = None, messages: Iterable[Message] = ()) -> Views:
    """What is known after ten seconds of vectors that are 40 nT off, and ``more``; ``messages`` in their place."""
    views = Views({} if recording is None else {"demo": recording})
    for message in messages or (one for second in range(10) for one in second_of(second, ripple_nt=40.0)):
        views.take(message, message.time_ns * 1e-9)
    for message in more:
        views.take(message, 10.0)
    return views


def shown(views: Views, now_s: float = 10.0, label: str = "", **frame: object) -> str:
    """The picture as plain text; it fits the screen."""
    one: Magnetometer | None = views.find(label)
    lines = picture(one, Frame("zenoh:here", now_s, keys="q quit", **frame), WIDTH, HEIGHT)  # type: ignore[arg-type]
    text = [painted(line, colour=False) for line in lines]
    assert len(text) <= HEIGHT
    assert all(columns(line) <= WIDTH for line in text)
    return "\n".join(text)


def test_the_screen_says_verdict_errors_field_residual_coverage_and_counters() -> None:
    text = shown(fed(TRUSTED, COUNTED))
    for said in (
        "demo  zenoh:here ",
        " live, troubles: 2 (magcal status)\n",
        "TRUSTED, protected to 209 nT (gain_step), ukf, tick 9\n",
        "status    trusted, 9 ticks\n",
        "bx   3000.0 +-    6.0 nT   D11  0.00000 +-",
        "    40.0 nT rms off |H|",
        "40000 to 40000 nT in 9 s",
        "295.2 nT rms, noise 300.0",
        "field came from 3% of sides",
        "accepted 9, ticks 8, p99 late 1.5 ms, late 1",
        "0 s ago    verdict trusted",
    ):
        assert said in text
    assert "doubled" not in text


def test_nothing_is_to_be_done_only_where_the_daemon_tells_of_no_trouble() -> None:
    troubled = replace(COUNTED, text="trusted, 9 ticks; no sample for 70 s")
    assert "status    trusted, 9 ticks; no sample for 70 s\n" in shown(fed(TRUSTED, troubled))
    text = shown(fed(TRUSTED, replace(COUNTED, counters={})))
    assert "why       every question is answered well\ndo        nothing\n" in text


def test_before_and_after_are_drawn_on_one_scale() -> None:
    lines = shown(fed(TRUSTED)).splitlines()
    before, after = (next(line for line in lines if line.startswith(name)) for name in ("before", "after"))
    assert before[10] == "█"  # 2430 nT in the first second, where the bias lies along the field
    assert after[10:20] == "▁" * 10


def test_a_doubt_is_said_with_reason_remedy_and_the_command_that_diagnoses_it() -> None:
    doubtful = replace(estimate(9, verdict=Verdict.DOUBTFUL), remedy="diagnose a recording")
    text = shown(fed(doubtful, status(9, TEXT), status(9, TEXT)))
    assert "DOUBTFUL" in text
    assert "why       model_doubtful" in text
    assert "do        diagnose a recording" in text
    assert "model     looks like thermal_bias (channel temperature), 34 nats over 46 min\n" in text
    assert "          run: magcal diagnose RECORDING\n" in text
    assert text.count("reset (command; by ops)") == 1


def test_a_recording_in_doubt_is_not_trusted_and_says_what_has_to_be_answered() -> None:
    text = shown(fed(TRUSTED, recording=Replayed("log.toml", ("altitude_unit: it is in km",))), recorded=True)
    assert "verdict   DOUBTFUL" in text
    assert "why       recording_doubtful" in text
    assert "recording altitude_unit: it is in km" in text


def test_before_the_start_no_number_is_shown_and_nothing_is_called_calibrated() -> None:
    messages = [one for second in range(3) for one in second_of(second, verdict=Verdict.NOT_STARTED)]
    text = shown(fed(estimate(2, verdict=Verdict.NOT_STARTED), messages=messages))
    assert "NOT_STARTED" in text
    assert "errors    awaited: there is no number before the filter starts\n" in text
    assert "status    awaited: the daemon sends one every output.status_period_s\n" in text
    assert "counters: awaited, in a status\n" in text
    assert "+-" not in text
    assert "after     no calibrated vectors over this link so far" in text


def test_without_an_estimate_the_status_says_why_and_old_counters_say_how_old_they_are() -> None:
    waiting = replace(status(0, "not_started (no_reference), 0 ticks; no sample for 61 s"), verdict=Verdict.NOT_STARTED)
    assert "status    not_started (no_reference), 0 ticks; no sample for 61 s\n" in shown(fed(waiting))
    assert "counted" not in shown(fed(COUNTED, replace(TRUSTED, time_ns=60_000_000_000)))
    assert "  counted 3.5 min ago, accepted 9" in shown(fed(COUNTED, replace(TRUSTED, time_ns=219_000_000_000)))


def test_a_stale_verdict_is_what_it_was_and_the_reason_of_the_silence_is_said() -> None:
    assert "  live\n" in shown(fed(TRUSTED), now_s=14.0)
    stale = shown(fed(TRUSTED), now_s=16.0, silence="nobody is at here")
    assert "STALE: nothing came for 6 s\n" in stale
    assert "verdict   was TRUSTED" in stale
    assert "link      nobody is at here" in stale
    assert "answered well" not in stale
    assert "waiting for the first result" in shown(Views(), silence="nobody is at here")


def test_a_line_that_brings_results_alone_says_what_it_does_not_bring() -> None:
    vectors = [one for second in range(5) for one in second_of(second) if type(one).__name__ == "CalibratedVector"]
    text = shown(fed(TRUSTED, messages=vectors))
    assert "|H|       no reference over this link so far" in text
    assert "before    no samples over this link so far" in text
    assert " 40000 to 40000 nT\n" in text


@pytest.mark.parametrize(
    ("told", "reference", "samples"),
    [
        ([COUNTED], "; the status counts 8 s with one", "; the status counts 9 accepted"),
        ([status(9, "trusted, 9 ticks")], "", ""),
        ([], ", and no status", ", and no status"),
    ],
)
def test_one_picture_says_how_long_it_listened_and_what_the_daemon_counts(
    told: list[Message], reference: str, samples: str
) -> None:
    told = [replace(one, counters={}) if one is not COUNTED and isinstance(one, Status) else one for one in told]
    vectors = [one for second in range(5) for one in second_of(second) if type(one).__name__ == "CalibratedVector"]
    text = shown(fed(TRUSTED, *told, messages=vectors), listened_s=2.44)
    assert f"|H|       no reference heard in 2.4 s{reference}\n" in text
    assert f"before    no samples heard in 2.4 s{samples}\n" in text


def test_a_status_that_was_asked_for_is_no_event_and_a_command_is_one() -> None:
    reply = CommandReply(
        craft="demo",
        source="magcal",
        sequence=1,
        time_ns=9_000_000_000,
        name="status",
        command_source="watch",
        command_sequence=0,
        accepted=True,
    )
    text = shown(fed(TRUSTED, reply, replace(reply, name="freeze", text="frozen")))
    assert "command status" not in text
    assert "command freeze accepted: frozen" in text


def test_without_blocks_in_the_encoding_traces_are_ascii() -> None:
    lines = picture(fed(TRUSTED, COUNTED).find(""), Frame("zenoh:here", 10.0), WIDTH, HEIGHT, ASCII_BARS)
    assert "".join(painted(line, colour=True) for line in lines).isascii()


def test_one_of_several_magnetometers_says_which_it_is() -> None:
    beside = estimate(9, source="mag2")
    assert "demo/mag2 (2 of 2)  zenoh:here" in shown(fed(TRUSTED, beside), label="demo/mag2", place=(2, 2))


@pytest.mark.parametrize(
    ("seconds", "said"), [(0.4, "0 s"), (119.0, "119 s"), (120.0, "2.0 min"), (9000.0, "2.5 h"), (2e5, "2.3 d")]
)
def test_times_are_said_in_the_unit_that_people_use(seconds: float, said: str) -> None:
    assert duration(seconds) == said
