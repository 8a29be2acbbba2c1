"""The node on a link, its recordings, and the commands."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from magcal_service.base.errors import ConfigError
from magcal_service.links import Role, open_link
from magcal_service.recordings.reader import read_recording
from magcal_service.wire.messages import CalibratedVector, MagnetometerSample, Message, Status, Verdict
from sim_sensor import cli
from sim_sensor.faults import FaultKind, LinkFault, Target
from sim_sensor.node import NodeReport, run_node
from sim_sensor.recorder import Series, record_simulation
from sim_sensor.scenario import Channel, PositionPlan, ReferenceForm, ReferencePlan, TelemetryPlan
from sim_sensor.scenario_reader import load_scenario, shipped_scenarios
from sim_sensor.simulation import Simulation

PAPER = load_scenario("paper")


def simulation(duration_s: float = 60.0, **changes: object) -> Simulation:
    return Simulation(replace(PAPER, **changes), 1, duration_s)


def drained(name: str, run: object) -> list[Message]:
    """What arrives at the service's end of a loop while ``run`` sends at the node's."""
    with open_link(f"loop:{name}?queue=100000", Role.SERVICE) as service:
        run()  # type: ignore[operator]
        return service.receive(0.0)


def test_the_service_receives_exactly_what_the_simulation_sends() -> None:
    def run() -> None:
        with open_link("loop:node-all", Role.NODE) as link:
            run_node(simulation(), link, speed=0.0)

    assert drained("node-all", run) == list(simulation().messages())


def test_a_run_is_paced_by_its_speed() -> None:
    with open_link("loop:node-pace", Role.NODE) as link:
        begin = time.monotonic()
        report = run_node(simulation(11.0), link, speed=20.0)
        took_s = time.monotonic() - begin
    assert 0.5 <= took_s < 5.0
    assert report.messages == 22
    assert report.elapsed_s == 10.0


def test_results_on_the_link_reach_the_callback() -> None:
    status = Status(craft="paper", source="magcal", sequence=0, time_ns=0, uptime_s=1.0, verdict=Verdict.CONVERGING)
    results: list[Message] = []
    with open_link("loop:node-back", Role.SERVICE) as service, open_link("loop:node-back", Role.NODE) as link:
        service.send(status)
        run_node(simulation(5.0), link, speed=0.0, on_result=results.append)
    assert results == [status]


def test_a_stop_ends_the_run_at_once() -> None:
    stop = threading.Event()
    with open_link("loop:node-stop", Role.NODE) as link:
        report = run_node(simulation(1e4), link, speed=1.0, stop=stop, on_sent=lambda _: stop.set())
    assert report.messages == 1


@pytest.mark.parametrize("speed", [-1.0, float("nan"), float("inf")])
def test_an_impossible_speed_is_refused(speed: float) -> None:
    with open_link("loop:node-speed", Role.NODE) as link, pytest.raises(ValueError, match="speed"):
        run_node(simulation(), link, speed=speed)


def test_a_recording_holds_the_run_bit_for_bit(tmp_path: Path) -> None:
    run = simulation(600.0, sensor=replace(PAPER.sensor, rate_hz=3.0), reference=ReferencePlan(rate_hz=3.0))
    recording = read_recording(record_simulation(run, tmp_path))
    block = run.arrays()
    np.testing.assert_array_equal(recording.time_ns, block.times_ns)
    np.testing.assert_array_equal(recording.field_body_nt, block.measured_nt)
    np.testing.assert_array_equal(recording.reference.vector_nt, block.true_eci_nt)


@pytest.mark.parametrize("name", shipped_scenarios())
def test_every_shipped_scenario_becomes_a_recording_that_can_be_read(name: str, tmp_path: Path) -> None:
    run = Simulation(load_scenario(name), duration_s=400.0)
    recording = read_recording(record_simulation(run, tmp_path))
    assert len(recording.time_ns) > 30


def test_the_truth_is_beside_a_recording_and_nowhere_in_it(tmp_path: Path) -> None:
    record_simulation(Simulation(load_scenario("random-errors"), 3, 100.0), tmp_path)
    truth = json.loads((tmp_path / "truth.json").read_text())
    sensor = Simulation(load_scenario("random-errors"), 3).truth.sensor
    assert truth["bias_nt"] == list(sensor.bias_nt)
    assert np.array(truth["D"])[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]].tolist() == list(sensor.D)
    assert truth["seed"] == 3
    assert str(sensor.bias_nt[0]) not in (tmp_path / "RECORDING.toml").read_text()


def test_channels_and_positions_are_recorded_at_their_rows(tmp_path: Path) -> None:
    run = simulation(60.0, telemetry=TelemetryPlan((Channel.GYRO,), 1.0, (0.0,)), position=PositionPlan(1.0))
    recording = read_recording(record_simulation(run, tmp_path))
    np.testing.assert_array_equal(recording.position.km, run.positions()[1])
    np.testing.assert_array_equal(recording.channels["gyro"].values, run.channel(Channel.GYRO)[1])


def test_lost_samples_are_absent_from_a_recording(tmp_path: Path) -> None:
    gap = LinkFault(FaultKind.GAP, Target.ALL, at_s=20.0, for_s=10.0)
    recording = read_recording(record_simulation(simulation(60.0, faults=(gap,)), tmp_path))
    elapsed = (recording.time_ns - PAPER.start_ns) // 10**9
    assert elapsed.tolist() == [*range(20), *range(30, 60)]


def test_a_run_without_reference_cannot_be_recorded(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"reference\.form"):
        record_simulation(simulation(reference=ReferencePlan(form=ReferenceForm.NONE)), tmp_path)


def test_a_slower_series_is_linear_between_its_samples_and_absent_in_a_gap() -> None:
    series = Series()
    for at_s, value in ((0, 0.0), (10, 100.0), (50, 500.0)):
        series.add(at_s * 10**9, (value,))
    rows = np.array([-1, 0, 4, 10, 20, 50, 51]) * 10**9
    np.testing.assert_array_equal(series.at(rows, 25.0)[:, 0], [np.nan, 0.0, 40.0, 100.0, np.nan, 500.0, np.nan])


def test_a_held_series_keeps_the_last_value() -> None:
    series = Series()
    for at_s, value in ((0, 1.0), (10, 2.0)):
        series.add(at_s * 10**9, (value,))
    np.testing.assert_array_equal(series.at(np.array([0, 9, 10]) * 10**9, 25.0, held=True)[:, 0], [1.0, 1.0, 2.0])


@pytest.mark.parametrize("held", [True, False])
def test_the_last_value_is_kept_for_a_period_after_it(held: bool) -> None:
    """As long as the next one would not have come; not before the first, and not into the gap after it."""
    series = Series()
    for second, value in ((10, 1.0), (20, 2.0)):
        series.add(second * 10**9, (value,))
    rows = np.array([9, 20, 21, 30, 31]) * 10**9
    found = series.at(rows, 25.0, held=held, kept_s=10.0)[:, 0]
    np.testing.assert_array_equal(found, [np.nan, 2.0, 2.0, 2.0, np.nan])


def test_a_shipped_recording_has_no_faults(tmp_path: Path) -> None:
    """Its telemetry comes every ten seconds, and the run ends between two of them."""
    scenario = replace(load_scenario("hot-electronics"), duration_s=96.0)
    report = read_recording(record_simulation(Simulation(scenario, 1, 96.0), tmp_path)).report
    assert report.lines() == ["96 rows, 96 read, 0 refused"]


def test_list_names_every_scenario(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["list"]) == 0
    printed = capsys.readouterr().out
    assert all(f"{name}\n" in printed for name in shipped_scenarios())


def test_record_writes_the_three_files(tmp_path: Path) -> None:
    assert cli.main(["record", "--scenario", "paper", "--out", str(tmp_path / "new"), "--duration", "100"]) == 0
    assert {path.name for path in (tmp_path / "new").iterdir()} == {"RECORDING.toml", "samples.csv", "truth.json"}


def test_record_with_the_same_seed_writes_the_same_bytes(tmp_path: Path) -> None:
    for name in ("one", "two"):
        cli.main(["record", "--scenario", "random-errors", "--out", str(tmp_path / name), "--duration", "50"])
    for file in ("RECORDING.toml", "samples.csv", "truth.json"):
        assert (tmp_path / "one" / file).read_bytes() == (tmp_path / "two" / file).read_bytes()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["run", "--scenario", "papper"], "did you mean 'paper'"),
        (["run", "--scenario", "absent.toml"], "absent.toml"),
        (["run", "--scenario", "paper", "--link", "zenho:tcp/127.0.0.1:1"], "did you mean 'zenoh'"),
        (["record", "--scenario", "paper", "--out", "/dev/null/x", "--duration", "5"], "--out"),
    ],
)
def test_a_refusal_is_one_line_and_code_2(arguments: list[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(arguments) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1


@pytest.mark.parametrize("option", [["--speed", "-1"], ["--seed", "1.5"], ["--duration", "0"], ["--wait", "x"]])
def test_a_bad_option_ends_with_code_2(option: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        cli.main(["run", "--scenario", "paper", *option])
    assert ended.value.code == 2
    assert option[0] in capsys.readouterr().err


def answer_everything(service: object, seen: list[Message], stop: threading.Event) -> None:
    while not stop.wait(0.3):  # slow: what is sent meanwhile has to fit into the queue
        for message in service.receive(0.0):  # type: ignore[attr-defined]
            seen.append(message)
            if isinstance(message, MagnetometerSample):
                service.send(  # type: ignore[attr-defined]
                    CalibratedVector(
                        craft=message.craft,
                        source=message.source,
                        sequence=message.sequence,
                        time_ns=message.time_ns,
                        field_body_nt=message.field_body_nt,
                        covariance_nt2=(1.0, 0.0, 0.0, 1.0, 0.0, 1.0),
                        verdict=Verdict.CONVERGING,
                    )
                )


def test_run_at_full_speed_waits_for_a_slower_daemon_and_records(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """600 samples through a queue that holds 450 messages: without waiting for answers, some would be lost."""
    seen: list[Message] = []
    stop = threading.Event()
    with open_link("loop:cli?queue=450", Role.SERVICE) as service:
        thread = threading.Thread(target=answer_everything, args=(service, seen, stop))
        thread.start()
        arguments = ["--link", "loop:cli", "--speed", "max", "--duration", "600", "--wait", "0"]
        code = cli.main(["run", "--scenario", "paper", *arguments, "--record", str(tmp_path)])
        stop.set()
        thread.join()
    assert code == 0
    assert seen == list(simulation(600.0).messages())
    assert "1200 messages sent, 600 of 600 samples answered" in capsys.readouterr().err
    assert len(read_recording(tmp_path / "RECORDING.toml").time_ns) == 600


def test_sigterm_ends_a_run_cleanly() -> None:
    command = [sys.executable, "-m", "sim_sensor.cli", "run", "--scenario", "paper", "--link", "loop:alone"]
    process = subprocess.Popen([*command, "--wait", "0.1"], stderr=subprocess.PIPE, text=True)
    assert process.stderr is not None
    assert "no daemon has answered" in process.stderr.readline()
    process.send_signal(signal.SIGTERM)
    _, error = process.communicate(timeout=20)
    assert process.returncode == 0
    assert "of 18000 s" in error
    assert "Traceback" not in error


def test_an_interrupted_record_says_so_and_writes_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def stopped(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("sim_sensor.cli.record_simulation", stopped)
    assert cli.main(["record", "--scenario", "paper", "--duration", "60", "--out", str(tmp_path / "out")]) == 130
    assert capsys.readouterr().err == "interrupted: what was asked for is not done\n"
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("address", "next_step"),
    [
        ("zenoh:tcp/127.0.0.1:7447", "see what the daemon says by `magcal status --link zenoh:tcp/127.0.0.1:7447`"),
        ("serial:/dev/ttyUSB0", "see what the daemon says in its log and metrics (docs/health.md)"),
    ],
)
def test_samples_without_an_answer_are_counted_and_said_with_what_to_do(
    address: str, next_step: str, capsys: pytest.CaptureFixture[str]
) -> None:
    view, report = cli.Progress(20.0), NodeReport()
    report.sent.update(MagnetometerSample=20, ReferenceSample=20)
    view.received["CalibratedVector"] = 17
    cli._tell_missing(report, view, address)
    why = "the daemon is behind, refused them, or they were lost"
    assert capsys.readouterr().err == f"3 of 20 samples have no answer: {why}\nnext: {next_step}\n"
    assert "40 messages sent, 17 of 20 samples answered" in view._line(report)
    view.received["CalibratedVector"] = 20
    cli._tell_missing(report, view, address)
    assert capsys.readouterr().err == ""
    assert cli._what_next(address, "nobody is there") == "start the daemon (magcal run), or give its address by --link"
