"""A model of ``physics.toml`` applied to any scene: what its effects add to the field and to the reference."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from magcal_service.base.errors import MagcalError
from magcal_service.model import Array, calibrate, measure
from magcal_service.physics.apply.empirical import NAME, Empirical
from magcal_service.physics.apply.model_file import ModelTerm, PhysicsModel
from magcal_service.physics.catalogue import effect_named
from magcal_service.physics.interface import Hypothesis
from magcal_service.physics.scene.memory import Memory
from magcal_service.physics.scene.motion import FEWEST_FOR_MEANS
from magcal_service.physics.scene.scene import Scene
from magcal_service.wire.messages import Clock


class DriverMissingError(MagcalError):
    """A scene lacks what drives an effect of the model."""


class MisfitError(MagcalError):
    """An effect's numbers do not fit its form in the catalogue."""


@dataclass(frozen=True, slots=True, eq=False)
class Bound:
    """A term whose hypothesis was found on a scene, with nonlinear numbers (m,) and amplitudes (k,)."""

    hypothesis: Hypothesis
    theta: Array
    amplitudes: Array

    def disturbance(self) -> tuple[Array, Array | float]:
        """Body field (n, 3) and growth of the magnitude (n,) [nT]."""
        columns = self.hypothesis.columns(self.theta)
        return columns.field(self.amplitudes), columns.growth(self.amplitudes)


def at_origin(scene: Scene, model: PhysicsModel) -> Scene:
    """The scene with its time counted from the model's origin, where both go by one clock; else as it is."""
    if scene.utc is not (model.clock is Clock.UTC) or scene.origin_ns == model.origin_ns:
        return scene
    shift_s = (scene.origin_ns - model.origin_ns) * 1e-9
    return replace(scene, time_s=scene.time_s + shift_s, origin_ns=model.origin_ns)


def bind(term: ModelTerm, scene: Scene, memory: Memory | None = None) -> Bound:
    """Find a term's hypothesis on a scene (times from the model's origin), under the term's constants.

    Raises DriverMissingError where the scene has no such driver, MisfitError where names or shapes differ.
    """
    given = replace(scene, given=term.constants, memory=memory)
    bound = _bound(term, given)
    moves_s = bound.hypothesis.moves_s
    if moves_s is None or memory is not None or len(scene) < FEWEST_FOR_MEANS:  # a moment has no course
        return bound
    return _bound(term, replace(given, moved_s=moves_s(bound.amplitudes) + np.zeros(len(scene))))


def less(scene: Scene, added_nt: Array, x: Array) -> Scene:
    """A scene less what a term adds (n, 3) [nT] by a first look: what bends the field acts on it as it is without.

    ``x``: nine errors (9,).
    """
    clean = calibrate(x, scene.clean_field_nt) - added_nt
    return replace(scene, calibrated_nt=clean, undisturbed_nt=measure(x, clean))


def _bound(term: ModelTerm, given: Scene) -> Bound:
    for hypothesis in effect_named(term.effect).hypotheses(given):
        if (hypothesis.driver, hypothesis.variant) == (term.driver, term.variant):
            theta = _theta(term, hypothesis)
            return Bound(hypothesis, theta, _amplitudes(term, hypothesis))
    raise DriverMissingError(f"{term.effect}: driver {described(term)} is not there")


def described(term: ModelTerm) -> str:
    """Driver and form in one text."""
    return f"{term.driver!r}, form {term.variant!r}" if term.variant else repr(term.driver)


def _theta(term: ModelTerm, hypothesis: Hypothesis) -> Array:
    names = [number.name for number in hypothesis.nonlinear]
    counts = {name: names.count(name) for name in names}
    _check_names(term, "nonlinear", counts, term.nonlinear)
    for name, count in counts.items():
        if np.size(term.nonlinear[name]) != count:
            given = np.size(term.nonlinear[name])
            raise MisfitError(f"{term.effect}: {name} has {given} numbers; {count} are accepted for this form")
    return np.concatenate([np.zeros(0), *(np.ravel(term.nonlinear[name]) for name in counts)])


def _amplitudes(term: ModelTerm, hypothesis: Hypothesis) -> Array:
    _check_names(term, "amplitudes", [block.name for block in hypothesis.blocks], term.amplitudes)
    parts = []
    for block in hypothesis.blocks:
        values = term.amplitudes[block.name]
        if not block.takes(values.shape):
            raise MisfitError(f"{term.effect}: {block.name} has shape {values.shape}; {block.shape} is accepted")
        parts.append(values.reshape(-1))
    return np.concatenate(parts)


def _check_names(term: ModelTerm, what: str, wanted: Iterable[str], found: Mapping[str, object]) -> None:
    names = list(wanted)
    if set(names) != set(found):
        accepted = ", ".join(names) or "none"
        raise MisfitError(f"{term.effect}: {what} {', '.join(found) or 'none'}; {accepted} is accepted for this form")


def followed(curve: Empirical, scene: Scene) -> Array:
    """Values (n,) of a curve's driver on a scene; raises DriverMissingError where the scene lacks it."""
    values = curve.followed(scene)
    if values is None:
        raise DriverMissingError(f"{NAME}: driver {curve.driver!r} is not there")
    return values
