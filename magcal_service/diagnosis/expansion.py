"""Where columns are made: at the vectors that a fit has calibrated, and halfway to where it has moved the reference."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from magcal_service.diagnosis.problem import Fit, Term, disturbances
from magcal_service.model import STATE_SIZE, Array, measure
from magcal_service.physics.interface import Hypothesis
from magcal_service.physics.scene.scene import Scene
from magcal_service.physics.scene.vectors import Vectors


def clean_vectors(fit: Fit) -> Vectors:
    """The vectors of a fit."""
    scene = fit.problem.scene
    body, magnitude = disturbances(fit.terms, scene)
    aimed = fit.problem.is_vector
    clean = fit.problem.target(fit.x) if aimed else fit.unit * (scene.magnitude_nt + magnitude)[:, None]
    moved_s = np.zeros(len(scene))
    for term in fit.terms:
        if term.hypothesis.moves_s is not None:
            moved_s += term.hypothesis.moves_s(term.amplitudes)
    x = fit.x[:STATE_SIZE]
    return Vectors(clean, measure(x, clean + body), moved_s, measure(x, clean))


def where_moved(scene: Scene, moved_s: Array | None) -> Scene:
    """The same recording with the reference that each sample has so much later along its course (n,) [s].

    Between samples and past the ends it goes on in straight lines; where it is no vector, nothing changes.
    """
    reference = scene.reference_eci_nt
    if reference is None or moved_s is None or not moved_s.any():
        return scene
    given = np.asarray(reference, dtype=np.float64)
    row = np.clip(np.searchsorted(scene.time_s, scene.time_s + moved_s) - 1, 0, len(scene) - 2)
    share = (scene.time_s + moved_s - scene.time_s[row]) / (scene.time_s[row + 1] - scene.time_s[row])
    found = given[row] + share[:, None] * (given[row + 1] - given[row])
    return replace(scene, reference_eci_nt=found, magnitude_nt=np.linalg.norm(found, axis=1))


def anew(term: Term, hypothesis: Hypothesis) -> Term:
    """A term with its form made anew."""
    return replace(term, hypothesis=hypothesis, theta=hypothesis.anew(term.theta))
