"""``magcal diagnose``: files, the contract's JSON, exit codes and refusals."""

from __future__ import annotations

import html
import json
import shlex
import tomllib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import jsonschema
import numpy as np
import pytest

from magcal_service.base import progress
from magcal_service.diagnosis.command import Request
from magcal_service.diagnosis.diagnose import Verdict
from magcal_service.diagnosis.joint.command import JointRequest
from magcal_service.diagnosis.stages import LEFT, READING, RIVALS, SEARCHING, SIMULATING, STEPS, WRITING
from magcal_service.offline.result_head import DIAGNOSIS, schema
from magcal_service.recordings.reader import read_recording
from tests.cli.cli_inputs import run
from tests.diagnosis.diagnosis_runs import Done, diagnose, recorded


@pytest.fixture(scope="module")
def hot(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """3000 s of a sensor whose bias and gain follow a recorded temperature."""
    return recorded("hot-electronics", 3000.0, tmp_path_factory.mktemp("hot"))


@pytest.fixture(scope="module")
def clean(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """1500 s in which nothing was left out."""
    return recorded("paper", 1500.0, tmp_path_factory.mktemp("clean"))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the diagnosis of ``hot`` goes."""
    return tmp_path_factory.mktemp("out") / "made" / "hot"


@pytest.fixture(scope="module")
def told() -> list[str]:
    """The steps that ``done`` was told of."""
    return []


@pytest.fixture(scope="module")
def done(hot: Path, folder: Path, told: list[str]) -> Done:
    """The command over ``hot``, against the scenario that it was made with."""

    @contextmanager
    def steps(names: Sequence[str], forecast: progress.Forecast) -> Iterator[Callable[[str], None]]:
        assert forecast.left_s(0.0) is None
        told.append(names[0])
        yield told.append

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(progress, "steps", steps)
        return diagnose(hot, "--out", folder, "--simulation", "hot-electronics")


@pytest.fixture(scope="module")
def content(done: Done, folder: Path) -> dict[str, Any]:
    """Its ``diagnosis.json``."""
    loaded: dict[str, Any] = json.loads((folder / "diagnosis.json").read_text(encoding="utf-8"))
    return loaded


def test_a_diagnosis_is_done_and_says_no_step_where_stderr_is_no_terminal(done: Done) -> None:
    assert (done.code, done.err) == (0, "")


def test_its_steps_are_told_in_their_order(done: Done, told: list[str]) -> None:
    """A search that keeps two effects looks for a third, and may be made again under a larger error of the field."""
    assert done.code == 0
    once = list(dict.fromkeys(told))
    assert once == [step for step in STEPS if step in once]
    assert {*SEARCHING, RIVALS, LEFT} < set(once)
    assert (told[:3], told[-1]) == ([READING, SIMULATING, SEARCHING[0]], WRITING)


def test_the_three_files_are_written(done: Done, folder: Path) -> None:
    assert done.code == 0
    assert {path.name for path in folder.iterdir()} == {"diagnosis.json", "report.html", "physics.toml"}


def test_it_keeps_its_schema(content: dict[str, Any]) -> None:
    jsonschema.validate(content, schema(DIAGNOSIS))
    assert content["effects"]


def test_the_physics_file_holds_the_nine_errors_and_every_effect(content: dict[str, Any], folder: Path) -> None:
    physics = tomllib.loads((folder / "physics.toml").read_text(encoding="utf-8"))
    assert physics["errors"]["bias_nt"] == content["fit"]["bias_nt"]
    assert all(effect["effect"] in str(physics) for effect in content["effects"])


def test_the_summary_is_short_and_has_verdict_numbers_and_files(done: Done, folder: Path) -> None:
    lines = done.out.splitlines()
    assert len(lines) <= 18
    assert "verdict: named" in lines
    assert any(line.startswith("  thermal_bias: ") for line in lines)
    assert any(line.startswith("rms on held-out rows: ") and "noise 100.0 nT stated" in line for line in lines)
    assert any(line.startswith("vectors without these effects: off by ") for line in lines)
    assert any(line.startswith("bias: ") for line in lines)
    files = next(line for line in lines if line.startswith("files: "))
    assert all(str(folder / name) in files for name in ("diagnosis.json", "report.html", "physics.toml"))


def test_it_says_at_which_temperature_the_nine_errors_hold(
    done: Done, folder: Path, content: dict[str, Any], hot: Path
) -> None:
    """That of the file's effects, the mean of what was recorded, wherever a bias is printed."""
    text = (folder / "physics.toml").read_text(encoding="utf-8")
    (zero,) = {effect["constants"]["zero_degc"] for effect in tomllib.loads(text)["effect"]}
    recording = read_recording(hot)
    assert zero == pytest.approx(float(np.nanmean(recording.channels["temperature"].values)), abs=0.1)
    (held,) = content["fit"]["errors_hold_at"]
    assert (held["driver"], held["value"], held["unit"]) == ("channel:temperature", zero, "degC")
    says = f"{held['value']:.1f} degC of channel temperature"
    assert held["says"] == says
    (bias,) = (line for line in done.out.splitlines() if line.startswith("bias: "))
    assert f" nT, at {says}; by nine errors alone" in bias
    assert f"[errors]  # D11 D22 D33 D12 D13 D23; at {says}\n" in text
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert f"With effects, the nine errors are those at {says}." in page
    exported = run("export", folder / "physics.toml", "--format", "c-header")
    assert f"without that they hold at {says}" in exported.out
    left_out = "thermal_bias, thermal_scale; they hold for B less the field of these, which physics.toml has"
    assert f"not in these numbers: {left_out}" in exported.err
    assert "#define MAGCAL_RESULT_EFFECTS_LEFT_OUT 2\n" in exported.out


def test_the_report_says_what_to_do_next_as_the_summary_does(done: Done, folder: Path) -> None:
    page = html.unescape((folder / "report.html").read_text(encoding="utf-8"))
    lines = done.out.splitlines()
    first = next(number for number, line in enumerate(lines) if line.startswith("next: "))
    assert "What to do next" in page
    for line in lines[first:]:
        assert f"<code>{line.removeprefix('next: ').strip()}</code>" in page


def test_without_heat_the_nine_errors_hold_anywhere(clean: Path, tmp_path: Path) -> None:
    assert diagnose(clean, "--out", tmp_path).code == 0
    assert json.loads((tmp_path / "diagnosis.json").read_text(encoding="utf-8"))["fit"]["errors_hold_at"] == []


def typed(value: object) -> object:
    """A JSON value with every leaf replaced by its type."""
    if isinstance(value, dict):
        return {key: typed(item) for key, item in value.items()}
    return [typed(item) for item in value] if isinstance(value, list) else type(value)


ROW = [float, float, float]
CONTRACT = {
    "verdict": str,
    "fit": {
        "noise_floor_nt": float,
        "held_out_rms_nt": {"simulation": float, "recalibrated": float, "with_effects": float},
        "bias_nt": ROW,
        "D": [ROW, ROW, ROW],
    },
    "trusted": bool,
    "reasons": [],
}


@pytest.mark.parametrize("field", CONTRACT)
def test_the_json_has_the_contracts_fields(field: str, content: dict[str, Any]) -> None:
    wanted, found = CONTRACT[field], typed(content[field])
    if isinstance(wanted, dict):
        assert isinstance(found, dict)
        found = {key: value for key, value in found.items() if key in wanted}
    assert found == wanted


def test_every_effect_has_the_contracts_fields(content: dict[str, Any]) -> None:
    assert content["effects"]
    for effect in content["effects"]:
        kinds = {"effect": str, "says": str, "probability": float, "rivals": list, "class": list, "driver": str}
        assert {key: type(effect[key]) for key in kinds} == kinds
        assert effect["effect"] in effect["class"]
        assert {"time_s", "axis", "frequency_hz", "share_of_mismatch"} <= set(effect["where"])
        assert all(
            set(value) == {"value", "sigma", "unit", "labels", "range"} for value in effect["parameters"].values()
        )
        assert all(set(rival) == {"effect", "probability"} for rival in effect["rivals"])


def test_effects_are_sorted_by_the_share_they_explain(content: dict[str, Any]) -> None:
    shares = [effect["where"]["share_of_mismatch"] for effect in content["effects"]]
    assert shares == sorted(shares, reverse=True)


def test_the_cause_is_named_with_its_driver_and_its_size(content: dict[str, Any]) -> None:
    assert content["verdict"] == Verdict.NAMED
    thermal = next(effect for effect in content["effects"] if effect["effect"] == "thermal_bias")
    assert thermal["driver"] == "channel:temperature"
    found = thermal["parameters"]["nt_per_k"]
    errors = [abs(v - t) / s for v, t, s in zip(found["value"], (8.0, -6.0, 12.0), found["sigma"], strict=True)]
    assert max(errors) < 5.0


def test_held_out_data_gain_by_the_effects(content: dict[str, Any]) -> None:
    rms = content["fit"]["held_out_rms_nt"]
    assert rms["with_effects"] < 0.9 * rms["recalibrated"] <= 0.9 * rms["simulation"] * 1.05
    assert rms["with_effects"] == pytest.approx(content["fit"]["noise_floor_nt"], rel=0.1)


def test_a_clean_recording_has_no_effect(clean: Path, tmp_path: Path) -> None:
    done = diagnose(clean, "--out", tmp_path)
    content = json.loads((tmp_path / "diagnosis.json").read_text(encoding="utf-8"))
    assert (done.code, content["verdict"], content["effects"]) == (0, "none", [])
    assert "agree to the noise" in done.out
    carry_out(done, tmp_path)
    assert (tmp_path / "vectors.csv").is_file()


def carry_out(done: Done, folder: Path) -> None:
    """Run each command that the end of a diagnosis names as the next one; its last lines stand below ``next:``."""
    lines = done.out[done.out.index("\nnext: ") :].strip().removeprefix("next:").splitlines()
    commands = [shlex.split(line)[1:] for line in map(str.strip, lines) if line.startswith("magcal ")]
    assert commands
    for command in commands:
        assert run(*command).code == 0, (command, folder)


def test_a_trusted_cause_is_followed_by_what_to_do_with_it(done: Done, folder: Path) -> None:
    carry_out(done, folder)
    physics = json.dumps(str((folder / "physics.toml").resolve()))
    assert done.out.endswith(f"\n      in flight: physics = {physics} under [[craft]] of the daemon's configuration\n")


def test_the_scenarios_errors_are_what_the_recording_is_compared_with(clean: Path, tmp_path: Path) -> None:
    """With another bias than the recording's own, the simulation's residual is that bias's, and no fit changes."""
    scenario = tmp_path / "off.toml"
    scenario.write_text("[magnetometer]\nbias_nt = [9000, 3000, 4000]\nD = [0.05, 0.10, 0.05, 0.05, 0.05, 0.05]\n")
    diagnose(clean, "--out", tmp_path, "--simulation", scenario)
    rms = json.loads((tmp_path / "diagnosis.json").read_text(encoding="utf-8"))["fit"]["held_out_rms_nt"]
    assert 1000.0 < rms["simulation"] < 4100.0
    assert rms["recalibrated"] == pytest.approx(300.0, rel=0.1)


def test_a_result_that_must_not_be_trusted_ends_with_3_and_says_why(tmp_path: Path) -> None:
    short = recorded("paper", 200.0, tmp_path / "short")
    done = diagnose(short, "--out", tmp_path / "out")
    content = json.loads((tmp_path / "out" / "diagnosis.json").read_text(encoding="utf-8"))
    assert (done.code, content["trusted"]) == (3, False)
    assert "not_enough_data" in content["reasons"]
    assert "next: " not in done.out
    assert done.out.index("  do not act on this:\n") < done.out.index("    not_enough_data: too few samples")


def test_a_hopeless_recording_is_refused_like_calibrate_does(tmp_path: Path) -> None:
    hopeless = recorded("paper", 30.0, tmp_path / "hopeless")
    done = diagnose(hopeless, "--out", tmp_path / "out")
    assert (done.code, done.out) == (2, "")
    assert "at least 50 samples" in done.err.splitlines()[-1]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[magnetometer]\nbias_nt = [1, 2]\n", "magnetometer.bias_nt: [1, 2] is refused"),
        ("[magnetometer]\nD = [-0.9, 0, 0, 0, 0, 0]\n", "magnetometer.D: "),
        ("[orbit]\naltitude_km = 500\n", "magnetometer: missing; "),
        ("[magnetometer]\n[random]\nbias_nt = 5000\n", "random.bias_nt: 5000 is refused"),
        ("no toml", "valid TOML"),
    ],
)
def test_a_scenario_without_nine_errors_is_refused_in_one_line(
    text: str, said: str, clean: Path, tmp_path: Path
) -> None:
    scenario = tmp_path / "scenario.toml"
    scenario.write_text(text)
    done = diagnose(clean, "--out", tmp_path / "out", "--simulation", scenario)
    assert (done.code, done.out, len(done.err.splitlines())) == (2, "", 1)
    assert said in done.err


