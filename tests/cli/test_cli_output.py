"""Standard output that goes away: what was asked for is done all the same, and no traceback is seen."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from sim_sensor.recorder import record_simulation
from sim_sensor.scenario_reader import load_scenario
from sim_sensor.simulation import Simulation
from tests.cli.cli_inputs import run

FULL = Path("/dev/full")


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record_simulation(Simulation(load_scenario("paper"), 4, 100.0), tmp_path_factory.mktemp("output"))


def unread(*arguments: object) -> tuple[int, str]:
    """Run with a standard output whose reader has left before anything came; code and stderr.

    Unbuffered, so that every line that is printed meets the closed pipe, as many of them do.
    """
    ours, theirs = os.pipe()
    os.close(ours)
    with open(theirs, "wb") as stream:
        command = [sys.executable, "-u", "-m", "magcal_service.cli", *map(str, arguments)]
        done = subprocess.run(command, stdout=stream, stderr=subprocess.PIPE, text=True, timeout=120, check=False)
    return done.returncode, done.stderr


def test_a_described_log_is_written_though_nobody_reads_on(recording: Path, tmp_path: Path) -> None:
    said = run("describe", recording.parent / "samples.csv", "--out", tmp_path / "a.toml", *ANSWERS)
    assert said.code == 0
    code, err = unread("describe", recording.parent / "samples.csv", "--out", tmp_path / "b.toml", *ANSWERS, "--quiet")
    assert (code, err) == (0, "")
    assert (tmp_path / "b.toml").read_text() == (tmp_path / "a.toml").read_text().replace("a.toml", "b.toml")


ANSWERS = ("--answer", "reference.frame=eci")


@pytest.mark.parametrize("command", ["inspect", "calibrate"])
def test_a_json_is_written_and_the_exit_code_kept(command: str, recording: Path, tmp_path: Path) -> None:
    """Of a recording too short to be trusted the code is 3, whoever reads."""
    out = tmp_path / "result.json"
    said = run(command, recording, "--json", out)
    content = out.read_text()
    out.unlink()
    assert unread(command, recording, "--json", out, "--quiet") == (said.code, "")
    assert out.read_text() == content
    assert command != "calibrate" or said.code == 3


@pytest.mark.skipif(not FULL.exists(), reason="there is no /dev/full here")
@pytest.mark.parametrize(("module", "arguments"), [("magcal_service.cli", ["xtce"]), ("sim_sensor.cli", ["list"])])
def test_a_full_disk_under_the_output_is_said_in_a_line(module: str, arguments: list[str]) -> None:
    with FULL.open("wb") as full:
        command = [sys.executable, "-m", module, *arguments]
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, timeout=120, check=False)
    assert done.returncode == 2
    assert done.stderr == "standard output: no space is left on the disk; give a file that can be written\n"


def test_an_output_that_is_closed_is_none(recording: Path, tmp_path: Path) -> None:
    command = f"{sys.executable} -m magcal_service.cli inspect {recording} --quiet --json {tmp_path}/a.json >&-"
    done = subprocess.run(["sh", "-c", command], stderr=subprocess.PIPE, text=True, timeout=120, check=False)
    assert (done.returncode, done.stderr) == (run("inspect", recording).code, "")
    assert (tmp_path / "a.json").stat().st_size > 0


def test_what_has_no_end_ends_when_nobody_reads_on(recording: Path) -> None:
    code, err = unread("watch", recording, "--speed", "100")
    assert (code, err) == (0, "")
