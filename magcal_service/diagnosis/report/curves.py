"""The numbers behind a report's figures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from magcal_service.base.units import CHANNEL_UNITS
from magcal_service.diagnosis.diagnose import Diagnosis
from magcal_service.diagnosis.leftover import significant
from magcal_service.diagnosis.lines import slots
from magcal_service.diagnosis.problem import Term
from magcal_service.model import Array
from magcal_service.physics.scene.scene import Scene

_BINS: Final = 20
"""Ranges of a driver; choice: enough to see a bend, each still with a twentieth of the samples."""

_MOST_TERMS: Final = 3
"""Effects with a separate figure: as many as a search keeps (``MOST_EFFECTS``)."""


@dataclass(frozen=True, slots=True, eq=False)
class Against:
    """Means of the disturbance in ranges of something, before and after, each with 1 sigma [nT]."""

    x_label: str
    y_label: str
    caption: str
    x: Array
    before: Array
    before_sigma: Array
    after: Array
    after_sigma: Array


def binned_rms(x: Array, values: Array, count: int) -> tuple[Array, Array]:
    """Centre and rms of values (n,) in ranges of x (n,) of one width; empty ranges left out."""
    edges = np.linspace(float(x.min()), float(x.max()), count + 1)
    number = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, count - 1)
    hits = np.bincount(number, minlength=count)
    squares = np.bincount(number, weights=values**2, minlength=count)
    used = hits > 0
    return (0.5 * (edges[1:] + edges[:-1]))[used], np.sqrt(squares[used] / hits[used])


def spectrum(scene: Scene, residual: Array) -> tuple[Array, Array]:
    """Frequencies [Hz] and density [nT / sqrt(Hz)] of a residual (n,) or (3 n,), gaps as zeros.

    Power is averaged over neighbours, by ever more of them towards high frequencies: 160 points at most.
    """
    slot = slots(scene)
    parts = residual.reshape(len(scene), -1).T
    size = int(slot[-1]) + 1
    grid = np.zeros((len(parts), size))
    grid[:, slot] = parts
    power = np.mean(np.abs(np.fft.rfft(grid)) ** 2, axis=0)[1:] * 2.0 * scene.period_s / len(scene)
    frequency = np.fft.rfftfreq(size, scene.period_s)[1:]
    edges = np.unique(np.geomspace(1, len(power) + 1, 161).astype(np.intp)) - 1
    counts = np.diff(edges)
    means = np.add.reduceat(power, edges[:-1]) / counts
    centres = np.add.reduceat(frequency, edges[:-1]) / counts
    return centres, np.sqrt(means)


def against(diagnosis: Diagnosis, before: Array, after: Array) -> list[Against]:
    """One for each of the largest effects; without any, for the residual or for the field's magnitude."""
    problem, fit = diagnosis.prepared.problem, diagnosis.fit
    if problem.is_vector:
        return []
    found = []
    for term in _largest(diagnosis):
        others = [other for other in fit.terms if other is not term]
        columns = [problem.rows(other.hypothesis.columns(other.theta), fit.unit) for other in others]
        taken = [c @ other.amplitudes for c, other in zip(columns, others, strict=True) if c is not None]
        found.append(_of_term(diagnosis, term, before - np.sum(taken, axis=0) if taken else before, after))
    if found:
        return found
    if diagnosis.left and significant(diagnosis.left[0]):
        signal = diagnosis.left[0].signal
        label = f"what is left, as fitted: {diagnosis.left[0].shape.says} [nT]"
        return [
            _plain("what is left against its fitted shape: a straight line is the shape itself", label, signal, after)
        ]
    magnitude = problem.scene.magnitude_nt * 1e-3
    return [_plain("against the size of the field", "|H| of the reference [µT]", magnitude, after)]


