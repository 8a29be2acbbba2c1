"""The figures of a report, each as one image that is part of the page."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from magcal_service.diagnosis.diagnose import Diagnosis
from magcal_service.diagnosis.empirical.curves import unit_of
from magcal_service.diagnosis.report.curves import Against, against, binned_rms, spectrum
from magcal_service.diagnosis.report.drawing import (
    AFTER,
    AFTER_POINTS,
    BEFORE,
    BEFORE_POINTS,
    COAST,
    DIVERGING,
    FLOOR,
    Picture,
    legend,
    picture,
    readable,
)
from magcal_service.diagnosis.words import curve_driver
from magcal_service.earth import geomagnetic
from magcal_service.model import Array
from magcal_service.physics.apply.empirical import Empirical

_POINTS: Final = 4000
"""Points drawn of a long curve; choice: several for each pixel of the figure's width, and the page stays small."""

_COASTLINES: Final = "coastlines.json"
"""Lines of longitude and latitude; where they come from stands in the file."""


def pictures(diagnosis: Diagnosis) -> list[Picture]:
    """Before and after, on data that took no part: over time, spectrum, against the driver, distribution."""
    before, after = diagnosis.prepared.baseline.held_out_residual, diagnosis.fit.held_out_residual
    noise = diagnosis.noise_nt
    changed = bool(diagnosis.fit.terms)
    return [
        _over_time(diagnosis, before, after, noise, changed),
        _spectrum(diagnosis, before, after, noise, changed),
        *[_against(shown, changed) for shown in against(diagnosis, before, after)],
        _histogram(before, after, noise, changed),
    ]


def track(diagnosis: Diagnosis) -> Picture | None:
    """Where the mismatch sits on the Earth; None without a position."""
    problem = diagnosis.prepared.problem
    place = problem.scene.position_ecef_km
    if place is None or problem.is_vector:
        return None
    latitude, longitude, _ = geomagnetic.geodetic_from_ecef(np.asarray(place, dtype=np.float64))
    residual = diagnosis.prepared.baseline.held_out_residual
    smooth = _smoothed(residual)
    rows = _thinned(len(smooth))
    limit = max(float(np.quantile(np.abs(smooth), 0.98)), 1e-3)

    def draw(figure: Any) -> None:
        from matplotlib.colors import LinearSegmentedColormap

        axes = figure.subplots()
        for line in coastlines():
            axes.plot(line[:, 0], line[:, 1], color=COAST, lw=0.6)
        points = axes.scatter(
            longitude[rows],
            latitude[rows],
            c=smooth[rows],
            cmap=LinearSegmentedColormap.from_list("signed", DIVERGING),
            vmin=-limit,
            vmax=limit,
            s=7,
            linewidths=0,
            rasterized=True,
        )
        axes.set(xlabel="longitude [deg]", ylabel="latitude [deg]", xlim=(-180, 180), ylim=(-90, 90))
        axes.set_xticks(range(-180, 181, 60))
        axes.set_yticks(range(-90, 91, 30))
        figure.colorbar(points, ax=axes, label="residual, smoothed [nT]", pad=0.02).outline.set_visible(False)

    words = f"Track over the Earth, coloured by the residual before any effect; colours span {limit:.3g} nT either way"
    return picture(draw, words, "The residual of the nine errors alone along the track, running mean of 15 samples.")


def coastlines() -> list[Array]:
    """The coasts of the Earth as lines (n, 2) of longitude and latitude [deg]."""
    content = json.loads(Path(__file__).with_name(_COASTLINES).read_text(encoding="utf-8"))
    return [0.1 * np.array(line, dtype=np.float64).reshape(-1, 2) for line in content["lines"]]


def _smoothed(residual: Array) -> Array:
    kernel = np.ones(min(15, len(residual)))
    return np.convolve(residual, kernel, "same") / np.convolve(np.ones(len(residual)), kernel, "same")


