"""deploy/requirements.lock holds what the base installation needs, each release by its hashes."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

from packaging.requirements import Requirement

ROOT = Path(__file__).resolve().parents[2]
LOCK = (ROOT / "deploy" / "requirements.lock").read_text(encoding="utf-8")
BASE = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["dependencies"]
ENTRIES = {
    match[1]: (match[2], re.findall(r"--hash=(\S+)", match[3]))
    for match in re.finditer(r"^([a-z0-9-]+)==(\S+)((?: \\\n    --hash=\S+)*)$", LOCK, re.MULTILINE)
}


def test_every_base_dependency_is_locked_to_an_accepted_version() -> None:
    """pyproject's requirement accepts the version in the lock file."""
    for text in BASE:
        requirement = Requirement(text)
        version, _ = ENTRIES[requirement.name]
        assert requirement.specifier.contains(version), f"{text} does not accept {version}: make lock"


def test_nothing_else_is_locked() -> None:
    """The base installation needs nothing beyond its own five packages."""
    assert set(ENTRIES) == {Requirement(text).name for text in BASE}
    assert len(ENTRIES) == 5


def test_every_line_of_the_lock_file_is_understood() -> None:
    """No entry without a version, no hash that is not a whole SHA-256, and nothing but these."""
    entries = [line for line in LOCK.splitlines() if not line.startswith((" ", "#"))]
    assert len(entries) == len(ENTRIES)
    for version, hashes in ENTRIES.values():
        assert version
        assert hashes
        assert all(re.fullmatch(r"sha256:[0-9a-f]{64}", one) for one in hashes)
    assert LOCK.count("--hash=") == sum(len(hashes) for _, hashes in ENTRIES.values())
    assert "http" not in LOCK
