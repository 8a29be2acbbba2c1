"""Every numeric constant says why it has the value it has: in a comment at it or above it, or in a docstring below."""

from __future__ import annotations

import ast
import io
import tokenize
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SOURCES = sorted(path for package in ("magcal_service", "sim_sensor") for path in (ROOT / package).rglob("*.py"))


def is_numeric(value: ast.expr) -> bool:
    """Whether an expression is written with numbers alone: a number, arithmetic that holds one, a tuple of such."""
    match value:
        case ast.Constant(value=constant):
            return isinstance(constant, int | float) and not isinstance(constant, bool)
        case ast.UnaryOp(operand=operand):
            return is_numeric(operand)
        case ast.BinOp(left=left, right=right):
            return is_numeric(left) or is_numeric(right)
        case ast.Tuple(elts=parts) | ast.List(elts=parts):
            return bool(parts) and all(map(is_numeric, parts))
    return False


def constant_names(statement: ast.stmt) -> list[str]:
    """Names that a statement gives a numeric constant, in upper case or ``Final``; none where it does not."""
    match statement:
        case ast.AnnAssign(target=ast.Name(id=name), annotation=annotation, value=ast.expr() as value):
            names, final = [name], "Final" in ast.unparse(annotation)
        case ast.Assign(targets=targets, value=value):
            inner = [
                part for target in targets for part in (target.elts if isinstance(target, ast.Tuple) else [target])
            ]
            names, final = [part.id for part in inner if isinstance(part, ast.Name)], False
        case _:
            return []
    return names if is_numeric(value) and (final or all(name.strip("_").isupper() for name in names)) else []


def constants(body: list[ast.stmt]) -> Iterator[tuple[str, ast.stmt, ast.stmt | None]]:
    """Names, statement and the one after it, of the constants of a module or class and of the classes in it."""
    for statement, after in zip(body, [*body[1:], None], strict=True):
        if isinstance(statement, ast.ClassDef):
            yield from constants(statement.body)
        elif names := constant_names(statement):
            yield ", ".join(names), statement, after


def comment_lines(source: str) -> tuple[set[int], set[int]]:
    """Line numbers with a comment after code, and those with a comment alone."""
    beside, alone = set(), set()
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT:
            (beside if token.line[: token.start[1]].strip() else alone).add(token.start[0])
    return beside, alone


def without_reason(source: str) -> list[str]:
    """``line NAME`` of each constant of a module that says nothing of its value."""
    found = list(constants(ast.parse(source).body))
    beside, alone = comment_lines(source) if found else (set(), set())
    bare = []
    for names, statement, after in found:
        match after:
            case ast.Expr(value=ast.Constant(value=str())):
                continue
        lines = range(statement.lineno, (statement.end_lineno or statement.lineno) + 1)
        if not beside.intersection(lines) and statement.lineno - 1 not in alone:
            bare.append(f"{statement.lineno} {names}")
    return bare


def test_every_numeric_constant_has_its_reason() -> None:
    assert len(SOURCES) > 200
    found = {str(path.relative_to(ROOT)): without_reason(path.read_text(encoding="utf-8")) for path in SOURCES}
    assert {path: lines for path, lines in found.items() if lines} == {}


@pytest.mark.parametrize(
    "source",
    [
        "LIMIT = 3.0",
        "LIMIT: Final = -3",
        "_LIMIT: Final[int] = 3",
        "low, HIGH = 1, 2\nA, B = 1, 2",
        "SPAN: Final = (1.0, 2.0)",
        "SPAN: Final = 2.0 * OTHER",
        "class Levels:\n    limit: Final = 3.0",
        '"""A docstring above is the module\'s."""\nLIMIT = 3.0',
        "# a comment two lines above\n\nLIMIT = 3.0",
        "OTHER = 'x'  # a comment beside the line above is that line's\nLIMIT = 3.0",
        "LIMIT = 3.0\nTEXT = '# no comment'",
    ],
)
def test_a_constant_without_a_reason_is_found(source: str) -> None:
    assert len(without_reason(source)) == 1


@pytest.mark.parametrize(
    "source",
    [
        "LIMIT = 3.0  # why",
        "# why\nLIMIT = 3.0",
        'LIMIT = 3.0\n"""Why."""',
        "SPAN: Final = (\n    1.0,  # why\n    2.0,\n)",
        "class Levels:\n    limit: Final = 3.0  # why",
        "name = 3.0",
        "FLAG = True",
        "NAME: Final = 'x'",
        "def function() -> None:\n    LIMIT = 3.0",
    ],
)
def test_what_has_a_reason_or_is_no_constant_passes(source: str) -> None:
    assert without_reason(source) == []