def _largest(diagnosis: Diagnosis) -> list[Term]:
    """The terms that hold most of the mismatch, largest first."""
    fit, problem = diagnosis.fit, diagnosis.prepared.problem

    def power(term: Term) -> float:
        rows = problem.rows(term.hypothesis.columns(term.theta), fit.unit)
        return 0.0 if rows is None else float(np.sum((rows @ term.amplitudes) ** 2))

    return sorted(fit.terms, key=power, reverse=True)[:_MOST_TERMS]


def _of_term(diagnosis: Diagnosis, term: Term, before: Array, after: Array) -> Against:
    """The residual along the effect's main direction, against its driver or against what the effect itself says."""
    fit, scene = diagnosis.fit, diagnosis.prepared.problem.scene
    field = term.hypothesis.columns(term.theta).field(term.amplitudes)
    if not field.any():
        grown = np.asarray(term.hypothesis.columns(term.theta).growth(term.amplitudes))
        x, label = grown, "what it predicts [nT]"
        weight, y_label = np.ones(len(x)), "mean residual [nT]"
    else:
        axis = _direction(field)
        weight = fit.unit @ axis
        driver = _driver(term, scene)
        x, label = driver or (field @ axis, "what it predicts [nT]")
        y_label = f"field along ({axis[0]:.2f}, {axis[1]:.2f}, {axis[2]:.2f}) [nT]"
    number, centres = _ranges(x)
    means = [_means(number, len(centres), weight, rows) for rows in (before, after)]
    caption = (
        f"{term.hypothesis.effect} against {_words(label)}: the field in the body, other effects off, with 1 sigma."
    )
    return Against(label, y_label, caption, centres, *means[0], *means[1])


def _words(label: str) -> str:
    return label.rpartition(" [")[0] or label


def _direction(field: Array) -> Array:
    """Unit vector (3,) along which a body field (n, 3) varies most."""
    centred = field - field.mean(axis=0)
    source = centred if float((centred**2).sum()) > 1e-6 * float((field**2).sum()) else field
    axis: Array = np.linalg.eigh(source.T @ source)[1][:, 2]
    return np.asarray(axis * np.sign(axis[int(np.argmax(np.abs(axis)))]))


def _driver(term: Term, scene: Scene) -> tuple[Array, str] | None:
    """Values and label of a recorded driver of one column; None for others."""
    kind, _, name = term.hypothesis.driver.partition(":")
    channel = scene.channels.get(name) if kind == "channel" else None
    if channel is None or channel.values.shape[1] != 1:
        return None
    base = next((unit.base for unit in CHANNEL_UNITS.values() if unit.quantity == channel.quantity), "")
    return channel.values[:, 0], f"{name} [{base}]" if base else name


def _plain(caption: str, label: str, x: Array, residual: Array) -> Against:
    number, centres = _ranges(x)
    means = _means(number, len(centres), np.ones(len(x)), residual)
    return Against(label, "mean residual [nT]", f"{caption[0].upper()}{caption[1:]}.", centres, *means, *means)


def _ranges(x: Array) -> tuple[NDArray[np.intp], Array]:
    """Range number (n,) and the mean of x in each: equally many samples a range, or one range a value."""
    values, of_value = np.unique(x, return_inverse=True)
    if len(values) <= _BINS:
        return of_value, values
    edges = np.unique(np.quantile(x, np.linspace(0.0, 1.0, _BINS + 1)))
    number = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, max(len(edges) - 2, 0))
    used, number = np.unique(number, return_inverse=True)
    counts = np.bincount(number, minlength=len(used))
    return number, np.bincount(number, weights=x, minlength=len(used)) / counts


def _means(number: NDArray[np.intp], count: int, weight: Array, residual: Array) -> tuple[Array, Array]:
    """Least-squares amplitude along ``weight`` in each range, and its 1 sigma."""
    size = np.maximum(np.bincount(number, weights=weight**2, minlength=count), 1e-9)
    mean = np.bincount(number, weights=weight * residual, minlength=count) / size
    hits = np.maximum(np.bincount(number, minlength=count), 1)
    rest = np.bincount(number, weights=(residual - weight * mean[number]) ** 2, minlength=count) / hits
    return mean, np.sqrt(rest / size)
