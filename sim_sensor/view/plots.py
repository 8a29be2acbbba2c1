"""Pictures of a run, like the paper's figures 1-3 (extra ``view``)."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from magcal_service.base.errors import ExtraMissingError
from magcal_service.views.nine import PARAMETERS
from sim_sensor.view.history import History

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["error_figure", "plot_errors", "plot_residual", "residual_figure"]

FloatArray = npt.NDArray[np.float64]

_ROWS = ("bias", "scale", "non-orthogonality")
_ERROR, _LIMIT, _REST = "#1f5fa8", "#b3261e", "#6b6b6b"
_MAX_POINTS = 4000  # more than any screen has columns; keeps the file small and the drawing quick
_ZOOM = 5.0  # the linear pictures show this many times the final 3 sigma
_DPI = 110  # pixels per inch; a choice: the labels are readable on a screen at full size


def plot_errors(history: History, path: Path, title: str = "") -> None:
    """Write ``error_figure`` as a PNG; ValueError where the history holds no estimate."""
    error_figure(history, title).savefig(path, dpi=_DPI)


def plot_residual(history: History, path: Path, title: str = "") -> None:
    """Write ``residual_figure`` as a PNG; ValueError where the history holds no estimate."""
    residual_figure(history, title).savefig(path, dpi=_DPI)


def error_figure(history: History, title: str = "") -> Figure:
    """Nine panels: error over time within the filter's own +-3 sigma, as in the paper's figures 1-3.

    Rows are bias [nT], scale [1e-3] and non-orthogonality [1e-3].  Each panel's range is set by the end of the run, so
    that the final error is readable; the inset shows the same run entire, on a logarithmic scale of |error|.
    Where truth is unknown, the deviation from the final estimate takes the error's place and the title says so.
    """
    if not len(history):
        raise ValueError("the history holds no estimate; there is nothing to plot")
    figure = _new_figure((13.0, 8.6))
    grid = figure.subplots(3, 3, sharex=True)
    pick = _thin(len(history))
    time_s, x, sigma, truth = history.time_s, history.x, history.sigma, history.truth
    known = not bool(np.isnan(truth[-1]).any())
    error = x - truth if known else x - x[-1]
    for i, parameter in enumerate(PARAMETERS):
        axes = grid[i // 3][i % 3]
        factor = 1.0 if parameter.unit == "nT" else 1e3
        _error_panel(axes, time_s[pick], factor * error[pick, i], 3.0 * factor * sigma[pick, i])
        axes.set_title(_panel_title(i, float(factor * error[-1, i]), float(3.0 * factor * sigma[-1, i]), known))
        axes.set_ylabel(f"{_ROWS[i // 3]} error [{'nT' if factor == 1.0 else '1e-3'}]" if i % 3 == 0 else "")
        if i // 3 == 2:
            axes.set_xlabel("sample time [s]")
    grid[0][0].legend(loc="lower right", fontsize=8, framealpha=0.9)
    what = "Estimation error" if known else "Deviation from the final estimate (truth unknown)"
    figure.suptitle(f"{what} and the filter's own 3 sigma limits" + (f": {title}" if title else ""))
    return figure


def residual_figure(history: History, title: str = "") -> Figure:
    """The daemon's running rms of the scalar residual |(I+D)B - b| - |H| against the sensor noise [nT]."""
    if not len(history):
        raise ValueError("the history holds no estimate; there is nothing to plot")
    figure = _new_figure((9.0, 4.2))
    axes = figure.subplots()
    pick = _thin(len(history))
    time_s, rms_nt, noise_nt = history.time_s[pick], history.residual_rms_nt[pick], history.noise_nt[pick]
    axes.plot(time_s, rms_nt, color=_ERROR, linewidth=1.0, label="residual rms")
    axes.plot(time_s, noise_nt, color=_LIMIT, linewidth=1.2, label="sensor noise")
    axes.set_ylim(0.0, 1.25 * max(rms_nt[rms_nt.size // 2 :].max(), noise_nt.max(), 1.0))
    axes.margins(x=0.0)
    axes.set_xlabel("sample time [s]")
    axes.set_ylabel("scalar residual, running rms [nT]")
    axes.grid(alpha=0.3)
    axes.legend(loc="lower right")
    figure.suptitle("Residual |(I+D)B - b| - |H|" + (f": {title}" if title else ""))
    return figure


def _new_figure(size_in: tuple[float, float]) -> Figure:
    try:
        from matplotlib.figure import Figure
    except ImportError as exc:
        raise ExtraMissingError(exc.name or "matplotlib", "view", "plotting") from None
    return Figure(figsize=size_in, layout="constrained")


def _thin(count: int) -> npt.NDArray[np.intp]:
    """At most ``_MAX_POINTS`` indices spread over ``count``, the first and the last among them."""
    return np.unique(np.linspace(0, count - 1, min(count, _MAX_POINTS)).round().astype(np.intp))


def _panel_title(i: int, error: float, limit: float, known: bool) -> str:
    factor = "" if PARAMETERS[i].unit == "nT" else "e-3"
    unit = " nT" if PARAMETERS[i].unit == "nT" else ""
    final = f"final error {error:+.2f}{factor}{unit}, " if known else ""
    return f"{PARAMETERS[i].name}: {final}3 sigma {limit:.2f}{factor}{unit}"


def _error_panel(axes: Any, time_s: FloatArray, error: FloatArray, limit: FloatArray) -> None:
    axes.fill_between(time_s, -limit, limit, color=_LIMIT, alpha=0.08, linewidth=0)
    axes.plot(time_s, limit, color=_LIMIT, linewidth=1.0, linestyle="--", label="±3 sigma")
    axes.plot(time_s, -limit, color=_LIMIT, linewidth=1.0, linestyle="--")
    axes.plot(time_s, error, color=_ERROR, linewidth=1.1, label="error")
    axes.axhline(0.0, color=_REST, linewidth=0.6)
    top = np.nanmax([_ZOOM * limit[-1], 1.2 * np.nanmax(np.abs(error[error.size // 2 :]))])
    if top > 0.0:  # a history of one row with unknown truth deviates from itself by nothing
        axes.set_ylim(-top, top)
    axes.margins(x=0.0)
    axes.locator_params(axis="x", nbins=5)
    axes.grid(alpha=0.25)
    axes.title.set_fontsize(10)
    _entire_inset(axes, time_s, error, limit)


def _entire_inset(axes: Any, time_s: FloatArray, error: FloatArray, limit: FloatArray) -> None:
    """The whole run small in the upper right corner, |error| and limit on a logarithmic scale."""
    inset = axes.inset_axes((0.52, 0.66, 0.46, 0.31))
    floor = 1e-2 * float(limit[-1]) if limit[-1] > 0.0 else 1e-3
    inset.plot(time_s, np.maximum(np.abs(error), floor), color=_ERROR, linewidth=0.6)
    inset.plot(time_s, limit, color=_LIMIT, linewidth=0.8, linestyle="--")
    inset.set_yscale("log")
    inset.set_ylim(bottom=floor)
    inset.margins(x=0.0)
    inset.tick_params(labelsize=6, labelbottom=False, length=2, pad=1)
    inset.minorticks_off()
    inset.text(
        0.97, 0.93, "entire run, |error|", transform=inset.transAxes, fontsize=6.5, ha="right", va="top", color=_REST
    )
