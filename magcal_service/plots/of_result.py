"""Figures of results in JSON: the nine errors of a calibration, and what a diagnosis gained."""

from __future__ import annotations

import math
import textwrap
from typing import Any, Final

from magcal_service.model import STATE_NAMES
from magcal_service.offline.given import Given
from magcal_service.plots.paper import AFTER, BEFORE, LINES, QUIET, Sheet

_LEVELS: Final = {
    "simulation": QUIET,
    "recalibrated": BEFORE,
    "with_effects": AFTER,
    "predicted_from_others": LINES[2],
}
"""Held-out residuals of one of several recordings, as they are drawn beside each other."""

_NARROW: Final = 14
"""Characters of a line beneath one of three bars; choice: as ``recalibrated`` with room."""

_WIDTH: Final = 0.8
"""Of a recording's place, what its bars fill; choice."""


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
    words = {"simulation": "\n".join(textwrap.wrap(str(content.get("compared_with", "simulation")), _NARROW))}

    def draw(figure: Any) -> None:
        held, share = figure.subplots(1, 2)
        names = [words.get(name, name.replace("_", "\n")) for name in levels]
        bars = held.bar(names, list(levels.values()), color=AFTER)
        held.bar_label(bars, fmt="%.0f", fontsize=8)
        held.axhline(fit["noise_floor_nt"], color=QUIET, ls="--", label="sensor noise")
        held.set(title="held-out residual rms [nT]")
        held.set_ylim(top=1.3 * held.get_ylim()[1])  # the legend above the bars
        held.legend(loc="upper right")
        _draw_shares(share, effects)

    return Sheet(draw, height_in=2.8)


def of_joint_diagnosis(content: dict[str, Any]) -> Sheet:
    """Each recording's held-out residual, without and with what they have in common, and predicted from the others."""
    recordings, effects = content["recordings"], content["effects"]
    levels = [
        {**one["held_out_rms_nt"], "predicted_from_others": one.get("predicted_from_others_rms_nt")}
        for one in recordings
    ]
    shown = [name for name in _LEVELS if any(isinstance(one.get(name), int | float) for one in levels)]
    floors, bar = [one["noise_floor_nt"] for one in recordings], _WIDTH / max(len(shown), 1)

    def draw(figure: Any) -> None:
        each, share = figure.subplots(1, 2, width_ratios=(2, 1))
        for place, name in enumerate(shown):
            x = [n + (place + 0.5) * bar - 0.5 * _WIDTH for n in range(len(levels))]
            heights = [math.nan if one.get(name) is None else one[name] for one in levels]
            bars = each.bar(x, heights, bar, color=_LEVELS[name], label=name.replace("_", " "))
            each.bar_label(bars, ["" if math.isnan(value) else f"{value:.0f}" for value in heights], fontsize=7)
        for n, floor in enumerate(floors):
            ends = (n - 0.5 * _WIDTH, n + 0.5 * _WIDTH)
            each.plot(ends, (floor, floor), color=QUIET, ls="--", label=None if n else "sensor noise")
        each.set_xticks(range(len(levels)), [one["name"] for one in recordings])
        each.set_title("held-out residual rms [nT]")
        each.legend(ncols=2, loc="lower center", bbox_to_anchor=(0.5, 1.1))
        _draw_shares(share, effects)

    return Sheet(draw, height_in=3.2)


def _draw_shares(axes: Any, effects: list[dict[str, Any]]) -> None:
    """Share of the mismatch by effect; one that is unknown has no probability and is not drawn."""
    named = [one for one in reversed(effects) if "probability" in one]
    names = [f"{one['effect']} ({100.0 * one['probability']:.0f} %)" for one in named]
    axes.barh(names, [100.0 * one["where"]["share_of_mismatch"] for one in named], color=AFTER)
    axes.set(title="share of the mismatch [%]\nby effect (probability)", xlim=(0, 100))