def test_a_misspelt_scenario_is_refused_with_the_nearest_name(clean: Path, tmp_path: Path) -> None:
    done = diagnose(clean, "--out", tmp_path / "out", "--simulation", "papre")
    assert done.code == 2
    assert "did you mean 'paper'?" in done.err


def test_a_folder_that_cannot_be_made_is_refused_before_the_work(clean: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    done = diagnose(clean, "--out", tmp_path / "file" / "out")
    assert (done.code, done.out, len(done.err.splitlines())) == (2, "", 1)


def test_without_a_folder_the_files_go_to_one_of_that_name(
    clean: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """So that the line which a daemon's status gives, ``magcal diagnose RECORDING``, can be copied."""
    monkeypatch.chdir(tmp_path)
    assert diagnose(clean).code == 0
    names = {path.name for path in (tmp_path / "diagnosis").iterdir()}
    assert names == {"diagnosis.json", "report.html", "physics.toml"}


@pytest.mark.parametrize(("terms", "modelled"), [((), None), ((object(),), None), ((), object())])
def test_what_compensates_nothing_is_no_file_for_the_flight(terms: tuple[object, ...], modelled: object) -> None:
    """A stop and a lattice are notes of ``physics.toml``: the nine errors go on board by a header."""
    named = SimpleNamespace(
        trusted=True, verdict=Verdict.NAMED, fit=SimpleNamespace(terms=terms), modelled=modelled, command=""
    )
    last = Request(Path("log.toml"), Path("out")).onward(named)[-1]  # type: ignore[arg-type]
    in_flight = bool(terms) or modelled is not None
    assert last.startswith("in flight: physics = " if in_flight else "magcal export out/physics.toml")


def test_several_recordings_go_on_with_the_latest() -> None:
    """Whose nine errors the model begins from."""
    request = JointRequest((Path("late.toml"), Path("early.toml")), Path("out"), "one")
    model = SimpleNamespace(terms=(object(),))
    for trusted, terms, lines in ((True, (object(),), 2), (False, (object(),), 0), (True, (), 0)):
        model.terms = terms
        onward = request.onward(SimpleNamespace(trusted=trusted, latest=0), model)  # type: ignore[arg-type]
        assert len(onward) == lines
        if onward:
            assert onward[0] == ("magcal apply late.toml --craft one --with out/physics.toml --out out/vectors.csv")
            assert onward[1].startswith("in flight: physics = ")
