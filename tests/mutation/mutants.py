"""Single changes of the code, drawn by seed, and whether the tests of the room notice."""

from __future__ import annotations

import ast
import contextlib
import os
import random
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import mutate_code

from tests.mutation.operators import operators
from tests.mutation.rooms import ROOT, Room

COPIED: Final = ("magcal_service", "sim_sensor", "tests", "docs", "deploy", "pyproject.toml", "README.md", "Makefile")
LONGEST_S: Final = 300.0  # of one room's tests with a mutant in: what takes longer counts as noticed


@dataclass(frozen=True, slots=True)
class Mutant:
    """One change: file, operator, which of its places, line (from 1), and the line before and after."""

    file: str
    operator: str
    occurrence: int
    line: int
    before: str
    after: str

    @property
    def text(self) -> str:
        """The change in one line."""
        return f"{self.file}:{self.line} `{self.before}` -> `{self.after}`"


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of a mutant: the test that noticed it, or none."""

    room: str
    mutant: Mutant
    killed_by: str

    def as_dict(self) -> dict[str, Any]:
        """Plain data for the results' file."""
        return {"room": self.room, "killed_by": self.killed_by, **asdict(self.mutant)}


def drawn(room: Room, count: int, seed: int) -> list[Mutant]:
    """``count`` mutants of a room, each of its places as likely as the others; all of them where it has fewer."""
    places = [place for file in room.files() for place in _places(file)]
    random.Random(f"{room.name} {seed}").shuffle(places)
    found = []
    for file, operator, occurrence in places:
        mutant = _mutant(file, operator, occurrence)
        if mutant is not None:
            found.append(mutant)
        if len(found) == count:
            break
    return found


def _places(file: Path) -> Iterator[tuple[Path, str, int]]:
    source = (ROOT / file).read_text(encoding="utf-8")
    tree, silent = get_ast(source), _silent_lines(source)
    for name, operator in operators().items():
        positions = (start for node in ast_nodes(tree) for start, _ in operator.mutation_positions(node))
        for occurrence, (line, _) in enumerate(positions):
            if line not in silent:
                yield file, name, occurrence


def _silent_lines(source: str) -> set[int]:
    """Lines that decide nothing: imports, ``__all__``, blocks for type checkers, and the words of a refusal.

    So do the arguments of ``@dataclass``: ``frozen`` and ``slots`` keep authors from mistakes and save memory, and no
    result depends on them.
    """
    silent: set[int] = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ClassDef):
            silent |= {line for decorator in node.decorator_list for line in _lines(decorator)}
        named = isinstance(node, ast.Assign) and any(ast.unparse(target) == "__all__" for target in node.targets)
        typing_only = isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"
        if named or typing_only or isinstance(node, ast.Import | ast.ImportFrom | ast.Raise):
            silent |= set(_lines(node))
    return silent


def _lines(node: ast.stmt | ast.expr) -> range:
    return range(node.lineno, (node.end_lineno or node.lineno) + 1)


def _mutant(file: Path, operator: str, occurrence: int) -> Mutant | None:
    """The mutant of a place; None where nothing but an annotation or a text's spelling changes."""
    source = (ROOT / file).read_text(encoding="utf-8")
    try:
        changed = mutate_code(source, operators()[operator], occurrence)
    except AttributeError:  # the operator for exceptions takes names without dots only
        return None
    if changed is None or _meaning(changed) == _meaning(source):
        return None
    lines, others = source.splitlines(), changed.splitlines()
    number = next((i for i, (a, b) in enumerate(zip(lines, others, strict=False)) if a != b), 0)
    return Mutant(file.as_posix(), operator, occurrence, number + 1, lines[number].strip(), others[number].strip())


def _meaning(source: str) -> str:
    """The syntax tree without annotations; the text itself where it is no Python any more."""
    try:
        tree = ast.parse(source)
    except SyntaxError:
        return source
    for node in ast.walk(tree):
        if isinstance(node, ast.arg):
            node.annotation = None
        elif isinstance(node, ast.FunctionDef):
            node.returns = None
        elif isinstance(node, ast.AnnAssign):
            node.annotation = ast.Constant(None)
    return ast.dump(tree)


class Bench:
    """A copy of the checkout in which one file at a time is changed.

    Parameters
    ----------
    folder: where the copy is made.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder / "checkout"
        self.folder.mkdir(parents=True)
        (folder / "shared").symlink_to(ROOT.parent / "shared")  # recordings, where a machine has them
        for name in COPIED:
            if (ROOT / name).is_dir():
                shutil.copytree(ROOT / name, self.folder / name, ignore=shutil.ignore_patterns("__pycache__"))
            else:
                shutil.copy2(ROOT / name, self.folder / name)

    def try_out(self, room: Room, mutant: Mutant) -> Outcome:
        """Run the room's tests with the mutant in place, up to the first that fails."""
        path = self.folder / mutant.file
        source = path.read_text(encoding="utf-8")
        changed = mutate_code(source, operators()[mutant.operator], mutant.occurrence)
        assert changed is not None
        path.write_text(changed, encoding="utf-8")
        try:
            killed_by = self._first_failure(room.test_files(Path(mutant.file)))
        finally:
            path.write_text(source, encoding="utf-8")
        return Outcome(room.name, mutant, killed_by)

    def _first_failure(self, tests: list[str]) -> str:
        command = [sys.executable, "-m", "pytest", "-x", "-n", "0", "--tb=no", "-p", "no:randomly", *tests]
        paths = os.pathsep.join((str(self.folder), str(self.folder / "tests/links")))
        environment = {**os.environ, "PYTHONPATH": paths, "PYTHONDONTWRITEBYTECODE": "1"}
        process = subprocess.Popen(
            command,
            cwd=self.folder,
            env=environment,
            text=True,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
        try:
            output, _ = process.communicate(timeout=LONGEST_S)
        except subprocess.TimeoutExpired:
            return "timeout"
        finally:
            _end(process)
        if process.returncode == 0:
            return ""
        failed = [line for line in output.splitlines() if line.startswith(("FAILED ", "ERROR "))]
        return failed[0].split(" ")[1] if failed else "the run itself"


def _end(process: subprocess.Popen[str]) -> None:
    """End the run with all that it started."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()
