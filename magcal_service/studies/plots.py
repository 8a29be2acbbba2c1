"""The curves of a study as a picture (extra ``view``)."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from magcal_service.errors import ExtraMissingError, unwritable
from magcal_service.studies.report import Panel

if TYPE_CHECKING:
    from collections.abc import Sequence

_COLOURS: Final = ("#1f5fa8", "#b3261e", "#2e7d32", "#8e5bb5", "#c77700", "#00838f", "#6b6b6b", "#ad1457")
_LIMIT_COLOUR: Final = "#333333"
_COLUMNS: Final = 3
"""Panels side by side; choice: 14 inches wide, still legible on a page."""


def plot(panels: Sequence[Panel], title: str, path: Path) -> None:
    """Write the panels as one PNG.

    Raises ExtraMissingError without matplotlib, InputRefusedError where the file can't be written.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError as exc:
        raise ExtraMissingError(exc.name or "matplotlib", "view", "the picture of a study") from None
    columns = min(_COLUMNS, len(panels))
    rows = math.ceil(len(panels) / columns)
    figure = Figure(figsize=(4.6 * columns, 3.4 * rows + 0.4), layout="constrained")
    grid = figure.subplots(rows, columns, squeeze=False)
    for axes, panel in zip(grid.flat, panels, strict=False):
        _draw(axes, panel)
    for axes in list(grid.flat)[len(panels) :]:
        axes.set_visible(False)
    figure.suptitle(title)
    try:
        figure.savefig(path, dpi=100, metadata={"Software": None})
    except OSError as exc:
        raise unwritable(path, exc) from None


def _draw(axes: Any, panel: Panel) -> None:
    for i, line in enumerate(panel.lines):
        colour = _LIMIT_COLOUR if line.limit else _COLOURS[i % len(_COLOURS)]
        style, marker = ("--", "") if line.limit else ("-", "o" if len(line.x) < 40 else "")
        axes.plot(line.x, line.y, color=colour, linestyle=style, marker=marker, markersize=3, label=line.label, lw=1.2)
    axes.set_title(panel.title, fontsize=10)
    axes.set_xlabel(panel.x_label)
    axes.set_ylabel(panel.y_label)
    if panel.log_x:
        axes.set_xscale("log")
    if panel.log_y:
        axes.set_yscale("log")
    axes.grid(alpha=0.3)
    axes.legend(fontsize=7)
