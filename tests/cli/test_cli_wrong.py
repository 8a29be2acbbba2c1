"""What is asked wrongly: no traceback, and a line that says what was given, what is accepted, and what to do."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.cli.cli_inputs import CONFIG, DESCRIPTOR, log_rows, run

COMMANDS = ("inspect", "calibrate", "replay", "diagnose")


@pytest.fixture
def described(tmp_path: Path) -> Path:
    (tmp_path / "log.csv").write_text(log_rows(120), encoding="utf-8")
    (tmp_path / "RECORDING.toml").write_text(DESCRIPTOR, encoding="utf-8")
    return tmp_path


@pytest.mark.parametrize("command", COMMANDS)
def test_a_log_without_its_descriptor_is_told_what_it_needs(described: Path, command: str) -> None:
    more = ("--out", described / "out") if command == "diagnose" else ()
    done = run(command, described / "log.csv", *more)
    assert (done.code, done.out) == (2, "")
    assert done.err.startswith(f"{described / 'log.csv'}: 'a log without its descriptor' is refused; ")
    assert f"magcal describe {described / 'log.csv'} --out {described / 'RECORDING.toml'} makes one" in done.err
    done = run(command, described, *more)
    assert done.code == 2
    assert done.err.endswith(f"give the file that describes it: {described / 'RECORDING.toml'}\n")
    (described / "RECORDING.toml").unlink()
    assert run(command, described, *more).err.endswith("give the file that describes it\n")


@pytest.mark.parametrize("command", ["calibrate", "diagnose"])
def test_a_file_in_place_of_a_folder_is_refused_by_its_own_name(described: Path, command: str) -> None:
    (described / "taken").write_text("")
    more = ("--separately",) if command == "diagnose" else ()
    done = run(command, described / "RECORDING.toml", *more, "--out", described / "taken")
    assert (done.code, done.out) == (2, "")
    expected = "a file of this name is there already; give a folder that can be made or written"
    assert done.err == f"{described / 'taken'}: {expected}\n"


@pytest.mark.parametrize("command", ["calibrate", "inspect"])
def test_an_output_that_cannot_be_written_is_refused_before_the_work(described: Path, command: str) -> None:
    done = run(command, described / "RECORDING.toml", "--json", described)
    assert (done.code, done.out, done.err) == (
        2,
        "",
        f"{described}: this is a folder, not a file; give a file that can be written\n",
    )
    done = run(command, described / "RECORDING.toml", "--json", described / "no" / "x.json")
    assert (done.code, done.out) == (2, "")
    assert f"there is no folder {described / 'no'}; make it, or give a file in a folder that is there" in done.err


def test_rows_are_replayed_as_the_craft_that_is_chosen_of_a_configuration(described: Path) -> None:
    second = CONFIG.split("[[craft]]")[1].split("[output]")[0].replace('"paper"', '"spare"')
    config = described / "magcal.toml"
    config.write_text(CONFIG.replace("[output]", f"[[craft]]{second}[output]"), encoding="utf-8")
    asked = ("replay", described / "RECORDING.toml", "--config", config)
    assert "estimates; " in run(*asked, "--craft", "spare").out
    done = run(*asked, "--craft", "nobody")
    assert done.code == 2
    assert done.err == "--craft: 'nobody' is refused; a [[craft]] of magcal.toml is accepted; known: paper, spare\n"
    assert "magcal.toml: craft: 2 is refused; a replay takes exactly one" in run(*asked).err
    assert "known: paper, spare" in run(*asked).err
    assert "craft: 'spare' is refused; only a recorded session" in run(*asked[:2], "--craft", "spare").err


WORDS = {
    "RECORDING.toml": "the descriptor of a log",
    "physics.toml": "a model of physics",
    "magcal.toml": "a configuration",
    "scenario.toml": "a scenario of sim-sensor",
}


@pytest.mark.parametrize("name", WORDS)
@pytest.mark.parametrize(
    ("own", "command"),
    [
        ("RECORDING.toml", "inspect {0}"),
        ("physics.toml", "apply {1} --with {0} --out {2}"),
        ("physics.toml", "export {0} --format csv"),
        ("magcal.toml", "run --check --config {0}"),
        ("scenario.toml", "diagnose {1} --simulation {0} --out {2}"),
    ],
)
def test_a_file_of_another_kind_is_refused_in_one_line(described: Path, name: str, own: str, command: str) -> None:
    """Each of its keys was, or it was taken: of a RECORDING.toml as a simulation the bias was 0."""
    if name == own:
        pytest.skip("it is of this kind")
    (described / "physics.toml").write_text("version = 1\n[recording]\n[errors]\n")
    (described / "magcal.toml").write_text(CONFIG)
    (described / "scenario.toml").write_text('version = 1\ndescription = "x"\ncraft = "a"\n')
    paths = (described / name, described / "RECORDING.toml", described / "out.csv")
    done = run(*(word.format(*map(str, paths)) for word in command.split()))
    assert (done.code, done.out) == (2, "")
    assert done.err.startswith(f"{name}: '{WORDS[name]}' is refused; {WORDS[own]} is accepted, ")
    assert done.err.count("\n") == 1


def test_an_interrupted_command_says_so(described: Path) -> None:
    """Ctrl-C: one line and exit code 130, and no result that looks like one."""
    (described / "log.csv").write_text(log_rows(20_000), encoding="utf-8")
    out = described / "out"
    command = [sys.executable, "-m", "magcal_service.cli", "diagnose", described / "RECORDING.toml", "--out", out]
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a job in the background ignores it, and its children do
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        deadline = time.monotonic() + 120.0
        while not out.is_dir() and time.monotonic() < deadline:
            time.sleep(0.01)
        process.send_signal(signal.SIGINT)
        said = process.communicate(timeout=120)[1]
    assert process.returncode == 130, said
    assert said.endswith("interrupted: what was asked for is not done\n")
    assert "Traceback" not in said
    assert list(out.iterdir()) == []
