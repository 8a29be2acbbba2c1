"""The account of a log's rows: every row once, at the step that leaves it out, and the same in every command."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from magcal_service.diagnosis.prepare import prepare
from magcal_service.diagnosis.rows import account_of
from magcal_service.recordings.inspect.account import WHY, Account
from magcal_service.recordings.inspect.inspection import inspect
from magcal_service.recordings.reader import read_recording
from tests.cli.cli_inputs import DESCRIPTOR, log_rows, run

COUNT = 900
SPIKES = (400, 500, 600)


def _written(folder: Path) -> Path:
    """A log with rows of every kind that a step leaves out."""
    header, *rows = log_rows(COUNT).splitlines()
    cells = [row.split(",") for row in rows]
    rng = np.random.default_rng(3)
    for row in cells:
        row[1:4] = [f"{float(value) + noise:.3f}" for value, noise in zip(row[1:4], rng.normal(0, 50, 3), strict=True)]
    for number in (20, 21):
        cells[number][1:4] = ["0", "0", "0"]
    cells[100][2] = "none"
    for number in (200, 201, 202):
        cells[number][4:7] = ["", "", ""]
    for number in SPIKES:
        cells[number][1:4] = [f"{1.3 * float(value):.3f}" for value in cells[number][1:4]]
    again = [*cells[300][:1], "1234.5", *cells[300][2:]]
    cells.insert(301, again)
    (folder / "log.csv").write_text("\n".join([header, *(",".join(row) for row in cells)]) + "\n", encoding="utf-8")
    path = folder / "RECORDING.toml"
    path.write_text(DESCRIPTOR, encoding="utf-8")
    return path


LEFT_OUT = {"unreadable": 1, "defect": 2, "same_time": 1, "no_reference": 3}


def test_every_row_is_counted_at_the_step_that_leaves_it_out(tmp_path: Path) -> None:
    inspection = inspect(read_recording(_written(tmp_path)))
    assert (inspection.account.rows, inspection.account.left_out) == (COUNT + 1, LEFT_OUT)
    assert inspection.account.used == COUNT - 6 == len(inspection.usable.sorted_unique())


def test_a_diagnosis_counts_what_it_leaves_out_besides_and_fits_the_rest(tmp_path: Path) -> None:
    inspection = inspect(read_recording(_written(tmp_path)))
    prepared = prepare(inspection.to_diagnose, ())
    account = account_of(inspection, prepared)
    assert account.left_out == LEFT_OUT | {
        "thinned": 0,
        "spikes": len(SPIKES),
        "edges": 0,
        "spoiled": 0,
        "weak_field": 0,
    }
    assert account.used == len(prepared.problem.scene)
    thinned = prepare(inspection.to_diagnose, (), stride=3)
    account = account_of(inspection, thinned)
    assert account.left_out["thinned"] == 596
    assert account.used == len(thinned.problem.scene)


def test_spikes_that_have_to_stay_are_not_counted_as_left_out(tmp_path: Path) -> None:
    """Of so few rows that the rest would not do, all are fitted."""
    inspection = inspect(read_recording(_written(tmp_path)))
    few = inspection.to_diagnose.sorted_unique()
    prepared = prepare(few.select(np.arange(350, 430)), ())
    assert prepared.left_out == {"thinned": 0, "spikes": 0, "edges": 0, "spoiled": 0, "weak_field": 0}
    assert len(prepared.problem.scene) == 80


def test_all_commands_say_the_same(tmp_path: Path) -> None:
    path = _written(tmp_path)
    said = {
        command: run(command, path, "--json", tmp_path / f"{command}.json").out for command in ("inspect", "calibrate")
    }
    words = ", ".join(f"{count} {WHY[why]}" for why, count in LEFT_OUT.items())
    assert f"{COUNT - 6} of {COUNT + 1} rows can be used" in said["inspect"]
    assert f"left out: {words}\n" in said["inspect"]
    for text in (said["calibrate"], run("replay", path).out):
        assert f"rows: {COUNT - 6} of {COUNT + 1} rows used; left out: {words}\n" in text
        assert f"{COUNT + 1} rows, {COUNT} read, 1 refused" in text
    found, calibrated = (json.loads((tmp_path / f"{name}.json").read_text()) for name in ("inspect", "calibrate"))
    assert calibrated["rows"] == {name: found[name] for name in ("rows", "used", "left_out")}


def test_nothing_left_out_is_not_spoken_of() -> None:
    account = Account(10, {"unreadable": 0, "spikes": 0})
    assert (str(account), account.why) == ("10 of 10 rows used", "")
