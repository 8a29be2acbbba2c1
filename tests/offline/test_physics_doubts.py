"""Whatever reads a ``physics.toml`` says once why not to act on it, in the words of the diagnosis that wrote it."""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import cache
from pathlib import Path

import pytest

from magcal_service.config.settings import PhysicsConfig
from magcal_service.daemon.pipeline import Pipeline
from magcal_service.diagnosis.summary import reason_lines
from magcal_service.physics.apply.advice import advice, doubts_of
from magcal_service.wire.messages import Estimate, Verdict
from sim_sensor import cli as sim_cli
from sim_sensor.recorder import record_simulation
from sim_sensor.simulation import Simulation
from tests.cli.cli_inputs import Done, run
from tests.physics.live_models import THERMAL, craft, hot, physics, stream

SAID = (
    "do not act on this: name_uncertain: less than 95 % speak for a name: other names, or a cause in no catalogue, "
    "have the rest; make a measurement that tells the names apart: magcal diagnose lists them for each name (next "
    "time, what would tell), and report.html (What to measure next)"
)

READERS = {
    "replay": ("replay", "{recording}", "--config", "{config}"),
    "calibrate": ("calibrate", "{recording}", "--config", "{config}"),
    "plot": ("plot", "{recording}", "--with", "{physics}", "--out", "{folder}/a.svg"),
    "apply": ("apply", "{recording}", "--with", "{physics}", "--out", "{folder}/v.csv"),
    "export": ("export", "{physics}", "--format", "csv", "--out", "{folder}/nine.csv"),
    "run": ("run", "--check", "--config", "{config}"),
}
"""Commands that are given a ``physics.toml``, by name; a daemon's log is in ``test_config_physics.py``."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("doubted")
    scenario = hot()
    record_simulation(Simulation(scenario, 20261130, 400.0), folder)
    sound = physics(*THERMAL, origin_ns=scenario.start_ns).text
    for name, doubts in (("sound", ""), ("doubtful", 'doubts = "name_uncertain"\n')):
        text = sound.replace("[recording]\n", f"[recording]\n{doubts}", 1)
        (folder / f"{name}.toml").write_text(text, encoding="utf-8")
        config = f'version = 1\n[[craft]]\nname = "hot"\nphysics = "{folder / name}.toml"\n'
        (folder / f"{name}-magcal.toml").write_text(config, encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def done(folder: Path) -> Callable[[str, str], Done]:
    """What a reader says of a recording with the doubtful or the sound file; each is asked once."""

    @cache
    def by(reader: str, name: str) -> Done:
        places = {
            "recording": folder / "RECORDING.toml",
            "config": folder / f"{name}-magcal.toml",
            "physics": folder / f"{name}.toml",
            "folder": folder,
        }
        return run(*(part.format(**places) for part in READERS[reader]))

    return by


@pytest.mark.parametrize("reader", READERS)
def test_a_reader_says_each_doubt_once_and_none_of_a_sound_file(reader: str, done: Callable[[str, str], Done]) -> None:
    for name, count in (("doubtful", 1), ("sound", 0)):
        told = done(reader, name)
        assert (told.out + told.err).count(SAID) == count, told


@pytest.mark.parametrize("reader", ["replay", "calibrate", "apply"])
def test_nothing_that_rests_on_a_doubtful_file_is_trusted(reader: str, done: Callable[[str, str], Done]) -> None:
    """One verdict, whoever gives it: apply said doubtful of vectors that a replay trusted."""
    for name, is_doubted in (("doubtful", True), ("sound", False)):
        told = done(reader, name)
        if reader == "apply":
            assert (" vectors, 0 of them trusted" in told.out) is is_doubted
        else:
            assert ("verdict: doubtful (physics_doubtful" in told.out + told.err) is is_doubted, told
            assert ("physics_doubtful" in told.out + told.err) is is_doubted


def test_live_each_message_says_so(folder: Path) -> None:
    """From the first estimate on, until the file is stopped or another is loaded; before it there is none to doubt."""
    texts = {name: (folder / f"{name}.toml").read_text(encoding="utf-8") for name in ("doubtful", "sound")}
    pipeline = Pipeline(craft("hot", PhysicsConfig(folder / "doubtful.toml", texts["doubtful"])))
    estimates = [one for message in stream(hot(), 1800.0) for one in pipeline.handle(message)]
    started = [one for one in estimates if isinstance(one, Estimate) and one.verdict is not Verdict.NOT_STARTED]
    assert len(started) > 1000
    assert {one.verdict for one in started} == {Verdict.DOUBTFUL}
    assert {one.reasons[0] for one in started} == {"physics_doubtful"}
    assert pipeline.trust.reasons[1:] == pipeline.monitor.judge(pipeline.estimator.estimate()).reasons
    pipeline.load_physics(texts["sound"])
    assert "physics_doubtful" not in pipeline.trust.reasons


def test_the_json_of_a_calibration_has_them(folder: Path) -> None:
    """As that of a diagnosis has its advice: a program that reads it alone is told."""
    for name, said in (("doubtful", [SAID]), ("sound", [])):
        out = folder / "calibration.json"
        run("calibrate", folder / "RECORDING.toml", "--config", folder / f"{name}-magcal.toml", "--json", out)
        assert json.loads(out.read_text(encoding="utf-8"))["physics_doubts"] == said


def test_the_simulator_says_them_too(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = str(folder / "again")
    arguments = ("record", "--scenario", "hot-electronics", "--duration", "60", "--quiet", "--out", out)
    for name, count in (("doubtful", 1), ("sound", 0)):
        sim_cli.main([*arguments, "--physics", str(folder / f"{name}.toml")])
        assert capsys.readouterr().err.count(f"{name}.toml: {SAID}") == count


def test_an_exported_file_says_them(folder: Path) -> None:
    run("export", folder / "doubtful.toml", "--format", "csv", "--out", folder / "nine.csv")
    assert SAID.replace("do not act on this", "DO NOT FLY THIS") in (folder / "nine.csv").read_text(encoding="utf-8")


def test_a_figure_of_a_diagnosis_is_doubted_as_it_is(folder: Path) -> None:
    fit = {"noise_floor_nt": 1.0, "held_out_rms_nt": {"recalibrated": 2.0, "with_effects": 1.0}}
    for reasons, count in ((["name_uncertain"], 1), ([], 0)):
        path = folder / "diagnosis.json"
        path.write_text(str({"fit": fit, "effects": [], "reasons": reasons}).replace("'", '"'), encoding="utf-8")
        done = run("plot", path, "--out", folder / "b.svg")
        assert done.out.count(f"diagnosis.json: {SAID}") == count


def test_they_are_the_words_of_the_diagnosis() -> None:
    """Apart from which effects a reason is about, which no ``physics.toml`` says."""
    reasons = ("name_uncertain", "size_uncertain")
    _, *said = reason_lines(advice(reasons, {}))
    told = " ".join(" ".join(said).split())
    assert [one.removeprefix("do not act on this: ") in told for one in doubts_of(", ".join(reasons))] == [True, True]


def test_a_doubtful_recording_comes_first_and_the_rest_by_name() -> None:
    first, rest = doubts_of("recording_doubtful, name_uncertain, poor_coverage")
    assert first.startswith("do not act on this: recording_doubtful: what was found on the recording itself")
    assert rest == "do not act on this: name_uncertain, poor_coverage: may follow from that"
    assert doubts_of("") == []
    assert doubts_of("of_tomorrow") == ["do not act on this: of_tomorrow: of tomorrow"]
