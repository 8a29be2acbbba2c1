"""A replay with ``physics.toml`` reports the residual of what it really did, against its own rows and messages."""

from __future__ import annotations

import csv
import json
import re
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from magcal_service.offline.compensated import Tally, compensation_lines
from magcal_service.offline.held import over_of
from magcal_service.offline.replay import craft_of, replay
from magcal_service.physics.apply.empirical import NAME, OUTSIDE, Empirical, Kind
from magcal_service.physics.apply.lacking import Cause
from magcal_service.physics.apply.model_file import ModelTerm, Note, parse_model
from magcal_service.recordings.reader import read_recording
from magcal_service.wire.messages import CalibratedVector, Message, Verdict
from sim_sensor.recorder import record_simulation
from sim_sensor.simulation import Simulation
from tests.cli.cli_inputs import run
from tests.physics.live_models import NOISE_NT, THERMAL, hot, physics

DURATION_S = 1500.0
GONE = ModelTerm(
    "current_loop", "channel:gone", "", {"nt_per_a": np.array([90.0, 0.0, 0.0])}, constants={"column_0": 0}
)
"""Its channel is not on board: what a formula over the recording refuses as a whole, the service leaves out."""

CONFIG = """
version = 1
[[craft]]
name = "hot"
physics = "{physics}"
[craft.sensor]
noise_nt = 100.0
[craft.spin]
rate_rpm = 7.5
"""


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("recorded")
    thermal = hot().effects.thermal
    assert thermal is not None
    heating = replace(thermal, bias_nt_per_k=(40.0, -30.0, 60.0), time_constant_s=600.0, start_degc=50.0)
    scenario = hot(effects=replace(hot().effects, thermal=heating))
    record_simulation(Simulation(scenario, 3, DURATION_S), folder)
    terms = (replace(THERMAL[0], amplitudes={"nt_per_k": np.array([40.0, -30.0, 60.0])}), THERMAL[1], GONE)
    (folder / "physics.toml").write_text(physics(*terms, origin_ns=scenario.start_ns).text, encoding="utf-8")
    (folder / "magcal.toml").write_text(CONFIG.format(physics=folder / "physics.toml"), encoding="utf-8")
    return folder


def ticks_squares(path: Path) -> list[float]:
    """Squared residual of each tick since the start, out of the running mean over 300 ticks that the rows hold."""
    squares, before, count = [], 0.0, 0
    for row in csv.DictReader(path.read_text(encoding="utf-8").splitlines()):
        running = float(row["residual_rms_nt"]) ** 2
        if running:
            count += 1
            squares.append(before + (running - before) * min(count, 300))
            before = running
    return squares


def test_the_residual_that_is_printed_is_that_of_the_rows(recorded: Path) -> None:
    """To 2 %: a vector leaves with the estimate of one or two ticks before the one whose residual its row has."""
    rows = recorded / "rows.csv"
    out = run("replay", recorded / "RECORDING.toml", "--config", recorded / "magcal.toml", "--out", rows).out
    after, published = (float(re.search(text, out)[1]) for text in (r"([\d.]+) nT after", r"since the start: ([\d.]+)"))  # type: ignore[index]
    squares = ticks_squares(rows)
    assert len(squares) > 900
    assert published == pytest.approx(np.sqrt(np.mean(squares)), rel=0.02)
    assert after == pytest.approx(NOISE_NT, rel=0.1)  # every sample without the heat, at the estimate of the end


def test_nine_errors_beside_compensated_heat_hold_at_the_files_temperature(recorded: Path) -> None:
    """Without the file they are constants over the range that was recorded, where the watch finds that it matters."""
    done = run("calibrate", recorded / "RECORDING.toml", "--config", recorded / "magcal.toml", "--json", "-")
    (held,) = json.loads(done.out)["errors_hold_at"]
    assert (held["driver"], held["value"], held["unit"]) == ("channel:temperature", 20.0, "degC")
    assert json.loads(done.out)["errors_over"] is None
    assert "\n  at 20.0 degC of channel temperature\n" in done.err
    recording = read_recording(recorded / "RECORDING.toml")
    pipeline: Any = SimpleNamespace(watch=SimpleNamespace(finding=SimpleNamespace(driver="channel temperature")))
    over, values = over_of(recording, pipeline), recording.channels["temperature"].values
    assert over is not None
    assert (over.low, over.high) == pytest.approx((np.nanmin(values), np.nanmax(values)), abs=1.0)
    assert over.mean == pytest.approx(np.nanmean(values), abs=0.1)
    pipeline.watch.finding = SimpleNamespace(driver="channel current")
    assert over_of(recording, pipeline) is None


