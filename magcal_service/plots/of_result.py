"""Figures of results in JSON: the nine errors of a calibration, what a diagnosis gained, the curves of a study."""

from __future__ import annotations

import math
from typing import Any, Final

from magcal_service.errors import Fault, InputRefusedError
from magcal_service.model import STATE_NAMES
from magcal_service.offline.given import Given
from magcal_service.plots.paper import AFTER, LINES, QUIET, Sheet

_COLUMNS: Final = 3
"""Panels side by side: the width of a page."""


def of_calibration(content: dict[str, Any], given: Given) -> Sheet:
    """The nine errors with 3 sigma, and the residual's levels."""
    levels = {name: value for name, value in content["residual_rms_nt"].items() if isinstance(value, int | float)}
    sigma = [3.0 * math.sqrt(max(value, 0.0)) for value in given.covariance.diagonal().tolist()]

    def draw(figure: Any) -> None:
        bias, matrix, residual = figure.subplots(1, 3)
        dots: dict[str, Any] = {"fmt": "o", "ms": 4, "capsize": 3, "color": AFTER}
        bias.errorbar(STATE_NAMES[:3], given.x[:3], sigma[:3], **dots)
        bias.set(title="bias [nT], 3 sigma")
        matrix.errorbar(STATE_NAMES[3:], given.x[3:], sigma[3:], **dots)
        matrix.set(title="D [-], 3 sigma")
        bars = residual.bar([name.replace("_", "\n") for name in levels], list(levels.values()), color=AFTER)
        residual.bar_label(bars, fmt="%.0f", fontsize=8)
        residual.set(title="residual rms [nT]")
        for axes in (bias, matrix):
            axes.axhline(0.0, color=QUIET, lw=0.8)

    return Sheet(draw, height_in=2.8)


def of_diagnosis(content: dict[str, Any]) -> Sheet:
    """Held-out residual without and with the effects, and the share of the mismatch that each explains."""
    fit, effects = content["fit"], content["effects"]
    levels = {name: value for name, value in fit["held_out_rms_nt"].items() if isinstance(value, int | float)}
    names = [f"{one['effect']} ({100.0 * one['probability']:.0f} %)" for one in effects if "probability" in one]
    shares = [100.0 * one["where"]["share_of_mismatch"] for one in effects if "probability" in one]

    def draw(figure: Any) -> None:
        held, share = figure.subplots(1, 2)
        bars = held.bar([name.replace("_", "\n") for name in levels], list(levels.values()), color=AFTER)
        held.bar_label(bars, fmt="%.0f", fontsize=8)
        held.axhline(fit["noise_floor_nt"], color=QUIET, ls="--", label="noise floor")
        held.set(title="held-out residual rms [nT]")
        held.legend()
        share.barh(names[::-1], shares[::-1], color=AFTER)
        share.set(title="share of the mismatch [%], by effect (probability)", xlim=(0, 100))

    return Sheet(draw, height_in=2.8)


def of_study(content: dict[str, Any]) -> Sheet:
    """The curves of a study with their bounds, a panel each.  Raises ``InputRefusedError`` where it has none."""
    panels = content["curves"]
    if not panels:
        accepted = "a study with curves is accepted; this one has tables alone"
        raise InputRefusedError([Fault("study", content["study"], accepted)])
    columns = min(_COLUMNS, len(panels))
    rows = math.ceil(len(panels) / columns)

    def draw(figure: Any) -> None:
        grid = list(figure.subplots(rows, columns, squeeze=False).flat)
        for axes, panel in zip(grid, panels, strict=False):
            for number, line in enumerate(panel["lines"]):
                is_limit = line.get("limit", line["label"].startswith("bound"))
                colour, style = (QUIET, "--") if is_limit else (LINES[number % len(LINES)], "-")
                values = [math.nan if value is None else value for value in line["y"]]
                axes.plot(line["x"], values, color=colour, ls=style, label=line["label"])
            axes.set(title=panel["title"], xlabel=panel["x"], ylabel=panel["y"])
            axes.set(xscale="log" if panel.get("log_x") else "linear", yscale="log" if panel.get("log_y") else "linear")
            axes.legend()
        for axes in grid[len(panels) :]:
            axes.set_visible(False)

    return Sheet(draw, height_in=2.6 * rows)
