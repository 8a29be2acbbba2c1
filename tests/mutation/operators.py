"""What is done to a line: cosmic-ray's operators, one replacement for each, and calls that are left out."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final

import parso
from cosmic_ray.operators.operator import Example, Operator
from cosmic_ray.plugins import get_operator

_BINARY: Final = {"Add": "Sub", "Sub": "Add", "Mul": "Div", "Div": "Mul", "Mod": "FloorDiv", "FloorDiv": "Mul"}
_COMPARISON: Final = {"Eq": "NotEq", "NotEq": "Eq", "Is": "IsNot", "IsNot": "Is"}
_ORDER: Final = {"Lt": ("LtE", "GtE"), "LtE": ("Lt", "Gt"), "Gt": ("GtE", "LtE"), "GtE": ("Gt", "Lt")}
"""An order is moved to its boundary and turned round."""

_OTHERS: Final = (
    "ReplaceTrueWithFalse",
    "ReplaceFalseWithTrue",
    "ReplaceAndWithOr",
    "ReplaceOrWithAnd",
    "ReplaceBreakWithContinue",
    "ReplaceContinueWithBreak",
    "ExceptionReplacer",
    "NumberReplacer",
    "ZeroIterationForLoop",
    "ReplaceUnaryOperator_Delete_USub",
    "ReplaceUnaryOperator_Delete_Not",
    "AddNot",
)


class LeaveOutCall(Operator):  # type: ignore[misc]  # the package has no types
    """A statement that is a call alone becomes ``pass``: no fsync, no append, no check."""

    def mutation_positions(self, node: Any) -> Iterator[tuple[tuple[int, int], tuple[int, int]]]:
        """Where such a statement stands."""
        if self._is_call(node):
            yield node.start_pos, node.end_pos

    @staticmethod
    def _is_call(node: Any) -> bool:
        """A docstring is no call, nor is what is assigned, returned or awaited."""
        if node.type != "atom_expr" or node.parent is None or node.parent.type != "simple_stmt":
            return False
        last = node.children[-1]
        return bool(last.type == "trailer" and last.children[0].value == "(")

    def mutate(self, node: Any, index: int) -> Any:
        """``pass`` in its place, with what stands before it."""
        return parso.python.tree.Keyword("pass", node.start_pos, prefix=node.get_first_leaf().prefix)

    @classmethod
    def examples(cls) -> tuple[Example, ...]:
        """What it makes of a line."""
        return (Example("file.flush()\n", "pass\n"),)


def operators() -> dict[str, Operator]:
    """Every operator by name."""
    names = [f"ReplaceBinaryOperator_{a}_{b}" for a, b in _BINARY.items()]
    names += [f"ReplaceComparisonOperator_{a}_{b}" for a, b in _COMPARISON.items()]
    names += [f"ReplaceComparisonOperator_{a}_{b}" for a, into in _ORDER.items() for b in into]
    found = {name: get_operator(f"core/{name}")() for name in (*names, *_OTHERS)}
    return {**found, "LeaveOutCall": LeaveOutCall()}