def test_each_effect_is_said_to_be_compensated_or_why_not(recorded: Path) -> None:
    """In the counts of the service's own counters; of the first samples the temperature is not there yet."""
    done = run("replay", recorded / "RECORDING.toml", "--config", recorded / "magcal.toml").out
    counters = dict(
        re.findall(r"(\S+) (\d+)(?:,|\n)", next(line for line in done.splitlines(True) if "estimates; " in line))
    )
    count = int(counters["accepted"])
    gone = (
        f"compensated in 0 of {count} samples; not in {count}: the recording has no channel gone (known: temperature)"
    )
    assert f"physics.toml: current_loop (channel:gone): {gone}\n" in done
    missing = int(counters.get("uncompensated.thermal_bias", 0))
    assert f"physics.toml: thermal_bias (channel:temperature): compensated in {count - missing} of {count} sa" in done
    assert int(counters["uncompensated.current_loop"]) == count
    assert count - missing > 1400


def test_a_misspelt_channel_is_told_before_the_work_by_the_files_own_name(recorded: Path) -> None:
    """By whatever takes the file, on stderr; and as the reason of the samples that were not compensated."""
    text = (recorded / "physics.toml").read_text(encoding="utf-8").replace("temperature", "temprature")
    (recorded / "mine.toml").write_text(text, encoding="utf-8")
    config, given = recorded / "mine-config.toml", recorded / "RECORDING.toml"
    config.write_text(CONFIG.format(physics=recorded / "mine.toml"), encoding="utf-8")
    meant = "the recording has no channel temprature (did you mean 'temperature'? known: temperature)"
    then = "describe that channel, correct its name here, or take the effect out"
    line = f"mine.toml: effect[0].driver: 'channel:temprature': {meant}; thermal_bias is not compensated: {then}"
    for command in (
        ("replay", given, "--config", config),
        ("calibrate", given, "--config", config),
        ("apply", given, "--with", recorded / "mine.toml", "--out", recorded / "v.csv"),
    ):
        done = run(*command)
        assert line in done.err.splitlines()
        assert "physics.toml: " not in done.out
        if command[0] != "calibrate":
            assert re.search(
                rf"mine.toml: thermal_bias .*: compensated in 0 of (\d+) samples; not in \1: {re.escape(meant)}\n",
                done.out,
            )
    config.write_text(f'link = "recording:{given}"\n' + config.read_text(encoding="utf-8"), encoding="utf-8")
    assert line in run("run", "--check", "--config", config).out.splitlines()
    config.write_text(config.read_text(encoding="utf-8").replace("RECORDING.toml", "RECORDING.toml?telemetry=no"))
    said = run("run", "--check", "--config", config).out
    assert (
        f"'channel:temprature': the recording has no channel temprature; thermal_bias is not compensated: {then}\n"
        in said
    )


def test_a_channel_without_a_value_and_one_that_goes_stale_are_told_apart(recorded: Path) -> None:
    """From two recordings, one whose temperature cells are all empty, and one in which they end."""
    rows = list(csv.reader((recorded / "samples.csv").read_text(encoding="utf-8").splitlines()))
    column, descriptor = rows[0].index("temperature"), (recorded / "RECORDING.toml").read_text(encoding="utf-8")
    for name, kept, why in (
        ("empty", 0, "channel temperature of the recording has no value in any row"),
        ("ending", 300, "the newest value of channel temperature was older than it may be"),
    ):
        cut = [[*row[:column], "", *row[column + 1 :]] if at > kept else row for at, row in enumerate(rows)]
        (recorded / f"{name}.csv").write_text("\n".join(map(",".join, cut)), encoding="utf-8")
        path = recorded / f"{name}.toml"
        path.write_text(descriptor.replace("samples.csv", f"{name}.csv"), encoding="utf-8")
        given = recorded / "physics.toml"
        out = run("apply", path, "--with", given, "--out", recorded / "v.csv").out
        (line,) = [line for line in out.splitlines() if line.startswith("physics.toml: thermal_bias")]
        assert line.endswith(f": {why}")
        assert ("compensated in 0 of" in line) is (kept == 0)


def test_the_effects_are_in_the_answer_of_a_program(recorded: Path) -> None:
    recording = read_recording(recorded / "RECORDING.toml")
    assert replay(recording).to_dict()["physics"] == []
    craft = replace(
        craft_of(recording), physics=replace(physics(origin_ns=0), text=(recorded / "physics.toml").read_text())
    )
    content = {one["effect"]: one for one in replay(recording, craft).to_dict()["physics"]}
    assert set(content) == {"thermal_bias", "thermal_scale", "current_loop"}
    assert content["current_loop"]["samples"] == {"no_driver": int(DURATION_S)}
    assert content["thermal_bias"]["samples"]["compensated"] > 1400


@dataclass
class _Craft:
    """As much of a craft as is counted."""

    missing: tuple[str, ...] = ()
    stopped: str = ""
    causes: dict[str, tuple[Cause, str]] = field(default_factory=dict)
    settling: object = None

    @property
    def compensation(self) -> _Craft:
        return self


