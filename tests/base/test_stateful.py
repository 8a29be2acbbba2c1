"""Nothing that outlives a restart can be forgotten: what a class changes is in its memory, or follows from it."""

from __future__ import annotations

import ast
import importlib
import inspect
import pkgutil
import textwrap
import types
import typing
from collections import Counter, deque
from collections.abc import Iterator
from dataclasses import dataclass, fields, is_dataclass
from enum import StrEnum

import numpy as np
import pytest
from numpy.typing import NDArray

import magcal_service
from magcal_service.base.snapshot import Stateful
from magcal_service.estimators.interface import Estimator
from magcal_service.model import Array

CHANGING = {"append", "appendleft", "extend", "insert", "clear", "update", "pop", "popleft", "popitem", "add", "remove"}
CHANGING |= {"discard", "setdefault", "sort", "reverse", "fill"}
BUILDERS = ("__init__", "restore_state")
"""Methods that make an object of its configuration, or of a memory."""


def stateful() -> list[type[Stateful]]:
    """Every class with a memory, wherever it is."""
    for module in pkgutil.walk_packages(magcal_service.__path__, "magcal_service."):
        if not module.name.endswith("__main__"):
            importlib.import_module(module.name)

    def below(kind: type[Stateful]) -> Iterator[type[Stateful]]:
        for child in kind.__subclasses__():
            if child.__module__.startswith("magcal_service."):
                yield child
                yield from below(child)

    return sorted(set(below(Stateful)), key=lambda kind: kind.__qualname__)


def changed(kind: type) -> set[str]:
    """Attributes of ``self`` that a class's own methods set or change after the construction."""
    tree = ast.parse(textwrap.dedent(inspect.getsource(kind))).body[0]
    assert isinstance(tree, ast.ClassDef)
    found = set()
    for method in tree.body:
        if isinstance(method, ast.FunctionDef) and method.name not in BUILDERS:
            found |= {name for node in ast.walk(method) for name in _changes(node)}
    return found


def _changes(node: ast.AST) -> Iterator[str]:
    if isinstance(node, ast.Assign | ast.AugAssign | ast.AnnAssign | ast.Delete):
        targets = node.targets if isinstance(node, ast.Assign | ast.Delete) else [node.target]
        for target in targets:
            yield from _owned(target)
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr in CHANGING:
        yield from _owned(node.func.value)


def _owned(target: ast.expr) -> Iterator[str]:
    """The attribute of ``self`` that a target belongs to: ``self.x``, ``self.x[i]``, ``a, self.x``."""
    while isinstance(target, ast.Subscript | ast.Starred):
        target = target.value
    if isinstance(target, ast.Tuple | ast.List):
        for part in target.elts:
            yield from _owned(part)
    elif isinstance(target, ast.Attribute) and isinstance(target.value, ast.Name) and target.value.id == "self":
        yield target.attr


def memory(kind: type) -> set[str]:
    return {part.name for part in fields(kind)} if is_dataclass(kind) else set()


@pytest.mark.parametrize("kind", stateful(), ids=lambda kind: kind.__qualname__)
def test_what_a_class_changes_is_in_its_memory_or_worked_out_from_it(kind: type[Stateful]) -> None:
    own = {name for base in kind.__mro__ if base not in (object, Stateful) for name in _changed_of(base)}
    assert own - memory(kind) - set(kind.worked_out) == set()


def _changed_of(base: type) -> set[str]:
    return changed(base) if issubclass(base, Stateful) else set()


@pytest.mark.parametrize("kind", stateful(), ids=lambda kind: kind.__qualname__)
def test_what_is_worked_out_is_no_memory_and_is_really_changed(kind: type[Stateful]) -> None:
    assert not set(kind.worked_out) & memory(kind)
    assert set(kind.worked_out) <= {name for base in kind.__mro__ for name in _changed_of(base)}


def unsavable(hint: typing.Any, of: str) -> Iterator[str]:
    """Parts of a hint whose values ``plain`` cannot write or ``restored`` cannot read, after the name they are part of.

    An estimator is restored into the one that is in its place.
    """
    kind, arguments = typing.get_origin(hint) or hint, typing.get_args(hint)
    if kind in (typing.Union, types.UnionType):
        several = [one for one in arguments if one is not types.NoneType]
        yield from [of] if len(several) > 1 else unsavable(several[0], of)
    elif hint in (Array, NDArray[np.bool_], bool, int, float, str, Estimator) or isinstance(hint, typing.TypeVar):
        return
    elif kind in (list, tuple, deque, dict, Counter) or (inspect.isclass(kind) and issubclass(kind, Stateful)):
        for part in arguments:
            yield from unsavable(part, of) if part is not Ellipsis else ()
    elif is_dataclass(kind) and isinstance(kind, type):
        hints = typing.get_type_hints(kind)
        for field in fields(kind):
            yield from unsavable(hints[field.name], f"{of}.{field.name}")
    elif not (inspect.isclass(kind) and issubclass(kind, StrEnum)):
        yield of


@pytest.mark.parametrize("kind", stateful(), ids=lambda kind: kind.__qualname__)
def test_whatever_a_memory_may_hold_can_be_saved_and_restored(kind: type[Stateful]) -> None:
    hints = typing.get_type_hints(kind)
    assert [found for name in sorted(memory(kind)) for found in unsavable(hints[name], name)] == []


@dataclass
class _Sliced:
    count: int
    states: slice | None


def test_a_part_of_a_memory_that_cannot_be_saved_is_seen() -> None:
    assert list(unsavable(dict[str, list[_Sliced]] | None, "rows")) == ["rows.states"]
    assert list(unsavable(int | str, "number")) == ["number"]


def test_every_class_with_a_memory_is_looked_at() -> None:
    assert len(stateful()) >= 28


class _Forgetful(Stateful):
    """A class that forgets."""

    def handle(self) -> None:
        """Change three attributes in three ways."""
        self.count = 1
        self.rows[0], self.other = 2, 3  # type: ignore[attr-defined]
        self.names.append("x")  # type: ignore[attr-defined]


def test_a_forgotten_attribute_is_seen() -> None:
    assert changed(_Forgetful) == {"count", "rows", "other", "names"}
