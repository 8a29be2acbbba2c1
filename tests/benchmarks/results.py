"""Where a benchmark leaves its figures, so that no table of the documentation is written by hand."""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

FOLDER: Final = Path(__file__).resolve().parents[2] / "docs/results"


def write(path: Path | None, figures: Mapping[str, Any]) -> None:
    """Figures with the command and the day that gave them; nothing where ``path`` is None."""
    if path is None:
        return
    module = Path(sys.argv[0]).stem
    words = [_of_any_machine(word) for word in sys.argv[1:] if word not in ("--json", str(path))]
    content = {
        "command": " ".join(["python -m", f"tests.benchmarks.{module}", *words]),
        "date": time.strftime("%Y-%m-%d", time.gmtime()),
        "cores": os.cpu_count(),
        "figures": dict(figures),
    }
    path.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def _of_any_machine(word: str) -> str:
    """A word of a command, a path as seen from the project."""
    return os.path.relpath(word, FOLDER.parents[1]) if os.path.isabs(word) else word


def read(name: str) -> dict[str, Any]:
    """What ``write`` left in ``docs/results`` under a name."""
    content: dict[str, Any] = json.loads((FOLDER / f"{name}.json").read_text(encoding="utf-8"))
    return content
