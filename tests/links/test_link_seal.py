"""Sealed commands over a real pair of pseudo-terminals: forged and repeated ones are refused, counted and answered."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from magcal_service.base.errors import ConfigError, LinkAddressError
from magcal_service.links import Link, Role, open_link
from magcal_service.links.counter_file import CounterFile
from magcal_service.links.line_seal import open_coders
from magcal_service.wire.framing import FrameEncoder
from magcal_service.wire.messages import CommandReply, Message
from magcal_service.wire.seal import seal
from sim_sensor.demo.pty_pair import PtyPair
from tests.links.link_messages import command, gather, sample, settle

KEY = bytes(range(32))


@pytest.fixture
def line(tmp_path: Path) -> Iterator[Callable[[Role], Link]]:
    """Opens one end of a line: the service with its key and counter, the operator with theirs."""
    (tmp_path / "key").write_text(KEY.hex())
    (tmp_path / "key").chmod(0o600)
    opened: list[Link] = []
    with PtyPair() as pair:

        def end(role: Role) -> Link:
            device = pair.paths[role is not Role.SERVICE]
            options = f"key={tmp_path / 'key'}&counter={tmp_path / role.value}"
            link = open_link(f"serial:{device}?{options}", role, crafts=["alpha"])
            opened.append(link)
            return link

        yield end
        for link in opened:
            link.close()


def raw(link: Link, data: bytes) -> None:
    """Write bytes on the device of an end, beside it."""
    device = link.address.removeprefix("serial:").partition("?")[0]
    with open(device, "wb", buffering=0) as file:
        file.write(data)


def answers(operator: Link, service: Link) -> list[CommandReply]:
    """What the operator hears once the service has taken in what was sent."""
    heard: list[Message] = []
    assert settle(lambda: bool(service.receive(0.01) or heard.extend(operator.receive(0.01)) or heard))
    return [message for message in heard if isinstance(message, CommandReply)]


def sealed_frame(counter: int, sequence: int = 1, key: bytes = KEY) -> bytes:
    return FrameEncoder(lambda payload: seal(key, counter, payload)).encode(command(sequence))


def test_an_operators_commands_arrive(line: Callable[[Role], Link]) -> None:
    """The operator's end seals, the service's opens, several in the same second too."""
    service, operator = line(Role.SERVICE), line(Role.VIEWER)
    for number in range(3):
        operator.send(command(number))
    assert gather(service, 3) == [command(number) for number in range(3)]


def test_a_recorded_command_is_refused_counted_and_answered(line: Callable[[Role], Link]) -> None:
    """The bytes of a command that was carried out, sent again, change nothing and are answered."""
    service, operator = line(Role.SERVICE), line(Role.VIEWER)
    recorded = sealed_frame(100)
    raw(operator, recorded)
    assert gather(service, 1) == [command(1)]
    raw(operator, recorded)
    (reply,) = answers(operator, service)
    assert (reply.accepted, reply.command_sequence, reply.source) == (False, 1, "magcal-line")
    assert reply.text.startswith("replayed: counter 100 was used; above 100 is accepted")
    assert service.counters["refused.replayed"] == 1


def test_a_sender_whose_clock_is_behind_is_told_by_how_much(line: Callable[[Role], Link]) -> None:
    service, operator = line(Role.SERVICE), line(Role.VIEWER)
    raw(operator, sealed_frame(1_700_000_090_500_000))
    assert gather(service, 1) == [command(1)]
    raw(operator, sealed_frame(1_700_000_000_000_000, 2))
    assert "is 90.5 s behind: set it, or wait" in answers(operator, service)[0].text


def test_a_recorded_command_is_refused_after_a_restart_too(line: Callable[[Role], Link]) -> None:
    """The counter outlives the process that stored it."""
    service, operator = line(Role.SERVICE), line(Role.VIEWER)
    raw(operator, sealed_frame(100))
    assert gather(service, 1) == [command(1)]
    service.close()
    service = line(Role.SERVICE)
    raw(operator, sealed_frame(100))
    assert answers(operator, service)[0].text.startswith("replayed")
    raw(operator, sealed_frame(101, 2))
    assert gather(service, 1) == [command(2)]


@pytest.mark.parametrize(
    ("frame", "reason"),
    [(FrameEncoder().encode(command(1)), "unsealed"), (sealed_frame(5, key=bytes(32)), "bad_seal")],
)
def test_a_forged_command_is_refused_counted_and_answered(
    line: Callable[[Role], Link], frame: bytes, reason: str
) -> None:
    """Without a seal or with another key nothing is carried out."""
    service, operator = line(Role.SERVICE), line(Role.VIEWER)
    raw(operator, frame)
    assert answers(operator, service)[0].text.startswith(reason)
    assert (service.counters[f"refused.{reason}"], service.counters["received"]) == (1, 0)


def test_samples_need_no_seal(line: Callable[[Role], Link]) -> None:
    """A node on a sealed line sends as ever."""
    service, node = line(Role.SERVICE), line(Role.NODE)
    node.send(sample(1))
    assert gather(service, 1) == [sample(1)]


def test_a_refused_command_for_another_craft_is_not_answered(line: Callable[[Role], Link]) -> None:
    """The line answers only for those it serves."""
    service, operator = line(Role.SERVICE), line(Role.VIEWER)
    raw(operator, FrameEncoder().encode(command(1, craft="stranger")))
    assert settle(lambda: not service.receive(0.01) and service.counters["refused.unsealed"] == 1)
    assert service.counters["sent"] == 0


def test_an_operator_that_lost_its_counter_is_not_shut_out(line: Callable[[Role], Link], tmp_path: Path) -> None:
    """The clock lifts a new counter above the old ones."""
    service, operator = line(Role.SERVICE), line(Role.VIEWER)
    operator.send(command(1))
    assert gather(service, 1) == [command(1)]
    operator.close()
    (tmp_path / "viewer").unlink()
    operator = line(Role.VIEWER)
    operator.send(command(2))
    assert gather(service, 1) == [command(2)]


def encoder(folder: Path, name: str) -> FrameEncoder:
    """What packs the frames of one more operator on the line, with a counter of its own."""
    return open_coders(Role.VIEWER, folder / "key", folder / name, Counter(), lambda command, error: None)[0]


def test_two_operators_in_the_same_second_are_both_heard(line: Callable[[Role], Link], tmp_path: Path) -> None:
    """Forty commands by turns with two counters all arrive; the same bytes again are refused, each with an answer."""
    service, listener = line(Role.SERVICE), line(Role.VIEWER)
    operators = [encoder(tmp_path, name) for name in ("anna", "bob")]
    frames = [operators[number % 2].encode(command(number)) for number in range(40)]
    raw(listener, b"".join(frames))
    assert gather(service, 40) == [command(number) for number in range(40)]
    raw(listener, b"".join(frames))
    heard: list[Message] = []
    assert settle(lambda: bool(service.receive(0.01) or heard.extend(listener.receive(0.01)) or len(heard) == 40))
    replies = [message for message in heard if isinstance(message, CommandReply)]
    assert [(reply.command_sequence, reply.accepted) for reply in replies] == [(number, False) for number in range(40)]
    assert (service.counters["refused.replayed"], service.counters["received"]) == (40, 40)


def test_two_ends_that_share_a_counter_never_use_one_twice(
    line: Callable[[Role], Link], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A clock that was set back does not matter: each reads what the other has used."""
    monkeypatch.setattr(time, "time_ns", lambda: 0)
    service, listener = line(Role.SERVICE), line(Role.VIEWER)
    shared = [encoder(tmp_path, "shared") for _ in range(2)]
    raw(listener, b"".join(shared[number % 2].encode(command(number)) for number in range(10)))
    assert gather(service, 10) == [command(number) for number in range(10)]


