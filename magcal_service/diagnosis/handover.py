"""A diagnosis as ``physics.toml``: the model that daemon and simulator apply."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from magcal_service.diagnosis.diagnose import Diagnosis
from magcal_service.diagnosis.entry import Entry
from magcal_service.diagnosis.errors_spread import errors_sigma
from magcal_service.diagnosis.problem import Fit
from magcal_service.model import STATE_SIZE, Array
from magcal_service.physics.apply.empirical import NAME
from magcal_service.physics.apply.model_file import ModelSpin, ModelTerm, Note, PhysicsModel, text_of
from magcal_service.physics.interface import UNLISTED, Hypothesis, by_name
from magcal_service.physics.scene.steady_spin import SpinSolution
from magcal_service.wire.messages import Clock


def write_model(diagnosis: Diagnosis, entries: Sequence[Entry], recording: str, craft: str = "") -> str:
    """The text of ``physics.toml``, as in ``path.write_text(write_model(diagnosis, entries(diagnosis), "flight"))``."""
    return text_of(model_of(diagnosis, entries, recording, craft))


def model_of(diagnosis: Diagnosis, entries: Sequence[Entry], recording: str, craft: str = "") -> PhysicsModel:
    """The model of a diagnosis; with curves that may be used elsewhere, the numbers of the fit that has them.

    Parameters
    ----------
    entries: of ``result.entries``: those that are no term of the fit become notes, but for ``unknown``.
    recording: name of the recording.
    craft: whose it is; empty where the recording does not say.
    """
    usable, fit = diagnosis.usable, diagnosis.handed_over
    scene, fitted = fit.problem.scene, {term.hypothesis.effect for term in fit.terms}
    sigma = errors_sigma(fit)
    others = [entry for entry in entries if entry.effect not in fitted and entry.effect != UNLISTED]
    spin = diagnosis.spin
    return PhysicsModel(
        recording=recording,
        origin_ns=scene.origin_ns,
        clock=Clock.UTC if scene.utc else Clock.ELAPSED,
        x=fit.x[:STATE_SIZE],
        sigma=sigma,
        noise_nt=diagnosis.noise_nt,
        terms=tuple(term for term in terms_of(fit) if term.effect != NAME),
        notes=tuple(Note(entry.effect, entry.says, _finite(entry)) for entry in others),
        spin=spin_of(spin),
        doubts=", ".join(diagnosis.reasons),
        empirical=() if usable is None else usable.curves,
        craft=craft,
    )


def terms_of(fit: Fit) -> tuple[ModelTerm, ...]:
    """The terms of a fit with the 1 sigma of their amplitudes."""
    sigma = np.sqrt(np.maximum(np.diagonal(fit.covariance), 0.0))
    found, at = [], fit.problem.size
    for term in fit.terms:
        own = model_term(term.hypothesis, term.theta, term.amplitudes)
        spread = model_term(term.hypothesis, term.theta, sigma[at : at + term.hypothesis.size]).amplitudes
        found.append(replace(own, sigma=spread))
        at += term.hypothesis.size
    return tuple(found)


def model_term(hypothesis: Hypothesis, theta: Array, amplitudes: Array) -> ModelTerm:
    """A hypothesis with its numbers by name."""
    parts, used = {}, 0
    for block in hypothesis.blocks:
        parts[block.name] = np.array(amplitudes[used : used + block.size]).reshape(block.shape)
        used += block.size
    numbers = by_name(hypothesis.nonlinear, theta)
    return ModelTerm(
        hypothesis.effect, hypothesis.driver, hypothesis.variant, parts, {}, numbers, dict(hypothesis.constants)
    )


def _finite(entry: Entry) -> dict[str, Array]:
    return {name: value.value for name, value in entry.parameters.items() if np.isfinite(value.value).all()}


def spin_of(spin: SpinSolution | None) -> ModelSpin | None:
    """A recording's steady spin as the model has it."""
    if spin is None:
        return None
    (bx, by, bz), (ix, iy, iz) = spin.axis_body.tolist(), spin.axis_eci.tolist()
    return ModelSpin((bx, by, bz), (ix, iy, iz), spin.rate_rad_s)
