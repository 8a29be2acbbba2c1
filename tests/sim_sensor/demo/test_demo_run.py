"""The demo from end to end against a daemon that behaves, or misbehaves, on purpose."""

from __future__ import annotations

import io
import json
import os
import re
import shlex
import signal
import sys
import threading
import time
import tomllib
from pathlib import Path

import pytest
from rich.console import Console

from magcal_service.cli.__main__ import main as magcal
from magcal_service.cli.__main__ import whole_parser
from magcal_service.config.reader import load_config
from sim_sensor.demo.__main__ import INTERRUPTED, main, parse_arguments, run_demo
from sim_sensor.demo.config import daemon_config
from sim_sensor.demo.daemon_process import DaemonDiedError
from sim_sensor.demo.report import DemoError, Plan, Wire
from sim_sensor.scenario import resolve
from sim_sensor.scenario_reader import load_scenario

FAKE = Path(__file__).parent / "fake_daemon.py"
ROOT = Path(__file__).parents[3]


@pytest.fixture(autouse=True)
def _quick(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """The daemon finds the packages; waits are short, and no picture is drawn unless the test asks for pictures."""
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    monkeypatch.setattr("sim_sensor.demo.__main__.QUIET_S", 0.3)
    monkeypatch.setattr("sim_sensor.demo.__main__.PATIENCE_S", 1.0)
    if "pictures" not in request.fixturenames:
        monkeypatch.setattr("sim_sensor.view.plots.plot_errors", lambda *_: None)
        monkeypatch.setattr("sim_sensor.view.plots.plot_residual", lambda *_: None)


@pytest.fixture
def pictures() -> None:
    """Ask for pictures."""


def plan(tmp_path: Path, mode: str, wire: Wire = Wire.SERIAL, duration_s: float = 300.0, speed: float = 0.0) -> Plan:
    return Plan(wire, "paper", speed, 1, tmp_path / "out", duration_s, (sys.executable, str(FAKE), mode))


def console(terminal: bool = False) -> Console:
    return Console(file=io.StringIO(), width=80, force_terminal=terminal)


def text_of(shown: Console) -> str:
    assert isinstance(shown.file, io.StringIO)
    return shown.file.getvalue()


@pytest.fixture(scope="module")
def real_runs(tmp_path_factory: pytest.TempPathFactory) -> dict[Wire, tuple[int, str, Path]]:
    """The paper's first 1400 s through ``magcal run`` over each link: exit code, what was shown, the folder."""
    runs = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", str(ROOT))
        patch.setattr("sim_sensor.view.plots.plot_errors", lambda *_: None)
        patch.setattr("sim_sensor.view.plots.plot_residual", lambda *_: None)
        for wire in Wire:
            shown, out = console(terminal=wire is Wire.ZENOH), tmp_path_factory.mktemp(wire.value)
            runs[wire] = (run_demo(Plan(wire, "paper", 0.0, 1, out, 1400.0, port=0), shown), text_of(shown), out)
    return runs


@pytest.mark.parametrize("wire", list(Wire))
def test_the_daemon_finds_all_nine_errors_over_a_real_link(
    real_runs: dict[Wire, tuple[int, str, Path]], wire: Wire
) -> None:
    code, shown, _ = real_runs[wire]
    assert (code, "all nine errors are inside 3 sigma, and trusted" in shown) == (0, True)


@pytest.mark.parametrize("wire", list(Wire))
def test_every_sample_is_answered_and_used(real_runs: dict[Wire, tuple[int, str, Path]], wire: Wire) -> None:
    assert "1400 sent, 1400 answered, 0 unanswered, 1400 used" in real_runs[wire][1]


def test_both_links_lead_to_the_same_estimates_bit_for_bit(real_runs: dict[Wire, tuple[int, str, Path]]) -> None:
    ticks = [(out / "ticks.csv").read_bytes() for _, _, out in real_runs.values()]
    assert len(ticks[0].splitlines()) == 1401
    assert ticks[0] == ticks[1]


@pytest.mark.parametrize("wire", list(Wire))
def test_it_opens_with_a_page_and_says_how_wrong_the_vector_was_and_is(
    real_runs: dict[Wire, tuple[int, str, Path]], wire: Wire
) -> None:
    shown = real_runs[wire][1]
    assert re.search(r"\A.*\n.*live page.*http://127\.0\.0\.1:\d+/", shown)
    assert re.search(r"was 8226 nT off by its nine errors, and is \d{1,3}\.\d nT off now", shown)
    assert "one flight is one draw; 95 % lie from 2.7 to 19.0" in shown


def test_what_it_says_to_do_next_is_what_the_commands_take(real_runs: dict[Wire, tuple[int, str, Path]]) -> None:
    _, shown, out = real_runs[Wire.SERIAL]
    lines = [shlex.split(line) for line in shown.split("What next?")[1].splitlines() if str(out) in line]
    asked = [line[line.index(str(out / "RECORDING.toml")) - 1 :] for line in lines]
    assert [line[0] for line in asked] == ["view", "replay", "diagnose", "plot"]
    for line in asked:
        whole_parser().parse_args(line)
    assert magcal(asked[1]) == 0
    assert (out / "again.csv").read_bytes() == (out / "ticks.csv").read_bytes()


@pytest.mark.usefixtures("pictures")
def test_everything_that_is_promised_lies_in_the_folder(tmp_path: Path) -> None:
    run_demo(plan(tmp_path, "polite", duration_s=60.0), console())
    out = tmp_path / "out"
    with (out / "RECORDING.toml").open("rb") as file:
        assert tomllib.load(file)["samples"]["file"] == "samples.csv"
    assert len((out / "samples.csv").read_text().splitlines()) == 61
    assert json.loads((out / "truth.json").read_text())["bias_nt"] == [5000.0, 3000.0, 4000.0]
    assert all((out / name).stat().st_size > 0 for name in ("errors.png", "residual.png", "summary.txt"))


def test_a_slow_daemon_slows_the_node_and_loses_nothing(tmp_path: Path) -> None:
    shown = console()
    run_demo(plan(tmp_path, "slow", duration_s=400.0), shown)
    assert "400 sent, 400 answered, 0 unanswered, 400 used" in text_of(shown)


def test_samples_without_an_answer_are_counted(tmp_path: Path) -> None:
    shown = console()
    run_demo(plan(tmp_path, "deaf", duration_s=101.0), shown)
    assert "101 sent, 81 answered, 20 unanswered" in text_of(shown)


@pytest.mark.parametrize("wire", list(Wire))
def test_a_daemon_that_dies_is_told_with_its_last_words(tmp_path: Path, wire: Wire) -> None:
    with pytest.raises(DaemonDiedError, match=r"(?s)exit code 9.*the fake daemon gives up"):
        run_demo(plan(tmp_path, "dies", wire, duration_s=2000.0), console())


def test_a_daemon_that_cannot_start_is_told_with_its_reason(tmp_path: Path) -> None:
    broken = Plan(Wire.SERIAL, "paper", 0.0, 1, tmp_path, 10.0, (sys.executable, "-c", "raise SystemExit('no luck')"))
    with pytest.raises(DaemonDiedError, match="no luck"):
        run_demo(broken, console())


def test_a_daemon_that_ends_with_a_fault_fails_the_demo(tmp_path: Path) -> None:
    with pytest.raises(DemoError, match="exit code 5"):
        run_demo(plan(tmp_path, "rude", duration_s=20.0), console())


def test_a_daemon_without_estimates_fails_the_demo(tmp_path: Path) -> None:
    with pytest.raises(DemoError, match="no estimate came back"):
        run_demo(plan(tmp_path, "mute", duration_s=5.0), console())


def test_estimates_outside_their_limits_end_with_code_3(tmp_path: Path) -> None:
    wrong = tmp_path / "wrong.toml"
    text = (ROOT / "sim_sensor" / "scenarios" / "paper.toml").read_text()
    assert "[5000, 3000, 4000]" in text
    wrong.write_text(text.replace("[5000, 3000, 4000]", "[5000, 3100, 4000]"))
    shown = console()
    given = Plan(Wire.SERIAL, str(wrong), 0.0, 1, tmp_path / "out", 20.0, (sys.executable, str(FAKE), "polite"))
    assert run_demo(given, shown) == 3
    assert "outside 3 sigma: by" in text_of(shown)


def test_ctrl_c_ends_in_order_and_shows_what_came_so_far(tmp_path: Path) -> None:
    shown, handler = console(), signal.getsignal(signal.SIGINT)

    def press_when_samples_flow() -> None:
        while "/18000 s" not in text_of(shown):
            time.sleep(0.02)
        time.sleep(1.0)
        os.kill(os.getpid(), signal.SIGINT)

    thread = threading.Thread(target=press_when_samples_flow)
    thread.start()
    code = run_demo(plan(tmp_path, "polite", speed=20.0, duration_s=18000.0), shown)
    thread.join()
    assert (code, signal.getsignal(signal.SIGINT)) == (INTERRUPTED, handler)
    assert "interrupted" in text_of(shown)


def test_ctrl_c_before_the_daemon_is_there_ends_as_interrupted(tmp_path: Path) -> None:
    shown = console()
    idle = (sys.executable, "-c", "import time; time.sleep(60)")
    timer = threading.Timer(0.5, os.kill, (os.getpid(), signal.SIGINT))
    timer.start()
    code = run_demo(Plan(Wire.SERIAL, "paper", 0.0, 1, tmp_path, 10.0, idle), shown)
    assert (code, "no estimate" in text_of(shown)) == (INTERRUPTED, True)


def test_an_unknown_scenario_is_refused_in_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--scenario", "papre"]) == 2
    assert "did you mean 'paper'" in capsys.readouterr().err


def test_by_default_a_zenoh_run_of_the_paper_goes_into_a_new_folder() -> None:
    given = parse_arguments([])
    assert (given.wire, given.scenario, given.speed) == (Wire.ZENOH, "paper", 300.0)
    assert given.out.parent.name == "output"


def test_the_page_is_on_a_free_port_and_nothing_waits_for_a_person() -> None:
    given = [parse_arguments(words) for words in ([], ["--port", "8047", "--stay"], ["--no-page"])]
    assert [(plan.port, plan.stay) for plan in given] == [(0, False), (8047, True), (None, False)]


@pytest.mark.parametrize(
    "words",
    [
        ["--speed", "-1"],
        ["--port", "70000"],
        ["--no-page", "--stay"],
        ["--speed", "nan"],
        ["--link", "can"],
        ["--duration", "inf"],
    ],
)
def test_a_wrong_argument_is_refused(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        parse_arguments(words)
    assert words[0] in capsys.readouterr().err


def test_the_daemon_is_told_what_an_operator_knows_and_no_truth(tmp_path: Path) -> None:
    scenario = resolve(load_scenario("paper"), 1)
    path = tmp_path / "magcal.toml"
    path.write_text(daemon_config(scenario, "serial:/dev/ttyUSB0", tmp_path / "ticks.csv"))
    craft = load_config(path).crafts[0]
    assert (craft.name, craft.sensor.noise_nt) == ("paper", 300.0)
    assert craft.spin is not None
    assert craft.spin.rate_rpm == pytest.approx(7.5)
    assert not any(value in path.read_text() for value in ("5000", "3000", "4000", "0.05"))
