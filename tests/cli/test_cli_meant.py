"""Misspelt options and commands are refused with what was probably meant."""

from __future__ import annotations

import pytest

from sim_sensor.cli import main as sim_sensor
from tests.cli.cli_inputs import run


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("calibrat x", "'calibrat' is refused; did you mean 'calibrate'? known: apply, calibrate,"),
        ("record inof x", "'inof' is refused; did you mean 'info'? known: check, describe,"),
        ("completion bsh", "did you mean 'bash'?"),
        ("flight.mcapp", "'flight.mcapp' is refused; known: apply, calibrate,"),
        ("calibrate x --pior y", "--pior: did you mean --prior?"),
        ("calibrate x --pior=y", "--pior: did you mean --prior?"),
        ("calibrate x -json y", "-json: did you mean --json?"),
        ("plot x --ot y", "--ot: did you mean --out?"),  # beside that --out is missing
        ("record info x --sorce=y", "--sorce: no such option; magcal record info --help lists them"),
        ("--verson", "--verson: did you mean --version?"),
        ("calibrate x --plot y", "--plot: plot is a command of its own: magcal plot --help"),
        ("calibrate x --export y", "--export: export is a command of its own: magcal export --help"),
        ("diagnose x --method spin", "--method: this is an option of magcal calibrate"),
        ("calibrate x --nonsense", "--nonsense: no such option; magcal calibrate --help lists them"),
    ],
)
def test_what_was_probably_meant_is_said(line: str, said: str) -> None:
    done = run(*line.split())
    assert done.code == 2
    assert said in done.err


@pytest.mark.parametrize(
    ("line", "said"),
    [("recrd", "did you mean 'record'?"), ("record --scenaro x --out y", "--scenaro: did you mean --scenario?")],
)
def test_the_simulator_says_it_too(line: str, said: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        sim_sensor(line.split())
    assert said in capsys.readouterr().err


@pytest.mark.parametrize("line", ["export x --form y", "plot -h=3", "plot --out -- --ot", "export x --index -1"])
def test_nothing_is_guessed_of_what_is_known(line: str) -> None:
    """A beginning that belongs to one option, a short one with a value, what follows ``--``, a negative number."""
    assert "did you mean --" not in run(*line.split()).err


def test_an_unknown_option_is_refused_by_the_command_that_was_given_it() -> None:
    """The usage that was shown was that of magcal as a whole."""
    assert run("calibrate", "x", "--pior", "y").err.startswith("usage: magcal calibrate ")
