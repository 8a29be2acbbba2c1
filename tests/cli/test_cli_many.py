"""``magcal calibrate`` and ``diagnose --separately`` of several recordings, and ``study`` with ``--resume``."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from magcal_service.base.errors import InputRefusedError
from magcal_service.offline.each import Asked, folders_of
from magcal_service.offline.result_files import SUMMARY
from sim_sensor.recorder import record_simulation
from sim_sensor.scenario_reader import load_scenario
from sim_sensor.simulation import Simulation
from tests.cli.cli_inputs import run


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """One that is trusted, one that is too short, and a descriptor that is none."""
    folder = tmp_path_factory.mktemp("recordings")
    made = [
        record_simulation(Simulation(load_scenario("paper"), 4, seconds), folder / name)
        for name, seconds in (("good", 1400.0), ("short", 100.0))
    ]
    broken = folder / "broken" / made[0].name
    broken.parent.mkdir()
    broken.write_text("version = 1\n", encoding="utf-8")
    return [*made, broken]


def files_of(folder: Path) -> dict[str, bytes]:
    """Contents of everything but what is kept for a resume, by place."""
    paths = [path for path in folder.rglob("*") if path.is_file() and path.parent.name != "pieces"]
    return {str(path.relative_to(folder)): path.read_bytes() for path in paths}


def test_each_recording_has_its_result_and_the_worst_is_the_exit_code(recordings: list[Path], tmp_path: Path) -> None:
    out = tmp_path / "out"
    done = run("calibrate", *recordings, "--out", out, "--workers", 2)
    assert done.code == 2
    assert done.out.splitlines()[-1] == "3 recordings: 1 trusted, 1 not to be trusted, 1 refused"
    assert done.out.splitlines()[0].split() == ["exit", "folder", "verdict", "what", "was", "found"]
    assert [line.split()[:3] for line in done.out.splitlines()[1:4]] == [
        ["0", "good", "trusted"],
        ["3", "short", "not_started"],
        ["2", "broken", "refused"],
    ]
    faults = done.err.splitlines()
    assert len(faults) > 1
    assert all(line.startswith(f"{recordings[2]}: RECORDING.toml: ") for line in faults)
    summary = json.loads((out / SUMMARY).read_text(encoding="utf-8"))
    assert [row["exit"] for row in summary["recordings"]] == [0, 3, 2]
    assert summary["exit"] == 2
    assert [f"{recordings[2]}: {line}" for line in summary["recordings"][2]["faults"]] == faults
    assert summary["recordings"][2]["says"] == summary["recordings"][2]["faults"][0]
    run("calibrate", recordings[0], "--json", tmp_path / "alone.json")
    alone = json.loads((tmp_path / "alone.json").read_text(encoding="utf-8"))
    assert json.loads((out / "good" / "calibration.json").read_text(encoding="utf-8")) == alone


def test_a_resume_does_nothing_again_and_writes_the_same(recordings: list[Path], tmp_path: Path) -> None:
    """Files that were lost are written again from what was kept; a piece that is gone is done again."""
    out = tmp_path / "out"
    first = run("calibrate", *recordings[:2], "--out", out, "--workers", 1)
    written = files_of(out)
    kept = {path: path.stat().st_mtime_ns for path in (out / "pieces").iterdir()}
    shutil.rmtree(out / "good")
    lost = min(kept)
    lost.unlink()
    assert run("calibrate", *recordings[:2], "--out", out, "--workers", 1, "--resume") == first
    assert files_of(out) == written
    again = {path: path.stat().st_mtime_ns for path in (out / "pieces").iterdir()}
    assert again.keys() == kept.keys()
    assert {path for path in kept if again[path] != kept[path]} == {lost}


def test_a_diagnosis_of_each_has_its_files_and_they_are_the_same_for_any_workers(
    recordings: list[Path], tmp_path: Path
) -> None:
    given = [recordings[0], recordings[2]]
    for workers in (1, 2):
        done = run("diagnose", *given, "--separately", "--out", tmp_path / str(workers), "--workers", workers)
        assert done.code == 2
    found = [files_of(tmp_path / str(workers)) for workers in (1, 2)]
    seconds = [json.loads(files.pop(SUMMARY))["recordings"][0].pop("seconds") for files in found]
    assert min(seconds) > 0.0
    assert found[0] == found[1]
    assert set(found[0]) == {"good/diagnosis.json", "good/report.html", "good/physics.toml"}


def test_results_of_an_earlier_run_are_removed_and_said_to_be(recordings: list[Path], tmp_path: Path) -> None:
    """A recording that is refused now, and one that is not asked for any more, have no result."""
    out = tmp_path / "out"
    run("calibrate", *recordings[:2], "--out", out, "--workers", 1)
    (out / "good" / "notes.txt").write_text("mine")
    recordings[1].write_text("version = 1\n", encoding="utf-8")
    done = run("calibrate", recordings[1], "--out", out, "--workers", 1)
    stale = "good/calibration.json, short/calibration.json"
    assert done.out.splitlines()[-1] == f"removed from {out}, of an earlier run: {stale}"
    assert set(files_of(out)) == {"good/notes.txt", SUMMARY}


@pytest.mark.parametrize(
    ("arguments", "fault"),
    [
        (["calibrate", "A", "A"], "number of recordings: 2 is refused; .* --out DIR"),
        (["calibrate", "A", "--workers", "2"], "--workers: 2 is refused; .* --out DIR"),
        (["calibrate", "A", "--resume"], "--resume: True is refused; .* --out DIR"),
        (["calibrate", "A", "--out", "DIR", "--json", "x.json"], "--json: 'x.json' is refused; .*leave --json out"),
        (
            ["calibrate", "A", "--out", "D", "--executor", "dusk://h:1"],
            "--executor: 'dusk://h:1' is refused; pool .*",
        ),
        (["calibrate", "A", "A", "--out", "DIR"], "recordings: '.*A' is refused; it is named 2 times; name it once"),
        (["diagnose", "A", "--out", "DIR", "--executor", "pool"], "--executor: 'pool' is refused; .* --separately"),
        (["study", "noise", "--resume"], "--resume: 'no --out' is refused; .*name that folder"),
    ],
)
def test_what_makes_no_sense_is_refused_in_a_line(
    arguments: list[str], fault: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import re

    monkeypatch.chdir(tmp_path)
    done = run(*arguments)
    assert done.code == 2
    assert re.fullmatch(fault + "\n", done.err)


def test_a_study_keeps_its_pieces_beside_its_results_and_goes_on_from_them(tmp_path: Path) -> None:
    command = ["study", "convergence", "--runs", "2", "--duration-s", "300", "--out", tmp_path, "--workers", "2"]
    first = run(*command)
    assert first.code == 0
    results = json.loads((tmp_path / "convergence.json").read_text(encoding="utf-8"))
    kept = {path: path.stat().st_mtime_ns for path in (tmp_path / "pieces").iterdir()}
    assert len(kept) == 2
    assert run(*command, "--resume").code == 0
    assert {path: path.stat().st_mtime_ns for path in (tmp_path / "pieces").iterdir()} == kept
    again = json.loads((tmp_path / "convergence.json").read_text(encoding="utf-8"))
    assert {**again, "seconds": 0} == {**results, "seconds": 0}


@pytest.mark.parametrize(
    ("paths", "folders"),
    [
        (["x/a.toml", "y/b.toml"], ["a", "b"]),
        (["x/recording.toml", "y/recording.toml"], ["x", "y"]),
        (["x/1/recording.toml", "x/2/recording.toml"], ["1", "2"]),
        (["recording.toml", "y/recording.toml"], ["recording", "y/recording"]),
        (["x/a.toml", "y/a.toml", "y/b.toml"], ["x/a", "y/a", "y/b"]),
        (["x/a.toml", "x/a.mcap"], ["a.toml", "a.mcap"]),
    ],
)
def test_folders_are_short_and_no_two_the_same(paths: list[str], folders: list[str]) -> None:
    assert folders_of([Path(path) for path in paths]) == folders


def test_a_recording_that_is_named_twice_is_refused() -> None:
    with pytest.raises(InputRefusedError, match="named 2 times"):
        folders_of([Path("a.toml"), Path.cwd() / "a.toml"])


@pytest.mark.parametrize(
    ("codes", "worst"), [([0, 0], 0), ([0, 3], 3), ([3, 2, 0], 2), ([0, 3, 2, 1], 1), ([1, 2], 1), ([], 0)]
)
def test_the_worst_of_the_exit_codes_is_that_of_all(codes: list[int], worst: int) -> None:
    assert Asked(tuple({"exit": code} for code in codes), ()).exit_code == worst
