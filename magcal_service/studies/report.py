"""What a study found: tables and curves -> JSON and Markdown.  No number is made here."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from magcal_service.base.errors import unwritable
from magcal_service.base.version import __version__

Cell = str | int | float | bool | None


@dataclass(frozen=True, slots=True)
class Table:
    """Rows of numbers and words under a title.

    Parameters
    ----------
    title: one line.
    columns: heads of the columns.
    rows: one cell per column; None and nan are shown as a dash.
    """

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]

    def markdown(self) -> str:
        """The table under a heading."""
        lines = [f"### {self.title}", "", "| " + " | ".join(self.columns) + " |", "|" + "---|" * len(self.columns)]
        lines += ["| " + " | ".join(shown(cell) for cell in row) + " |" for row in self.rows]
        return "\n".join(lines)


@dataclass(frozen=True, slots=True)
class Line:
    """One line of a picture: label, points, and whether it is a limit (drawn dashed)."""

    label: str
    x: tuple[float, ...]
    y: tuple[float, ...]
    limit: bool = False


@dataclass(frozen=True, slots=True)
class Panel:
    """One panel of a picture; ``log_x`` and ``log_y`` make its scales logarithmic."""

    title: str
    x_label: str
    y_label: str
    lines: tuple[Line, ...]
    log_x: bool = False
    log_y: bool = False


@dataclass(frozen=True, slots=True)
class Grid:
    """Time by the classes of two quantities; only classes with time in them.

    Parameters
    ----------
    title: one line.
    x_label, y_label: what the classes are of, with units.
    cells: x from and to, y from and to, and the time in it [s], of each class.
    """

    title: str
    x_label: str
    y_label: str
    cells: tuple[tuple[float, float, float, float, float], ...]


@dataclass(frozen=True, slots=True)
class Findings:
    """What the study itself hands back.

    Parameters
    ----------
    tables, panels: for people; all their numbers are in the JSON, too.
    grids: for `magcal plot`, in the JSON alone.
    figures: the few numbers that the study is for, by name.
    settings: what it was run with, beside runs and seed.
    notes: what a reader has to know to read the tables rightly.
    """

    tables: tuple[Table, ...]
    figures: dict[str, Cell]
    settings: dict[str, Cell]
    notes: tuple[str, ...] = ()
    panels: tuple[Panel, ...] = ()
    grids: tuple[Grid, ...] = ()


@dataclass(frozen=True, slots=True)
class Report:
    """A study that was run: its findings, and how to get them again.

    Parameters
    ----------
    study, summary: its name and what it asks.
    runs, seed, command: how it was run; None where nothing was drawn.
    seconds: how long it took [s]; the only number that differs from run to run.
    """

    study: str
    summary: str
    runs: int | None
    seed: int | None
    command: str
    seconds: float
    findings: Findings

    def as_json(self) -> str:
        """The report as JSON; nan and infinities become null."""
        findings = self.findings
        content: dict[str, Any] = {
            "study": self.study,
            "version": __version__,
            "command": self.command,
            "runs": self.runs,
            "seed": self.seed,
            "seconds": round(self.seconds, 1),
            "settings": findings.settings,
            "figures": findings.figures,
            "tables": [
                {"title": table.title, "columns": table.columns, "rows": table.rows} for table in findings.tables
            ],
            "curves": [
                {
                    "title": panel.title,
                    "x": panel.x_label,
                    "y": panel.y_label,
                    "log_x": panel.log_x,
                    "log_y": panel.log_y,
                    "lines": [
                        {"label": line.label, "x": line.x, "y": line.y, "limit": line.limit} for line in panel.lines
                    ],
                }
                for panel in findings.panels
            ],
            "notes": findings.notes,
        }
        if findings.grids:
            content["grids"] = [
                {"title": grid.title, "x": grid.x_label, "y": grid.y_label, "cells": grid.cells}
                for grid in findings.grids
            ]
        return json.dumps(_plain(content), indent=1, allow_nan=False, ensure_ascii=False) + "\n"

    def markdown(self, picture: str = "") -> str:
        """The report as a page; ``picture`` is the file name of its plot, empty where there is none."""
        findings = self.findings
        parts = [f"# Study `{self.study}`", self.summary, self._how()]
        parts += [table.markdown() for table in findings.tables]
        if findings.figures:
            parts.append("\n".join(["### Figures", "", *(_item(entry) for entry in findings.figures.items())]))
        if findings.notes:
            parts.append("\n".join(["### Notes", "", *(f"- {note}" for note in findings.notes)]))
        if picture:
            parts.append(f"![{self.study}]({picture})")
        return "\n\n".join(parts) + "\n"

    def _how(self) -> str:
        settings = "; ".join(f"{name} {shown(value)}" for name, value in self.findings.settings.items())
        return f"```\n{self.command}\n```\n\nmagcal {__version__}, {self.seconds:.0f} s. Settings: {settings}."


def write(path: Path, text: str) -> None:
    """Write a text file; raises InputRefusedError where that can't be done."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    except OSError as exc:
        raise unwritable(path, exc) from None


def shown(cell: Cell) -> str:
    """A cell as text: four figures for numbers, a dash where there is none."""
    if cell is None or (isinstance(cell, float) and not math.isfinite(cell)):
        return "-"
    if isinstance(cell, bool):
        return "yes" if cell else "no"
    if isinstance(cell, float):
        return f"{cell:.1f}" if 1000.0 <= abs(cell) < 1e6 else f"{cell:.3g}"
    return str(cell)


def _item(entry: tuple[str, Cell]) -> str:
    return f"- {entry[0]}: {shown(entry[1])}"


def _plain(value: Any) -> Any:
    """numpy numbers as Python's, what is not finite as None."""
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [_plain(item) for item in value]
    if isinstance(value, np.generic):
        return _plain(value.item())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
