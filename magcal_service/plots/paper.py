"""The sheet that figures are drawn on, and the file it becomes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from magcal_service.base.errors import ExtraMissingError, Fault, InputRefusedError, unwritable
from magcal_service.base.progress import Work, counted
from magcal_service.views.colours import LIGHT

BEFORE: Final = LIGHT["before"]
AFTER: Final = LIGHT["after"]
QUIET: Final = LIGHT["soft"]
COAST: Final = "#a1a1aa"
LINES: Final = (AFTER, BEFORE, "#15803d", "#7e22ce", "#a16207", "#0e7490", "#be185d", QUIET)
"""Told apart by their lightness too, so that a figure printed without colour is read."""

SUFFIXES: Final = (".svg", ".pdf", ".png")

_POINTS: Final = 4000
"""Points drawn of a long curve; choice: several for each pixel of a figure's width."""

_STYLE: Final[dict[Any, Any]] = {
    "font.size": 9,
    "axes.titlesize": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.alpha": 0.3,
    "grid.linewidth": 0.6,
    "axes.axisbelow": True,
    "legend.frameon": False,
    "legend.fontsize": 8,
    "lines.linewidth": 1.2,
    "pdf.fonttype": 42,
    "svg.fonttype": "none",
    "svg.hashsalt": "magcal",
}


@dataclass(frozen=True, slots=True)
class Sheet:
    """A figure that is ready to be drawn.

    Parameters
    ----------
    draw: fills an empty matplotlib figure.
    doubts: why what it shows must not be trusted, a line each.
    width_in, height_in: of the figure [inch]; a column of a paper is 3.5 wide.
    """

    draw: Callable[[Any], None]
    width_in: float = 7.0
    height_in: float = 4.2
    doubts: tuple[str, ...] = ()


def refuse_suffix(path: Path) -> None:
    """Raise ``InputRefusedError`` for a file of another kind than ``SUFFIXES``."""
    if path.suffix.lower() not in SUFFIXES:
        raise InputRefusedError([Fault("--out", str(path), f"a file that ends in {', '.join(SUFFIXES)} is accepted")])


def save(sheet: Sheet, path: Path) -> None:
    """Write a figure; the same input gives the same bytes of SVG and PNG.

    Raises ``ExtraMissingError`` without matplotlib, ``InputRefusedError`` where the file can't be written.
    """
    try:
        from matplotlib import rc_context
        from matplotlib.figure import Figure
    except ImportError as exc:
        raise ExtraMissingError(exc.name or "matplotlib", "view", "a figure") from None
    undated: dict[str, dict[str, str | None]] = {
        ".svg": {"Date": None, "Creator": None},
        ".pdf": {"CreationDate": None},
        ".png": {"Software": None},
    }
    with rc_context(_STYLE):
        figure = Figure(figsize=(sheet.width_in, sheet.height_in), layout="constrained")
        with counted(Work("drawing")):
            sheet.draw(figure)
            try:
                figure.savefig(path, dpi=300, metadata=undated[path.suffix.lower()])
            except OSError as exc:
                raise unwritable(path, exc) from None


def thinned(count: int) -> NDArray[np.intp]:
    """Which of ``count`` points to draw."""
    return np.arange(0, count, max(1, -(-count // _POINTS)))


def time_axis(seconds: float) -> tuple[float, str]:
    """The unit for a time axis of this length: its length [s], and its name."""
    return (3600.0, "h") if seconds > 5400.0 else (1.0, "s")
