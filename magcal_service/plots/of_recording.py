"""Figures of a recording: before and after, the nine errors over time, ground track, spectrum with the spin's tones."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from magcal_service.base.errors import Fault, InputRefusedError, Lacking
from magcal_service.diagnosis.report.drawing import DIVERGING
from magcal_service.diagnosis.report.figures import coastlines
from magcal_service.earth import geomagnetic
from magcal_service.model import STATE_NAMES, STATE_SIZE, Array, calibrate
from magcal_service.offline import short_log
from magcal_service.offline.apply import apply
from magcal_service.offline.calibrate import calibrate as calibrate_whole
from magcal_service.offline.given import Given
from magcal_service.offline.replay import Replay, replay
from magcal_service.plots.paper import AFTER, BEFORE, COAST, QUIET, Sheet, thinned, time_axis
from magcal_service.recordings.inspect.inspection import Inspection, inspect
from magcal_service.recordings.recording import Recording
from magcal_service.residuals import rms
from magcal_service.wire.messages import Estimate, Frame, Verdict

_SIGMAS: Final = 3.0
"""Sigmas of the limits that are drawn, as in the paper: 99.7 % of the errors lie inside."""

ERRORS: Final = "errors"
"""The one figure that needs a replay."""

_TONES: Final = (1, 2)
"""Multiples of the spin's rate that a sensor's errors leave in |w|: bias at the first, scale and skew at the second."""


@dataclass(frozen=True, slots=True, eq=False)
class Shown:
    """What the figures of a recording are drawn from.

    Parameters
    ----------
    recording: its usable rows, in order of time.
    calibrated_nt: w (n, 3) [nT], without the disturbances of a ``physics.toml`` that was given.
    reference_nt: |H| (n,) [nT], with its corrections where a ``physics.toml`` has any.
    estimates: times (k,) [s], states (k, 9) and 1 sigma (k, 9) of the replay; empty where a result was given, or the
        log was taken as one batch.
    spin_hz: rate of the spin [Hz], None where none is stated.
    """

    recording: Recording
    calibrated_nt: Array
    reference_nt: Array
    estimates: tuple[Array, Array, Array]
    spin_hz: float | None

    @property
    def time_s(self) -> Array:
        """Seconds since the first row (n,)."""
        times: Array = 1e-9 * (self.recording.time_ns - self.recording.time_ns[0]).astype(np.float64)
        return times

    @property
    def before(self) -> Array:
        """|B| - |H| as recorded (n,) [nT]."""
        magnitude = self.recording.reference.magnitude_nt
        return np.asarray(np.linalg.norm(self.recording.field_body_nt, axis=1) - magnitude)

    @property
    def after(self) -> Array:
        """|w| - |H| (n,) [nT]."""
        return np.asarray(np.linalg.norm(self.calibrated_nt, axis=1) - self.reference_nt)


def shown(recording: Recording, given: Given | None) -> Shown:
    """Replay a recording, or take the nine errors of a result.

    A log that is over before the filter starts is taken as one batch, as ``magcal calibrate`` takes it.

    Raises ``InputRefusedError`` where the recording comes to no estimate, or the effects of a ``physics.toml`` cannot
    be subtracted.
    """
    inspection = inspect(recording)
    spin = recording.descriptor.spin
    spin_hz = None if spin is None or not spin.rate_rpm else abs(spin.rate_rpm) / 60.0
    usable = inspection.usable.sorted_unique()
    none: Array = np.zeros((0, STATE_SIZE))
    over_time: tuple[Array, Array, Array] = (none[:, 0], none, none)
    if given is not None:
        if given.model is not None:
            return Shown(*_compensated(given, inspection), over_time, spin_hz)
        calibrated = calibrate(given.x, usable.field_body_nt)
        return Shown(usable, calibrated, usable.reference.magnitude_nt, over_time, spin_hz)
    found: list[Estimate] = []

    def keep(message: object) -> None:
        if isinstance(message, Estimate) and message.verdict is not Verdict.NOT_STARTED:
            found.append(message)

    result = replay(recording, inspection=inspection, sink=keep)
    started = bool(found) and result.verdict is not Verdict.NOT_STARTED
    x, over_time = (result.x, _over_time(found)) if started else (_of_one_batch(recording, result), over_time)
    calibrated = calibrate(x, usable.field_body_nt)
    return Shown(usable, calibrated, usable.reference.magnitude_nt, over_time, spin_hz)


def _of_one_batch(recording: Recording, result: Replay) -> Array:
    """Nine errors (9,) of a log on which a replay did not start; raises ``InputRefusedError`` where there are none."""
    why, start_s = result.remedy, result.pipeline.config.filter.start_s
    if short_log.for_whole(result.inspection.to_replay, result.pipeline.config) is not None:
        batch = calibrate_whole(recording)
        if batch.verdict is not Verdict.NOT_STARTED:
            return batch.x
        ends = f"it ends before the filter starts ({start_s:g} s)"
        why = f"{ends}, and is not enough as one batch: magcal calibrate says why"
    others = ", ".join(name for name in FIGURES if name != ERRORS)
    accepted = f"{why}; with another recording's result, --with RESULT.json, these can be drawn: {others}"
    raise InputRefusedError([Lacking(recording.name, "no estimate to draw", accepted)])


def _compensated(given: Given, inspection: Inspection) -> tuple[Recording, Array, Array]:
    """Usable rows, w (n, 3) and |H| (n,) [nT] as ``magcal apply`` has them by a ``physics.toml``."""
    applied = apply(given, inspection)
    if applied.stopped:
        accepted = f"{applied.stopped}; show the nine errors alone by the result of magcal calibrate"
        raise InputRefusedError([Fault("--with", given.name, accepted)])
    vectors = {one.time_ns: one.field_body_nt for one in applied.vectors}
    usable = inspection.usable.sorted_unique()
    usable = usable.select(np.array([time_ns in vectors for time_ns in usable.time_ns.tolist()]))
    calibrated = np.array([vectors[time_ns] for time_ns in usable.time_ns.tolist()]).reshape(-1, 3)
    return usable, calibrated, applied.reference_at(usable.time_ns)


def _over_time(found: Sequence[Estimate]) -> tuple[Array, Array, Array]:
    """Times since the first (k,) [s], states and 1 sigma (k, 9) of estimates."""
    diagonal = np.cumsum([0, *range(STATE_SIZE, 1, -1)])  # of an upper triangle, row by row
    times = 1e-9 * np.array([one.time_ns - found[0].time_ns for one in found], dtype=np.float64)
    states = np.array([[*one.bias_nt, *one.D] for one in found])
    return times, states, np.sqrt(np.array([one.covariance for one in found])[:, diagonal])


def before_after(of: Shown) -> Sheet:
    """|B| and |w| beside the reference, and the residual of both."""
    time_s, recording = of.time_s, of.recording
    rows, (scale, unit) = thinned(len(time_s)), time_axis(float(time_s[-1]))
    measured = np.linalg.norm(recording.field_body_nt, axis=1)
    calibrated = np.linalg.norm(of.calibrated_nt, axis=1)
    before, after = of.before, of.after

    def draw(figure: Any) -> None:
        upper, lower = figure.subplots(2, 1, sharex=True)
        points: dict[str, Any] = {"s": 2, "linewidths": 0, "rasterized": True}
        upper.scatter(time_s[rows] / scale, measured[rows] / 1e3, c=BEFORE, label="measured |B|", **points)
        upper.scatter(time_s[rows] / scale, calibrated[rows] / 1e3, c=AFTER, label="calibrated |w|", **points)
        upper.plot(time_s[rows] / scale, of.reference_nt[rows] / 1e3, color=QUIET, lw=1.0, label="reference |H|")
        upper.set_ylabel("field [uT]")
        upper.legend(ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.0), markerscale=4)
        lower.scatter(time_s[rows] / scale, after[rows], c=AFTER, **points)
        lower.set(xlabel=f"time [{unit}]", ylabel="|w| - |H| [nT]")
        lower.set_title(f"residual {rms(before):.0f} nT rms before, {rms(after):.0f} nT after")

    return Sheet(draw)


def errors(of: Shown) -> Sheet:
    """The nine errors over time inside their 3 sigma, each less its last value."""
    time_s, states, sigma = of.estimates
    if not len(time_s):
        accepted = "they are those of a replay, without --with, of a log that goes on after the start of the filter"
        raise InputRefusedError([Lacking(f"--figure {ERRORS}", "no errors over time", accepted)])
    rows, (scale, unit) = thinned(len(time_s)), time_axis(float(time_s[-1]))

    def draw(figure: Any) -> None:
        for i, axes in enumerate(figure.subplots(3, 3, sharex=True).flat):
            factor = 1.0 if i < 3 else 1e3
            away, limit = factor * (states[rows, i] - states[-1, i]), factor * _SIGMAS * sigma[rows, i]
            axes.fill_between(time_s[rows] / scale, -limit, limit, color=QUIET, alpha=0.2, lw=0)
            axes.plot(time_s[rows] / scale, away, color=AFTER)
            top = 4.0 * float(np.median(limit))
            axes.set(ylim=(-top, top), title=f"{STATE_NAMES[i]} {'[nT]' if i < 3 else '[1e-3]'}")
            if i >= 6:
                axes.set_xlabel(f"time [{unit}]")

    return Sheet(draw, height_in=5.6)


def track(of: Shown) -> Sheet:
    """The ground track over the coasts, coloured by the residual."""
    position = of.recording.position
    if position is None:
        accepted = "a recording with [position] is accepted"
        raise InputRefusedError([Lacking("--figure track", "no position", accepted)])
    times, km = of.recording.time_ns, position.km
    ecef = km if position.frame is Frame.ECEF else geomagnetic.ecef_from_eci(times, km)
    latitude, longitude, _ = geomagnetic.geodetic_from_ecef(np.asarray(ecef, dtype=np.float64))
    residual, rows = of.after, thinned(len(times))
    limit = max(float(np.quantile(np.abs(residual), 0.98)), 1.0)

    def draw(figure: Any) -> None:
        from matplotlib.colors import LinearSegmentedColormap

        axes = figure.subplots()
        for line in coastlines():
            axes.plot(line[:, 0], line[:, 1], color=COAST, lw=0.6)
        colours = LinearSegmentedColormap.from_list("signed", DIVERGING)
        points = axes.scatter(
            longitude[rows], latitude[rows], c=residual[rows], cmap=colours, vmin=-limit, vmax=limit, s=6, linewidths=0
        )
        axes.set(xlabel="longitude [deg]", ylabel="latitude [deg]", xlim=(-180, 180), ylim=(-90, 90))
        axes.set(xticks=range(-180, 181, 60), yticks=range(-90, 91, 30))
        figure.colorbar(points, ax=axes, label="|w| - |H| [nT]", pad=0.02)

    return Sheet(draw)


def spectrum(of: Shown) -> Sheet:
    """Spectrum of the residual before and after, on an even grid of the median period, with the spin's tones."""
    time_s = of.time_s
    period_s = float(np.median(np.diff(time_s)))
    slot = np.rint(time_s / period_s).astype(np.intp)
    tones = [] if of.spin_hz is None else [(k, k * of.spin_hz) for k in _TONES if k * of.spin_hz < 0.5 / period_s]

    def density(residual: Array) -> Array:
        grid = np.zeros(int(slot[-1]) + 1)
        grid[slot] = residual - residual.mean()
        return np.asarray(np.abs(np.fft.rfft(grid)[1:]) * np.sqrt(2.0 * period_s / len(residual)))

    frequency = np.fft.rfftfreq(int(slot[-1]) + 1, period_s)[1:]
    curves = [(of.before, BEFORE, "measured"), (of.after, AFTER, "calibrated")]

    def draw(figure: Any) -> None:
        axes = figure.subplots()
        for residual, colour, label in curves:
            axes.loglog(
                frequency, np.maximum(density(residual), 1e-3), color=colour, lw=0.6, label=label, rasterized=True
            )
        for multiple, tone_hz in tones:
            axes.axvline(tone_hz, color=QUIET, ls="--", lw=0.9)
            axes.annotate(f"{multiple} x spin", (tone_hz, 0.02), xycoords=("data", "axes fraction"), rotation=90)
        axes.set(xlabel="frequency [Hz]", ylabel="|w| - |H| [nT / sqrt(Hz)]")
        axes.legend()

    return Sheet(draw, height_in=3.6)


FIGURES: Final[dict[str, Callable[[Shown], Sheet]]] = {
    "before-after": before_after,
    ERRORS: errors,
    "track": track,
    "spectrum": spectrum,
}
"""Figures of a recording by name, the first where none is named."""
