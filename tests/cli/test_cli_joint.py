"""``magcal diagnose`` of several recordings of one craft: files, exit codes, and what is refused."""

from __future__ import annotations

import json
from pathlib import Path

import jsonschema
import numpy as np
import pytest

from magcal_service.cli.__main__ import main
from magcal_service.offline.result_head import JOINT, schema
from magcal_service.physics.apply.model_file import read_model
from magcal_service.physics.catalogue import effect_named
from tests.diagnosis.joint_days import day
from tests.recordings.recording_logs import described

PER_K = np.array([12.0, -8.0, 15.0])


def _written(number: int, folder: Path) -> Path:
    recording = day(number, PER_K, np.zeros(3)).recording
    table = np.column_stack(
        [
            recording.time_ns * 1e-9,
            recording.field_body_nt,
            recording.reference.magnitude_nt,
            recording.channels["board"].values,
        ]
    )
    np.savetxt(folder / f"day{number}.csv", table, "%.4f", ",", header="t,x,y,z,h,T", comments="")
    path = folder / f"day{number}.toml"
    form, field = 'format = "unix_s"', ("x", "y", "z")
    text = described(f"day{number}.csv", time=form, field=field, noise_nt=50.0, reference="h", channels={"board": "T"})
    path.write_text(text, encoding="utf-8")
    return path


@pytest.fixture
def days(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Two days' descriptors; the catalogue is one effect, for speed."""
    effects = (effect_named("thermal_bias"),)
    monkeypatch.setattr("magcal_service.diagnosis.joint.diagnose.catalogue", lambda: effects)
    return [str(_written(number, tmp_path)) for number in range(2)]


def test_two_days_give_three_files_and_end_with_0(
    days: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert main(["diagnose", *days, "--out", str(out)]) == 0
    content = json.loads((out / "diagnosis.json").read_text())
    assert [one["name"] for one in content["recordings"]] == ["day0", "day1"]
    assert [one["effect"] for one in content["effects"]] == ["thermal_bias"]
    jsonschema.validate(content, schema(JOINT))
    told = [one["held_out_rms_nt"]["predicted"] for one in content["predicted_from_the_others"]]
    assert [one["predicted_from_others_rms_nt"] for one in content["recordings"]] == told
    (effect,) = content["effects"]
    assert effect["shared"]
    assert effect["where"]["share_of_mismatch"] == pytest.approx(1.0 - content["unexplained_share"], abs=1e-3)
    assert read_model(out / "physics.toml").terms[0].amplitudes["nt_per_k"] == pytest.approx(PER_K, abs=1.5)
    page = (out / "report.html").read_text()
    assert "day0.csv" in page
    assert f"magcal diagnose {days[0]} {days[1]} --out {out}" in page
    told = capsys.readouterr()
    onward = [
        f"next: magcal apply {days[1]} --with {out / 'physics.toml'} --out {out / 'vectors.csv'}",
        f'      in flight: physics = "{out / "physics.toml"}" under [[craft]] of the daemon\'s configuration',
    ]
    assert told.out.splitlines()[-2:] == onward
    assert "have in common a bias that follows the sensor" in told.out
    assert "thermal_bias nt_per_k: shared" in told.out
    assert "day1: rows: 1000 of 1000 rows used\n" in told.out
    assert content["recordings"][1]["rows"]["used"] == 1000
    assert "warning: nothing says that day0, day1 are of one craft" in told.err
    assert content["assumed"] in told.err
    assert "nothing says that day0, day1 are of one craft" in page


def test_results_of_another_kind_of_run_are_removed_and_a_refused_run_keeps_them(
    days: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    (out / "day0").mkdir(parents=True)
    summary = {"question": "diagnose", "recordings": [{"folder": "day0"}]}
    (out / "summary.json").write_text(json.dumps(summary), encoding="utf-8")
    (out / "day0" / "report.html").write_text("old", encoding="utf-8")
    (out / "notes.html").write_text("mine", encoding="utf-8")
    stale = "day0/report.html, summary.json"
    assert main(["diagnose", *days, "absent.toml", "--out", str(out)]) == 2
    assert f"{out} still has the files of an earlier run: {stale}\n" in capsys.readouterr().err
    assert (out / "summary.json").is_file()
    assert main(["diagnose", *days, "--out", str(out)]) == 0
    assert capsys.readouterr().out.endswith(f"removed from {out}, of an earlier run: {stale}\n")
    left = {str(path.relative_to(out)) for path in out.rglob("*") if path.is_file()}
    assert left == {"diagnosis.json", "report.html", "physics.toml", "notes.html"}


def _name_craft(path: str, craft: str) -> None:
    text = Path(path).read_text(encoding="utf-8")
    Path(path).write_text(text.replace("[time]", f'craft = "{craft}"\n[time]'), encoding="utf-8")


def test_days_that_name_their_craft_need_no_warning(
    days: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for path in days:
        _name_craft(path, "alpha")
    assert main(["diagnose", *days, "--out", str(tmp_path / "out")]) == 0
    assert "warning" not in capsys.readouterr().err
    assert json.loads((tmp_path / "out" / "diagnosis.json").read_text())["assumed"] == ""


def test_days_of_different_craft_are_refused_by_name(
    days: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for path, craft in zip(days, ("alpha", "beta"), strict=True):
        _name_craft(path, craft)
    assert main(["diagnose", *days, "--out", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err
    assert said.startswith("craft: 'day0 of alpha, day1 of beta' is refused; recordings of one craft")


@pytest.mark.parametrize(
    ("more", "refused"),
    [
        (["--simulation", "paper"], "--simulation: 'paper' is refused; one recording is compared with a scenario"),
        (["{0}"], "the same samples as"),
        (["absent.toml"], "absent.toml"),
    ],
)
def test_what_is_no_set_of_days_is_refused(
    days: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str], more: list[str], refused: str
) -> None:
    given = [one.format(*days) for one in more]
    assert main(["diagnose", *days, *given, "--out", str(tmp_path / "out")]) == 2
    assert refused in capsys.readouterr().err
