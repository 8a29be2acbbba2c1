"""The shipped TLS configuration, run for real on 127.0.0.1: who gets in, and what each certificate may do."""

from __future__ import annotations

import shutil
import socket
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from magcal_service.links import Link, Role, open_link
from magcal_service.wire.messages import (
    Command,
    CommandReply,
    Estimate,
    MagnetometerSample,
    Message,
    Verdict,
)

DEPLOY = Path(__file__).resolve().parents[2] / "deploy"
WAIT_S = 120.0

pytestmark = pytest.mark.skipif(shutil.which("openssl") is None, reason="openssl is not installed")

Open = Callable[[str, Role], Link]


@pytest.fixture(scope="module")
def certificates(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Certificates by the shipped script, for 127.0.0.1."""
    directory = tmp_path_factory.mktemp("tls") / "tls"
    subprocess.run([DEPLOY / "make-certificates.sh", directory], check=True, capture_output=True, timeout=60)
    return directory


@pytest.fixture(scope="module")
def port() -> int:
    """A port that was free a moment ago."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def shipped(name: str, certificates: Path, role: str = "magcal-feeder") -> Path:
    """A shipped zenoh configuration with the test's certificates in place of the installed ones."""
    text = (DEPLOY / "config" / name).read_text()
    text = text.replace("/run/credentials/magcal.service/service.key", str(certificates / "magcal-service.key"))
    text = text.replace("/etc/magcal/tls/magcal-feeder", str(certificates / role))
    path = certificates.parent / f"{certificates.name}-{role}-{name}"
    path.write_text(text.replace("/etc/magcal/tls", str(certificates)))
    return path


@pytest.fixture(scope="module")
def service(certificates: Path, port: int) -> Iterator[Link]:
    """The daemon's end, as deploy/config/zenoh-tls.toml opens it."""
    config = shipped("zenoh-tls.json5", certificates)
    with open_link(f"zenoh:tls/127.0.0.1:{port}?mode=peer&listen=yes&config={config}", Role.SERVICE) as link:
        yield link


@pytest.fixture
def connect(certificates: Path, port: int, service: Link) -> Iterator[Open]:
    """Opens the other end with the certificate of one name, in one role."""
    service.receive(0.0)
    with ExitStack() as stack:

        def opened(certificate: str, role: Role) -> Link:
            config = shipped("zenoh-tls-client.json5", certificates, certificate)
            link = open_link(f"zenoh:tls/127.0.0.1:{port}?config={config}", role, crafts=["demo"])
            return stack.enter_context(link)

        yield opened


def sample(sequence: int = 0) -> MagnetometerSample:
    return MagnetometerSample(
        craft="demo", source="mag", sequence=sequence, time_ns=10**18, field_body_nt=(20000.0, -5000.0, 40000.0)
    )


def command() -> Command:
    return Command(craft="demo", source="console", sequence=0, time_ns=10**18, name="reset")


def estimate(tick: int) -> Estimate:
    return Estimate(
        craft="demo", source="magcal", sequence=tick, time_ns=10**18, method="ukf", tick=tick,
        bias_nt=(1.0, 2.0, 3.0), D=(0.0,) * 6, covariance=(1.0,) * 45, verdict=Verdict.CONVERGING,
    )  # fmt: skip


def reply() -> CommandReply:
    return CommandReply(
        craft="demo", source="magcal", sequence=0, time_ns=10**18, name="reset",
        command_source="console", command_sequence=0, accepted=True,
    )  # fmt: skip


def delivered(sender: Link, receiver: Link, message: Message) -> list[Message]:
    """Send until ``message`` comes out at the other end; everything received until then, or within WAIT_S."""
    received: list[Message] = []
    deadline = time.monotonic() + WAIT_S
    while message not in received and time.monotonic() < deadline:
        sender.send(message)
        received += receiver.receive(0.2)
    return received


def test_the_feeders_samples_arrive(service: Link, connect: Open) -> None:
    assert sample() in delivered(connect("magcal-feeder", Role.NODE), service, sample())


@pytest.mark.parametrize(
    ("certificate", "role"),
    [("magcal-feeder", Role.NODE), ("magcal-operator", Role.VIEWER), ("magcal-viewer", Role.VIEWER)],
)
def test_everyone_with_a_certificate_gets_the_results(
    service: Link, connect: Open, certificate: str, role: Role
) -> None:
    assert estimate(1) in delivered(service, connect(certificate, role), estimate(1))


def test_a_late_joiner_gets_the_newest_estimate_at_once(service: Link, connect: Open) -> None:
    service.send(estimate(7))
    assert estimate(7) in connect("magcal-viewer", Role.VIEWER).receive(WAIT_S)


def test_the_operator_commands_and_is_answered(service: Link, connect: Open) -> None:
    operator = connect("magcal-operator", Role.VIEWER)
    assert command() in delivered(operator, service, command())
    assert reply() in delivered(service, operator, reply())


def test_a_feeder_may_not_command(service: Link, connect: Open) -> None:
    feeder = connect("magcal-feeder", Role.NODE)
    feeder.send(command())
    received = delivered(feeder, service, sample(1)) + service.receive(0.5)
    assert {type(message) for message in received} == {MagnetometerSample}


@pytest.mark.parametrize("certificate", ["magcal-operator", "magcal-viewer"])
def test_only_a_feeder_may_feed(service: Link, connect: Open, certificate: str) -> None:
    pretender, feeder = connect(certificate, Role.NODE), connect("magcal-feeder", Role.NODE)
    for sequence in range(100, 110):
        pretender.send(sample(sequence))
    received = delivered(feeder, service, sample(2)) + service.receive(0.5)
    assert [message for message in received if message.sequence >= 100] == []


def test_a_viewer_may_not_command(service: Link, connect: Open) -> None:
    viewer, feeder = connect("magcal-viewer", Role.VIEWER), connect("magcal-feeder", Role.NODE)
    assert estimate(3) in delivered(service, viewer, estimate(3))  # the viewer is connected
    viewer.send(command())
    received = delivered(feeder, service, sample(3)) + service.receive(0.5)
    assert {type(message) for message in received} == {MagnetometerSample}


def test_a_forged_result_reaches_nobody(service: Link, connect: Open) -> None:
    feeder, viewer = connect("magcal-feeder", Role.NODE), connect("magcal-viewer", Role.VIEWER)
    feeder.send(estimate(666))
    received = delivered(service, viewer, estimate(4)) + viewer.receive(0.5)
    assert estimate(666) not in received


def stays_out(service: Link, link: Link) -> bool:
    """Whether nothing of what ``link`` sends arrives, for three seconds."""
    deadline = time.monotonic() + 3.0
    while time.monotonic() < deadline:
        link.send(sample(9))
        if service.receive(0.2):
            return False
    return link.counters["up"] == 0


def test_nobody_gets_in_without_a_certificate(service: Link, certificates: Path, port: int) -> None:
    text = shipped("zenoh-tls-client.json5", certificates).read_text()
    lines = [line for line in text.splitlines() if "connect_" not in line or "verify" in line]
    config = certificates.parent / "without.json5"
    config.write_text("\n".join(lines).replace("enable_mtls: true", "enable_mtls: false"))
    with open_link(f"zenoh:tls/127.0.0.1:{port}?config={config}", Role.NODE, crafts=["demo"]) as link:
        assert stays_out(service, link)


def test_nobody_gets_in_with_a_certificate_of_another_authority(
    service: Link, certificates: Path, port: int, tmp_path: Path
) -> None:
    foreign = tmp_path / "foreign"
    subprocess.run([DEPLOY / "make-certificates.sh", foreign], check=True, capture_output=True, timeout=60)
    shutil.copy(certificates / "ca.pem", foreign / "ca.pem")  # it trusts the service; the service must not trust it
    config = shipped("zenoh-tls-client.json5", foreign)
    with open_link(f"zenoh:tls/127.0.0.1:{port}?config={config}", Role.NODE, crafts=["demo"]) as link:
        assert stays_out(service, link)


def test_a_node_refuses_a_service_whose_certificate_names_another_host(
    certificates: Path, service: Link, port: int
) -> None:
    config = shipped("zenoh-tls-client.json5", certificates)
    with open_link(f"zenoh:tls/localhost:{port}?config={config}", Role.NODE, crafts=["demo"]) as link:
        assert stays_out(service, link)


def test_private_keys_are_readable_by_their_owner_alone(certificates: Path) -> None:
    assert {path.stat().st_mode & 0o077 for path in certificates.glob("*.key")} == {0}


def test_an_authority_is_never_overwritten(certificates: Path) -> None:
    before = (certificates / "ca.key").read_bytes()
    done = subprocess.run(
        [DEPLOY / "make-certificates.sh", certificates], capture_output=True, text=True, timeout=60, check=False
    )
    assert (done.returncode, (certificates / "ca.key").read_bytes()) == (2, before)
