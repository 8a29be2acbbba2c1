"""The command line as a whole: every help text, completion, JSON on standard output, and ``run --check``."""

from __future__ import annotations

import argparse
import io
import json
import logging
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from magcal_service.base import log
from magcal_service.cli.__main__ import whole_parser
from magcal_service.cli.common import Parser, subparsers
from magcal_service.studies import studies
from sim_sensor.cli import _parser as sim_sensor_parser
from sim_sensor.cli import main as sim_sensor
from tests.cli.cli_inputs import CONFIG, DESCRIPTOR, log_rows, run


def every_parser(parser: Parser) -> list[Parser]:
    """A parser and those of its commands, all the way down."""
    return [parser, *(below for one in subparsers(parser).values() for below in every_parser(one))]


WHOLE = {"magcal": whole_parser(), "sim-sensor": sim_sensor_parser()}
PARSERS = {one.prog: one for whole in WHOLE.values() for one in every_parser(whole)}


def test_the_walk_meets_every_command() -> None:
    assert {"magcal", "magcal calibrate", "magcal record join", "sim-sensor run"} <= set(PARSERS)


@pytest.mark.parametrize("name", PARSERS)
def test_every_command_says_what_it_does_and_every_argument_what_it_means(name: str) -> None:
    parser = PARSERS[name]
    arguments = [one for one in parser._actions if not isinstance(one, argparse._SubParsersAction)]
    assert parser.description
    assert [one.dest for one in arguments if not one.help] == []


@pytest.mark.parametrize("name", PARSERS)
def test_every_command_has_examples_of_itself_that_are_accepted(name: str) -> None:
    parser = PARSERS[name]
    assert parser.examples, f"{name}: give its parser examples"
    shown = parser.format_help()
    for example in parser.examples:
        program, *words = shlex.split(example.partition(" >")[0])
        assert example.startswith(name)
        assert f"\n  {example}\n" in shown
        if "--help" not in words:
            WHOLE[program].parse_args(words)


def test_the_help_of_study_lists_every_study_with_its_runs() -> None:
    listed = run("study", "--help").out.partition("\nstudies:\n")[2].partition("\n\n")[0].splitlines()
    ends = ["(takes recordings)" if one.takes_recordings else f"(default: {one.runs} runs)" for one in studies()]
    assert [line.split()[0] for line in listed] == [one.name for one in studies()]
    assert all(line.endswith(end) for line, end in zip(listed, ends, strict=True))


@pytest.mark.parametrize("shell", ["bash", "zsh", "tcsh"])
def test_completion_knows_the_commands_and_the_methods(shell: str) -> None:
    pytest.importorskip("shtab", reason="shtab is not installed: pip install '.[completion]'")
    done = run("completion", shell)
    assert (done.code, done.err) == (0, "")
    assert all(word in done.out for word in ("calibrate", "--method", "sliding-batch", "spin-rates"))


@pytest.mark.parametrize("shell", ["bash", "zsh"])
def test_completion_of_the_simulator_knows_its_scenarios(shell: str, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("shtab", reason="shtab is not installed: pip install '.[completion]'")
    assert sim_sensor(["completion", shell]) == 0
    script = capsys.readouterr().out
    assert all(word in script for word in ("record", "--duration", "paper"))


def test_bash_completes_a_scenario_by_name_and_by_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("shtab", reason="shtab is not installed: pip install '.[completion]'")
    sim_sensor(["completion", "bash"])
    (tmp_path / "own.toml").touch()
    script = (
        capsys.readouterr().out
        + """
COMP_WORDS=(sim-sensor record --scenario "$1"); COMP_CWORD=3; _shtab_sim_sensor sim-sensor "$1" --scenario
echo "${COMPREPLY[@]}"
"""
    )
    for typed, whole in (("pap", "paper"), ("ow", "own.toml")):
        done = subprocess.run(["bash", "-c", script, "x", typed], cwd=tmp_path, capture_output=True, text=True)
        assert done.stdout.split() == [whole], done.stderr


def test_completion_without_its_extra_says_how_to_install_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "shtab", None)
    done = run("completion", "bash")
    assert (done.code, done.out) == (2, "")
    assert "[completion]'" in done.err


