"""docs/security.md names tests and counters that exist."""

from __future__ import annotations

import re
from pathlib import Path

from magcal_service.links.zenoh_log import DENIALS
from magcal_service.wire.seal import SEAL_REFUSALS

ROOT = Path(__file__).resolve().parents[2]
TEXT = (ROOT / "docs" / "security.md").read_text(encoding="utf-8")
TESTS = {path.name: path.read_text(encoding="utf-8") for path in (ROOT / "tests").rglob("test_*.py")}


def test_every_test_it_names_is_there() -> None:
    """A row whose test has been renamed or removed proves nothing."""
    functions = set(re.findall(r"\b(test_\w+)\b(?!\.py)", TEXT))
    files = set(re.findall(r"\b(test_\w+\.py)\b", TEXT))
    defined = {name for text in TESTS.values() for name in re.findall(r"^ *def (test_\w+)", text, re.MULTILINE)}
    assert files <= set(TESTS)
    assert functions <= defined
    assert len(functions) >= 12


def test_every_denial_is_in_the_table() -> None:
    """Each thing that can be counted at the door stands in the threat model or in docs/links.md."""
    links = (ROOT / "docs" / "links.md").read_text(encoding="utf-8")
    assert [name for name in DENIALS if f"denied.{name}`" not in links] == []
    told = set(re.findall(r"`(?:link\.denied\.)?(\w+)`", TEXT)) | set(
        re.findall(r"link\.(?:denied|refused)\.(\w+)", TEXT)
    )
    assert {"no_certificate", "wrong_certificate", "expired_certificate", "password", "no_role"} <= told
    assert {"unsealed", "bad_seal", "replayed"} <= told & set(SEAL_REFUSALS)
