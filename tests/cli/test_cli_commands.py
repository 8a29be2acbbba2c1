"""``magcal replay``, ``calibrate`` and ``run``: exit codes, files and texts."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from magcal_service.base.version import __version__
from magcal_service.cli.common import verdict_text
from magcal_service.daemon.estimate_csv import COLUMNS
from magcal_service.estimators import find_method, methods
from magcal_service.trust.reasons import Reason
from sim_sensor.recorder import record_simulation
from sim_sensor.scenario_reader import load_scenario
from sim_sensor.simulation import Simulation
from tests.cli.cli_inputs import CONFIG, DESCRIPTOR, log_rows, run


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """1400 s of the paper's scenario: enough to be trusted."""
    return record_simulation(Simulation(load_scenario("paper"), 4, 1400.0), tmp_path_factory.mktemp("good"))


@pytest.fixture(scope="module")
def short(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """100 s of it: not enough."""
    return record_simulation(Simulation(load_scenario("paper"), 4, 100.0), tmp_path_factory.mktemp("short"))


@pytest.mark.parametrize("command", ["replay", "calibrate"])
def test_a_good_recording_is_done_and_trusted(command: str, good: Path) -> None:
    done = run(command, good)
    assert (done.code, done.err) == (0, "")
    assert "verdict: trusted\n" in done.out


@pytest.mark.parametrize("command", ["replay", "calibrate"])
def test_a_short_recording_is_done_and_not_trusted_with_reason_and_remedy(command: str, short: Path) -> None:
    done = run(command, short)
    assert (done.code, done.err) == (3, "")
    assert "verdict: not_started (" in done.out
    assert "remedy: " in done.out


def test_a_replay_writes_a_row_for_every_tick(good: Path, tmp_path: Path) -> None:
    run("replay", good, "--out", tmp_path / "rows.csv")
    lines = (tmp_path / "rows.csv").read_text().splitlines()
    assert (lines[0], len(lines)) == (",".join(COLUMNS), 1401)


@pytest.fixture(scope="module")
def result(good: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, object]:
    """``calibrate --json`` of the good recording."""
    path = tmp_path_factory.mktemp("json") / "result.json"
    assert run("calibrate", good, "--json", path).code == 0
    content: dict[str, object] = json.loads(path.read_text())
    return content


def numbers(*shape: int) -> object:
    """What JSON of this shape looks like with every number replaced by its type."""
    return [numbers(*shape[1:]) for _ in range(shape[0])] if shape else float


def typed(value: object) -> object:
    """A JSON value with every leaf replaced by its type."""
    if isinstance(value, dict):
        return {key: typed(item) for key, item in value.items()}
    return [typed(item) for item in value] if isinstance(value, list) else type(value)


CONTRACT = {
    "method": str,
    "trusted": bool,
    "reasons": [],
    "samples": int,
    "ticks": int,
    "bias_nt": numbers(3),
    "D": numbers(3, 3),
    "sigma": {"bias_nt": numbers(3), "D": numbers(3, 3)},
    "residual_rms_nt": {"before": float, "after": float, "noise_floor": float},
}


@pytest.mark.parametrize("field", CONTRACT)
def test_the_json_has_the_contracts_fields(field: str, result: dict[str, object]) -> None:
    wanted, found = CONTRACT[field], typed(result[field])
    if isinstance(wanted, dict) and isinstance(found, dict):
        found = {key: value for key, value in found.items() if key in wanted}
    assert found == wanted


def test_the_json_says_what_is_true(result: dict[str, object]) -> None:
    bias, sigma = result["bias_nt"], result["sigma"]
    assert isinstance(bias, list)
    assert isinstance(sigma, dict)
    errors = [abs(a - b) / s for a, b, s in zip(bias, (5000.0, 3000.0, 4000.0), sigma["bias_nt"], strict=True)]
    assert max(errors) < 4.0
    assert (result["method"], result["trusted"], result["samples"], result["ticks"]) == ("ukf", True, 1400, 1400)
    residual = result["residual_rms_nt"]
    assert isinstance(residual, dict)
    assert residual["noise_floor"] == 300.0
    assert residual["after"] == pytest.approx(300.0, rel=0.1)
    assert residual["before"] > 5.0 * residual["after"]


def test_the_matrix_in_the_json_is_symmetric(result: dict[str, object]) -> None:
    matrix = result["D"]
    assert isinstance(matrix, list)
    assert [matrix[0][1], matrix[0][2], matrix[1][2]] == [matrix[1][0], matrix[2][0], matrix[2][1]]


def test_the_reasons_in_the_json_are_codes(short: Path, tmp_path: Path) -> None:
    assert run("calibrate", short, "--json", tmp_path / "result.json").code == 3
    content = json.loads((tmp_path / "result.json").read_text())
    assert content["reasons"]
    assert set(content["reasons"]) <= {str(reason) for reason in Reason}
    assert content["trusted"] is False


@pytest.mark.parametrize("method", [method.name for method in methods()])
def test_every_method_runs_on_a_recording_and_names_itself_or_says_what_is_missing(
    method: str, short: Path, tmp_path: Path
) -> None:
    done = run("calibrate", short, "--method", method, "--json", tmp_path / "result.json")
    needs = find_method(method).needs
    if needs:
        assert (done.code, f"a channel of three columns with a unit of {needs}" in done.err) == (2, True)
        return
    assert done.code in (0, 3), done.err
    assert json.loads((tmp_path / "result.json").read_text())["method"] == method


@pytest.mark.parametrize("command", ["calibrate", "study"])
def test_the_help_lists_every_method_with_its_line(command: str) -> None:
    done = run(command, "--help")
    lines = done.out.partition("\nmethods:\n")[2].splitlines()
    assert done.code == 0
    listed = [tuple(line.partition(" (needs")[0].strip().split(None, 1)) for line in lines]
    assert listed == [(m.name, m.summary) for m in methods()]


def test_an_unknown_method_is_refused_with_the_nearest(short: Path) -> None:
    done = run("calibrate", short, "--method", "ufk")
    assert (done.code, done.out, len(done.err.splitlines())) == (2, "", 1)
    assert "'ufk' is refused; did you mean 'ukf'?" in done.err


@pytest.mark.parametrize("speed", ["-1", "nan", "inf", "1e7", "fast", ""])
def test_a_speed_that_makes_no_sense_is_refused(speed: str, short: Path) -> None:
    done = run("replay", short, f"--speed={speed}")
    assert done.code == 2
    assert "is refused; 0 (as fast as it goes) to 1e6 is accepted" in done.err


@pytest.mark.parametrize(("command", "option"), [("replay", "--out"), ("calibrate", "--json")])
def test_an_output_that_cannot_be_written_is_refused_by_name(
    command: str, option: str, short: Path, tmp_path: Path
) -> None:
    path = tmp_path / "absent" / "file"
    done = run(command, short, option, path)
    assert (done.code, done.err.splitlines()) == (
        2,
        [f"{path}: there is no folder {path.parent}; make it, or give a file in a folder that is there"],
    )


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="/dev/full, a disk that is always full, is not here")
@pytest.mark.parametrize(("command", "option"), [("replay", "--out"), ("calibrate", "--json")])
def test_a_full_disk_is_one_line(command: str, option: str, short: Path) -> None:
    done = run(command, short, option, "/dev/full")
    assert (done.code, len(done.err.splitlines())) == (2, 1)
    assert "no space is left on the disk" in done.err


