"""Tables of a physics file whose keys are names of blocks: numbers, arrays, or arrays of equally long arrays."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Final

import numpy as np

from magcal_service.base.typed_toml import Table, nearest
from magcal_service.model import Array

MOST_NUMBERS: Final = 64
"""In one block; the largest of the catalogue has 5 x 3."""

_NAME: Final = re.compile(r"[a-z][a-z0-9_]{0,31}")


def named_numbers(table: Table, key: str, known: Mapping[str, str] | None) -> dict[str, float]:
    """The named numbers of a sub-table; names are checked as by ``named_arrays``."""
    found = named_arrays(table, key, known)
    for name, value in found.items():
        if value.ndim:
            table.refuse(f"{key}.{name}", value.tolist(), "one finite number is accepted")
    return {name: float(value) for name, value in found.items() if value.ndim == 0}


def named_arrays(table: Table, key: str, known: Mapping[str, str] | None) -> dict[str, Array]:
    """The named numbers and arrays of a sub-table; names are checked where ``known`` are given."""
    inner = table.table(key)
    if inner is None:
        return {}
    found = {}
    for name in inner.keys():  # noqa: SIM118 - a Table is no mapping
        inner.has(name)
        value = inner.content[name]
        array = array_of(value)
        if known is not None and name not in known:
            inner.refuse(name, value, f"unknown name; {nearest(name, known)}")
        elif known is None and not _NAME.fullmatch(name):
            inner.refuse(name, value, "a name of a-z 0-9 _ is accepted")
        elif array is None:
            inner.refuse(name, value, f"a finite number or an array of at most {MOST_NUMBERS} of them is accepted")
        else:
            found[name] = array
    return found


def array_of(value: object) -> Array | None:
    """A finite number, a list of them, or a list of equally long lists; None for anything else."""
    rows = value if isinstance(value, list) else [value]
    flat = [number for row in rows for number in (row if isinstance(row, list) else [row])]
    if not flat or len(flat) > MOST_NUMBERS or any(isinstance(n, bool) or not isinstance(n, int | float) for n in flat):
        return None
    if len({len(row) if isinstance(row, list) else -1 for row in rows}) > 1:
        return None
    try:
        array = np.array(value, dtype=np.float64)
    except OverflowError:
        return None
    return array if np.isfinite(array).all() else None
