"""A link that other machines can reach without TLS says so, in the log at the start and in every status."""

from __future__ import annotations

import json
import threading

import pytest
import zenoh

from magcal_service.config.settings import Config, CraftConfig
from magcal_service.daemon.run import run_daemon
from magcal_service.daemon.service import Service
from magcal_service.links import Link, Role, open_link
from magcal_service.links.zenoh_settings import exposures
from magcal_service.wire.messages import Status


def asked(listen: str = "", connect: str = "", more: str = "{}") -> tuple[str, ...]:
    config = zenoh.Config.from_json5(more)
    config.insert_json5("listen/endpoints", json.dumps([listen] if listen else []))
    config.insert_json5("connect/endpoints", json.dumps([connect] if connect else []))
    return exposures(config)


@pytest.mark.parametrize("endpoint", ["tcp/127.0.0.1:7447", "tcp/[::1]:7447", "udp/localhost:1", "unixsock-stream/x"])
def test_this_machine_alone_is_no_exposure(endpoint: str) -> None:
    """Loopback and local sockets need no warning, listening or connecting."""
    assert asked(endpoint) == asked("", endpoint) == ()


@pytest.mark.parametrize("endpoint", ["tcp/0.0.0.0:7447", "tcp/[::]:7447", "udp/192.168.1.10:1", "ws/magcal.local:80"])
def test_listening_wider_without_tls_is_said(endpoint: str) -> None:
    """An address that other machines reach, or a name, is a warning for each thing that is missing."""
    warnings = asked(endpoint)
    assert warnings[0] == f"listens on {endpoint} without TLS"
    assert len(warnings) == 3


def test_connecting_elsewhere_without_tls_is_said() -> None:
    """What passes to a router on another machine can be read on the way."""
    assert asked("", "tcp/10.0.0.1:7447") == ("connects to tcp/10.0.0.1:7447 without TLS",)


def test_tls_with_certificates_and_rules_is_no_exposure() -> None:
    """With everything in place there is nothing to say."""
    more = "{transport: {link: {tls: {enable_mtls: true}}}, access_control: {enabled: true, rules: [], subjects: [], "
    assert asked("tls/0.0.0.0:7447", more=f"{more} policies: []}}}}") == ()


def test_tls_alone_lets_everybody_in() -> None:
    """TLS hides what passes; it does not ask who comes."""
    assert [warning.split()[0] for warning in asked("tls/0.0.0.0:7447")] == ["asks", "has"]


def test_the_status_carries_the_warning() -> None:
    """Who looks at the daemon sees what it leaves open, cut to what a text may hold."""
    with open_link("loop:exposed", Role.SERVICE) as link, open_link("loop:exposed", Role.VIEWER) as viewer:
        link.warnings = ("listens on tcp/0.0.0.0:7447 without TLS", "\u00e4" * 600)
        Service(Config(link.address, (CraftConfig("demo"),)), link).publish_status()
        (status,) = [message for message in viewer.receive(1.0) if isinstance(message, Status)]
    assert "listens on tcp/0.0.0.0:7447 without TLS" in status.text
    assert len(status.text.encode()) > 500


def test_the_start_is_logged_with_the_warning(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """What a link leaves open is a warning in the log once it serves."""
    monkeypatch.setattr(Link, "warnings", ("listens on tcp/0.0.0.0:7447 without TLS",))
    stop = threading.Event()
    stop.set()
    with caplog.at_level("WARNING"):
        run_daemon(Config("loop:start", (CraftConfig("demo"),)), stop)
    assert "loop:start: listens on tcp/0.0.0.0:7447 without TLS" in caplog.messages


def test_a_link_on_loopback_warns_of_nothing() -> None:
    """The default address is this machine's own."""
    with open_link("zenoh:tcp/127.0.0.1:0?listen=yes", Role.SERVICE) as link:
        assert link.warnings == ()
