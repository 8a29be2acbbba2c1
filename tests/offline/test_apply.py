"""``apply``: the vectors of a file are those that the daemon publishes with the same estimate, to the last bit."""

from __future__ import annotations

import csv
import json
import re
from dataclasses import replace
from pathlib import Path

import jsonschema
import numpy as np
import pytest

from magcal_service.base.errors import InputRefusedError
from magcal_service.daemon.pipeline import Pipeline
from magcal_service.estimators.interface import Phase
from magcal_service.model import Array
from magcal_service.offline.apply import _noise, apply, residual_rms
from magcal_service.offline.calibrate import calibrate
from magcal_service.offline.given import read_given
from magcal_service.offline.replay import craft_of
from magcal_service.offline.result_head import CALIBRATION, schema
from magcal_service.physics.apply.model_file import Note, text_of
from magcal_service.recordings.inspect.inspection import inspect
from magcal_service.recordings.messages import messages
from magcal_service.recordings.reader import read_recording
from magcal_service.recordings.recording import Recording
from magcal_service.wire.messages import CalibratedVector
from sim_sensor.recorder import record_simulation
from sim_sensor.scenario_reader import load_scenario
from sim_sensor.simulation import Simulation
from tests.cli.cli_inputs import run
from tests.physics.live_models import HOT_X, THERMAL, hot, model_of


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The paper's craft, 1500 s."""
    return record_simulation(Simulation(load_scenario("paper"), 31, 1500.0), tmp_path_factory.mktemp("flight"))


@pytest.fixture(scope="module")
def result(flight: Path) -> Path:
    """Its calibration, as the command writes it."""
    path = flight.with_name("result.json")
    path.write_text(calibrate(flight).as_json())
    return path


def vectors_nt(vectors: tuple[CalibratedVector, ...]) -> Array:
    return np.array([one.field_body_nt for one in vectors]).reshape(-1, 3)


def live(
    recording: Recording, pipeline: Pipeline, x: Array, covariance: Array, noise_nt: float
) -> list[CalibratedVector]:
    """What a daemon publishes while its estimate stands still."""
    pipeline.frozen = True
    pipeline._state = replace(pipeline._state, x=x, covariance=covariance, noise_nt=noise_nt, phase=Phase.RUNNING)
    return [
        one for message in messages(recording) for one in pipeline.handle(message) if isinstance(one, CalibratedVector)
    ]


def test_it_gives_the_vectors_that_the_daemon_would(flight: Path, result: Path) -> None:
    given, recording = read_given(result), read_recording(flight)
    applied = apply(given, inspect(recording)).vectors
    published = live(recording, Pipeline(craft_of(recording)), given.x, given.covariance, 300.0)
    assert len(applied) == len(recording) == 1500
    assert [one.field_body_nt for one in applied] == [one.field_body_nt for one in published]
    assert [one.covariance_nt2 for one in applied] == [one.covariance_nt2 for one in published]
    truth = calibrate(flight)
    jsonschema.validate(json.loads(result.read_text()), schema(CALIBRATION))
    np.testing.assert_array_equal(given.x, truth.x)  # nothing is lost in the file
    np.testing.assert_array_equal(given.covariance, truth.covariance)
    np.testing.assert_allclose(vectors_nt(applied), truth.apply(recording.field_body_nt), rtol=0.0, atol=1e-8)


def test_effects_are_subtracted_as_they_are_live(tmp_path: Path) -> None:
    scenario = hot()
    recording = read_recording(record_simulation(Simulation(scenario, 4, 600.0), tmp_path))
    model = model_of(*THERMAL, origin_ns=scenario.start_ns)
    path = tmp_path / "physics.toml"
    path.write_text(text_of(model))
    given = read_given(path)
    applied = apply(given, inspect(recording))
    craft = replace(craft_of(recording), physics=_config(path))
    published = live(recording, Pipeline(craft), given.x, given.covariance, craft.sensor.noise_nt or 0.0)
    assert [one.field_body_nt for one in applied.vectors] == [one.field_body_nt for one in published]
    plain = np.linalg.norm(given.apply(recording.field_body_nt), axis=1) - recording.reference.magnitude_nt
    left = np.linalg.norm(vectors_nt(applied.vectors), axis=1) - recording.reference.magnitude_nt
    assert np.sqrt(np.mean(left**2)) < 1.1 * (craft.sensor.noise_nt or 0.0) < np.sqrt(np.mean(plain**2))
    raw = np.linalg.norm(recording.field_body_nt, axis=1) - recording.reference.magnitude_nt
    rms = [float(np.sqrt(np.mean(off**2))) for off in (raw, left)]
    assert residual_rms(given, inspect(recording), applied) == pytest.approx(rms)
    done = run("apply", recording.descriptor.path, "--with", path, "--out", tmp_path / "v.csv")
    assert f"residual rms: {rms[0]:.1f} nT before, {rms[1]:.1f} nT after\n" in done.out
    for effect in ("thermal_bias", "thermal_scale"):
        assert f"physics.toml: {effect} (channel:temperature): compensated in 600 of 600 samples\n" in done.out
    np.testing.assert_array_equal(given.x, HOT_X)
    blind = apply(given, inspect(replace(recording, channels={})))
    assert [(one.effect, dict(one.samples), one.why) for one in blind.accounts] == [
        (effect, {"no_driver": 600}, "not in 600: the recording has no channel temperature")
        for effect in ("thermal_bias", "thermal_scale")
    ]
    assert blind.partly == 600
    assert {str(one.verdict) for one in blind.vectors} == {"doubtful"}


