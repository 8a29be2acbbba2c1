"""Every example of docs/python.md runs, in order, as a reader would type it."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

PAGE = Path(__file__).resolve().parents[2] / "docs/python.md"
EXAMPLES = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)

BASE = """
import sys
for name in "ppigrf pandas polars pyarrow scipy matplotlib jinja2 rich sgp4 mcap zstandard".split():
    sys.modules[name] = None  # an extra that is not installed
"""


def run(code: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=200, check=False)


def test_every_example_runs_on_the_base_installation() -> None:
    done = run(BASE + "\n".join(EXAMPLES))
    assert done.returncode == 0, done.stderr
    printed = done.stdout
    assert "Fit of 2000 samples" in printed
    assert "no sound solution fits 2000 samples" in printed
    assert "Recording arrays: 2000 samples" in printed
    assert "trusted ()" in printed
    assert "Diagnosis: none" in printed


def test_the_page_has_an_example_for_every_function() -> None:
    text = "\n".join(EXAMPLES)
    for name in (
        "fit",
        "calibrate",
        "replay",
        "diagnose",
        "Pipeline",
        "Recording.from_arrays",
        "Recording.from_dataframe",
    ):
        assert f"magcal.{name}(" in text
