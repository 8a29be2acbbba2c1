import time
from pathlib import Path

import pytest

from magcal_service.base.errors import LinkAddressError, RecordingError
from magcal_service.links.base import Role
from magcal_service.links.recording import RecordingLink
from magcal_service.recordings.messages import messages
from magcal_service.recordings.reader import read_recording
from magcal_service.wire.messages import Command, MagnetometerSample, Message
from tests.recordings.recording_logs import descriptor, row, write_log

COMMAND = Command(craft="craft", source="test", sequence=0, time_ns=0, name="status")


def drain(link: RecordingLink, timeout_s: float = 5.0) -> list[Message]:
    received: list[Message] = []
    while not link.exhausted:
        received += link.receive(timeout_s)
    return received


def test_a_link_plays_every_message_in_order_and_is_then_exhausted(tmp_path: Path) -> None:
    path = write_log(tmp_path, None, [row(second) for second in range(1000)])
    with RecordingLink(f"recording:{path}") as link:
        received = drain(link)
        assert received == list(messages(read_recording(path)))
        assert (link.receive(0.1), link.counters["received"], link.counters["lost"]) == ([], 2000, 0)


def test_an_exhausted_link_does_not_wait(tmp_path: Path) -> None:
    with RecordingLink(f"recording:{write_log(tmp_path)}") as link:
        drain(link)
        before_s = time.monotonic()
        link.receive(10.0)
        assert time.monotonic() - before_s < 1.0


def test_a_long_recording_arrives_in_pieces(tmp_path: Path) -> None:
    path = write_log(tmp_path, None, [row(second) for second in range(1000)])
    with RecordingLink(f"recording:{path}") as link:
        assert 0 < len(link.receive(1.0)) < 2000


def test_speed_paces_by_the_time_of_the_samples(tmp_path: Path) -> None:
    path = write_log(tmp_path, None, [row(second) for second in range(0, 50, 10)])
    with RecordingLink(f"recording:{path}?speed=100") as link:
        before_s = time.monotonic()
        drain(link)
        assert 0.4 <= time.monotonic() - before_s < 2.0


def test_a_paced_link_waits_no_longer_than_asked(tmp_path: Path) -> None:
    with RecordingLink(f"recording:{write_log(tmp_path)}?speed=0.01") as link:
        assert len(link.receive(0.05)) == 2
        before_s = time.monotonic()
        assert link.receive(0.05) == []
        assert 0.05 <= time.monotonic() - before_s < 1.0


def test_a_paced_link_sends_a_late_row_at_once(tmp_path: Path) -> None:
    with RecordingLink(f"recording:{write_log(tmp_path, None, [row(100), row(1)])}?speed=1") as link:
        assert len(link.receive(0.0)) == 4


@pytest.mark.parametrize(("crafts", "option", "craft"), [((), "", "craft"), (("a",), "", "a"), (("a", "b"), "b", "b")])
def test_messages_carry_the_craft_that_was_asked_for(
    tmp_path: Path, crafts: tuple[str, ...], option: str, craft: str
) -> None:
    address = f"recording:{write_log(tmp_path)}" + (f"?craft={option}" if option else "")
    with RecordingLink(address, crafts) as link:
        assert {message.craft for message in drain(link)} == {craft}


def test_telemetry_can_be_left_out(tmp_path: Path) -> None:
    path = write_log(tmp_path, descriptor('[channels]\nheat = { column = "temp", unit = "degC" }\n'))
    with RecordingLink(f"recording:{path}?telemetry=no") as link:
        assert len(drain(link)) == 6


def test_what_is_sent_is_counted_and_reaches_the_sink(tmp_path: Path) -> None:
    sent: list[Message] = []
    with RecordingLink(f"recording:{write_log(tmp_path)}", sink=sent.append) as link:
        link.send(COMMAND)
        assert (sent, link.counters["sent"]) == ([COMMAND], 1)


def test_results_can_still_be_sent_after_the_last_message(tmp_path: Path) -> None:
    with RecordingLink(f"recording:{write_log(tmp_path)}") as link:
        drain(link)
        link.send(COMMAND)
        assert (link.counters["sent"], link.counters["dropped"]) == (1, 0)


def test_a_closed_link_plays_no_more_and_drops_what_is_sent(tmp_path: Path) -> None:
    link = RecordingLink(f"recording:{write_log(tmp_path)}")
    link.close()
    link.close()
    link.send(COMMAND)
    assert (link.exhausted, link.receive(0.0)) == (True, [])
    assert (link.counters["down"], link.counters["sent"], link.counters["dropped"]) == (1, 0, 1)


def test_a_recording_that_was_read_before_is_played_as_it_is(tmp_path: Path) -> None:
    recording = read_recording(write_log(tmp_path)).select([2, 0])
    with RecordingLink("recording:elsewhere.toml", recording=recording) as link:
        times = [m.time_ns for m in drain(link) if isinstance(m, MagnetometerSample)]
    assert times == [1_700_000_002_000_000_000, 1_700_000_000_000_000_000]


def test_a_path_may_be_percent_encoded(tmp_path: Path) -> None:
    folder = tmp_path / "a?b"
    folder.mkdir()
    write_log(folder)
    with RecordingLink(f"recording:{tmp_path}/a%3Fb/log.toml") as link:
        assert len(drain(link)) == 6


@pytest.mark.parametrize("query", ["sped=1", "speed=-1", "speed=nan", "craft=a b", "telemetry=maybe"])
def test_an_unknown_or_wrong_option_is_refused(tmp_path: Path, query: str) -> None:
    with pytest.raises(LinkAddressError, match=query.split("=")[0]):
        RecordingLink(f"recording:{write_log(tmp_path)}?{query}")


def test_an_address_without_a_file_is_refused() -> None:
    with pytest.raises(LinkAddressError, match=r"recording:FILE\.toml"):
        RecordingLink("recording:")


def test_a_recording_that_is_not_there_is_refused() -> None:
    with pytest.raises(RecordingError, match=r"nowhere\.toml"):
        RecordingLink("recording:nowhere.toml")


def test_the_one_door_opens_a_recording(tmp_path: Path) -> None:
    from magcal_service.links import open_link

    with open_link(f"recording:{write_log(tmp_path)}", Role.SERVICE) as link:
        assert isinstance(link, RecordingLink)
