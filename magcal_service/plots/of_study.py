"""Figures of a study in JSON: its curves with their bounds, a Stanford diagram, a reliability diagram."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from operator import itemgetter
from typing import Any, Final

import numpy as np

from magcal_service.base.errors import ExtraMissingError, Fault, InputRefusedError
from magcal_service.plots.paper import AFTER, BEFORE, LINES, QUIET, Sheet

_COLUMNS: Final = 3
"""Panels side by side: the width of a page."""

_FEW: Final = 40
"""Points of a curve below which each is marked; choice: more would touch one another."""

_DIAGONAL: Final = "error = protection"  # the label of that line in the study's curves

_HIGHEST_NT: Final = 100.0  # of the axes of a diagram without points: any

_SHORTEST_S: Final = 1.0  # of the colours: a vector's time

_LEAST_NT: Final = 1.0
"""Where the axes of a Stanford diagram begin [nT]: less is no error that anybody minds."""

_PROBABILITIES: Final = (0.2, 0.5, 0.9, 0.99, 0.999, 0.9999)
"""Ticks of a claimed probability, whose axis is linear in the logarithm of its odds."""

_LEAST_CLAIM: Final = 1e-4
"""A claim nearer to 0 or 1 is drawn there: its odds have no end."""


def of_study(content: dict[str, Any]) -> Sheet:
    """The figure of a study.  Raises ``InputRefusedError`` where it has nothing to draw."""
    if content["study"] == "integrity":
        return _stanford(content)
    if content["study"] == "concealed":
        return _reliability(content)
    panels = content["curves"]
    _refuse_empty(content, panels)
    return _sheet([partial(_draw_curves, panel) for panel in panels])


def _refuse_empty(content: dict[str, Any], drawn: Sequence[object]) -> None:
    if not drawn:
        accepted = "a study with curves is accepted; this one has tables alone"
        raise InputRefusedError([Fault("study", content["study"], accepted)])


def _sheet(
    panels: Sequence[Callable[[Any], None]],
    height_in: float = 2.6,
    finish: Callable[[Any, Sequence[Any]], None] = lambda figure, axes: None,
) -> Sheet:
    """Panels in rows of at most three: what fills each is given its axes, ``finish`` the figure and all axes."""
    columns = min(_COLUMNS, len(panels))
    rows = math.ceil(len(panels) / columns)

    def draw(figure: Any) -> None:
        grid = list(figure.subplots(rows, columns, squeeze=False).flat)
        for fill, axes in zip(panels, grid, strict=False):
            fill(axes)
        for axes in grid[len(panels) :]:
            axes.set_visible(False)
        finish(figure, grid)

    return Sheet(draw, height_in=height_in * rows)


def _draw_curves(panel: dict[str, Any], axes: Any) -> None:
    for number, line in enumerate(panel["lines"]):
        is_limit = line.get("limit", line["label"].startswith("bound"))
        colour, style = (QUIET, "--") if is_limit else (LINES[number % len(LINES)], "-")
        values = [math.nan if value is None else value for value in line["y"]]
        mark = "o" if len(values) < _FEW and not is_limit else ""
        axes.plot(line["x"], values, color=colour, ls=style, marker=mark, markersize=3, label=line["label"])
    axes.set(title=panel["title"], xlabel=panel["x"], ylabel=panel["y"])
    axes.set(xscale="log" if panel.get("log_x") else "linear", yscale="log" if panel.get("log_y") else "linear")
    axes.legend()


# Error against protection level


def _stanford(content: dict[str, Any]) -> Sheet:
    """Trusted time by error and protection level; by the error's quantiles where a study kept no more than those."""
    figures = content.get("figures", {})
    seconds, misled = figures.get("trusted with a protection level [s]"), figures.get("share of that time that misled")
    title = ""
    if seconds and misled is not None:
        title = f"beyond protection and 4 sigma: {100.0 * misled:.2g} % of {seconds / 3600.0:.3g} h of trusted time"
    grids = content.get("grids", [])
    if grids:
        return _by_time(grids, title)
    _refuse_empty(content, content["curves"])
    return _by_quantiles(content["curves"], title)