@pytest.mark.parametrize(("level_nt", "trusted"), [(100.0, 600), (30.0, 0)])
def test_noise_with_a_memory_counts_with_its_whole_level(level_nt: float, trusted: int, tmp_path: Path) -> None:
    """Of noise with a memory ``noise_nt`` is the white part: vectors were doubtful on the recording they come from."""
    scenario = hot()
    path = record_simulation(Simulation(scenario, 4, 600.0), tmp_path)
    path.write_text(re.sub("noise_nt = .*", "", path.read_text()))
    note = Note("coloured_noise", "The noise has a memory.", {"level_nt": np.array(level_nt)})
    model = model_of(*THERMAL, origin_ns=scenario.start_ns, noise_nt=30.0, notes=(note,))
    given_path = tmp_path / "physics.toml"
    given_path.write_text(text_of(model))
    given = read_given(given_path)
    assert given.noise_nt == level_nt
    assert apply(given, inspect(read_recording(path))).trusted == trusted


@pytest.mark.parametrize(
    ("stated_nt", "added_nt", "noise_nt", "trusted"),
    [(30.0, 80.0, 85.4, 600), (30.0, 10.0, 31.6, 0), (30.0, 1e4, 97.0, 600), (100.0, 95.0, 100.0, 600)],
)
def test_noise_that_a_lattice_adds_counts_beside_the_stated_one(
    stated_nt: float, added_nt: float, noise_nt: float, trusted: int, tmp_path: Path
) -> None:
    """As a note has it, but no more than the residual shows, 97 nT: the lattice may be in what is stated."""
    scenario = hot()
    path = record_simulation(Simulation(scenario, 4, 600.0), tmp_path)
    path.write_text(re.sub("noise_nt = .*", f"noise_nt = {stated_nt}", path.read_text()))
    note = Note("quantisation", "Values lie on a lattice.", {"added_noise_nt": np.array(added_nt)})
    given_path = tmp_path / "physics.toml"
    given_path.write_text(text_of(model_of(*THERMAL, origin_ns=scenario.start_ns, noise_nt=stated_nt, notes=(note,))))
    recording = read_recording(path)
    given = read_given(given_path)
    assert apply(given, inspect(recording)).trusted == trusted
    assert _noise(given, recording) == pytest.approx(noise_nt, rel=0.01)


def _config(path: Path):  # type: ignore[no-untyped-def]
    from magcal_service.config.physics_file import physics_of

    return physics_of(path)


@pytest.mark.parametrize("suffix", [".csv", ".parquet", ".mcap"])
def test_every_format_holds_the_same(flight: Path, result: Path, suffix: str, tmp_path: Path) -> None:
    out = tmp_path / f"vectors{suffix}"
    done = run("apply", flight, "--with", result, "--out", out)
    given = read_given(result)
    assert done.code == (0 if given.trusted else 3), done
    assert "compensated" not in done.out
    expected = apply(given, inspect(read_recording(flight))).vectors
    if suffix == ".mcap":
        assert "1500 records" in run("record", "info", out).out
        found = [one for _, one in _vectors(out)]
        assert found == list(expected)
        return
    if suffix == ".csv":
        with out.open(newline="") as file:
            rows = list(csv.DictReader(file))
    else:
        parquet = pytest.importorskip("pyarrow.parquet")
        rows = parquet.read_table(out).to_pylist()
    assert list(rows[0])[:5] == ["time", "wx_nt", "wy_nt", "wz_nt", "cov_xx_nt2"]
    found = [tuple(float(row[f"w{axis}_nt"]) for axis in "xyz") for row in rows]
    assert found == [one.field_body_nt for one in expected]
    assert [str(row["verdict"]) for row in rows] == [str(one.verdict) for one in expected]
    assert str(rows[7]["time"]).endswith("Z")


