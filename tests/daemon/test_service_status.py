"""``magcal status`` and the metrics of a daemon in a process of its own."""

from __future__ import annotations

import json
import re
import time
import urllib.request
from pathlib import Path

import pytest

from magcal_service.cli.__main__ import main
from sim_sensor.cli import main as sensor
from tests.daemon.service_processes import CRAFT, Node, daemon, free_port, stream, wait_for


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
    """3 before the start, 0 afterwards, though not protected yet; in words, as JSON, as metrics and as log lines."""
    port, metrics = free_port(), free_port()
    config = configured(tmp_path, port, metrics)
    with daemon(config) as process, Node(f"zenoh:tcp/127.0.0.1:{port}") as node:
        node.until_heard()
        assert main(["status", "--config", str(config), "--timeout", "60"]) == 3
        told = capsys.readouterr().out
        assert (
            "NOT HEALTHY: not_started (collecting), 0 ticks; to do: keep the samples and the reference coming\n" in told
        )
        node.send(stream(seconds=900))
        node.settle()
        node.until_accepted(900)
        assert main(["status", "--link", f"zenoh:tcp/127.0.0.1:{port}", "--json", "--timeout", "60"]) == 0
        told = json.loads(capsys.readouterr().out)
        assert (told["healthy"], told["craft"]["paper"]["verdict"]) == (True, "converging")
        assert re.search(r"\(unprotected\), protected to \d+ nT \(reference_late\)", told["craft"]["paper"]["text"])
        assert told["craft"]["paper"]["counters"]["protection_nt"] > 350
        assert told["craft"]["paper"]["counters"]["tick_late_p99_us"] > 0
        with urllib.request.urlopen(f"http://127.0.0.1:{metrics}/metrics", timeout=60.0) as answer:
            text = answer.read()
        assert b'magcal_samples_total{craft="paper",outcome="accepted"}' in text
        assert b'magcal_protection_tesla{craft="paper",hazard="reference_late"} ' in text
        assert process.stop() == 0
    lines = [json.loads(line) for line in process.log.read_text().splitlines()]
    summaries = [line["health"] for line in lines if "health" in line]
    assert [line["text"] for line in lines if "health" in line][-1] == "health: paper converging; no troubles"
    assert {"uptime_s", "tick_late_p99_us", "rss_kb", "open_files", "threads", "craft"} <= set(summaries[-1])


def test_nobody_there_is_2_and_one_clear_line(capsys: pytest.CaptureFixture[str]) -> None:
    address = f"zenoh:tcp/127.0.0.1:{free_port()}"
    assert main(["status", "--link", address, "--timeout", "0.5"]) == 2
    told = capsys.readouterr().err
    assert told.startswith(f"no status of any craft on {address}: nobody is at {address.removeprefix('zenoh:')}, ")
    assert told.endswith("; is the daemon running?\n")


def test_a_craft_that_nobody_serves_is_told_long_before_the_wait_is_over(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    address = f"zenoh:tcp/127.0.0.1:{free_port()}"
    with daemon(configured(tmp_path, int(address.rpartition(":")[2]), free_port())):
        began_s = time.monotonic()
        assert main(["status", "--link", address, "--craft", "wrong", "--craft", "paper", "--timeout", "300"]) == 2
        assert time.monotonic() - began_s < 100.0
    told = capsys.readouterr().err
    assert told == f"no status of craft wrong on {address}: no daemon there serves craft wrong; served: paper\n"


def test_a_node_whose_craft_nobody_serves_ends_with_three_and_says_what_is_served(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The daemon says it as well, in its log and in the status of those that it serves."""
    address = f"zenoh:tcp/127.0.0.1:{free_port()}"
    arguments = ["--scenario", "paper", "--craft", "wrong", "--link", address, "--speed", "max", "--duration", "20"]
    with daemon(configured(tmp_path, int(address.rpartition(":")[2]), free_port())) as process:
        assert sensor(["run", *arguments, "--wait", "0.5", "--quiet"]) == 3
        told = (
            f"20 samples were sent on {address} and none was answered: no daemon there serves craft wrong; "
            "served: paper\n"
            f"next: see what the daemon says by `magcal status --link {address}`, then run this again\n"
        )
        assert capsys.readouterr().err == told
        wait_for("messages of craft 'wrong' are refused; served: paper", process.log)
        assert main(["status", "--link", address, "--craft", "paper", "--timeout", "60"]) == 3
    assert "messages of craft wrong are refused; served: paper" in capsys.readouterr().out


def test_a_serial_daemon_is_asked_at_the_viewers_end(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "magcal.toml"
    path.write_text('version = 1\nlink = "serial:/dev/null"\n[[craft]]\nname = "demo"\n')
    assert main(["status", "--config", str(path)]) == 2
    assert "give --link with the end of a viewer" in capsys.readouterr().err
