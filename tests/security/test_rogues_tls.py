"""Rogues at a daemon with client certificates and access rules: refused, and seen in its status by the right name."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from magcal_service.links import Role
from magcal_service.wire.messages import CommandReply, Message
from tests.security.rogue_links import (
    Blunt,
    Door,
    caller,
    command,
    door,
    expire,
    knock_raw,
    make_certificates,
    sample,
    shipped,
)

pytestmark = pytest.mark.skipif(shutil.which("openssl") is None, reason="openssl is not installed")


@pytest.fixture(scope="module")
def certificates(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_certificates(tmp_path_factory.mktemp("rogues") / "tls")


def client(certificates: Path, name: str = "magcal-feeder") -> Path:
    """The shipped client configuration with the certificate of a name."""
    out = certificates.parent / f"{certificates.name}-{name}.json5"
    return shipped("zenoh-tls-client.json5", certificates, out, **{"magcal-feeder": name})


@pytest.fixture(scope="module")
def tls(certificates: Path) -> Iterator[Door]:
    folder = certificates.parent
    service = shipped("zenoh-tls.json5", certificates, folder / "service.json5")
    with door(folder, service, client(certificates, "magcal-operator")) as found:
        yield found


def accepted(tls: Door) -> int:
    return tls.counters.get("accepted", 0)


def stays_out(tls: Door, config: Path, name: str) -> None:
    """Somebody sends samples, is counted under this name, and none of the samples arrives."""
    before, samples = tls.denied(name), accepted(tls)
    with caller(tls, config, Role.NODE) as rogue:
        for number in range(900, 905):
            rogue.send(sample(number))
        tls.until(f"{name} is not counted", lambda: tls.denied(name) > before)
        assert rogue.counters["up"] == 0
    assert accepted(tls) == samples


def test_without_a_certificate(tls: Door, certificates: Path) -> None:
    """A rogue that shows no certificate is counted as no_certificate."""
    text = client(certificates).read_text()
    lines = [line for line in text.splitlines() if "connect_" not in line or "verify" in line]
    config = certificates.parent / "without.json5"
    config.write_text("\n".join(lines).replace("enable_mtls: true", "enable_mtls: false"))
    stays_out(tls, config, "no_certificate")


def test_with_the_certificate_of_another_authority(tls: Door, certificates: Path, tmp_path: Path) -> None:
    """A rogue with the right name by a wrong authority is counted as wrong_certificate."""
    foreign = make_certificates(tmp_path / "foreign")
    shutil.copy(certificates / "ca.pem", foreign / "ca.pem")
    stays_out(tls, client(foreign), "wrong_certificate")


def test_with_a_certificate_that_has_expired(tls: Door, certificates: Path, tmp_path: Path) -> None:
    """A former feeder whose certificate has ended is counted as expired_certificate."""
    stays_out(tls, client(expire(certificates, tmp_path / "expired")), "expired_certificate")


def test_one_who_speaks_no_tls_at_all(tls: Door) -> None:
    """Garbage at the door is counted as a failed handshake."""
    before = tls.denied("handshake")
    knock_raw(tls.port, b"GET / HTTP/1.1\r\n\r\n")
    tls.until("the handshake is not counted", lambda: tls.denied("handshake") > before)


def denied(tls: Door, config: Path, name: str, *messages: Message) -> None:
    """Messages of somebody who has connected are counted as denied, each once."""
    before = tls.denied(name)
    with Blunt(tls.port, config) as rogue:
        for message in messages:
            rogue.put(message)
        tls.until(f"{name} is not counted", lambda: tls.denied(name) - before >= len(messages))
        tls.rest()
    assert tls.denied(name) - before == len(messages)


def test_a_viewer_that_feeds(tls: Door, certificates: Path) -> None:
    """A right certificate without the permission to feed: five samples, five denials, none accepted."""
    samples = accepted(tls)
    denied(tls, client(certificates, "magcal-viewer"), "sample", *(sample(number) for number in range(5)))
    assert accepted(tls) == samples


def test_a_feeder_that_commands(tls: Door, certificates: Path) -> None:
    """A right certificate without the permission to command: counted, and nobody is answered."""
    denied(tls, client(certificates), "command", command(1), command(2))
    assert not [message for message in tls.heard if isinstance(message, CommandReply)]


def test_a_certificate_that_no_rule_knows(tls: Door, certificates: Path) -> None:
    """A certificate of the right authority whose name has no role is counted, and so is what it sends."""
    before = tls.denied("no_role")
    denied(tls, client(certificates, "magcal-service"), "other", command(3))
    assert tls.denied("no_role") == before + 1
    assert not [message for message in tls.heard if isinstance(message, CommandReply)]


def test_a_feeder_that_feeds_is_not_counted_as_denied(tls: Door, certificates: Path) -> None:
    """What is allowed leaves the counters of denied samples and commands as they were."""
    before, samples = (tls.denied("sample"), tls.denied("command")), accepted(tls)
    with caller(tls, client(certificates), Role.NODE) as feeder:
        tls.until("the feeder is not connected", lambda: feeder.counters["up"] == 1)
        for number in range(2000, 2050):
            feeder.send(sample(number))
        tls.until("the samples are not accepted", lambda: accepted(tls) - samples >= 50)
    assert (tls.denied("sample"), tls.denied("command")) == before


def test_the_log_names_who_was_denied(tls: Door, certificates: Path) -> None:
    """The first denial of a kind is a warning with the certificate's name and the key."""
    denied(tls, client(certificates, "magcal-viewer"), "command", command(9))
    assert "CertCommonName(magcal-" in tls.log.read_text()
    assert "magcal/v1/demo/command" in tls.log.read_text()