@pytest.mark.parametrize("command", [("inspect",), ("calibrate", "--method", "two-step")])
def test_json_to_standard_output_is_json_alone_and_the_rest_goes_to_stderr(
    command: tuple[str, ...], tmp_path: Path
) -> None:
    (tmp_path / "log.csv").write_text(log_rows(200))
    (tmp_path / "log.toml").write_text(DESCRIPTOR)
    name, *options = command
    done = run(name, tmp_path / "log.toml", *options, "--json", "-")
    plain = run(name, tmp_path / "log.toml", *options, "--json", tmp_path / "result.json")
    assert json.loads(done.out) == json.loads((tmp_path / "result.json").read_text())
    assert (done.code, done.err) == (plain.code, plain.out + plain.err)


def test_a_check_of_a_sound_configuration_writes_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "daemon.toml").write_text(CONFIG + '[state]\ndirectory = "state"\n')
    done = run("run", "--check", "--config", "daemon.toml")
    assert (done.code, done.err, done.out.splitlines()[-1]) == (0, "", "sound")
    assert [one.name for one in tmp_path.iterdir()] == ["daemon.toml"]


def test_a_check_names_every_fault_of_files_and_addresses_at_once(tmp_path: Path) -> None:
    text = CONFIG.replace("loop:cli", f"serial:/dev/absent?key={tmp_path}/line.key&counter={tmp_path}/line.counter")
    key = tmp_path / "line.key"
    key.write_text("00" * 16)
    key.chmod(0o644)
    (tmp_path / "daemon.toml").write_text(text.replace('"rows.csv"', f'"{tmp_path}/absent/rows.csv"'))
    done = run("run", "--check", "--config", tmp_path / "daemon.toml")
    faults = done.err.splitlines()
    assert (done.code, done.out, len(faults)) == (2, "", 2)
    assert f"{key}: 'mode 0644' is refused" in faults[0]
    assert faults[1].startswith("output.csv: ")


def test_a_check_opens_no_zenoh_session_and_refuses_its_wrong_options(tmp_path: Path) -> None:
    (tmp_path / "daemon.toml").write_text(CONFIG.replace("loop:cli", "zenoh:tcp/127.0.0.1:7447?queue=0"))
    done = run("run", "--check", "--config", tmp_path / "daemon.toml")
    assert (done.code, "queue is '0'" in done.err) == (2, True)


class _Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize(("no_colour", "level"), [("", "\x1b[33mwarning\x1b[0m"), ("1", "warning")])
def test_log_lines_on_a_terminal_are_plain_and_coloured_unless_no_color_is_set(
    no_colour: str, level: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    terminal = _Terminal()
    monkeypatch.setattr("sys.stderr", terminal)
    monkeypatch.setenv("NO_COLOR", no_colour)
    monkeypatch.setattr(log, "_stdout_free", False)
    monkeypatch.setattr(logging.getLogger(), "handlers", [])
    log.to_stderr()
    logging.getLogger("magcal").warning("craft \x1b[2J lost", extra={"fields": {"craft": "demo"}})
    when, said = terminal.getvalue().split("Z ", 1)
    assert len(when) == len("2026-01-01 00:00:00")
    assert said == f'{level} craft \\x1b[2J lost {{"craft": "demo"}}\n'


def test_log_lines_elsewhere_are_json(monkeypatch: pytest.MonkeyPatch) -> None:
    pipe = io.StringIO()
    monkeypatch.setattr("sys.stderr", pipe)
    monkeypatch.setattr(log, "_stdout_free", False)
    monkeypatch.setattr(logging.getLogger(), "handlers", [])
    log.to_stderr()
    logging.getLogger("magcal").info("serving")
    assert json.loads(pipe.getvalue())["text"] == "serving"