def _vectors(path: Path):  # type: ignore[no-untyped-def]
    from magcal_service.recordings.mcap_reader import McapReader
    from magcal_service.recordings.session import decoded

    with path.open("rb") as file:
        yield from decoded(McapReader(file, str(path)), {}, frozenset({"calibrated"}))


def test_a_vector_that_is_not_as_long_as_the_field_is_doubtful(flight: Path, result: Path) -> None:
    recording = read_recording(flight)
    field = recording.field_body_nt.copy()
    field[700] *= 1.5
    content = {**json.loads(result.read_text()), "trusted": True, "verdict": "trusted", "reasons": []}
    path = result.with_name("trusted.json")
    path.write_text(json.dumps(content))
    applied = apply(read_given(path), inspect(replace(recording, field_body_nt=field)))
    assert applied.strayed == 1
    assert [i for i, one in enumerate(applied.vectors) if one.verdict != "trusted"] == [700]


def test_what_is_not_to_be_trusted_ends_with_3_and_says_why(flight: Path, result: Path, tmp_path: Path) -> None:
    content = {**json.loads(result.read_text()), "trusted": False, "reasons": ["poor_coverage"]}
    path = tmp_path / "result.json"
    path.write_text(json.dumps(content))
    done = run("apply", flight, "--with", path, "--out", tmp_path / "v.csv")
    assert done.code == 3
    assert done.out.endswith("not to be trusted: poor_coverage\n")
    assert ",trusted," not in (tmp_path / "v.csv").read_text()


def test_a_result_of_another_magnetometer_is_not_trusted_on_it(flight: Path, result: Path, tmp_path: Path) -> None:
    """A bias 700 nT off moves every length by less than the noise's 6 sigma, and all of them together by far more."""
    content = {**json.loads(result.read_text()), "trusted": True, "verdict": "trusted", "reasons": []}
    path = tmp_path / "result.json"
    for off_nt, code in ((0.0, 0), (1500.0, 3)):
        bias = [content["bias_nt"][0] + off_nt, *content["bias_nt"][1:]]
        path.write_text(json.dumps({**content, "bias_nt": bias}))
        done = run("apply", flight, "--with", path, "--out", tmp_path / "v.csv")
        assert done.code == code, done
        assert (",trusted," in (tmp_path / "v.csv").read_text()) == (code == 0)
    assert "result.json does not fit this recording: beside 300.0 nT of noise" in done.out


@pytest.mark.parametrize(
    "changes",
    [
        {"protection_nt": float("nan")},
        {"protection_nt": 1e9},
        {"protection_nt": 10**400},
        {"residual_rms_nt": {"noise_floor": float("nan")}},
        {"residual_rms_nt": {"noise_floor": -5.0}},
        {"bias_nt": [10**400, 0, 0]},
        {"bias_nt": ["1", "2", "3"]},
        {"reasons": 5},
        {"covariance": (-np.eye(9)).tolist()},
        {"covariance": np.triu(np.ones((9, 9))).tolist()},
        {"schema": "foo-99"},
        {"equation": "w = B - b"},
        {"units": {"B": "uT"}},
    ],
    ids=str,
)
def test_numbers_that_no_estimate_has_are_refused(result: Path, changes: dict[str, object], tmp_path: Path) -> None:
    path = tmp_path / "result.json"
    path.write_text(json.dumps({**json.loads(result.read_text()), **changes}))
    with pytest.raises(InputRefusedError, match=f"result.json: {next(iter(changes)).split('_rms')[0][:8]}|noise_floor"):
        read_given(path)


@pytest.mark.parametrize("changes", [{"verdict": "doubtful"}, {"reasons": ["poor_coverage"]}, {"trusted": 1}])
def test_a_result_that_contradicts_itself_is_not_trusted(
    result: Path, changes: dict[str, object], tmp_path: Path
) -> None:
    content = {**json.loads(result.read_text()), "trusted": True, "verdict": "trusted", "reasons": []}
    path = tmp_path / "result.json"
    path.write_text(json.dumps(content))
    assert read_given(path).trusted
    path.write_text(json.dumps({**content, **changes}))
    assert not read_given(path).trusted


def test_what_is_read_is_not_written_over(flight: Path, result: Path) -> None:
    """The result, the descriptor, and the log that it names."""
    log = flight.with_name("samples.csv")
    before = [path.read_bytes() for path in (flight, result, log)]
    for out in (log, flight.with_name("samples.csv").resolve()):
        done = run("apply", flight, "--with", result, "--out", out)
        assert (done.code, "'the input itself' is refused" in done.err) == (2, True), done
    assert run("calibrate", flight, "--json", flight).code == 2
    assert run("inspect", flight, "--json", log).code == 2
    assert run("describe", log, "--out", log).code == 2
    assert run("export", result, "--format", "csv", "--out", result).code == 2
    assert [path.read_bytes() for path in (flight, result, log)] == before