def test_a_replay_takes_exactly_one_craft(short: Path, tmp_path: Path) -> None:
    (tmp_path / "two.toml").write_text(f'{CONFIG}[[craft]]\nname = "other"\n')
    done = run("replay", short, "--config", tmp_path / "two.toml")
    assert (done.code, "a replay takes exactly one [[craft]]" in done.err) == (2, True)


@pytest.mark.parametrize("command", ["replay", "calibrate"])
def test_a_craft_that_the_configuration_has_not_is_refused(command: str, short: Path, tmp_path: Path) -> None:
    """It has one alone, and the misspelt name was ignored."""
    (tmp_path / "one.toml").write_text('version = 1\n[[craft]]\nname = "lisbon"\n')
    done = run(command, short, "--config", tmp_path / "one.toml", "--craft", "lisbom")
    assert (done.code, "--craft: 'lisbom' is refused" in done.err, "known: lisbon" in done.err) == (2, True, True)


def test_a_replay_takes_the_crafts_name_from_the_configuration(short: Path, tmp_path: Path) -> None:
    (tmp_path / "one.toml").write_text('version = 1\n[[craft]]\nname = "lisbon"\n')
    run("replay", short, "--config", tmp_path / "one.toml", "--out", tmp_path / "rows.csv")
    assert {line.split(",")[0] for line in (tmp_path / "rows.csv").read_text().splitlines()[1:]} == {"lisbon"}


@pytest.mark.parametrize("command", ["replay", "calibrate", "run"])
@pytest.mark.parametrize("kind", ["absent", "folder", "binary", "empty"])
def test_a_file_that_is_none_is_refused_in_a_line(command: str, kind: str, tmp_path: Path) -> None:
    path = tmp_path / "input.toml"
    if kind == "folder":
        path.mkdir()
    elif kind != "absent":
        path.write_bytes(b"\x00\xff\xfe=" if kind == "binary" else b"")
    done = run(command, *(["--config"] if command == "run" else []), path)
    assert done.code == 2
    assert done.err
    assert "Traceback" not in done.err


@pytest.mark.parametrize("rows", [0, 1, 20])
def test_too_few_samples_are_refused_with_their_number(rows: int, tmp_path: Path) -> None:
    (tmp_path / "RECORDING.toml").write_text(DESCRIPTOR)
    (tmp_path / "log.csv").write_text(log_rows(rows))
    done = run("calibrate", tmp_path / "RECORDING.toml")
    assert (done.code, len(done.err.splitlines())) == (2, 1)


