"""Which code is broken on purpose, and which tests have to notice."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).resolve().parents[2]


@dataclass(frozen=True, slots=True)
class Room:
    """A part of the core and the tests that are its own.

    Parameters
    ----------
    name: as the table shows it.
    sources: files and folders under the root whose lines are changed.
    tests: files and folders of tests that have to fail then.
    without: parts of ``sources`` that need a link, a terminal or a report to be noticed.
    """

    name: str
    sources: tuple[str, ...]
    tests: tuple[str, ...]
    without: tuple[str, ...] = ()

    def files(self) -> list[Path]:
        """The source files, relative to the root."""
        found = [path for source in self.sources for path in _python(ROOT / source)]
        left_out = {path for part in self.without for path in _python(ROOT / part)}
        return sorted(path.relative_to(ROOT) for path in set(found) - left_out)

    def test_files(self, mutated: Path, root: Path = ROOT) -> tuple[list[str], list[str]]:
        """The room's test files under a root: those that name the mutated module, where most mutants die; the rest."""
        module = mutated.with_suffix("").as_posix().replace("/", ".")
        files = sorted({path for test in self.tests for path in _python(root / test) if path.name.startswith("test_")})
        found: tuple[list[str], list[str]] = ([], [])
        for path in files:
            found[module not in path.read_text(encoding="utf-8")].append(path.relative_to(root).as_posix())
        return found


def _python(path: Path) -> list[Path]:
    return [path] if path.suffix == ".py" else sorted(path.rglob("*.py"))


S: Final = "magcal_service"
ROOMS: Final = (
    Room(
        "model",
        tuple(f"{S}/{name}.py" for name in ("model", "residuals", "base/snapshot", "base/units", "earth/geomagnetic")),
        ("tests/ground", "tests/base", "tests/earth"),
    ),
    Room("ticks", (f"{S}/ticks",), ("tests/ticks",)),
    Room("estimators", (f"{S}/estimators",), ("tests/estimators",)),
    Room("trust", (f"{S}/trust",), ("tests/trust",)),
    Room("watch", (f"{S}/watch",), ("tests/watch",)),
    Room("wire", (f"{S}/wire",), ("tests/wire",)),
    Room(
        "links",
        (f"{S}/links",),
        ("tests/links",),
        tuple(f"{S}/links/{name}.py" for name in ("zenoh", "zenoh_log", "zenoh_session", "zenoh_settings")),
    ),
    Room(
        "checkpoints",
        (f"{S}/daemon/checkpoints",),
        ("tests/daemon/checkpoints", "tests/daemon/test_pipeline_checkpoints.py"),
    ),
    Room(
        "recorder",
        tuple(
            f"{S}/recordings/{name}.py"
            for name in ("recorder", "session_file", "session_files", "mcap_writer", "mcap_reader", "mcap_records")
        ),
        ("tests/recordings",),
    ),
    Room("physics", (f"{S}/physics",), ("tests/physics",)),
    Room("diagnosis", (f"{S}/diagnosis",), ("tests/diagnosis",), (f"{S}/diagnosis/report",)),
)


def room_named(name: str) -> Room:
    """The room of that name; KeyError where there is none."""
    return {room.name: room for room in ROOMS}[name]
