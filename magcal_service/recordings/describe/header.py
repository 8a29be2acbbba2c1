"""A log's line of names, and a line of units under it; whether columns can go by these names."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from magcal_service.recordings.describe.cells import NUMBER, WHITESPACE, is_value, split
from magcal_service.recordings.unit_words import are_units

_MOST_UNNAMED = 40  # cells of a header beyond those of the rows


@dataclass(frozen=True, slots=True)
class Header:
    """What stands above the rows.

    Parameters
    ----------
    names: of the columns from the first on; empty texts where there is none.
    units: what a line of units says; empty where there is none.
    by_name: whether the reader can take columns by these names; else they go by number.
    skip_lines: lines before the header, or before the first row where columns go by number.
    first_row: index of the first row.
    remarks: what was noticed, in sentences.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    by_name: bool
    skip_lines: int
    first_row: int
    remarks: tuple[str, ...]


def find_header(head: Sequence[str], comment: str, delimiter: str, labels: tuple[str, ...]) -> Header:
    """Look upwards from the first row for a line of names.

    Parameters
    ----------
    labels: of the columns of the rows: as many as a row has cells.
    """
    first = next((i for i, line in enumerate(head) if _is_row(line, comment, delimiter, labels)), len(head))
    width = len(labels)
    lines = _name_lines(head[:first], comment, delimiter, width)
    units_at = next((at for at, cells, marked in lines if not marked and are_units(cells)), None)
    if units_at is not None and len(lines) == 1:
        units_at = None  # one line that only looks like units is a line of names
    named = [line for line in lines if line[0] != units_at]
    remarks = [] if units_at is None else [f"line {units_at + 1} holds units, no row"]
    units = next((cells for at, cells, _ in lines if at == units_at), ())
    if not named:
        remarks.append("no line of names: columns go by their number")
        return Header((), units, False, first, first, tuple(remarks))
    at, names, marked = named[0]
    doubt, names = _check(names, width, head[first : first + 50], delimiter)
    if marked:
        remarks.append(f"the names stand in the comment of line {at + 1}: columns go by their number")
    if doubt:
        remarks.append(doubt)
    by_name = not marked and not doubt
    skip = at if by_name else first
    if by_name and comment and all(line.lstrip().startswith(comment) for line in head[:at]):
        skip = 0  # comments are passed over anyway
    return Header(names, units, by_name, skip, first, tuple(remarks))


def _name_lines(
    lines: Sequence[str], comment: str, delimiter: str, width: int
) -> list[tuple[int, tuple[str, ...], bool]]:
    """The lines right above the rows that could be names or units: index, cells, whether it is a comment."""
    found = []
    for at in range(len(lines) - 1, -1, -1):
        line = lines[at]
        if not line.strip():
            continue
        marked = bool(comment) and line.lstrip().startswith(comment)
        cells = _names(line.lstrip()[len(comment) :] if marked else line, delimiter, width)
        if cells is not None:
            found.append((at, cells, marked))
        elif not marked:
            break
        if len(found) == 2:
            break
    return found


def _check(names: tuple[str, ...], width: int, rows: Sequence[str], delimiter: str) -> tuple[str, tuple[str, ...]]:
    """Why columns cannot go by their names, empty where they can; and the names as the columns have them."""
    filled = [name for name in names if name]
    if len(names) < width:
        cells = [row for row in (split(line, delimiter) for line in rows) if row is not None and len(row) == width]
        if all(not cell for row in cells for cell in row[len(names) :]):
            return "", names
        if len(names) == width - 1 and all(row[0].isdecimal() for row in cells):
            text = "the rows begin with a number that the header does not name"
            return f"{text}: columns go by their number", ("", *names)
        return f"the header has {len(names)} names for {width} columns: they are not used", ()
    if len(names) > width:  # the reader would miss cells in every row
        if len(filled) <= width or names[width:] == ("|",):
            return "the header has more cells than the rows: columns go by their number", names[:width]
        return f"the header has {len(filled)} names for {width} columns: they are not used", ()
    if len(set(filled)) < len(filled):
        return "a name stands twice in the header: columns go by their number", names[:width]
    return "", names


def _is_row(line: str, comment: str, delimiter: str, labels: tuple[str, ...]) -> bool:
    if not line.strip() or (comment and line.lstrip().startswith(comment)):
        return False
    cells = split(line, delimiter)
    if cells is None or len(cells) != len(labels):
        return False
    filled = [(cell, label) for cell, label in zip(cells, labels, strict=True) if cell]
    values = sum(is_value(cell) or (bool(label) and cell == label) for cell, label in filled)
    return values * 2 >= len(filled) > 0 and any(NUMBER.match(cell) for cell in cells)


def _names(line: str, delimiter: str, width: int) -> tuple[str, ...] | None:
    """The cells of a line that could hold the names, or the units, of the columns."""
    cells = split(line.strip() if delimiter == WHITESPACE else line.rstrip("\r"), delimiter)
    if cells is None or not width - 1 <= len(cells) <= width + _MOST_UNNAMED:
        return None
    filled = [cell for cell in cells if cell]
    if len(filled) < 2 or sum(bool(NUMBER.fullmatch(cell)) for cell in filled) * 2 >= len(filled):
        return None
    return tuple(cells)