def _by_time(grids: Sequence[dict[str, Any]], title: str) -> Sheet:
    try:
        from matplotlib.cm import ScalarMappable
        from matplotlib.colors import LogNorm
        from matplotlib.patches import Rectangle
    except ImportError as exc:
        raise ExtraMissingError(exc.name or "matplotlib", "view", "a figure") from None
    every = np.concatenate([np.reshape(grid["cells"], (-1, 5)) for grid in grids]).astype(np.float64)
    longest_s = max(2.0 * _SHORTEST_S, every[:, 4].max(initial=0.0))
    colours = ScalarMappable(LogNorm(_SHORTEST_S, longest_s), "viridis_r")
    highest_nt = every[:, :4].max(initial=_HIGHEST_NT)

    def fill(grid: dict[str, Any], axes: Any) -> None:
        for error, error_to, level, level_to, seconds in np.reshape(grid["cells"], (-1, 5)).tolist():
            corner = (max(error, _LEAST_NT), max(level, _LEAST_NT))
            axes.add_patch(
                Rectangle(corner, error_to - corner[0], level_to - corner[1], color=colours.to_rgba(seconds))
            )
        if not grid["cells"]:
            axes.annotate("never trusted", (0.06, 0.9), xycoords="axes fraction", color=QUIET)
        _draw_frame(axes, grid["title"], highest_nt)

    def finish(figure: Any, axes: Sequence[Any]) -> None:
        figure.suptitle(title, fontsize=9)
        figure.colorbar(colours, ax=axes, label="trusted time [s]", location="bottom", shrink=0.5)

    return _sheet([partial(fill, grid) for grid in grids], 3.2, finish)


def _by_quantiles(panels: Sequence[dict[str, Any]], title: str) -> Sheet:
    curves = [[line for line in panel["lines"] if line["label"] != _DIAGONAL] for panel in panels]
    points = [value for own in curves for line in own for value in (*line["x"], *line["y"])]

    def fill(number: int, axes: Any) -> None:
        for colour, line in zip(LINES, curves[number], strict=False):
            axes.plot(line["y"], line["x"], color=colour, marker="o", ms=3, label=line["label"])
        _draw_frame(axes, panels[number]["title"], max(points, default=_HIGHEST_NT))

    def finish(figure: Any, axes: Sequence[Any]) -> None:
        figure.suptitle(title, fontsize=9)
        figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=2)

    return _sheet([partial(fill, number) for number in range(len(panels))], 3.2, finish)


def _draw_frame(axes: Any, title: str, highest_nt: float) -> None:
    """The diagonal, the half below it that misleads, equal scales."""
    ends = (_LEAST_NT, 2.0 * highest_nt)
    axes.fill_between(ends, ends, _LEAST_NT, color=BEFORE, alpha=0.12, lw=0, zorder=0.5)
    axes.plot(ends, ends, color=QUIET, ls="--", lw=0.9)
    axes.annotate("error beyond\nprotection", (0.96, 0.06), xycoords="axes fraction", ha="right", color=BEFORE)
    axes.set(xscale="log", yscale="log", xlim=ends, ylim=ends, box_aspect=1.0)
    axes.set(title=title, xlabel="error of the vector [nT]", ylabel="protection level [nT]")


# Claimed probability against the share that is true


def _reliability(content: dict[str, Any]) -> Sheet:
    """Share true with its 95 % interval over the claim, for all cases and for each simulator."""
    table: dict[str, Any] = next(
        (one for one in content["tables"] if one["title"].startswith("Reliability")), {"rows": []}
    )
    rows: dict[str, list[list[Any]]] = {}
    for row in table["rows"]:
        if row[2]:
            rows.setdefault(row[0], []).append(row)
    _refuse_empty(content, list(rows))
    return _sheet([partial(_draw_claims, name, own) for name, own in rows.items()])


_CLOSE: Final = 1.6  # in log odds: two numbers of three digits that are nearer are drawn over each other


def _draw_claims(name: str, rows: Sequence[Sequence[Any]], axes: Any) -> None:
    claimed, true = [_logit(row[3]) for row in rows], np.array([row[4] for row in rows], dtype=np.float64)
    low, high = (np.array([row[place] for row in rows], dtype=np.float64) for place in (5, 6))
    ends = min(_logit(_PROBABILITIES[0]) - 1.0, min(claimed) - 0.5), max(_logit(_PROBABILITIES[-1]), max(claimed)) + 0.5
    steps = np.linspace(*ends, 100)
    axes.plot(steps, 1.0 / (1.0 + np.exp(-steps)), color=QUIET, ls="--", lw=0.9)
    axes.errorbar(claimed, true, (true - low, high - true), fmt="o", ms=4, capsize=3, color=AFTER)
    raised, before = False, -math.inf
    for x, top, row in sorted(zip(claimed, high, rows, strict=True), key=itemgetter(0)):
        raised, before = x - before < _CLOSE and not raised, x
        above = (0, 13 if raised else 5)  # points: a line of numbers, or the one over it
        axes.annotate(f"{row[2]}", (x, top), above, textcoords="offset points", ha="center", fontsize=7, color=QUIET)
    axes.set_xticks([_logit(p) for p in _PROBABILITIES], [f"{p:g}" for p in _PROBABILITIES], rotation=45)
    axes.set(xlim=(steps[0], steps[-1]), ylim=(-0.05, 1.18), xlabel="claimed probability", ylabel="share true")
    axes.set_title(f"{name} ({sum(row[2] for row in rows)} names)")


def _logit(p: float) -> float:
    p = min(max(p, _LEAST_CLAIM), 1.0 - _LEAST_CLAIM)
    return math.log(p / (1.0 - p))
