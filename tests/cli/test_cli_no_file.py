"""What is given in place of a file is refused in one line by every command: empty, a folder, no text, quotes."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.cli.cli_inputs import DESCRIPTOR, log_rows, run

NEXT = {
    "empty": "this file is empty; ",
    "folder": "this is a folder, not a file; ",
    "absent": "there is no such file or folder; ",
    "no text": "this is no text",
    "quotes": " from line 1, column ",
}
"""What each is said to be."""

CONTENT = {"empty": b"", "no text": b"\x80\xf0\x85 = 1", "quotes": b'file = ""log.csv""\n'}
JSON_CONTENT = {**CONTENT, "quotes": b'{"method": ""ukf""}\n'}

COMMANDS = {
    "inspect": ("inspect", "{bad}.toml"),
    "calibrate": ("calibrate", "{bad}.toml"),
    "calibrate by a prior": ("calibrate", "{good}", "--prior", "{bad}.json"),
    "diagnose": ("diagnose", "{bad}.toml", "--out", "{folder}/d"),
    "replay": ("replay", "{bad}.toml"),
    "replay by a configuration": ("replay", "{good}", "--config", "{bad}.toml"),
    "apply": ("apply", "{bad}.toml", "--with", "{bad}.json", "--out", "{folder}/v.csv"),
    "apply by a result": ("apply", "{good}", "--with", "{bad}.json", "--out", "{folder}/v.csv"),
    "apply by a physics file": ("apply", "{good}", "--with", "{bad}.toml", "--out", "{folder}/v.csv"),
    "plot": ("plot", "{bad}.toml", "--out", "{folder}/a.svg"),
    "plot of a result": ("plot", "{bad}.json", "--out", "{folder}/a.svg"),
    "export": ("export", "{bad}.json", "--format", "csv"),
    "export of a physics file": ("export", "{bad}.toml", "--format", "csv"),
    "run": ("run", "--check", "--config", "{bad}.toml"),
}


def made(folder: Path, kind: str) -> None:
    """The bad input as ``bad.toml``, ``bad.json`` and ``bad.csv``, and a good recording."""
    (folder / "RECORDING.toml").write_text(DESCRIPTOR, encoding="utf-8")
    (folder / "log.csv").write_text(log_rows(60), encoding="utf-8")
    for suffix in ("toml", "json", "csv"):
        path = folder / f"bad.{suffix}"
        if kind == "folder":
            path.mkdir()
        elif kind != "absent":
            path.write_bytes((JSON_CONTENT if suffix == "json" else CONTENT)[kind])


@pytest.mark.parametrize("kind", NEXT)
@pytest.mark.parametrize("command", COMMANDS)
def test_what_is_no_file_is_refused_in_a_line(command: str, kind: str, tmp_path: Path) -> None:
    """With the file, what it is, and what to give; nothing is written."""
    made(tmp_path, kind)
    places = {"bad": tmp_path / "bad", "good": tmp_path / "RECORDING.toml", "folder": tmp_path}
    done = run(*(part.format(**places) for part in COMMANDS[command]))
    (line,) = done.err.splitlines()
    assert done.code == 2
    named, _, said = line.partition(": ")
    assert Path(named).stem == "bad"
    assert NEXT[kind].strip() in f": {said}"
    assert ";" in said
    assert not [path for path in tmp_path.iterdir() if path.name in ("v.csv", "a.svg")]


LOGS = {
    "empty": (b"", "this file is empty; a log with a row a line is accepted"),
    "blank lines": (b"\n \n", "this file is empty; a log with a row a line is accepted"),
    "whole rows in quotes": (
        b'"t,mx,my,mz"\n' + b'"1,2,3,4"\n' * 9,
        "rows stand in quotes, or have them doubled: tr -d",
    ),
    "doubled quotes": (
        b'""t"",""mx"",""my"",""mz""\n' + b'""1"",""2"",""3"",""4""\n' * 9,
        "rows stand in quotes, or have them doubled: tr -d",
    ),
}


@pytest.mark.parametrize("case", LOGS)
def test_a_log_that_is_none_is_refused_with_the_next_step(case: str, tmp_path: Path) -> None:
    content, said = LOGS[case]
    (tmp_path / "log.csv").write_bytes(content)
    done = run("describe", tmp_path / "log.csv")
    (line,) = done.err.splitlines()
    assert (done.code, said in line) == (2, True)


@pytest.mark.parametrize("command", ["inspect", "calibrate", "diagnose", "replay", "plot"])
def test_a_described_log_that_is_empty_is_refused_by_its_own_name(command: str, tmp_path: Path) -> None:
    (tmp_path / "RECORDING.toml").write_text(DESCRIPTOR, encoding="utf-8")
    (tmp_path / "log.csv").write_text("\n", encoding="utf-8")
    more = {"diagnose": ("--out", tmp_path / "d"), "plot": ("--out", tmp_path / "a.svg")}
    done = run(command, tmp_path / "RECORDING.toml", *more.get(command, ()))
    assert done.code == 2
    assert done.err == f"{tmp_path / 'log.csv'}: this file is empty; a header line and rows below it are accepted\n"


def test_a_session_that_is_empty_is_said_to_be(tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_bytes(b"")
    assert "a.mcap: this file is empty; an MCAP file" in run("inspect", tmp_path / "a.mcap").err


def test_a_line_that_is_no_toml_is_shown_with_what_is_mostly_wrong(tmp_path: Path) -> None:
    path = tmp_path / "RECORDING.toml"
    path.write_text('version = 1\n[samples]\nfile = ""log.csv""\n', encoding="utf-8")
    (line,) = run("inspect", path).err.splitlines()
    assert line.startswith(f"{path}: this is no TOML from line 3, column 10 on (Expected newline")
    assert line.endswith(
        '): file = ""log.csv""; valid TOML in UTF-8 is accepted; a text stands between one pair of quotes'
    )


@pytest.mark.parametrize("line", ['craft = "" demo', 'craft = """demo', "names = ['a', \"\" 'b']"])
def test_an_empty_or_a_long_text_is_not_taken_for_quotes_that_are_doubled(line: str, tmp_path: Path) -> None:
    path = tmp_path / "RECORDING.toml"
    path.write_text(f"version = 1\n{line}\n", encoding="utf-8")
    told = run("inspect", path).err
    assert "this is no TOML" in told
    assert "pair of quotes" not in told
