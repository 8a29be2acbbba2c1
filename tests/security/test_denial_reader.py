"""zenoh's log lines become denials by name, whatever the pieces they come in."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from magcal_service.links.zenoh_log import DENIALS, DenialReader

ZID = "25ca465f9b084d215615bbe014d6b4b8"
HEAD = "2026-11-25T02:25:11.205364Z"
RULES = "zenoh::net::routing::interceptor"


def door(text: str, origin: str = "zenoh_link_tls::unicast") -> str:
    return f"{HEAD}  WARN acc-0 ThreadId(05) {origin}: {text}. Hint: increase the system open file limit.\n"


def verdict(action: str, key: str, flow: str = "ingress", thread: int = 9) -> str:
    who = f"{ZID} on Interface(lo)+CertCommonName(magcal-viewer)+Transport(Tls)+{ZID}"
    words = f"{who} is unauthorized to {action} ({flow}) on {key}"
    return f"{HEAD} TRACE  rx-1 ThreadId({thread:02}) {RULES}::access_control: {words}\n"


def intercepted(thread: int = 9) -> str:
    return f"{HEAD} TRACE  rx-1 ThreadId({thread:02}) {RULES}: Msg intercepted!\n"


def names(text: str) -> list[str]:
    return [name for name, _ in DenialReader().feed(text.encode())]


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("peer sent no certificates", "no_certificate"),
        ("invalid peer certificate: BadSignature", "wrong_certificate"),
        ("invalid peer certificate: certificate expired: verification time 1795573632", "expired_certificate"),
        ("received corrupt message of type InvalidContentType", "handshake"),
    ],
)
def test_a_failed_handshake_has_its_reason(text: str, name: str) -> None:
    """Each way to fail at the door has its own counter."""
    assert names(door(text)) == [name]


def test_a_wrong_password_is_told_from_a_new_link() -> None:
    """Of what the authentication says, only refusals count."""
    origin = "zenoh_transport::unicast::establishment::accept"
    assert names(door("UsrPwd extension - Recv OpenSyn. Invalid password", origin)) == ["password"]
    assert names(door("New transport link accepted from a to b", origin)) == []


@pytest.mark.parametrize(
    ("action", "key", "name"),
    [
        ("Put", "magcal/v1/demo/command", "command"),
        ("Put", "magcal/v1/demo/sample/magnetometer/mag", "sample"),
        ("Put", "magcal/v1/demo/result/estimate/magcal", "result"),
        ("Put", "magcal/v1/demo/reply", "reply"),
        ("Put", "elsewhere", "other"),
        ("Declare Subscriber", "magcal/v1/demo/command", "other"),
    ],
)
def test_a_denied_message_is_counted_by_what_it_was(action: str, key: str, name: str) -> None:
    """The part of the key after the craft names the counter."""
    assert names(verdict(action, key) + intercepted()) == [name]


def test_a_verdict_without_a_message_is_no_denial() -> None:
    """zenoh works verdicts out beforehand; they count when a message is intercepted."""
    assert names(verdict("Put", "magcal/v1/demo/command") * 5) == []


def test_what_this_end_sends_and_a_rule_stops_is_no_denial() -> None:
    """A result that its listener may not see is everyday life."""
    assert names(verdict("Put", "magcal/v1/demo/result/estimate/magcal", "egress") + intercepted()) == []


def test_two_threads_do_not_take_each_others_verdicts() -> None:
    """Lines of two threads that mix give each its own denial."""
    mixed = verdict("Put", "magcal/v1/demo/command", thread=8) + verdict("Put", "magcal/v1/demo/reply", thread=9)
    assert names(mixed + intercepted(8) + intercepted(9)) == ["command", "reply"]


def test_the_words_are_one_printable_line() -> None:
    """A name in a certificate cannot put control characters into the log."""
    ((_, words),) = DenialReader().feed(door("invalid peer certificate: \x1b[31m\r fake").encode())
    assert words == "invalid peer certificate: ?[31m? fake"


@given(st.lists(st.sampled_from([door("peer sent no certificates"), intercepted(), "noise\n"])), st.integers(1, 97))
def test_any_split_gives_the_same_denials(lines: list[str], size: int) -> None:
    """The reader's answer does not depend on how the bytes are cut."""
    data = "".join(lines).encode()
    reader = DenialReader()
    pieces = [name for start in range(0, len(data), size) for name, _ in reader.feed(data[start : start + size])]
    assert pieces == names(data.decode())


@given(st.binary(max_size=400))
def test_no_bytes_stop_the_reader(data: bytes) -> None:
    """Whatever stands in the log, the reader lives on and names only what there is a counter for."""
    reader = DenialReader()
    found = reader.feed(data + b"\n") + reader.feed(door("peer sent no certificates").encode())
    assert {name for name, _ in found} <= set(DENIALS)
    assert found[-1][0] == "no_certificate"
