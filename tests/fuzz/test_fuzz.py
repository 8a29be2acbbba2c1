"""A short run of the fuzzer on every reader, and proof that it sees what it looks for."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from magcal_service.base.errors import DecodeError
from tests.fuzz import __main__ as command
from tests.fuzz import engine
from tests.fuzz.engine import fuzz
from tests.fuzz.inputs import ROOT
from tests.fuzz.targets import TARGETS, Target

ANY = Target("any", len, (), lambda: [b"abc", b"12,34"])


@pytest.mark.parametrize("target", TARGETS, ids=lambda target: target.name)
def test_no_input_does_what_none_may_do(target: Target) -> None:
    totals = fuzz(target, round(500 * target.share), seed=1)
    assert [crash.told for crash in totals.crashes] == []


@pytest.mark.parametrize("target", TARGETS, ids=lambda target: target.name)
def test_some_inputs_are_accepted(target: Target) -> None:
    totals = fuzz(replace(target, own=()), len(target.seeds()), seed=1)
    assert totals.accepted == totals.inputs


def key_error(data: bytes) -> int:
    return {97: 1, 49: 1}.get(data[0], 0) if data[:1] in (b"a", b"1") else {}[0]  # type: ignore[no-any-return]


def broken_promise(data: bytes) -> None:
    assert b"\0" not in data


def hang(data: bytes) -> None:
    while b"c" not in data:
        pass


def swallowed_hang(data: bytes) -> None:
    while b"c" not in data:
        try:
            while True:
                pass
        except Exception:
            continue


def memory(data: bytes) -> int:
    return len(bytearray(1 << 33)) if b"c" not in data else 0


def other_error(data: bytes) -> None:
    raise DecodeError("not_msgpack", "an error that this reader may not raise")


@pytest.mark.parametrize(
    ("run", "told"),
    [
        (key_error, "KeyError"),
        (broken_promise, "AssertionError"),
        (hang, "HangError"),
        (swallowed_hang, "HangError"),
        (memory, "MemoryError"),
        (other_error, "DecodeError"),
    ],
)
def test_a_defect_is_found(run: Callable[[bytes], None], told: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(engine, "HANG_S", 0.05)
    totals = fuzz(replace(ANY, run=run), 3000, seed=1, most_crashes=1)
    (crash,) = totals.crashes
    assert told in crash.told
    with pytest.raises(BaseException):  # noqa: B017, PT011 - whatever it is, the input shows it again
        _again(run, crash.data, monkeypatch)


def _again(run: Callable[[bytes], None], data: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    totals = fuzz(replace(ANY, run=run, seeds=lambda: [data]), 1, seed=1)
    if totals.crashes:
        raise RuntimeError(totals.crashes[0].told)


def test_an_error_that_a_reader_may_raise_is_no_crash() -> None:
    totals = fuzz(replace(ANY, run=other_error, refuses=DecodeError), 100, seed=1)
    assert (totals.refused, totals.crashes) == (100, [])


def test_one_defect_is_told_once() -> None:
    assert len(fuzz(replace(ANY, run=other_error), 200, seed=1).crashes) == 1


def test_the_same_seed_gives_the_same_inputs() -> None:
    taken: list[list[bytes]] = [[], [], []]
    for number, seed in enumerate((1, 1, 2)):
        fuzz(replace(ANY, run=taken[number].append), 200, seed)
    assert taken[0] == taken[1] != taken[2]


def test_the_command_prints_totals_and_ends_with_zero() -> None:
    command = [sys.executable, "-m", "tests.fuzz", "--inputs", "60", "--target", "payload", "--target", "times"]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, check=False, timeout=120)
    assert done.returncode == 0, done.stderr
    assert "| payload | 48 |" in done.stdout
    assert "60 inputs, seed 1, 0 crashes" in done.stdout


def test_the_command_keeps_what_crashes_and_ends_with_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(command, "TARGETS", (replace(ANY, run=broken_promise),))
    monkeypatch.setattr(sys, "argv", ["fuzz", "--inputs", "3000", "--keep", str(tmp_path)])
    assert command.main() == 1
    assert "1 crashes" in capsys.readouterr().out
    (kept,) = (tmp_path / "any").iterdir()
    with pytest.raises(AssertionError):
        broken_promise(kept.read_bytes())


def test_the_command_grows_the_corpus_by_inputs_that_end_at_places_of_their_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(command, "TARGETS", (replace(ANY, run=lambda data: len(data) % 5),))
    monkeypatch.setattr(command, "CORPUS", tmp_path)
    monkeypatch.setattr(sys, "argv", ["fuzz", "--inputs", "500", "--grow", "4"])
    assert command.main() == 0
    kept = [path.read_bytes() for path in (tmp_path / "any").iterdir()]
    assert len({len(data) % 5 for data in kept}) == len(kept) == 4
