"""The samples of several recordings as one scene: one after another, each with its own drivers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from magcal_service.model import Array
from magcal_service.physics.scene.scene import KEPT, Scene, Warmed
from magcal_service.physics.scene.vectors import Vectors

_BETWEEN_S: Final = 3600.0
"""Pause between two recordings on the common clock [s]: longer than any gap that a course is carried over."""

_SAME_UNDER_CONSTANTS: Final = tuple(name for name in KEPT if name not in ("memo", "_warmed", "_skins", "eclipses"))
"""Results of a scene that no constant of a model changes."""


@dataclass(frozen=True, eq=False)
class JointScene(Scene):
    """As ``Scene``, with the scenes of the recordings; times rise over all of them, with pauses between.

    Parameters
    ----------
    parts: one scene a recording, each on its own clock.
    """

    parts: tuple[Scene, ...] = ()

    @classmethod
    def of(cls, parts: Sequence[Scene]) -> JointScene:
        """The scenes one after another."""
        times = [part.time_s + offset for part, offset in zip(parts, offsets_s(parts), strict=True)]
        return cls(
            time_s=np.concatenate(times),
            origin_ns=parts[0].origin_ns,
            utc=all(part.utc for part in parts),
            field_nt=np.concatenate([part.field_nt for part in parts]),
            calibrated_nt=np.concatenate([part.calibrated_nt for part in parts]),
            clean_field_nt=np.concatenate([part.clean_field_nt for part in parts]),
            undisturbed_nt=np.concatenate([part.free_field_nt for part in parts]),
            magnitude_nt=np.concatenate([part.magnitude_nt for part in parts]),
            moved_s=np.concatenate([np.zeros(len(part)) if part.moved_s is None else part.moved_s for part in parts]),
            in_orbit=all(part.in_orbit for part in parts),
            parts=tuple(parts),
        )

    def course_at(self, at_s: float) -> Array:
        """Times (k,) [s], on the common clock, of the recording that a time belongs to."""
        shifts = offsets_s(self.parts)
        number = max(int(np.searchsorted(shifts, at_s, side="right")) - 1, 0)
        return self.parts[number].time_s + shifts[number]

    def recalibrated(self, found: Vectors) -> JointScene:
        """The same recordings with other vectors, of all one after another."""
        ends = np.cumsum([len(part) for part in self.parts])
        own = (slice(end - len(part), end) for part, end in zip(self.parts, ends, strict=True))
        return JointScene.of([part.recalibrated(found.part(rows)) for part, rows in zip(self.parts, own, strict=True)])


def offsets_s(parts: Sequence[Scene]) -> list[float]:
    """What is added to each recording's own time [s] on the common clock."""
    found = [0.0]
    for part in parts[:-1]:
        found.append(found[-1] + float(part.time_s[-1]) + _BETWEEN_S)
    return found


def under(scene: Scene, constants: Mapping[str, float], warmed: Warmed) -> Scene:
    """A scene to which a model with these constants is applied.

    ``warmed`` keeps answers to light, which depend on the constants but not on calibrated vectors.
    """
    for name in _SAME_UNDER_CONSTANTS:
        getattr(scene, name)
    given = replace(scene, given=constants)
    given.__dict__.update({name: scene.__dict__[name] for name in _SAME_UNDER_CONSTANTS})
    given.__dict__["_warmed"] = warmed
    return given
