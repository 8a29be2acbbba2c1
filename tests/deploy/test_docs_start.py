"""The first page's log: its commands, run in their order, end and print as the page says."""

from __future__ import annotations

import re
import shlex
import shutil
from pathlib import Path

import pytest

from sim_sensor.cli import main as sim_sensor
from tests.cli.cli_inputs import Done, run

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs/index.md").read_text(encoding="utf-8")
LOG = PAGE.partition("## A log")[2].partition("## A live loop")[0]
ASKED = "magcal describe output/first/samples.csv"


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Done]:
    """What each command line of the section ended with and said."""
    ended = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path_factory.mktemp("start"))
        for line in "".join(re.findall(r"```sh\n(.*?)```", LOG, re.S)).splitlines():
            command = line.partition(" #")[0].strip()
            program, *words = shlex.split(command)
            ended[command] = run(*words) if program == "magcal" else Done(sim_sensor(words), "", "")
    return ended


def test_every_command_is_done_but_the_one_that_asks(done: dict[str, Done]) -> None:
    assert {command: one.code for command, one in done.items() if one.code} == {ASKED: 3}
    assert "answer with: --answer reference.frame=eci" in done[ASKED].out


def test_the_calibration_prints_the_figures_of_the_page(done: dict[str, Done]) -> None:
    shown = re.search(r"```\n(  bx.*?)```", LOG, re.S)
    assert shown is not None
    printed = next(one.out for command, one in done.items() if command.startswith("magcal calibrate")).splitlines()
    assert [line for line in shown[1].splitlines() if line != "  ..." and line not in printed] == []


def test_the_live_loops_configuration_is_sound(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    command = re.search(r"^magcal (run --check --config (\S+))", PAGE, re.M)
    assert command is not None
    place = tmp_path / command[2]
    place.parent.mkdir(parents=True)
    shutil.copy(ROOT / command[2], place)
    monkeypatch.chdir(tmp_path)
    assert run(*command[1].split()).code == 0
