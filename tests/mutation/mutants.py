"""Single changes of the code, drawn by seed, and whether the tests of the room notice."""

from __future__ import annotations

import ast
import contextlib
import math
import os
import random
import resource
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
BY_TIME: Final = "time"  # what noticed a mutant whose run came to no end
SLOWER: Final = 3.0  # a mutant's run may take this multiple of the processor time that it takes without the mutant
STARTING_S: Final = (
    60.0  # and this much more: a short run is mostly imports, which vary with what else the machine does
)
LONGEST_TEST_S: Final = 1200  # of wall clock in one test that waits for ever; the longest take 30 s on an idle machine

_NOT_UNDERSTOOD: Final = 4  # exit status of pytest: its arguments, a missing file among them
_NO_TESTS: Final = 5  # exit status of pytest


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
    """What became of a mutant.

    Parameters
    ----------
    killed_by: the test that noticed it, `BY_TIME` where the run came to no end, empty where it lived.
    seed: what it was drawn by.
    at_first: whether it was noticed before tests were added for it.
    """

    room: str
    mutant: Mutant
    killed_by: str
    seed: int
    at_first: bool

    def as_dict(self) -> dict[str, Any]:
        """Plain data for the results' file."""
        own = asdict(self)
        return {**own.pop("mutant"), **own}


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


def located(mutant: Mutant) -> Mutant | None:
    """The same change of a file that may have been edited since; None where that line stands there no more."""
    if not (ROOT / mutant.file).is_file():
        return None
    places = (place for place in _places(Path(mutant.file)) if place[1] == mutant.operator)
    found = (_mutant(*place) for place in places)
    same = [one for one in found if one and (one.before, one.after) == (mutant.before, mutant.after)]
    return min(same, key=lambda one: abs(one.line - mutant.line), default=None)


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
    """The mutant of a place; None where only an annotation changes or what comes out is no Python."""
    source = (ROOT / file).read_text(encoding="utf-8")
    try:
        changed = mutate_code(source, operators()[operator], occurrence)
        if changed is None or _meaning(changed) == _meaning(source):
            return None
    except (AttributeError, SyntaxError):  # the operator for exceptions takes names without dots only
        return None
    lines, others = source.splitlines(), changed.splitlines()
    number = next((i for i, (a, b) in enumerate(zip(lines, others, strict=False)) if a != b), 0)
    return Mutant(file.as_posix(), operator, occurrence, number + 1, lines[number].strip(), others[number].strip())


def _meaning(source: str) -> str:
    """The syntax tree without annotations and a signature's ``*`` and ``/``; SyntaxError where it is no Python."""
    tree = ast.parse(source)
    for node in ast.walk(tree):
        if isinstance(node, ast.arg):
            node.annotation = None
        elif isinstance(node, ast.arguments):
            node.posonlyargs, node.args, node.kwonlyargs = [], [*node.posonlyargs, *node.args, *node.kwonlyargs], []
            node.defaults, node.kw_defaults = [*node.defaults, *filter(None, node.kw_defaults)], []
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

    def processor_time(self, room: Room) -> float:
        """[s] of processor that the room's tests take without a mutant; RuntimeError where one of them fails."""
        before = _children_s()
        near, others = room.test_files(room.files()[0], self.folder)
        failed = self._first_failure([*near, *others])
        if failed:
            raise RuntimeError(f"{room.name}: {failed} fails without a mutant")
        return _children_s() - before

    def try_out(self, room: Room, mutant: Mutant, processor_s: float) -> str:
        """What notices the mutant: run the room's tests with it in place, up to the first that fails.

        Files that do not name the mutant's module are only collected where those that do let it live.

        Parameters
        ----------
        processor_s: what they take without it. Time is the processor's, so that a loaded machine notices no mutants.
        """
        path = self.folder / mutant.file
        source = path.read_text(encoding="utf-8")
        changed = mutate_code(source, operators()[mutant.operator], mutant.occurrence)
        assert changed is not None
        path.write_text(changed, encoding="utf-8")
        try:
            parts = [part for part in room.test_files(Path(mutant.file), self.folder) if part]
            failures = (self._sure_failure(part, SLOWER * processor_s + STARTING_S) for part in parts)
            return next(filter(None, failures), "")
        finally:
            path.write_text(source, encoding="utf-8")

    def _sure_failure(self, tests: list[str], longest_s: float) -> str:
        """The first test that fails twice: one that waits for another process may fail once by a loaded machine."""
        left_out: list[str] = []
        while failed := self._first_failure([*tests, *left_out], longest_s):
            function = failed.partition("[")[0]
            if "::" not in function or self._first_failure([function], longest_s):
                return failed
            left_out += ["--deselect", function]
        return ""

    def _first_failure(self, tests: list[str], longest_s: float | None = None) -> str:
        waiting = f"--timeout={LONGEST_TEST_S}"
        command = [sys.executable, "-m", "pytest", "-x", "-n", "0", "--tb=no", "-p", "no:randomly", waiting, *tests]
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
            if longest_s is not None:  # those that it starts inherit the limit, each for itself
                resource.prlimit(process.pid, resource.RLIMIT_CPU, (math.ceil(longest_s),) * 2)
            output, _ = process.communicate()
        finally:
            _end(process)
        return _noticed(process.returncode, output)


def _noticed(status: int, output: str) -> str:
    """What ended a run of pytest with that exit status and output: a test, time, or nothing.

    RuntimeError where it did not run at all: a file that is not there would notice every mutant.
    """
    if status == 0:
        return ""
    failed = [line for line in output.splitlines() if line.startswith(("FAILED ", "ERROR "))]
    if status in (_NOT_UNDERSTOOD, _NO_TESTS) and "while loading conftest" not in output:
        raise RuntimeError(f"pytest did not run: {output}")
    if not failed:
        return BY_TIME if status in (-signal.SIGXCPU, -signal.SIGKILL) else "the run itself"
    return BY_TIME if "Timeout (>" in failed[0] else failed[0].split(" ")[1]


def _children_s() -> float:
    """[s] of processor that the ended children have used."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _end(process: subprocess.Popen[str]) -> None:
    """End the run with all that it started."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()
