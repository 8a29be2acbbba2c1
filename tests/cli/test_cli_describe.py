"""``magcal describe``: exit codes, a descriptor that the other commands take as it is, and evidence with it."""

from pathlib import Path

import pytest

from tests.cli.cli_inputs import run
from tests.recordings.describe.maker_logs import phone


def test_questions_end_with_3_and_their_answers_make_a_descriptor(tmp_path: Path) -> None:
    log, out = phone(tmp_path).path, tmp_path / "RECORDING.toml"
    done = run("describe", log, "--out", out)
    assert (done.code, done.err, out.exists()) == (3, "", False)
    assert "question reference: no column is a reference" in done.out
    assert "answer with: --answer 'reference=49.2 uT'" in done.out
    done = run("describe", log, "--out", out, "--answer", "reference=49.2 uT")
    assert (done.code, done.err) == (0, "")
    assert "# reference.constant = 49.2 uT: by your answer reference\n" in out.read_text()
    done = run("inspect", out)
    assert (done.code, done.err) == (0, "")
    assert "600 of 600 rows can be used" in done.out


def test_without_out_the_descriptor_is_printed_whole(tmp_path: Path) -> None:
    log = phone(tmp_path).path
    done = run("describe", log, "--answer", "reference=49.2 uT")
    assert done.code == 0
    (tmp_path / "printed.toml").write_text(done.out, encoding="utf-8")
    assert run("inspect", tmp_path / "printed.toml").code == 0


def test_a_descriptor_in_another_folder_finds_its_log(tmp_path: Path) -> None:
    log = phone(tmp_path).path
    (tmp_path / "described").mkdir()
    out = tmp_path / "described" / "phone.toml"
    assert run("describe", log, "--out", out, "--answer", "reference=49.2 uT").code == 0
    assert 'file = "../Raw Data.csv"' in out.read_text()
    assert run("inspect", out).code == 0


@pytest.mark.parametrize("answer", ["reference", "reference=49.2 uT"])
def test_an_answer_without_value_or_given_twice_is_refused(answer: str, tmp_path: Path) -> None:
    log = phone(tmp_path).path
    done = run("describe", log, "--answer", "reference=48 uT", "--answer", answer)
    assert (done.code, done.out) == (2, "")
    assert done.err.startswith(f"--answer: {answer!r} is refused; ")