@pytest.mark.parametrize("content", [b"", b"magcal counter 5 00000000\n", b"magcal counter 99", bytes(300)])
def test_a_damaged_counter_lets_no_command_pass(content: bytes, line: Callable[[Role], Link], tmp_path: Path) -> None:
    """Where the last counter is not known, samples pass and commands are refused and answered."""
    (tmp_path / "service").write_bytes(content)
    service, operator = line(Role.SERVICE), line(Role.VIEWER)
    raw(operator, sealed_frame(10**9))
    assert answers(operator, service)[0].text.startswith("not_kept")
    operator.send(sample(1))
    assert gather(service, 1) == [sample(1)]


def test_a_counter_is_whole_whenever_it_is_read(tmp_path: Path) -> None:
    """A half-written new file beside it, as a power cut leaves one, changes nothing."""
    kept = CounterFile(tmp_path / "counter")
    kept.keep(41)
    (tmp_path / "counter.new").write_bytes(b"magcal coun")
    assert CounterFile(tmp_path / "counter").last == 41
    kept.keep(42)
    assert CounterFile(tmp_path / "counter").last == 42


def test_a_key_that_others_can_read_stops_the_link(line: Callable[[Role], Link], tmp_path: Path) -> None:
    """The link is refused before it opens, with the file and its mode."""
    (tmp_path / "key").chmod(0o644)
    with pytest.raises(ConfigError, match="key: 'mode 0644'"):
        line(Role.SERVICE)


@pytest.mark.parametrize(("given", "missing"), [("key=k", "counter"), ("counter=c", "key")])
def test_key_and_counter_go_together(given: str, missing: str) -> None:
    """One without the other is refused by the name of what is missing."""
    with pytest.raises(LinkAddressError, match=f"{missing} is missing"):
        open_link(f"serial:/dev/null?{given}", Role.SERVICE)
