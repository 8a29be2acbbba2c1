"""The study of real recordings, on a folder with two that were made up, and one without its samples beside them."""

from __future__ import annotations

import json
import os
import re
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest

from magcal_service.base.errors import ConfigError
from magcal_service.cli.__main__ import main
from magcal_service.studies import run_study
from magcal_service.studies.real import plan
from magcal_service.studies.real.plan import Known, questions_of
from magcal_service.studies.report import Report
from magcal_service.studies.study import Request
from tests.many.here import HERE
from tests.recordings.recording_logs import described

COUNT, NOISE_NT, PER_K_NT = 400, 50.0, 60.0
DAYS = ("lab/first", "lab/second")
KNOWN = {
    "lab/first": Known(("thermal_bias",), witness="its oven"),
    "lab/second": Known(("bias_step",), witness="told wrongly"),
    "gone/lost": Known(()),
}
PLAN = ((DAYS[:1], ("oven",)), (DAYS, ("bench",)), (("lab/first", "lab/never"), ()))


def write_recording(folder: Path, name: str, seed: int) -> None:
    """A tumbling sensor with a field along x per kelvin of its oven; a thermometer at the bench follows it badly."""
    rng = np.random.default_rng(seed)
    t = 2.0 * np.arange(COUNT)
    direction = np.stack([np.sin(t / 13.0 + seed), np.cos(t / 7.0), np.sin(t / 29.0) + 0.3], axis=1)
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    magnitude = 35_000.0 + 9000.0 * np.sin(t / 310.0 + seed)
    oven = 20.0 + 8.0 * np.sin(t / 97.0 + seed)
    bench = oven + rng.normal(0.0, 1.0, COUNT)
    field = direction * magnitude[:, None] + [3000.0, -2000.0, 1500.0] + rng.normal(0.0, NOISE_NT, (COUNT, 3))
    field[:, 0] += PER_K_NT * (oven - 20.0)
    folder.mkdir(parents=True, exist_ok=True)
    table = np.column_stack([t, field, magnitude, oven, bench])
    np.savetxt(folder / f"{name}.csv", table, fmt="%.3f", delimiter=",", header="t,x,y,z,f,oven,bench", comments="")
    text = described(
        f"{name}.csv",
        time='format = "elapsed_s"',
        field=("x", "y", "z"),
        noise_nt=NOISE_NT,
        reference="f",
        channels={"oven": "oven", "bench": "bench"},
    )
    (folder / f"{name}.toml").write_text(text, encoding="utf-8")


@cache
def report() -> Report:
    """The study, run once for all tests."""
    with TemporaryDirectory(prefix="magcal-reality-") as made, pytest.MonkeyPatch.context() as patched:
        folder = Path(made)
        for number, name in enumerate(DAYS, start=1):
            write_recording((folder / "data" / name).parent, Path(name).name, number)
        write_recording(folder / "cases/gone", "lost", 3)
        (folder / "cases/gone/lost.csv").unlink()
        patched.setattr(plan, "KNOWN", KNOWN)
        patched.setattr(plan, "PLAN", PLAN)
        return run_study("reality", Request(None, 1, HERE, recordings=(folder / "data",)))


def rows(number: int) -> list[dict[str, Any]]:
    """A table of the study by its columns."""
    table = report().findings.tables[number]
    return [dict(zip(table.columns, row, strict=True)) for row in table.rows]


def test_each_recording_is_asked_as_it_is_and_then_as_planned() -> None:
    assert [(row["recording"], row["hidden"]) for row in rows(0)] == [
        ("lab/first", None),
        ("lab/second", None),
        ("cases/gone/lost", None),
        ("lab/first", "oven"),
        ("lab/first + second", "bench"),
    ]


def test_what_is_hidden_drives_nothing_and_what_is_left_does() -> None:
    drivers = [re.findall(r"channel:(\w+)", str(row["effects (driver, probability)"])) for row in rows(0)]
    assert drivers == [["oven"], ["oven"], [], ["bench"], ["oven"]]


def test_a_trusted_name_that_is_not_the_known_cause_is_false() -> None:
    first, second, *_ = rows(0)
    assert (first["verdict"], first["trusted, or the doubts"], first["false name"]) == ("named", "trusted", "no")
    assert (second["known cause"], second["witness"], second["false name"]) == (
        "bias_step",
        "told wrongly",
        "thermal_bias",
    )
    assert report().findings.figures["false names with exit 0"] == 1


