"""Where an effect acts: when, along which direction, at which frequencies, and in how much of the mismatch."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from magcal_service.diagnosis.diagnose import Diagnosis
from magcal_service.diagnosis.leftover import significant
from magcal_service.diagnosis.lines import slots
from magcal_service.diagnosis.problem import Fit, Term
from magcal_service.model import Array


def _mismatch(diagnosis: Diagnosis) -> float:
    """Sum of squares that simulation and recording differ by, beyond noise [nT^2]."""
    before, after = diagnosis.prepared.baseline.residual, diagnosis.fit.residual
    explained = max(float(before @ before) - float(after @ after), 1e-9)
    left = diagnosis.left[0].squares if diagnosis.left and significant(diagnosis.left[0]) else 0.0
    return explained + left


def where_of_term(diagnosis: Diagnosis, index: int) -> dict[str, Any]:
    """Where a term acts: time, axis, frequencies, and the share of the mismatch that it explains."""
    fit = diagnosis.fit
    plain = replace(diagnosis.search.problem, field_error=None)  # shares are of the residual as it is
    search = replace(diagnosis.search, problem=plain, whitening=np.zeros(0))
    term = fit.terms[index]
    rows = search.rows_of(term.hypothesis, term.theta, fit)
    assert rows is not None
    space = search.workspace(fit, index)
    gain = space.gain(rows, max(fit.white_rms_nt, 1e-3))
    signal = fit.problem.rows(term.hypothesis.columns(term.theta), fit.unit)
    assert signal is not None
    scene = fit.problem.scene
    return {
        "time_s": span(fit, signal @ term.amplitudes),
        "axis": direction(term, len(scene)),
        "frequency_hz": lines(fit, signal @ term.amplitudes),
        "share_of_mismatch": round(min(1.0, gain.squares / _mismatch(diagnosis)), 4),
    }


def span(fit: Fit, signal: Array) -> list[float]:
    """Where nearly all of a signal lies [s]."""
    weight = np.cumsum(signal**2)
    if weight[-1] <= 0.0:
        return [0.0, float(fit.problem.row_time_s[-1])]
    inside = np.searchsorted(weight / weight[-1], [0.001, 0.999])
    times = fit.problem.row_time_s
    first, last = (float(times[min(int(i), len(times) - 1)]) for i in inside)
    return [round(0.0 if first < 0.02 * times[-1] else first, 1), round(last, 1)]


def direction(term: Term, count: int) -> list[float] | None:
    """Main direction of a body field (3,); None for a reference's error."""
    field = term.hypothesis.columns(term.theta).field(term.amplitudes)
    if not field.any():
        return None
    centred = field - field.mean(axis=0)
    source = centred if float((centred**2).sum()) > 1e-6 * float((field**2).sum()) else field
    _, vectors = np.linalg.eigh(source.T @ source)
    axis = vectors[:, 2]
    return [round(float(v), 4) for v in axis * np.sign(axis[np.argmax(np.abs(axis))])]


def lines(fit: Fit, signal: Array) -> list[float]:
    """The one or two strongest frequencies of a signal [Hz]."""
    scene = fit.problem.scene
    if fit.problem.is_vector or len(signal) < 16:
        return []
    slot = slots(scene)
    grid = np.zeros(int(slot[-1]) + 1)
    grid[slot] = signal - signal.mean()
    power = np.abs(np.fft.rfft(grid)) ** 2
    frequency = np.fft.rfftfreq(len(grid), scene.period_s)
    order = np.argsort(power[1:])[::-1][:2] + 1
    kept = [i for i in order.tolist() if power[i] > 0.25 * power[order[0]]]
    return [float(f"{frequency[i]:.4g}") for i in kept]
