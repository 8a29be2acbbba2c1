"""``magcal xtce``: the XTCE on standard output or in a file, with the APIDs of an address; what it refuses."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.cli.cli_inputs import run

DEFAULT = Path(__file__).resolve().parents[2] / "deploy/yamcs/mdb/magcal.xml"


def test_it_writes_a_file_or_to_standard_output(tmp_path: Path) -> None:
    done = run("xtce", "--out", tmp_path / "magcal.xml")
    assert (done.code, done.out, done.err) == (0, "", "")
    assert (tmp_path / "magcal.xml").read_text(encoding="utf-8") == DEFAULT.read_text(encoding="utf-8")
    assert run("xtce").out == DEFAULT.read_text(encoding="utf-8")


def test_it_has_the_apids_of_the_address() -> None:
    text = run("xtce", "--link", "ccsds:udp/10.0.0.5:10015?apid=100&apid_status=7").out
    found = [line.partition('value="')[2].partition('"')[0] for line in text.splitlines() if "<Comparison" in line]
    assert found == ["100", "101", "7", "103"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--link", "zenoh:tcp/127.0.0.1:7447"), "a ccsds: address is accepted"),
        (("--link", "ccsds:udp/mission.example:10015"), "with an IP address"),
        (("--out", "/"), "give a file that can be written"),
    ],
)
def test_what_is_asked_wrongly_is_one_line(arguments: tuple[str, ...], words: str) -> None:
    done = run("xtce", *arguments)
    assert (done.code, done.out, done.err.count("\n")) == (2, "", 1)
    assert words in done.err
