"""The tutorials: their commands, in their order, end and print as their pages say, and their Python runs."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
from pathlib import Path

import pytest

from sim_sensor.cli import main as sim_sensor
from sim_sensor.demo.daemon_process import DaemonProcess
from tests.cli.cli_inputs import Done, run

ROOT = Path(__file__).resolve().parents[2]
TUTORIALS = ROOT / "docs/tutorials"
BLOCK = re.compile(r"```(sh|text|toml|python)\n(.*?)```", re.S)
EXIT_CODE = re.compile(r"# exit code (\d)")


def blocks(name: str) -> list[tuple[str, str]]:
    """The blocks of a page, each as its language and its text."""
    return BLOCK.findall((TUTORIALS / f"{name}.md").read_text(encoding="utf-8"))


def done(line: str) -> Done:
    """What a command line of a page ends with and prints; commands that are not ours go to a shell."""
    program, *words = shlex.split(line, comments=True)
    if program == "magcal":
        return run(*words)
    if program == "sim-sensor":
        return Done(sim_sensor(words), "", "")
    return Done(subprocess.run(line, shell=True, check=False).returncode, "", "")


def not_shown(lines: list[str], printed: list[str]) -> list[str]:
    """The lines of a page that no program has printed so: one after another, but where ``...`` leaves some out."""
    at, gap = 0, False
    for place, line in enumerate(lines):
        if line == "...":
            gap = True
            continue
        found = next((i for i in range(at, len(printed)) if printed[i] == line), -1)
        if found < 0 or (found > at and not gap):
            return lines[place:]
        at, gap = found + 1, False
    return ["..."] if gap and at == len(printed) else [] if gap or at == len(printed) else printed[at:]


def test_a_line_that_is_left_out_without_a_sign_is_seen() -> None:
    assert not_shown(["a", "b"], ["a", "b"]) == []
    assert not_shown(["...", "b", "..."], ["a", "b", "c"]) == []
    assert not_shown(["a", "c"], ["a", "b", "c"]) == ["c"]
    assert not_shown(["a"], ["a", "b"]) == ["b"]
    assert not_shown(["a", "..."], ["a"]) == ["..."]
    assert not_shown(["...", "d"], ["a", "b"]) == ["d"]


def played(name: str) -> None:
    """Run a page here: each command ends as its comment says, else with 0, and each line that is shown is printed."""
    printed: list[str] = []
    for language, text in blocks(name):
        if language == "toml":
            Path("mission.toml").write_text(text, encoding="utf-8")
        elif language == "sh":
            printed = []
            for line in text.splitlines():
                code = EXIT_CODE.search(line)
                ended = done(line)
                assert ended.code == int(code[1] if code else 0), (line, ended)
                printed += ended.out.splitlines()
        elif language == "text":
            assert not_shown(text.splitlines(), printed) == []


@pytest.mark.parametrize("name", ["cubesat", "simulation"])
def test_every_command_of_a_tutorial_ends_and_prints_as_its_page_says(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    played(name)


def test_the_phone_of_the_tutorial_is_calibrated_as_its_page_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    exec(next(text for language, text in blocks("phone") if language == "python"), {})
    played("phone")
    assert (tmp_path / "vectors.csv").read_text(encoding="utf-8").count("\n") == 3001


def test_the_notebook_runs_and_trusts_its_flight(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "agg")
    played("notebook")
    names: dict[str, object] = {}
    exec("".join(text for language, text in blocks("notebook") if language == "python"), names)
    assert names["calibration"].verdict == "trusted"  # type: ignore[attr-defined]
    assert names["bias"].shape == (1800, 3)  # type: ignore[attr-defined]


@pytest.mark.skipif(not shutil.which("cc") or not shutil.which("make"), reason="no cc or no make here")
def test_the_board_of_the_tutorial_is_served_by_its_configuration(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = blocks("board")
    build, start = next(text for language, text in page if language == "sh").splitlines()
    settings = next(text for language, text in page if language == "toml")
    shown = [text.splitlines() for language, text in page if language == "text"]
    monkeypatch.chdir(tmp_path)
    subprocess.run([*shlex.split(build.replace("deploy", f"{ROOT}/deploy")), "-s", f"BUILD={tmp_path}"], check=True)
    program, *words = shlex.split(start, comments=True)
    words[words.index("600")] = "10"
    with subprocess.Popen([tmp_path / Path(program).name, *words], stdout=subprocess.PIPE, text=True) as board:
        try:
            assert board.stdout is not None
            device = board.stdout.readline().split()[1]
            settings = settings.replace(shown[0][0].split()[1], device)
            config = tmp_path / "board.toml"
            config.write_text(settings, encoding="utf-8")
            assert run("run", "--check", "--config", config).code == 0
            with DaemonProcess(config, tmp_path / "daemon.log"):
                told, _ = board.communicate(timeout=60)
        finally:
            board.kill()
    assert board.returncode == 0, told
    assert "sent: samples 100, refused here 0" in told
    assert "back: vectors 100, " in told
    assert os.path.getsize(tmp_path / "estimates.csv") > 0
