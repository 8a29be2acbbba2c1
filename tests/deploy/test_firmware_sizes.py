"""The table of sizes in the kit's page is what its compilers make of the headers today."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest

KIT = Path(__file__).resolve().parents[2] / "deploy/firmware"
VERSIONS = {"arm-none-eabi-gcc": "12.", "avr-gcc": "5.4."}
"""Those whose sizes the page has; another compiler makes other code."""

ROW = re.compile(r"\| (Cortex-M|AVR).*\d \|")


@pytest.mark.skipif(shutil.which("make") is None, reason="make is not installed")
def test_the_page_has_the_sizes_that_its_compilers_make() -> None:
    for compiler, version in VERSIONS.items():
        if shutil.which(compiler) is None:
            pytest.skip(f"{compiler} is not installed")
        found = subprocess.run([compiler, "-dumpversion"], capture_output=True, text=True, check=True).stdout
        if not found.startswith(version):
            pytest.skip(f"the page's table is of {compiler} {version}, here is {found.strip()}")
    made = subprocess.run(["make", "-s", "-C", KIT, "sizes"], capture_output=True, text=True, check=True).stdout
    page = (KIT / "README.md").read_text(encoding="utf-8")
    assert rows(page) == rows(made)


def rows(text: str) -> list[str]:
    """Lines of the table of sizes, each with one space between its words."""
    table = text[text.index("| target | samples out") :]
    return [" ".join(line.split()) for line in table.splitlines() if ROW.match(line)]
