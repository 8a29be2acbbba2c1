"""How a figure of a report is drawn: one image that is part of the page and takes its light or dark colours.

A browser applies an image's own ``prefers-color-scheme`` rules, so colours stand in the SVG as names and each name has
two values.  Points of long curves are drawn as pixels, which have one colour: one that is read on both grounds.
"""

from __future__ import annotations

import base64
import io
import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

from magcal_service.base.errors import ExtraMissingError
from magcal_service.views.colours import DARK, LIGHT

BEFORE: Final = LIGHT["before"]
AFTER: Final = LIGHT["after"]
FLOOR: Final = LIGHT["soft"]
COAST: Final = "#71717a"
_INK: Final = "#27272a"
_EDGE: Final = "#a1a1aa"
_GRID: Final = "#e4e4e7"

BEFORE_POINTS: Final = "#ea580c"
AFTER_POINTS: Final = "#3b82f6"
"""Colours of what is drawn as pixels: at least 3 to 1 against white and against the dark page (WCAG 2.1, 1.4.11)."""

DIVERGING: Final = ("#2563eb", "#8b8b95", "#ea580c")
"""Colours of a signed quantity drawn as pixels, its middle a grey that is seen on both grounds."""

_DARK: Final = {
    BEFORE: DARK["before"],
    AFTER: DARK["after"],
    FLOOR: DARK["soft"],
    COAST: "#9d9da8",
    _INK: "#e4e4e7",
    _EDGE: "#71717a",
    _GRID: "#34343a",
}
"""What each colour is on a dark page."""

_SIZE: Final = (4.6, 3.0)
"""Width and height of a figure [inch]: 460 by 300 pixels on the page at 100 to an inch; text is read at 320 too."""

_STYLE: Final[dict[Any, Any]] = {
    "font.size": 9.5,
    "axes.titlesize": 10,
    "axes.labelsize": 9.5,
    "axes.edgecolor": _EDGE,
    "axes.facecolor": "none",
    "axes.labelcolor": _INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "xtick.color": _INK,
    "ytick.color": _INK,
    "text.color": _INK,
    "axes.grid": True,
    "grid.color": _GRID,
    "grid.linewidth": 0.7,
    "axes.axisbelow": True,
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "svg.hashsalt": "magcal",
}


@dataclass(frozen=True, slots=True)
class Picture:
    """An image: ``src`` with all of its data, what it shows in words, and a caption."""

    src: str
    alt: str
    caption: str


def picture(draw: Callable[[Any], None], alt: str, caption: str) -> Picture:
    """The image that ``draw`` makes on an empty figure; ``ExtraMissingError`` without matplotlib."""
    try:
        from matplotlib import rc_context
        from matplotlib.figure import Figure
    except ImportError as exc:
        raise ExtraMissingError(exc.name or "matplotlib", "diagnosis", "the report of a diagnosis") from None
    with rc_context(_STYLE):
        figure = Figure(figsize=_SIZE, layout="constrained", facecolor="none")
        draw(figure)
        target = io.StringIO()
        figure.savefig(target, format="svg", dpi=170, metadata={"Date": None, "Creator": None})
    src = "data:image/svg+xml;base64," + base64.b64encode(light_and_dark(target.getvalue()).encode()).decode("ascii")
    return Picture(src, alt, caption)


def light_and_dark(svg: str) -> str:
    """An SVG whose colours, of those that have a dark value, follow the page's scheme."""
    names = {colour: f"--c{number}" for number, colour in enumerate(_DARK)}
    named = re.sub("|".join(_DARK), lambda match: f"var({names[match[0]]})", svg)
    light = "".join(f"{names[colour]}:{colour};" for colour in _DARK)
    dark = "".join(f"{names[colour]}:{value};" for colour, value in _DARK.items())
    rules = f":root{{{light}}}@media(prefers-color-scheme:dark){{:root{{{dark}}}}}"
    return named.replace("</style>", f"{rules}</style>", 1)


def readable(text: str) -> str:
    """Text that no font lacks and that is no mathematics to the drawing library."""
    return "".join(c if c == "√" or ord(c) < 0x250 else "?" for c in text).replace("$", r"\$")


def legend(axes: Any) -> None:
    """A legend above the axes."""
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3, borderaxespad=0.2, handlelength=1.6)