def _thinned(count: int) -> NDArray[np.intp]:
    return np.arange(0, count, max(1, -(-count // _POINTS)))


def _over_time(diagnosis: Diagnosis, before: Array, after: Array, noise: float, changed: bool) -> Picture:
    time_s = diagnosis.prepared.problem.row_time_s
    rows = _thinned(len(time_s))
    scale, unit = (3600.0, "h") if time_s[-1] > 5400.0 else (1.0, "s")
    limit = 1.1 * float(np.quantile(np.abs(before), 0.998))

    shown = [(before, BEFORE_POINTS, "nine errors"), (after, AFTER_POINTS, "with effects")][: 1 + changed]

    def draw(figure: Any) -> None:
        panels = figure.subplots(len(shown), 1, sharex=True, squeeze=False)[:, 0]
        for axes, (values, colour, label) in zip(panels, shown, strict=True):
            axes.axhspan(-2.0 * noise, 2.0 * noise, color=FLOOR, alpha=0.15, lw=0)
            axes.scatter(time_s[rows] / scale, values[rows], s=3, c=colour, alpha=0.5, linewidths=0, rasterized=True)
            axes.set(ylabel=f"{label} [nT]", ylim=(-limit, limit))
        panels[-1].set_xlabel(f"time [{unit}]")

    centres, rms_before = binned_rms(time_s, before, 30)
    _, rms_after = binned_rms(time_s, after, 30)
    worst = float(centres[int(np.argmax(rms_before))])
    alt = f"Residual over time. Worst stretch before: {rms_before.max():.0f} nT rms near {worst:.0f} s"
    alt += f"; worst after: {rms_after.max():.0f} nT." if changed else "."
    return picture(
        draw, alt, "Residual over time, each point from a fit that has not seen its block; grey: noise, 2 sigma."
    )


def _spectrum(diagnosis: Diagnosis, before: Array, after: Array, noise: float, changed: bool) -> Picture:
    scene = diagnosis.prepared.problem.scene
    frequency, density = spectrum(scene, before)
    _, density_after = spectrum(scene, after)
    white = noise * np.sqrt(2.0 * scene.period_s)

    def draw(figure: Any) -> None:
        axes = figure.subplots()
        axes.loglog(frequency, density, color=BEFORE, lw=1.3, label="nine errors")
        if changed:
            axes.loglog(frequency, density_after, color=AFTER, lw=1.1, label="with effects")
        axes.axhline(white, color=FLOOR, lw=1, ls="--", label="white noise")
        axes.set(xlabel="frequency [Hz]", ylabel="residual [nT / √Hz]")
        legend(axes)

    peak = int(np.argmax(density))
    alt = f"Spectrum of the residual. Highest before: {density[peak]:.3g} nT per root hertz at {frequency[peak]:.3g} Hz"
    alt += f", {density_after[peak]:.3g} after" if changed else ""
    return picture(draw, f"{alt}; white noise is {white:.3g}.", "Spectrum, averaged over neighbouring frequencies.")


def _against(shown: Against, changed: bool) -> Picture:
    def draw(figure: Any) -> None:
        axes = figure.subplots()
        bars: dict[str, Any] = {"fmt": "o", "ms": 4, "lw": 1.1}
        axes.axhline(0.0, color=FLOOR, lw=0.8)
        axes.errorbar(shown.x, shown.before, shown.before_sigma, color=BEFORE, label="nine errors", **bars)
        if changed:
            axes.errorbar(shown.x, shown.after, shown.after_sigma, color=AFTER, label="with effects", **bars)
        axes.set(xlabel=readable(shown.x_label), ylabel=readable(shown.y_label))
        legend(axes)

    ends = f"from {shown.before.min():.3g} to {shown.before.max():.3g} nT before"
    ends += f", from {shown.after.min():.3g} to {shown.after.max():.3g} nT after" if changed else ""
    return picture(draw, f"{shown.y_label} against {shown.x_label}: {ends}.", shown.caption)


def curve_picture(curve: Empirical) -> Picture:
    """A curve without a name over its driver, each axis with 1 sigma."""
    values, sigma = (part.reshape(len(curve.knots), -1) for part in (curve.values, curve.sigma))
    names = ("magnitude",) if values.shape[1] == 1 else tuple(f"axis {axis}" for axis in "xyz")
    driver, unit = curve_driver(curve), unit_of(curve)
    x_label = driver if unit == "1" else f"{driver} [{unit}]"
    y_label = f"{curve.kind} beyond its mean" + ("" if curve.kind.unit == "1" else f" [{curve.kind.unit}]")

    def draw(figure: Any) -> None:
        axes = figure.subplots()
        axes.axhline(0.0, color=FLOOR, lw=0.8, ls="--")
        for column, (name, colour) in enumerate(zip(names, (AFTER, BEFORE, FLOOR), strict=False)):
            axes.plot(curve.knots, values[:, column], color=colour, marker="o", ms=3, lw=1.4, label=name)
            band = values[:, column] - sigma[:, column], values[:, column] + sigma[:, column]
            axes.fill_between(curve.knots, *band, color=colour, alpha=0.2, lw=0)
        axes.set(xlabel=readable(x_label), ylabel=readable(y_label))
        legend(axes)

    sized = f"from {values.min():.3g} to {values.max():.3g}" + ("" if curve.kind.unit == "1" else f" {curve.kind.unit}")
    alt = f"{curve.kind} against {x_label}: {sized}, over {curve.span[0]:.4g} to {curve.span[1]:.4g}"
    return picture(draw, f"{alt}.", f"The {curve.kind} over {driver}, straight between its knots, with 1 sigma.")


def _histogram(before: Array, after: Array, noise: float, changed: bool) -> Picture:
    limit = max(4.5 * noise, float(np.quantile(np.abs(before), 0.995)))
    edges = np.linspace(-limit, limit, 81)
    centres = 0.5 * (edges[1:] + edges[:-1])

    def draw(figure: Any) -> None:
        axes = figure.subplots()

        def each(values: Array) -> Array:  # of the samples, per uT
            return np.full(len(values), 1e3 / (len(values) * (edges[1] - edges[0])))

        axes.hist(before, edges, weights=each(before), color=BEFORE, alpha=0.35, label="nine errors")
        if changed:
            axes.hist(after, edges, weights=each(after), histtype="step", color=AFTER, lw=1.6, label="with effects")
        gauss = 1e3 * np.exp(-0.5 * (centres / noise) ** 2) / (noise * np.sqrt(2.0 * np.pi))
        axes.plot(centres, gauss, color=FLOOR, ls="--", lw=1.3, label="noise alone")
        axes.set(xlabel="residual [nT]", ylabel="share per µT", xlim=(-limit, limit))
        legend(axes)

    alt = f"Distribution of the residual: {np.std(before):.0f} nT wide before"
    alt += f", {np.std(after):.0f} nT after" if changed else ""
    return picture(draw, f"{alt}; noise alone {noise:.0f} nT.", "Distribution, with the noise's own Gaussian.")
