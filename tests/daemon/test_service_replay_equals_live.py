"""A replay is the live run, byte for byte: the same samples over a real link, and from a recording of them."""

from __future__ import annotations

import contextlib
import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from magcal_service.cli.__main__ import main
from sim_sensor.demo.pty_pair import PtyPair
from sim_sensor.recorder import record_simulation
from sim_sensor.scenario_reader import load_scenario
from sim_sensor.simulation import Simulation
from tests.daemon.service_processes import daemon, free_port, write_config

SECONDS = 900


def run(*arguments: str) -> subprocess.CompletedProcess[str]:
    """A command of the project; 0 and 3 are its ways to be done."""
    done = subprocess.run([sys.executable, "-m", *arguments], capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode in (0, 3), done.stderr
    return done


@contextlib.contextmanager
def ends(kind: str) -> Iterator[tuple[str, str]]:
    """Addresses of the daemon's and the node's end of a link."""
    if kind == "zenoh":
        address = f"zenoh:tcp/127.0.0.1:{free_port()}"
        yield address, address
    else:
        with PtyPair() as pair:
            yield f"serial:{pair.paths[0]}", f"serial:{pair.paths[1]}"


@pytest.mark.parametrize("kind", ["zenoh", "serial"])
def test_a_replay_writes_the_same_bytes_as_the_live_run(kind: str, tmp_path: Path) -> None:
    live, replayed = tmp_path / "live.csv", tmp_path / "replayed.csv"
    scenario = ("--scenario", "paper", "--seed", "5", "--duration", str(SECONDS))
    with ends(kind) as (service, node):
        config = write_config(tmp_path, service, csv=live)
        with daemon(config) as process:
            run("sim_sensor.cli", "run", *scenario, "--speed", "max", "--link", node, "--quiet")
            assert process.stop() == 0
        run("sim_sensor.cli", "record", *scenario, "--out", str(tmp_path / "recording"))
        run(
            "magcal_service.cli",
            "replay",
            str(tmp_path / "recording" / "RECORDING.toml"),
            "--config",
            str(config),
            "--out",
            str(replayed),
        )
    rows = live.read_bytes().splitlines()
    assert len(rows) == SECONDS + 1
    assert b",converging,unprotected," in rows[-1]  # a late reference would not have been seen yet
    assert replayed.read_bytes() == live.read_bytes()


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """200 s of the paper's scenario."""
    folder = tmp_path_factory.mktemp("recording")
    return record_simulation(Simulation(load_scenario("paper"), 5, 200.0), folder)


@pytest.mark.parametrize("speed", ["400", "1e6"])
def test_a_paced_replay_writes_the_same_bytes_as_a_fast_one(speed: str, recording: Path, tmp_path: Path) -> None:
    for name, pace in (("fast", "0"), ("paced", speed)):
        main(["replay", str(recording), "--speed", pace, "--out", str(tmp_path / name)])
    assert (tmp_path / "paced").read_bytes() == (tmp_path / "fast").read_bytes()


def test_a_second_replay_replaces_the_rows_of_the_first(recording: Path, tmp_path: Path) -> None:
    contents = []
    for _ in range(2):
        main(["replay", str(recording), "--out", str(tmp_path / "rows.csv")])
        contents.append((tmp_path / "rows.csv").read_bytes())
    assert contents[0] == contents[1]


def test_a_daemon_on_a_recording_ends_by_itself_with_the_rows_of_a_replay(recording: Path, tmp_path: Path) -> None:
    config = write_config(tmp_path, f"recording:{recording}", csv=tmp_path / "daemon.csv")
    done = run("magcal_service.cli", "run", "--config", str(config))
    main(["replay", str(recording), "--config", str(config), "--out", str(tmp_path / "replay.csv")])
    assert (tmp_path / "daemon.csv").read_bytes() == (tmp_path / "replay.csv").read_bytes()
    assert [json.loads(line)["text"].split()[0] for line in done.stderr.splitlines()][-1] == "stopped"
