"""The Prometheus text: well-formed by promtool's word, complete, and served to whoever asks in order."""

from __future__ import annotations

import re
import select
import shutil
import socket
import subprocess
import time
import urllib.error
import urllib.request
from collections import Counter
from collections.abc import Iterator
from types import SimpleNamespace

import pytest

from magcal_service.base.errors import InputRefusedError
from magcal_service.config.settings import CraftConfig, SensorConfig, SpinConfig
from magcal_service.daemon.health import figures
from magcal_service.daemon.health.figures import BOUNDS_S, TickLateness
from magcal_service.daemon.health.metrics import Metrics
from magcal_service.daemon.health.metrics_server import MOST_CONNECTIONS, PATIENCE_S, MetricsServer
from magcal_service.daemon.health.report import Health
from magcal_service.daemon.pipeline import Pipeline
from magcal_service.links import Role, open_link
from sim_sensor.scenario_reader import load_scenario
from sim_sensor.simulation import Simulation


@pytest.fixture(scope="module")
def text() -> str:
    """What a daemon of two craft would serve, one of them after 400 s of the paper's scenario."""
    craft = CraftConfig("paper", SensorConfig(noise_nt=300.0), SpinConfig(rate_rpm=7.5))
    pipelines = [Pipeline(craft), Pipeline(CraftConfig("silent"))]
    with (
        open_link("loop:metrics", Role.SERVICE, crafts=["paper"]) as service,
        open_link("loop:metrics", Role.NODE) as node,
    ):
        health = Health(service)
        for message in Simulation(load_scenario("paper"), 1, 400.0).messages():
            node.send(message)
            for received in service.receive(0.0):
                pipelines[0].handle(received)
        health.lateness.note()
        return health.metrics(pipelines, Counter({"state.writes": 3}))


def test_promtool_finds_no_fault(text: str) -> None:
    promtool = shutil.which("promtool")
    if promtool is None:
        pytest.skip("promtool (Debian: prometheus) is not installed")
    checked = subprocess.run(
        [promtool, "check", "metrics"], input=text, capture_output=True, text=True, timeout=60, check=False
    )
    assert (checked.returncode, checked.stdout, checked.stderr) == (0, "", "")


@pytest.mark.parametrize(
    "line",
    [
        'magcal_samples_total{craft="paper",outcome="accepted"} 400',
        'magcal_messages_received_total{craft="paper",source="mag0",kind="magnetometer"} 400',
        'magcal_messages_lost_total{craft="paper",source="mag0",kind="magnetometer"} 0',
        'magcal_verdict{craft="silent",verdict="not_started"} 1',
        'magcal_daemon_events_total{event="state.writes"} 3',
        'magcal_link_events_total{event="received"} 800',
        'magcal_tick_lateness_seconds_bucket{le="+Inf"} 1',
        "magcal_tick_lateness_seconds_count 1",
    ],
)
def test_it_says(text: str, line: str) -> None:
    assert line in [re.sub(r'source="[^"]*"', 'source="mag0"', row) for row in text.splitlines()]


def test_labels_cannot_break_out_of_their_quotes() -> None:
    metrics = Metrics()
    metrics.add("x", "gauge", "X.", [({"a": 'b"c\\d\ne'}, 1.5)])
    assert metrics.render().splitlines()[-1] == 'magcal_x{a="b\\"c\\\\d\\ne"} 1.5'


@pytest.fixture
def server() -> Iterator[MetricsServer]:
    with MetricsServer("127.0.0.1:0") as server:
        yield server


def fetch(server: MetricsServer, path: str = "/metrics") -> str:
    with urllib.request.urlopen(f"http://127.0.0.1:{server.port}{path}", timeout=30.0) as answer:
        body: bytes = answer.read()
    return body.decode()


def test_what_was_published_last_is_served_with_its_age(server: MetricsServer) -> None:
    server.publish("first 1\n")
    server.publish("second 2\n")
    assert fetch(server).startswith("second 2\n# HELP magcal_loop_age_seconds")


def test_anything_else_is_not_found(server: MetricsServer) -> None:
    with pytest.raises(urllib.error.HTTPError, match="404"):
        fetch(server, "/etc/passwd")


def test_mute_and_rude_connections_hold_up_no_scrape(server: MetricsServer) -> None:
    """30 mute connections, one that reads nothing of a long answer, and garbage: the scrape does not wait for them."""
    server.publish("x 1\n" * 1_000_000)
    mute = [socket.create_connection(("127.0.0.1", server.port)) for _ in range(30)]
    with (
        socket.create_connection(("127.0.0.1", server.port)) as deaf,
        socket.create_connection(("127.0.0.1", server.port)) as rude,
    ):
        deaf.sendall(b"GET /metrics HTTP/1.1\r\n\r\n")
        rude.sendall(b"\x00\xff" * 5000)
        begun_s = time.monotonic()
        assert len(fetch(server)) > 4_000_000
        assert time.monotonic() - begun_s < 5.0 * PATIENCE_S  # one after the other they would take 30 times that
    for connection in mute:
        connection.settimeout(60.0)
        assert connection.recv(1) == b""  # its second is over
        connection.close()


def test_more_connections_than_are_held_end_the_oldest_mute_one(server: MetricsServer) -> None:
    server.publish("x 1\n")
    mute = [socket.create_connection(("127.0.0.1", server.port)) for _ in range(MOST_CONNECTIONS + 1)]
    assert select.select(mute, [], [], 60.0)[0] == [mute[0]]  # before any of them has had its time
    assert mute[0].recv(1) == b""
    assert fetch(server).startswith("x 1\n")
    for connection in mute:
        connection.close()


def test_a_taken_port_is_refused_by_its_field(server: MetricsServer) -> None:
    with pytest.raises(InputRefusedError, match=r"health.metrics: '127.0.0.1:[0-9]+' is refused; a free port"):
        MetricsServer(f"127.0.0.1:{server.port}")


def test_closing_ends_its_thread(server: MetricsServer) -> None:
    server.close()
    with pytest.raises(OSError, match="refused"):
        socket.create_connection(("127.0.0.1", server.port), timeout=5.0)


def test_lateness_counts_the_wait_in_front_of_the_daemon(monkeypatch: pytest.MonkeyPatch) -> None:
    """A message found waiting counts from when the daemon last looked; one waited for, from when it came."""
    now_s = 100.0
    monkeypatch.setattr(figures, "time", SimpleNamespace(monotonic=lambda: now_s))
    lateness = TickLateness()
    now_s += 0.06
    lateness.polled(now_s)
    lateness.note()
    lateness.polled(now_s - 1.0)
    now_s += 0.002
    lateness.note()
    assert (sum(lateness.counts[BOUNDS_S.index(0.05) :]), sum(lateness.counts)) == (1, 2)
    assert lateness.total_s == pytest.approx(0.062)
