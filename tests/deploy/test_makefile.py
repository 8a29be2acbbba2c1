"""The Makefile's first step on machines that lack something: one clear line, and nothing left behind."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]

pytestmark = pytest.mark.skipif(shutil.which("make") is None, reason="make is not installed")


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """A directory with the Makefile and what its stamps depend on."""
    for name in ("Makefile", "pyproject.toml"):
        shutil.copy(ROOT / name, tmp_path / name)
    return tmp_path


def python_that(checkout: Path, answer: str) -> Path:
    """An interpreter that runs this one, except where ``answer`` (shell, on ``$*``) says otherwise."""
    script = checkout / "some-python"
    script.write_text(f'#!/bin/sh\ncase "$*" in\n{answer}\nesac\nexec {sys.executable} "$@"\n')
    script.chmod(0o755)
    return script


def make(checkout: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    ours = (
        "MAKEFLAGS",
        "MAKELEVEL",
        "MFLAGS",
        "MAKEOVERRIDES",
        "ARGS",
        "LINK",
        "PYTHON",
    )  # of a make around these tests
    environment = {name: value for name, value in os.environ.items() if name not in ours}
    return subprocess.run(
        ["make", "--no-print-directory", *arguments],
        cwd=checkout, env=environment, capture_output=True, text=True, timeout=60, stdin=subprocess.DEVNULL,
    )  # fmt: skip


@pytest.mark.parametrize("target", ["run", "test", "lint", "check", "bench"])
@pytest.mark.parametrize(
    ("answer", "message"),
    [
        ("*version_info*) exit 1;;\n--version) echo Python 3.9.2; exit;;", "Python 3.9.2 is too old, 3.11 or later"),
        ("*ensurepip*) exit 1;;", "on Debian: apt install python3-venv"),
        ("'-m venv .venv') mkdir .venv; echo no space left >&2; exit 1;;", "no space left"),
    ],
    ids=["old", "without-ensurepip", "failing"],
)
def test_a_python_that_will_not_do_is_named(checkout: Path, target: str, answer: str, message: str) -> None:
    done = make(checkout, target, f"PYTHON={python_that(checkout, answer)}")
    assert (done.returncode, message in done.stderr, (checkout / ".venv").exists()) == (2, True, False), done.stderr


def test_a_missing_python_is_named(checkout: Path) -> None:
    done = make(checkout, "test", "PYTHON=python-that-is-not-there")
    assert "python-that-is-not-there is not installed; on Debian: apt install" in done.stderr


@pytest.fixture
def installed(checkout: Path) -> Path:
    """A checkout whose .venv holds a recorder instead of Python: it writes its arguments to ``calls``."""
    (checkout / ".venv/bin").mkdir(parents=True)
    recorder = checkout / ".venv/bin/python"
    recorder.write_text('#!/bin/sh\necho "$*" >>calls\n')
    recorder.chmod(0o755)
    return checkout


def calls(checkout: Path) -> list[str]:
    path = checkout / "calls"
    return path.read_text().splitlines() if path.exists() else []


@pytest.mark.parametrize(
    ("arguments", "install", "last"),
    [
        (["run"], "-m pip install -q -e .[sim,view,diagnosis]", "-m sim_sensor.demo --link zenoh"),
        (["run", "LINK=serial"], "-m pip install -q -e .[sim,view,diagnosis]", "-m sim_sensor.demo --link serial"),
        (["test"], "-m pip install -q -e .[dev]", "-m pytest -n auto --dist loadfile --no-loadscope-reorder"),
    ],
)
def test_the_two_first_commands_install_and_run(installed: Path, arguments: list[str], install: str, last: str) -> None:
    assert make(installed, *arguments).returncode == 0
    assert [line.rstrip() for line in calls(installed)] == [install, last]


def test_the_check_is_format_lint_layers_types_and_tests_in_that_order(installed: Path) -> None:
    make(installed, "check")
    lint = ["-m ruff format --check .", "-m ruff check .", ".venv/bin/lint-imports --no-logo", "-m mypy"]
    expected = [*lint, "-m pytest -n auto --dist loadfile --no-loadscope-reorder"]
    assert [line.rstrip() for line in calls(installed)[1:]] == expected


@pytest.mark.parametrize(
    ("choice", "expected"),
    [
        ([], ["-m tests.benchmarks.bench_one", "-m tests.benchmarks.bench_two"]),
        (["BENCH=two"], ["-m tests.benchmarks.bench_two"]),
    ],
)
def test_the_benchmarks_are_those_of_their_directory(installed: Path, choice: list[str], expected: list[str]) -> None:
    (installed / "tests/benchmarks").mkdir(parents=True)
    for name in ("bench_one.py", "bench_two.py", "helper.py"):
        (installed / "tests/benchmarks" / name).touch()
    assert make(installed, "bench", *choice).returncode == 0
    assert [line.rstrip() for line in calls(installed)[1:]] == expected


def test_a_second_run_installs_nothing(installed: Path) -> None:
    make(installed, "test")
    (installed / "calls").unlink()
    make(installed, "test")
    make(installed, "run")
    assert [line for line in calls(installed) if "pip" in line] == []


def test_a_changed_project_file_installs_anew(installed: Path) -> None:
    make(installed, "test")
    stamp = (installed / ".venv/.dev").stat().st_mtime
    os.utime(installed / "pyproject.toml", (stamp + 10, stamp + 10))
    make(installed, "test")
    assert len([line for line in calls(installed) if "pip" in line]) == 2


def test_a_failed_installation_is_tried_again(installed: Path) -> None:
    recorder = installed / ".venv/bin/python"
    working = recorder.read_text()
    recorder.write_text(working + "exit 1\n")
    assert make(installed, "test").returncode == 2
    recorder.write_text(working)
    make(installed, "test")
    assert len([line for line in calls(installed) if "pip" in line]) == 2


def test_continuous_integration_runs_lint_and_the_readmes_test_command(tmp_path: Path) -> None:
    script = tmp_path / ".ci/run"
    script.parent.mkdir()
    shutil.copy(ROOT / ".ci/run", script)
    programs = tmp_path / "bin"
    programs.mkdir()
    wanted = re.findall(r"\[([^] ]+)\]=", script.read_text())  # programs that it would have installed if not there
    assert "make" in wanted
    for name in (*wanted, "npm", "python3", "apt-get"):
        told = name in ("make", "apt-get")
        (programs / name).write_text(f'#!/bin/sh\n[ {int(told)} = 0 ] || echo "{name} $*" >>calls\n')
        (programs / name).chmod(0o755)
    subprocess.run([script], env={"PATH": f"{programs}:/usr/bin:/bin"}, check=True, timeout=60)
    assert calls(tmp_path) == ["make lint", "make test", "make docs"]