def test_samples_are_counted_by_what_kept_an_effect_from_them() -> None:
    model = parse_model(physics(*THERMAL, GONE, origin_ns=0).text.encode())
    tally = Tally()
    for craft, times in (
        (_Craft(settling=1), 5),
        (_Craft(missing=("thermal_bias",)), 3),
        (_Craft(), 2),
        (_Craft(stopped="it harms"), 7),
    ):
        for _ in range(times):
            tally.sample(craft)  # type: ignore[arg-type]
    heat, scale, loop = tally.accounts(model, {"temperature": True}, "it harms")
    assert heat.samples == {"compensated": 2, "no_driver": 3, "start_unknown": 5, "stopped": 7}
    assert scale.samples == {"compensated": 5, "start_unknown": 5, "stopped": 7}
    assert loop.effect == "current_loop"
    assert str(scale) == (
        "thermal_scale (channel:temperature): compensated in 5 of 17 samples; not in 5: before the temperature at the "
        "start was known; not in 7: after compensation was stopped: it harms"
    )
    assert "not in 3: its driver was missing or older than it may be" in heat.why


def test_curves_without_a_name_are_one_account() -> None:
    """A sample in which one's driver is missing and another's beyond its range counts once, as missing."""
    curve = Empirical(
        driver="channel:warm",
        kind=Kind.BIAS,
        quantity="temperature",
        column=0,
        knots=np.array([0.0, 1.0]),
        values=np.zeros((2, 3)),
        sigma=np.zeros((2, 3)),
        span=(0.0, 1.0),
    )
    both = (curve, replace(curve, driver="computed:latitude", quantity=""))
    model = parse_model(physics(origin_ns=0, empirical=both).text.encode())
    tally = Tally()
    for missing, times in (((), 3), ((NAME,), 2), ((OUTSIDE,), 4), ((NAME, OUTSIDE), 5)):
        for _ in range(times):
            tally.sample(_Craft(missing))  # type: ignore[arg-type]
    (account,) = tally.accounts(model, {"warm": True}, "")
    assert account.samples == {"compensated": 3, "no_driver": 7, "driver_outside": 4}
    assert account.drivers == ("channel:warm", "computed:latitude")
    assert "not in 4: a driver was beyond the range of its curve" in str(account)


@pytest.mark.parametrize(
    ("effect", "form", "instead"),
    [
        ("current_loop", "circuit 2, recorded late", ", by the record as its row has it, for later rows have not come"),
        ("response_lag", "by the steps", ", by what its turn alone shortens, without its delay"),
        ("current_loop", "circuit 2", ""),
    ],
)
def test_what_stands_live_in_a_forms_place_is_said(effect: str, form: str, instead: str) -> None:
    """Where it was subtracted at all."""
    model = replace(parse_model(physics(origin_ns=0).text.encode()), terms=(ModelTerm(effect, "none", form, {}),))
    done, gone = Tally(), Tally()
    done.corrected((), {})
    gone.corrected((effect,), {})
    assert str(done.accounts(model, {}, "")[0]) == f"{effect}: compensated in 1 of 1 samples{instead}"
    assert "compensated in 0 of 1 samples; not in 1" in str(gone.accounts(model, {}, "")[0])


def test_an_effect_that_needs_the_crafts_turn_is_said_to_lack_it() -> None:
    skew = ModelTerm("axis_skew", "none", "", {"after_x_s": np.ones(2)})
    model = replace(parse_model(physics(origin_ns=0).text.encode()), terms=(skew,))
    tally = Tally()
    tally.corrected(("axis_skew",), {})
    assert "not in 1: it needs to know how the craft turns" in str(tally.accounts(model, {}, "")[0])


def test_a_form_that_no_single_moment_determines_is_said_to_be_none_for_the_daemon() -> None:
    late = ModelTerm("time_offset", "none", "by minutes", {"s": np.array([200.0])})
    model = replace(
        parse_model(physics(*THERMAL, origin_ns=0).text.encode()),
        terms=(late,),
        notes=(Note("nutation", "It nutates."),),
    )
    tally = Tally()
    tally.sample(_Craft(missing=("time_offset",)))  # type: ignore[arg-type]
    accounts = tally.accounts(model, {}, "")
    assert compensation_lines(accounts, model, "other.toml") == [
        "other.toml: time_offset: compensated in 0 of 1 samples; not in 1: this form cannot be followed live",
        "other.toml: stated, and no field that is compensated: nutation",
    ]


def test_the_published_residual_is_that_of_the_messages(recorded: Path) -> None:
    """|B_cal| - |H| of each vector that went out after the start, to the last digit."""
    recording = read_recording(recorded / "RECORDING.toml")
    model = (recorded / "physics.toml").read_text(encoding="utf-8")
    craft = replace(craft_of(recording), physics=replace(physics(origin_ns=0), text=model))
    sent: list[Message] = []
    result = replay(recording, craft, sink=sent.append)
    vectors = [m for m in sent if isinstance(m, CalibratedVector) and m.verdict is not Verdict.NOT_STARTED]
    magnitude = dict(zip(recording.time_ns.tolist(), recording.reference.magnitude_nt.tolist(), strict=True))
    wanted = [np.linalg.norm(m.field_body_nt) - magnitude[m.time_ns] for m in vectors]
    assert result.published is not None
    assert result.published.since_start() == pytest.approx(np.array(wanted), abs=1e-6)
