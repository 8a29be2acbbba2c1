"""``magcal record``: what it says of a file, what it makes of it, and what it refuses."""

from __future__ import annotations

import csv
import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow.parquet
import pytest
from mcap.reader import make_reader

from magcal_service.base.errors import how_to_install
from magcal_service.cli.__main__ import main
from magcal_service.recordings.mcap_reader import McapReader
from magcal_service.recordings.mcap_writer import McapWriter
from magcal_service.recordings.reader import read_recording
from magcal_service.recordings.session_info import session_info
from tests.recordings.sessions import craft, record, stream

Say = Callable[..., tuple[int, str, str]]


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """300 s of one craft with telemetry, in several chunks."""
    folder = tmp_path_factory.mktemp("session")
    (path,) = record(folder, stream(300, "hot-electronics"), csv=folder / "live.csv", flush_s=0.0005)
    return path


@pytest.fixture(scope="module")
def two(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two craft in one file."""
    both = [*stream(60, name="alpha"), *stream(60, name="beta")]
    (path,) = record(tmp_path_factory.mktemp("two"), both, [craft("alpha"), craft("beta")])
    return path


@pytest.fixture
def say(capsys: pytest.CaptureFixture[str]) -> Say:
    """Runs ``magcal record ...``: exit code, stdout, stderr."""

    def run(*arguments: object) -> tuple[int, str, str]:
        code = main(["record", *map(str, arguments)])
        told = capsys.readouterr()
        return code, told.out, told.err

    return run


@pytest.fixture
def cut(session: Path, tmp_path: Path) -> Path:
    """The session up to the middle of its last chunk, wherever the recorder has flushed."""
    path = tmp_path / "cut.mcap"
    with session.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    last = max(summary.chunk_indexes, key=lambda chunk: chunk.chunk_start_offset)
    path.write_bytes(session.read_bytes()[: last.chunk_start_offset + last.chunk_length // 2])
    return path


def test_info_counts_by_craft_and_kind(session: Path, say: Say) -> None:
    code, told, _ = say("info", session)
    assert code == 0
    assert f"{session.stat().st_size} bytes, sound" in told
    for kind, count in (("magnetometer", 300), ("reference", 300), ("calibrated", 300), ("estimate", 300)):
        assert any(line.split()[:3] == ["paper", kind, str(count)] for line in told.splitlines())


def test_info_as_json_is_the_same_account(session: Path, say: Say) -> None:
    code, told, _ = say("info", session, "--json")
    content = json.loads(told)
    assert (code, content["sound"], content["size_bytes"]) == (0, True, session.stat().st_size)
    assert {one["kind"]: one["count"] for one in content["kinds"]}["magnetometer"] == 300
    assert len(content["about"]["configuration_sha256"]) == 64


def test_info_on_a_file_without_its_end_says_so_and_ends_with_three(cut: Path, say: Say) -> None:
    code, told, _ = say("info", cut)
    assert code == 3
    assert "NOT SOUND: it ends" in told
    assert "magcal record recover" in told


def test_recover_makes_a_sound_file_beside(cut: Path, say: Say) -> None:
    code, told, _ = say("recover", cut)
    out = cut.with_suffix(".recovered.mcap")
    info = session_info(out)
    assert code == 3  # the cut went through a chunk
    assert info.sound
    assert f"{sum(kind.count for kind in info.kinds)} records of cut.mcap recovered" in told
    assert cut.exists()


def test_a_replay_of_a_file_without_its_end_says_so(cut: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["replay", str(cut)]) in (0, 3)
    assert "file: truncated_file" in capsys.readouterr().out


def test_join_of_a_spoilt_part_is_done_but_not_to_be_trusted(
    cut: Path, session: Path, say: Say, tmp_path: Path
) -> None:
    code, told, _ = say("join", session, cut, "--out", tmp_path / "all.mcap")
    assert code == 3
    assert f"not all could be read of: {cut}" in told


def test_join_of_two_sessions_says_so(session: Path, two: Path, say: Say, tmp_path: Path) -> None:
    code, told, _ = say("join", session, two, "--out", tmp_path / "all.mcap")
    assert code == 0
    assert "of 2 sessions: the service began anew between them" in told


def test_check_finds_every_recorded_estimate_again(session: Path, say: Say) -> None:
    code, told, _ = say("check", session)
    assert (code, told) == (0, "paper: 300 of 300 recorded estimates came again, to the last bit\n")


def test_check_takes_a_session_that_was_killed(cut: Path, say: Say) -> None:
    code, told, _ = say("check", cut)
    assert code == 0
    assert "first difference" not in told


def test_check_tells_the_first_estimate_that_differs(session: Path, say: Say, tmp_path: Path) -> None:
    path = tmp_path / "changed.mcap"
    with session.open("rb") as source, path.open("wb", buffering=0) as file:
        writer = McapWriter(file, "test")
        reader = McapReader(source, "session")
        raws = list(reader.messages())
        for name, content in reader.metadata:
            writer.add_metadata(name, content)
        estimates = 0
        for raw in raws:
            estimates += raw.topic.kind == "estimate"
            changed = raw.topic.kind == "estimate" and estimates == 100
            writer.add(raw._replace(data=raw.data.replace(b'"noise_nt":300', b'"noise_nt":301')) if changed else raw)
        writer.finish()
    code, told, _ = say("check", path)
    assert code == 3
    assert "299 of 300 recorded" in told
    assert "first difference: tick 100: noise_nt was 301.0, is 300.0" in told


def test_exported_samples_are_the_recordings_arrays(session: Path, say: Say, tmp_path: Path) -> None:
    assert say("export", session, "--out", tmp_path / "s.csv")[0] == 0
    with (tmp_path / "s.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    recording = read_recording(session)
    got = np.array([[float(row[f"field_body_nt.{axis}"]) for axis in range(3)] for row in rows])
    assert np.array_equal(got, recording.field_body_nt)
    assert [int(row["time_ns"]) for row in rows] == recording.time_ns.tolist()
    assert {"reference_magnitude_nt", "channel_temperature [degC]"} <= set(rows[0])


@pytest.mark.parametrize("kind", ["samples", "estimate", "status", "telemetry", "magnetometer"])
def test_parquet_holds_the_same_numbers_as_csv(kind: str, session: Path, say: Say, tmp_path: Path) -> None:
    for suffix in ("csv", "parquet"):
        assert say("export", session, "--kind", kind, "--out", tmp_path / f"t.{suffix}")[0] == 0
    table = pyarrow.parquet.read_table(tmp_path / "t.parquet").to_pylist()
    with (tmp_path / "t.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(table) > 0
    for text, typed in zip(rows, table, strict=True):
        assert text == {name: "" if cell is None or cell != cell else str(cell) for name, cell in typed.items()}


def test_exported_estimates_are_the_live_rows(session: Path, say: Say, tmp_path: Path) -> None:
    say("export", session, "--kind", "estimate", "--out", tmp_path / "e.csv")
    with (tmp_path / "e.csv").open(newline="") as file, (session.parent / "live.csv").open(newline="") as live:
        for ours, row in zip(csv.DictReader(file), csv.DictReader(live), strict=True):
            assert (ours["tick"], ours["verdict"]) == (row["tick"], row["verdict"])
            assert [ours[f"bias_nt.{axis}"] for axis in range(3)] == [row["bx"], row["by"], row["bz"]]


def test_export_of_one_craft_leaves_the_other_out(two: Path, say: Say, tmp_path: Path) -> None:
    say("export", two, "--kind", "magnetometer", "--craft", "beta", "--out", tmp_path / "b.csv")
    with (tmp_path / "b.csv").open(newline="") as file:
        assert [row["craft"] for row in csv.DictReader(file)] == ["beta"] * 60


def test_describe_names_the_craft(two: Path, say: Say) -> None:
    code, told, _ = say("describe", two, "--craft", "alpha")
    assert code == 0
    assert 'craft = "alpha"' in told


REFUSED = {
    "no file": (("info", "absent.mcap"), "there is no such file"),
    "no MCAP": (("info", "{text}"), "not an MCAP file"),
    "no MCAP to recover": (("recover", "{text}"), "not an MCAP file"),
    "no file to recover": (("recover", "absent.mcap"), "there is no such file"),
    "no file to join": (("join", "absent.mcap", "--out", "out.mcap"), "there is no such file"),
    "over itself": (("recover", "{session}", "--out", "{session}"), "another file"),
    "other table": (("export", "{session}", "--out", "x.xls"), "ending in .csv or .parquet"),
    "unknown kind": (("export", "{session}", "--out", "x.csv", "--kind", "estimates"), "did you mean 'estimate'"),
    "unknown craft": (("export", "{two}", "--out", "x.csv", "--craft", "alhpa"), "did you mean 'alpha'"),
    "no craft": (("export", "{two}", "--out", "x.csv"), "2 craft"),
    "no craft to describe": (("describe", "{two}"), "choose one with --craft"),
    "no folder": (("export", "{session}", "--out", "absent/x.csv"), "there is no folder absent"),
}


@pytest.mark.parametrize(("arguments", "reason"), REFUSED.values(), ids=REFUSED)
def test_what_cannot_be_done_is_refused_in_one_line(
    arguments: tuple[str, ...],
    reason: str,
    session: Path,
    two: Path,
    say: Say,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "text").write_text("hello, world")
    names = {"session": session, "two": two, "text": tmp_path / "text"}
    code, _, told = say(*(argument.format(**names) for argument in arguments))
    assert code == 2
    assert reason in told
    assert len(told.splitlines()) == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["text"]


def test_without_the_extra_the_daemon_runs_and_recording_names_it() -> None:
    code = (
        "import sys; sys.modules['mcap'] = None\n"
        "from magcal_service.cli.__main__ import main\n"
        "import magcal_service.daemon.service\n"
        "sys.exit(main(['record', 'info', 'x.mcap']))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=60)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert how_to_install("record") in done.stderr


def test_a_daemon_that_does_not_record_loads_nothing_for_it() -> None:
    code = (
        "import sys, magcal_service.cli.__main__, magcal_service.daemon.service\n"
        "heavy = {'mcap', 'zstandard', 'lz4', 'pyarrow', 'magcal_service.recordings.recorder'}\n"
        "print(sorted(heavy & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    assert done.stdout.strip() == "[]"