@pytest.mark.parametrize(
    ("field", "why"),
    [("0.0,0.0,0.0", "100 rows of 100 read (0, 0, 0)"), ("1.0,2.0,3.0", "look for a stuck or unwired axis")],
)
def test_a_sensor_that_never_changes_is_refused(field: str, why: str, tmp_path: Path) -> None:
    lines = log_rows(100).splitlines()
    fixed = [",".join([line.split(",")[0], field, *line.split(",")[4:]]) for line in lines[1:]]
    (tmp_path / "RECORDING.toml").write_text(DESCRIPTOR)
    (tmp_path / "log.csv").write_text("\n".join([lines[0], *fixed, ""]))
    done = run("calibrate", tmp_path / "RECORDING.toml")
    assert (done.code, why in done.err) == (2, True)


def test_zeros_as_reference_give_no_result_that_is_trusted(tmp_path: Path) -> None:
    lines = log_rows(200).splitlines()
    fixed = [",".join([*line.split(",")[:4], "0.0,0.0,0.0", "20.0"]) for line in lines[1:]]
    (tmp_path / "RECORDING.toml").write_text(DESCRIPTOR)
    (tmp_path / "log.csv").write_text("\n".join([lines[0], *fixed, ""]))
    for command in ("replay", "calibrate"):
        done = run(command, tmp_path / "RECORDING.toml")
        assert done.code in (2, 3)
        assert "nan" not in done.out


def test_a_refused_configuration_is_a_line_for_each_fault(tmp_path: Path) -> None:
    path = tmp_path / "magcal.toml"
    path.write_text(CONFIG.replace("noise_nt = 300.0", "noise_nt = -1").replace("hold_s", "hold"))
    done = run("run", "--config", path)
    assert (done.code, [line.split(": ")[1] for line in done.err.splitlines()]) == (
        2,
        ["craft[0].sensor.noise_nt", "craft[0].ticks.hold"],
    )


@pytest.mark.parametrize("command", ["run", "replay"])
def test_an_unknown_method_in_the_configuration_is_refused_with_the_nearest(
    command: str, short: Path, tmp_path: Path
) -> None:
    path = tmp_path / "magcal.toml"
    path.write_text('version = 1\nlink = "loop:cli"\n[[craft]]\nname = "a"\n[craft.filter]\nmethod = "two-steps"\n')
    done = process(command, *([str(short)] if command == "replay" else []), "--config", str(path))
    assert done.returncode == 2
    assert "'two-steps' is refused; did you mean 'two-step'?" in done.stderr.splitlines()[-1]


@pytest.mark.parametrize("place", ["absent/rows.csv", "."])
def test_a_daemon_whose_rows_cannot_be_written_does_not_start(place: str, tmp_path: Path) -> None:
    path = tmp_path / "magcal.toml"
    path.write_text(CONFIG.replace("rows.csv", str(tmp_path / place)))
    done = process("run", "--config", str(path))
    assert (done.returncode, done.stderr.splitlines()[0].startswith(str(tmp_path))) == (2, True)


def process(*arguments: str) -> subprocess.CompletedProcess[str]:
    """The command in a process of its own: for what installs signal handlers."""
    command = [sys.executable, "-m", "magcal_service.cli", *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)


def test_a_port_that_is_taken_is_refused_in_a_line(tmp_path: Path) -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        path = tmp_path / "magcal.toml"
        text = CONFIG.replace("rows.csv", str(tmp_path / "rows.csv"))
        path.write_text(text.replace("loop:cli", f"zenoh:tcp/127.0.0.1:{other.getsockname()[1]}"))
        done = process("run", "--config", str(path.resolve()))
    lines = done.stderr.splitlines()
    assert (done.returncode, sum("cannot listen" in line for line in lines)) == (2, 1)
    assert "Traceback" not in done.stderr


def test_a_reader_that_leaves_early_is_no_error(short: Path) -> None:
    read, write = os.pipe()
    os.close(read)
    command = [sys.executable, "-m", "magcal_service.cli", "replay", str(short)]
    done = subprocess.run(command, stdout=write, stderr=subprocess.PIPE, timeout=60, check=False)
    os.close(write)
    assert (done.returncode, done.stderr) == (3, b"")  # as for who reads it: the recording is too short


def test_the_version_is_told() -> None:
    assert (run("--version").code, run("--version").out) == (0, f"magcal {__version__}\n")


def test_no_command_is_refused_with_the_usage() -> None:
    done = run()
    assert (done.code, done.err.startswith("usage: magcal")) == (2, True)


def test_the_command_that_diagnoses_names_the_recording_that_was_read() -> None:
    said = "model doubtful: heat; run: magcal diagnose RECORDING"
    text = verdict_text("doubtful", ["model_doubtful"], "", said, Path("my log.toml"))
    assert text.endswith("run: magcal diagnose 'my log.toml'")
