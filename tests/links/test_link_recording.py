"""A recording on the link: all at once or paced by its own time, from a clock that stands until it is set."""

from __future__ import annotations

from pathlib import Path

import pytest

from magcal_service.base.errors import LinkAddressError
from magcal_service.links import recording as module
from magcal_service.links.recording import RecordingLink
from magcal_service.links.states import LinkState
from magcal_service.recordings.messages import messages
from magcal_service.recordings.reader import read_recording
from magcal_service.wire.messages import Message
from tests.links.link_messages import vector
from tests.recordings.recording_logs import descriptor, row, write_log

CHANNEL = '[channels]\nheat = { column = "temp", unit = "degC" }\n'


class Clock:
    """A monotonic clock; sleeping moves it."""

    def __init__(self) -> None:
        self.now_s = 50.0
        self.slept: list[float] = []

    def monotonic(self) -> float:
        return self.now_s

    def sleep(self, pause_s: float) -> None:
        self.slept.append(pause_s)
        self.now_s += pause_s


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(module, "time", clock)
    return clock


def opened(folder: Path, options: str = "", crafts: tuple[str, ...] = (), count: int = 3) -> RecordingLink:
    """A link over rows two seconds apart; each gives a reference and a sample."""
    path = write_log(folder, None, [row(1_700_000_000 + 2 * number) for number in range(count)])
    return RecordingLink(f"recording:{path}{options}", crafts)


def test_without_a_speed_it_comes_as_fast_as_it_is_taken(tmp_path: Path, clock: Clock) -> None:
    link = opened(tmp_path)
    assert link._poll(0.0) == list(messages(read_recording(tmp_path / "log.toml")))
    assert (link.exhausted, link.state, clock.slept) == (True, LinkState.EXHAUSTED, [])
    assert link._poll(5.0) == []


def test_a_call_takes_256_messages_at_most(tmp_path: Path) -> None:
    link = opened(tmp_path, count=200)
    assert [len(link._poll(0.0)) for _ in range(3)] == [256, 144, 0]


def test_a_speed_paces_by_the_recordings_own_time(tmp_path: Path, clock: Clock) -> None:
    """At ten times real time a row every 0.2 s from the first call on, however late that comes."""
    link = opened(tmp_path, "?speed=10")
    clock.now_s += 30.0
    assert len(link._poll(0.0)) == 2
    clock.now_s += 0.15
    assert link._poll(0.0) == []
    assert clock.slept == []
    clock.now_s += 0.1
    assert len(link._poll(0.0)) == 2
    assert not link.exhausted
    assert len(link._poll(1.0)) == 2
    assert clock.slept == [pytest.approx(0.15)]
    assert link.exhausted


def test_a_paced_call_sleeps_no_longer_than_it_may(tmp_path: Path, clock: Clock) -> None:
    link = opened(tmp_path, "?speed=1")
    assert len(link._poll(0.0)) == 2
    assert link._poll(0.5) == []
    assert clock.slept == [0.5]
    assert len(link._poll(1.5)) == 2
    assert clock.slept == [0.5, pytest.approx(1.5)]


@pytest.mark.parametrize(
    ("crafts", "option", "craft"),
    [((), "", "craft"), (("a",), "", "a"), (("a", "b"), "", "craft"), (("a",), "?craft=b", "b")],
)
def test_its_messages_carry_the_craft_that_was_asked_for(
    tmp_path: Path, crafts: tuple[str, ...], option: str, craft: str
) -> None:
    assert {message.craft for message in opened(tmp_path, option, crafts)._poll(0.0)} == {craft}


@pytest.mark.parametrize(("option", "count"), [("", 9), ("?telemetry=yes", 9), ("?telemetry=no", 6)])
def test_channels_come_unless_they_are_left_out(tmp_path: Path, option: str, count: int) -> None:
    path = write_log(tmp_path, descriptor(CHANNEL))
    assert len(RecordingLink(f"recording:{path}{option}")._poll(0.0)) == count


@pytest.mark.parametrize("option", ["spede=1", "speed=-1", "speed=1000001", "craft=two%20words", "telemetry=maybe"])
def test_an_option_that_is_none_is_refused_by_name(tmp_path: Path, option: str) -> None:
    with pytest.raises(LinkAddressError, match=option.partition("=")[0]):
        opened(tmp_path, f"?{option}")


def test_an_address_without_a_file_is_refused() -> None:
    with pytest.raises(LinkAddressError, match=r"recording:FILE\.toml"):
        RecordingLink("recording:")


def test_what_is_sent_is_counted_and_handed_on_until_it_is_closed(tmp_path: Path) -> None:
    sent: list[Message] = []
    link = RecordingLink(f"recording:{write_log(tmp_path)}", sink=sent.append)
    link._poll(0.0)
    link.send(vector(1))
    link.close()
    link.send(vector(2))
    assert sent == [vector(1)]
    assert (link.counters["sent"], link.counters["dropped"], link.counters["up"], link.counters["down"]) == (1, 1, 1, 1)
    assert link._poll(0.0) == []


def test_an_empty_recording_is_at_its_end_at_once(tmp_path: Path) -> None:
    recording = read_recording(write_log(tmp_path)).select([])
    link = RecordingLink("recording:elsewhere.toml?speed=1", recording=recording)
    assert (link.exhausted, link._poll(0.0)) == (True, [])
