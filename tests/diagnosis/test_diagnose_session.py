"""``magcal diagnose`` on a recorded session: the same diagnosis as of the same samples in a CSV."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

from magcal_service.cli.__main__ import main
from magcal_service.config.settings import SensorConfig
from tests.diagnosis.diagnosis_runs import undrawn
from tests.recordings.recording_logs import described
from tests.recordings.sessions import craft, record, stream

SECONDS = 2000


def diagnosed(recording: Path, out: Path) -> dict[str, Any]:
    """What the command writes of a recording, but for the time that it took."""
    with undrawn():
        code = main(["diagnose", str(recording), "--out", str(out)])
    content: dict[str, Any] = json.loads((out / "diagnosis.json").read_text(encoding="utf-8"))
    assert code == (0 if content["trusted"] else 3)
    assert content.pop("seconds") > 0.0
    return content


def as_csv(session: Path, folder: Path) -> Path:
    """The session's samples as ``magcal record export`` writes them, and their descriptor."""
    assert main(["record", "export", str(session), "--out", str(folder / "export.csv")]) == 0
    with (folder / "export.csv").open(newline="") as file:
        header, *rows = csv.reader(file)
    assert header[0] == "time_ns"
    with (folder / "flight.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["t", *header[1:]])
        writer.writerows([f"{row[0][:-9]}.{row[0][-9:]}", *row[1:]] for row in rows)
    spin = craft().spin
    assert spin is not None
    descriptor = folder / "flight.toml"
    text = described(
        "flight.csv",
        time='format = "unix_s"',
        field=[f"field_body_nt.{axis}" for axis in range(3)],
        noise_nt=100.0,
        reference=[f"reference_eci_nt.{axis}" for axis in range(3)],
        channels={"temperature": "channel_temperature [degC]"},
        spin_axis=spin.axis,
    )
    descriptor.write_text(text)
    return descriptor


def test_a_session_has_the_diagnosis_of_its_samples_in_a_csv(tmp_path: Path) -> None:
    """Verdict, effects, numbers and held-out gain are the same to the last bit."""
    quiet = replace(craft(), sensor=SensorConfig(noise_nt=100.0))
    (session,) = record(tmp_path / "rec", stream(SECONDS, "hot-electronics"), [quiet])
    from_session = diagnosed(session, tmp_path / "session")
    assert from_session["verdict"] == "named"
    assert from_session == diagnosed(as_csv(session, tmp_path), tmp_path / "csv")
