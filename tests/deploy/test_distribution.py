"""The distribution: its own name, extras that hold what is used and nothing else, hints that are right."""

from __future__ import annotations

import ast
import importlib.metadata
import json
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from magcal_service.base.errors import DISTRIBUTION, ExtraMissingError, how_to_install

ROOT = Path(__file__).resolve().parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
EXTRAS = PROJECT["optional-dependencies"]
MODULES = {"pyserial": "serial", "eclipse-zenoh": "zenoh", "dask": "distributed"}
"""Packages whose module has another name."""

USERS = ("sim", "diagnosis", "view", "record", "export", "cluster", "completion")
"""Extras of the product; ``dev`` and ``fuzz`` are of its tests."""


def packages(requirements: list[str]) -> set[str]:
    """The modules that requirements bring, those of named extras included."""
    found = set()
    for requirement in requirements:
        name, extras = re.match(r"([A-Za-z0-9-]+)(?:\[([a-z,]+)\])?", requirement).groups()  # type: ignore[union-attr]
        if name == PROJECT["name"]:
            found |= set().union(*(packages(EXTRAS[extra]) for extra in extras.split(",")))
        else:
            found.add(MODULES.get(name, name))
    return found


def imported() -> set[str]:
    """Third-party modules that the product's code imports anywhere."""
    found = set()
    for room in ("magcal_service", "sim_sensor"):
        for path in (ROOT / room).rglob("*.py"):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if isinstance(node, ast.Import):
                    found |= {alias.name.partition(".")[0] for alias in node.names}
                elif isinstance(node, ast.ImportFrom) and node.module:
                    found.add(node.module.partition(".")[0])
    return found - set(sys.stdlib_module_names) - {"magcal_service", "sim_sensor"}


def test_base_and_extras_hold_what_the_code_imports_and_nothing_else() -> None:
    declared = packages(PROJECT["dependencies"]).union(*(packages(EXTRAS[name]) for name in USERS))
    assert declared == imported()


def test_what_is_no_code_is_installed_too() -> None:
    """Templates, tables and pages are named in ``package-data``, and what is named there exists."""
    shipped = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["setuptools"]["package-data"]
    for room, patterns in shipped.items():
        there = {path for path in (ROOT / room).rglob("*") if path.is_file() and path.suffix not in (".py", ".pyc")}
        named = [set((ROOT / room).glob(pattern)) for pattern in patterns]
        assert there == set().union(*named)
        assert all(named)


def test_every_extra_that_an_error_may_name_exists() -> None:
    named = set()
    for room in ("magcal_service", "sim_sensor"):
        for path in (ROOT / room).rglob("*.py"):
            named |= set(re.findall(r'ExtraMissingError\([^,]+, "(\w+)"', path.read_text(encoding="utf-8")))
    assert named
    assert named <= set(EXTRAS)


def test_the_distribution_has_a_name_of_its_own() -> None:
    assert PROJECT["name"] == DISTRIBUTION == "magcal-service"
    assert PROJECT["scripts"]["magcal"].startswith("magcal_service.")


class Installed:
    """A distribution as ``importlib.metadata`` gives it, installed from ``url``."""

    def __init__(self, url: str, editable: bool) -> None:
        self._origin = {"url": url, "dir_info": {"editable": editable}} if url else None

    def read_text(self, name: str) -> str | None:
        assert name == "direct_url.json"
        return None if self._origin is None else json.dumps(self._origin)


@pytest.mark.parametrize(
    ("url", "editable", "hint"),
    [
        ("", False, "pip install 'magcal-service[sim]'"),
        ("https://example.org/magcal.whl", False, "pip install 'magcal-service[sim]'"),
        ("file:///home/an%20engineer/magcal", True, "pip install -e '/home/an engineer/magcal[sim]'"),
        ("file:///home/an%20engineer/magcal", False, "pip install '/home/an engineer/magcal[sim]'"),
    ],
    ids=["from the index", "from an address", "editable", "from a folder"],
)
def test_the_hint_fits_the_way_it_was_installed(
    monkeypatch: pytest.MonkeyPatch, url: str, editable: bool, hint: str
) -> None:
    monkeypatch.setattr(importlib.metadata, "distribution", lambda _: Installed(url, editable))
    assert how_to_install("sim") == hint
    assert str(ExtraMissingError("sgp4", "sim", "an orbit")).endswith(f"install it with: {hint}")


def test_the_hint_of_a_checkout_that_nobody_installed_names_its_folder(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str) -> Installed:
        raise importlib.metadata.PackageNotFoundError(name)

    monkeypatch.setattr(importlib.metadata, "distribution", missing)
    assert how_to_install("view") == f"pip install -e '{ROOT}[view]'"


def test_the_hint_printed_here_is_one_that_pip_takes() -> None:
    """pip itself resolves the hint's requirement, without installing anything."""
    words = how_to_install("record").split("'")
    command = [sys.executable, "-m", "pip", "install", "--dry-run", "--no-deps", "--no-index", "--no-build-isolation"]
    command += [*words[0].split()[2:], words[1]]
    done = subprocess.run(command, capture_output=True, text=True, timeout=200, check=False)
    assert done.returncode == 0, done.stderr


def test_vectors_are_written_as_csv_without_the_packages_of_recorded_sessions(tmp_path: Path) -> None:
    script = (
        "import sys\nfrom pathlib import Path\n"
        "sys.modules.update(dict.fromkeys(('mcap', 'mcap.writer', 'zstandard')))\n"
        "from magcal_service.offline.vector_file import write_vectors\n"
        "write_vectors(Path(sys.argv[1]), [], {})"
    )
    out = tmp_path / "vectors.csv"
    subprocess.run([sys.executable, "-c", script, str(out)], check=True, timeout=60)
    assert out.read_text().startswith("time,wx_nt,")
