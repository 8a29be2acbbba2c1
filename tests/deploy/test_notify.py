"""``sd_notify`` against a real datagram socket."""

from __future__ import annotations

import os
import socket
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from magcal_service.config.daemon_settings import StateConfig
from magcal_service.config.settings import Config, CraftConfig
from magcal_service.daemon.checkpoints.store import Checkpoints
from magcal_service.daemon.notify import (
    READY,
    STOPPING,
    WATCHDOG,
    asking_for_time,
    notify,
    status,
    watchdog_period_s,
)
from magcal_service.daemon.service import Service
from magcal_service.links import Role, open_link


@pytest.fixture(params=["path", "abstract"])
def manager(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[socket.socket]:
    """A listening service manager whose address is in NOTIFY_SOCKET."""
    name = f"magcal-test-{os.getpid()}" if request.param == "abstract" else str(tmp_path / "notify")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener:
        listener.bind("\0" + name if request.param == "abstract" else name)
        listener.settimeout(5.0)
        monkeypatch.setenv("NOTIFY_SOCKET", "@" + name if request.param == "abstract" else name)
        yield listener


@pytest.mark.parametrize(
    ("assignments", "datagram"),
    [
        ((READY,), b"READY=1"),
        ((WATCHDOG,), b"WATCHDOG=1"),
        ((STOPPING,), b"STOPPING=1"),
        ((READY, status("3 craft, link up")), b"READY=1\nSTATUS=3 craft, link up"),
        ((status("two\nlines"),), b"STATUS=two lines"),
    ],
)
def test_each_call_is_one_datagram(manager: socket.socket, assignments: tuple[str, ...], datagram: bytes) -> None:
    assert notify(*assignments)
    assert manager.recv(4096) == datagram


@pytest.mark.parametrize("address", [None, "", "relative/path", "vsock:2:1234"])
def test_nothing_is_sent_where_no_manager_listens(monkeypatch: pytest.MonkeyPatch, address: str | None) -> None:
    monkeypatch.delenv("NOTIFY_SOCKET", raising=False)
    if address is not None:
        monkeypatch.setenv("NOTIFY_SOCKET", address)
    assert not notify(READY)


def test_a_manager_that_has_gone_away_is_no_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "gone"))
    assert not notify(WATCHDOG)


def test_a_manager_that_does_not_read_never_blocks(manager: socket.socket) -> None:
    assert not all(notify(WATCHDOG) for _ in range(10_000))


@pytest.mark.parametrize(
    ("micros", "pid", "period_s"),
    [
        ("30000000", None, 15.0),
        ("30000000", "self", 15.0),
        ("30000000", "1", None),
        (None, None, None),
        ("0", None, None),
        ("-3", None, None),
        ("soon", None, None),
    ],
)
def test_the_watchdog_is_fed_at_half_its_time(
    monkeypatch: pytest.MonkeyPatch, micros: str | None, pid: str | None, period_s: float | None
) -> None:
    for name, value in (("WATCHDOG_USEC", micros), ("WATCHDOG_PID", str(os.getpid()) if pid == "self" else pid)):
        monkeypatch.delenv(name, raising=False)
        if value is not None:
            monkeypatch.setenv(name, value)
    assert watchdog_period_s() == period_s


def test_more_time_is_asked_for_while_work_goes_on(manager: socket.socket, monkeypatch: pytest.MonkeyPatch) -> None:
    """At once and every two seconds; work that hangs asks no more."""
    now = [100.0]
    monkeypatch.setattr("magcal_service.daemon.notify.time.monotonic", lambda: now[0])
    done = []
    for item in asking_for_time(range(8)):
        done.append(item)
        now[0] += 0.5
    assert done == list(range(8))
    assert [manager.recv(4096) for _ in range(2)] == [b"EXTEND_TIMEOUT_USEC=10000000"] * 2
    manager.setblocking(False)
    with pytest.raises(BlockingIOError):
        manager.recv(4096)


def test_the_unit_gives_as_much_to_begin_with() -> None:
    unit = (Path(__file__).parents[2] / "deploy" / "magcal.service").read_text()
    assert "TimeoutStopSec=10\n" in unit
    assert "Type=notify\n" in unit  # who sends no messages is not listened to


def test_a_service_that_stops_asks_for_time(manager: socket.socket, tmp_path: Path) -> None:
    """For its last checkpoints, for closing its ticks, and for its last statuses."""
    crafts, stop = (CraftConfig("one"), CraftConfig("two")), threading.Event()
    stop.set()
    state = StateConfig(tmp_path / "state")
    with open_link("loop:stopping", Role.SERVICE) as link, Checkpoints(state, crafts) as checkpoints:
        Service(Config(link.address, crafts, state=state), link, checkpoints=checkpoints).run(stop)
    assert [manager.recv(4096) for _ in range(3)] == [b"EXTEND_TIMEOUT_USEC=10000000"] * 3
