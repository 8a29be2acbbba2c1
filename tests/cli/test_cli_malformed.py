"""No input brings a traceback out: small changes to files that are right, and bytes that are none."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from tests.cli.cli_inputs import CONFIG, DESCRIPTOR, log_rows, run

SECONDS = 60
PIECES = (
    *(
        "",
        "\x00",
        "\n",
        '"',
        "=",
        "[",
        "]]",
        "{",
        "#",
        "-",
        "1e400",
        "nan",
        "inf",
        "-0.0",
        "9" * 400,
        "0x",
        "\U0001f6f0",
    ),
    *(
        "true",
        "[]",
        "[[1]]",
        "{}",
        '""',
        '"\\u0000"',
        "'''",
        "1979-05-27",
        "../..",
        "é",
        "\ud7ff",
        "a" * 5000,
        "[craft]",
    ),
)


@st.composite
def spoiled(draw: st.DrawFn, text: str) -> str:
    """The text with one to three small things changed: a piece put in, a stretch taken out, a line doubled or moved."""
    for _ in range(draw(st.integers(1, 3))):
        at = draw(st.integers(0, len(text)))
        lines = text.split("\n")
        row = draw(st.integers(0, len(lines) - 1))
        match draw(st.integers(0, 4)):
            case 0:
                text = text[:at] + draw(st.sampled_from(PIECES)) + text[at:]
            case 1:
                text = text[:at] + text[at + draw(st.integers(1, 12)) :]
            case 2:
                text = "\n".join([*lines[: row + 1], *lines[row:]])
            case 3:
                key, equals, _ = lines[row].partition("=")
                lines[row] = f"{key}{equals} {draw(st.sampled_from(PIECES))}" if equals else ""
                text = "\n".join(lines)
            case _:
                lines.insert(draw(st.integers(0, len(lines))), lines.pop(row))
                text = "\n".join(lines)
    return text


def assert_told(*arguments: object) -> None:
    """The command is done, or refuses in whole lines; it never fails."""
    done = run(*arguments)
    assert done.code in (0, 2, 3)
    assert "Traceback" not in done.err
    assert (done.code == 2) == bool(done.err), done


def write(folder: Path, descriptor: str, log: bytes) -> Path:
    (folder / "log.csv").write_bytes(log)
    path = folder / "RECORDING.toml"
    path.write_bytes(descriptor.encode("utf-8", "surrogatepass"))
    return path


LOG = log_rows(SECONDS).encode()


@settings(max_examples=75, deadline=None)
@given(spoiled(DESCRIPTOR))
@example(DESCRIPTOR.replace("log.csv", "\\u0000"))
@example(DESCRIPTOR.replace("log.csv", "."))
def test_a_descriptor_with_something_changed_is_read_or_refused(text: str) -> None:
    with TemporaryDirectory() as name:
        assert_told("replay", write(Path(name), text, LOG))


@settings(max_examples=75, deadline=None)
@given(spoiled(CONFIG))
@example(CONFIG.replace("loop:cli", "\\u0000"))
@example(CONFIG.replace("loop:cli", "zenoh:tcp/127.0.0.1:99999"))
def test_a_configuration_with_something_changed_is_read_or_refused(text: str) -> None:
    with TemporaryDirectory() as name:
        path = Path(name) / "magcal.toml"
        path.write_bytes(text.encode("utf-8", "surrogatepass"))
        assert_told("replay", write(Path(name), DESCRIPTOR, LOG), "--config", path)


@settings(max_examples=50, deadline=None)
@given(spoiled(log_rows(SECONDS)))
def test_a_log_with_something_changed_is_read_or_refused(text: str) -> None:
    with TemporaryDirectory() as name:
        path = write(Path(name), DESCRIPTOR, text.encode("utf-8", "surrogatepass"))
        assert_told("calibrate", path, "--json", Path(name) / "result.json")


@settings(max_examples=50, deadline=None)
@given(st.binary(max_size=300), st.integers(0, len(LOG)))
def test_a_log_with_any_bytes_in_it_is_read_or_refused(piece: bytes, at: int) -> None:
    with TemporaryDirectory() as name:
        assert_told("replay", write(Path(name), DESCRIPTOR, LOG[:at] + piece + LOG[at:]))


@pytest.mark.parametrize(
    ("line", "why"),
    [
        ('csv = "\\u0000"', "is refused"),
        ('csv = "/"', "this is a folder, not a file"),
        ('csv = "."', "this is a folder, not a file"),
    ],
)
def test_rows_that_cannot_be_written_are_refused_when_the_daemon_starts(line: str, why: str, tmp_path: Path) -> None:
    path = tmp_path / "magcal.toml"
    path.write_text(CONFIG.replace('csv = "rows.csv"', line))
    done = run("run", "--config", path)
    assert done.code == 2
    assert why in done.err.splitlines()[-1]
