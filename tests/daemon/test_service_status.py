"""``magcal status`` and the metrics of a daemon in a process of its own."""

from __future__ import annotations

import json
import urllib.request
from pathlib import Path

import pytest

from magcal_service.cli.__main__ import main
from tests.daemon.service_processes import CRAFT, Node, daemon, free_port, stream


def configured(folder: Path, port: int, metrics: int) -> Path:
    path = folder / "magcal.toml"
    path.write_text(
        f'version = 1\nlink = "zenoh:tcp/127.0.0.1:{port}"\n{CRAFT.format(name="paper")}'
        f'[output]\nstatus_period_s = 1.0\n[health]\nmetrics = "127.0.0.1:{metrics}"\nsummary_s = 1.0\n'
    )
    return path


def test_a_daemon_is_asked_and_found_healthy_once_its_estimate_is_sound(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """3 before the start, 0 once it is trusted; in words, as JSON, as metrics and as log lines."""
    port, metrics = free_port(), free_port()
    config = configured(tmp_path, port, metrics)
    with daemon(config) as process, Node(f"zenoh:tcp/127.0.0.1:{port}") as node:
        node.until_heard()
        assert main(["status", "--config", str(config), "--timeout", "60"]) == 3
        assert "NOT HEALTHY: not_started" in capsys.readouterr().out
        node.send(stream(seconds=900))
        node.settle()
        node.until_accepted(900)
        assert main(["status", "--link", f"zenoh:tcp/127.0.0.1:{port}", "--json", "--timeout", "60"]) == 0
        told = json.loads(capsys.readouterr().out)
        assert (told["healthy"], told["craft"]["paper"]["verdict"]) == (True, "trusted")
        assert told["craft"]["paper"]["counters"]["tick_late_p99_us"] > 0
        with urllib.request.urlopen(f"http://127.0.0.1:{metrics}/metrics", timeout=60.0) as answer:
            assert b'magcal_samples_total{craft="paper",outcome="accepted"}' in answer.read()
        assert process.stop() == 0
    lines = [json.loads(line) for line in process.log.read_text().splitlines()]
    summaries = [line["health"] for line in lines if "health" in line]
    assert {"uptime_s", "tick_late_p99_us", "rss_kb", "open_files", "threads", "craft"} <= set(summaries[-1])


def test_nobody_there_is_2_and_one_clear_line(capsys: pytest.CaptureFixture[str]) -> None:
    address = f"zenoh:tcp/127.0.0.1:{free_port()}"
    assert main(["status", "--link", address, "--timeout", "0.5"]) == 2
    assert capsys.readouterr().err == (f"no status of any craft on {address} within 0.5 s; is the daemon running?\n")


def test_a_serial_daemon_is_asked_at_the_viewers_end(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "magcal.toml"
    path.write_text('version = 1\nlink = "serial:/dev/null"\n[[craft]]\nname = "demo"\n')
    assert main(["status", "--config", str(path)]) == 2
    assert "give --link with the end of a viewer" in capsys.readouterr().err