def test_what_is_left_by_the_effects_is_the_noise() -> None:
    first = rows(0)[0]
    assert first["with effects [nT]"] == pytest.approx(NOISE_NT, rel=0.15)
    assert first["recalibrated [nT]"] > 3.0 * NOISE_NT


def test_a_refused_recording_is_a_row_with_the_refusal_and_without_its_place() -> None:
    lost = rows(0)[2]
    assert re.fullmatch(r"refused: lost\.csv: there is no such file or folder; .*", lost["verdict"])
    assert [lost["false name"], lost["processor [s]"]] == ["no", None]
    assert report().findings.figures["no diagnosis"] == 1


def test_recordings_together_share_the_number_and_predict_each_other() -> None:
    (number,) = [row for row in rows(1) if row["number"] == "nt_per_k"]
    low, high = map(float, str(number["value"]).split(" to "))
    assert high == pytest.approx(PER_K_NT, abs=3.0)
    assert abs(low) < 3.0
    assert str(number["shared?"]).startswith("shared")
    assert [row["recording"] for row in rows(2)] == ["first", "second"]
    assert all(row["kept of its gain [%]"] > 95.0 for row in rows(2))


def test_the_report_has_neither_runs_nor_seed() -> None:
    content = json.loads(report().as_json())
    assert [content["runs"], content["seed"]] == [None, None]
    assert re.fullmatch(r"magcal study reality --recordings \S+data", content["command"])


def test_a_folder_that_is_not_there_is_refused_with_what_is_accepted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["study", "reality", "--recordings", str(tmp_path / "nowhere")]) == 2
    said = re.escape(f"--recordings: {str(tmp_path / 'nowhere')!r} is refused; a folder with descriptors of recordings")
    assert re.fullmatch(rf"{said} \(\*\.toml.*name yours\n", capsys.readouterr().err)


def test_without_a_folder_the_one_beside_the_checkout_is_looked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "checkout").mkdir()
    monkeypatch.chdir(tmp_path / "checkout")
    with pytest.raises(ConfigError, match=re.escape(f"{os.path.join('..', 'shared', 'data')!r} is refused")):
        questions_of(())
    write_recording(tmp_path / "shared/data", "one", 1)
    write_recording(tmp_path / "shared/cases", "two", 2)
    assert [question.name for question in questions_of(())] == ["one", "cases/two"]


def test_a_folder_without_descriptors_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"a folder with descriptors \(\*\.toml\) is accepted; write one"):
        questions_of((tmp_path,))


def test_beside_two_folders_nothing_is_taken_along(tmp_path: Path) -> None:
    for name in ("data", "more", "cases"):
        write_recording(tmp_path / name, "one", 1)
    assert [one.name for one in questions_of((tmp_path / "data", tmp_path / "more"))] == ["one", "more/one"]


@pytest.mark.parametrize(
    ("name", "arguments", "fault"),
    [
        (
            "noise",
            ["--recordings", "A"],
            "--recordings: 'A' is refused; the study noise draws its flights itself; .*reality",
        ),
        ("reality", ["--runs", "3"], "--runs: 3 is refused; the study reality takes recordings .*"),
        ("reality", ["--methods", "ukf"], "--methods: 'ukf' is refused; the study reality takes recordings .*"),
        ("reality", ["--duration-s", "600"], "--duration-s: 600 is refused; the study reality takes recordings .*"),
    ],
)
def test_what_a_study_has_no_use_for_is_refused_by_name(
    name: str, arguments: list[str], fault: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["study", name, *arguments]) == 2
    assert re.fullmatch(f"{fault}\n", capsys.readouterr().err)


def test_what_is_known_decides_what_is_false() -> None:
    assert Known().is_false("torquer") is None
    assert Known(()).is_false("torquer") is True
    assert Known(("torquer",), beside=("spin_rate",)).is_false("spin_rate") is False


def test_every_recording_of_the_plan_is_known() -> None:
    assert {name for names, _ in plan.PLAN for name in names} <= set(plan.KNOWN)