@pytest.mark.parametrize(
    ("content", "told"),
    [
        ("[1]", "this JSON is a list, and no result; what calibrate --json"),
        ("12", "this JSON is a number"),
        ("{", "this JSON breaks off in line 1"),
        ('{"a":\n 1, 2}', "this is no JSON from line 2, column 5 on (Expecting property name"),
        ("[" * 100_000, "this JSON is nested too deeply"),
        (" \n", "this file is empty"),
        ("<!DOCTYPE html>", "this is a page of HTML or XML"),
        ("t,mx,my,mz\n0,1,2,3", "this is no JSON; what calibrate --json"),
        ("{}", "this JSON is no result: it is empty"),
        ('{"a": 1, "b": 2, "c": 3, "d": 4, "e": 5, "f": 6, "g": 7}', "it has a, b, c, d, e, f and 1 more"),
        ('{"usable": true, "findings": []}', "these are findings of magcal inspect"),
        ('{"bias_nt": [0, 0, 0], "D": [0, 0, 0], "seed": 1}', "this is the truth of a simulation"),
        ('{"D": [[1]]}', "bias_nt: missing; numbers of shape (3,)"),
        ('{"verdict": "not_started"}', "a result with an estimate is accepted"),
        ('{"recordings": []}', "the result of one recording is accepted"),
        ('{"effects": [{}], "fit": {}}', "give that file"),
        ('{"bias_nt": [0, 0, NaN], "D": [[0,0,0],[0,0,0],[0,0,0]]}', "bias_nt: '[0, 0, nan]' is refused"),
    ],
)
def test_what_is_no_result_is_refused(content: str, told: str, tmp_path: Path) -> None:
    path = tmp_path / "result.json"
    path.write_text(content)
    with pytest.raises(InputRefusedError) as caught:
        read_given(path)
    assert told in str(caught.value)


@pytest.mark.parametrize(
    ("d", "told"),
    [([[0, 0.1, 0], [0, 0, 0], [0, 0, 0]], "a symmetric matrix"), ([[-2, 0, 0], [0, 0, 0], [0, 0, 0]], "eigenvalues")],
)
def test_a_matrix_that_is_none_is_refused(result: Path, d: list[list[float]], told: str, tmp_path: Path) -> None:
    path = tmp_path / "result.json"
    path.write_text(json.dumps({**json.loads(result.read_text()), "D": d}))
    with pytest.raises(InputRefusedError, match=told):
        read_given(path)


@pytest.mark.parametrize("name", ["RECORDING.toml", "magcal.toml"])
def test_a_toml_of_another_kind_is_told_what_may_stand_in_its_place(name: str, tmp_path: Path) -> None:
    """It was told of physics.toml alone."""
    path = tmp_path / name
    path.write_text("[samples]" if name == "RECORDING.toml" else "[[craft]]")
    with pytest.raises(
        InputRefusedError, match=r"is refused; a model of physics is accepted, .* so is the .json that calibrate"
    ):
        read_given(path)


def test_another_end_of_the_name_is_refused_before_anything_is_read(tmp_path: Path) -> None:
    done = run("apply", tmp_path / "no.toml", "--with", "no.json", "--out", tmp_path / "v.txt")
    assert (done.code, done.err.count("\n")) == (2, 1)
    assert "a name ending in .csv, .parquet, .mcap is accepted" in done.err


def test_a_result_of_another_craft_is_refused_wherever_it_is_used(flight: Path, result: Path, tmp_path: Path) -> None:
    """Its errors may be near enough to pass for sound: a bias 370 nT off was, at 300 nT of noise."""
    model = tmp_path / "physics.toml"
    model.write_text(text_of(replace(model_of(*THERMAL, origin_ns=0), craft="paper")))
    stranger = flight.with_name("stranger.toml")
    stranger.write_text(flight.read_text().replace('craft = "paper"', 'craft = "other"'))
    for given in (result, model):
        said = run("apply", stranger, "--with", given, "--out", tmp_path / "v.csv")
        assert said.code == 2
        assert "craft: 'paper' is refused; a result of craft other is accepted" in said.out + said.err
    for words in (("calibrate", stranger, "--prior", result), ("plot", stranger, "--with", result, "--out", "v.png")):
        said = run(*words)
        assert "a result of craft other is accepted" in said.out + said.err
    nameless = flight.with_name("nameless.toml")
    nameless.write_text(flight.read_text().replace('craft = "paper"\n', ""))
    assert run("apply", nameless, "--with", result, "--out", tmp_path / "v.csv").code in (0, 3)
