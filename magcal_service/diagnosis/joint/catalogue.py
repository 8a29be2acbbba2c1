"""The catalogue on several recordings: the forms its effects have together, under constants that suit them all."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final

from magcal_service.diagnosis.joint.forms import EACH_ITS_OWN, OF_CHANGES, JointHypothesis, joined, like
from magcal_service.diagnosis.joint.scene import offsets_s, under
from magcal_service.diagnosis.problem import Problem
from magcal_service.diagnosis.screen import hypotheses_of
from magcal_service.physics.interface import Effect, Hypothesis
from magcal_service.physics.scene.scene import MOST_WARMED, SKIN_START, Scene, Warmed

_OF_ONE_RECORDING: Final = ("middle_s", "span_s")
"""Constants of a course in time: they have no meaning in another recording."""

_LARGEST: Final = ("full_sun", "full_scale_nt", "largest_am2", "scale_nt")
"""Constants that scale a signal to its largest value."""

_BY_THE_DATA: Final = ("as_well", "imitated_by", "if_completed", "if_along", "if_none")
"""Fields of a hypothesis that say what else a recording may be showing."""

_NUMBERED: Final = ("face", "column")
"""Constants that list what is used: in several recordings, what is used in any."""


@dataclass(eq=False)
class Forms:
    """Every way the catalogue's effects may act on several recordings of one craft.

    A form is left out where a recording lacks what it needs (a channel, a place): what is common to all is asked.
    Left to each recording alone are tones and duties, whose phases are its own, and drivers whose pattern is guessed.
    Changes, at an instant or over a while, are forms of one recording each.

    Parameters
    ----------
    effects: the catalogue.
    constants: for each form, by its label, the constants that all recordings share.
    """

    effects: tuple[Effect, ...]
    constants: Mapping[str, Mapping[str, float]]
    _warmed: dict[Any, Warmed] = field(default_factory=dict, repr=False)

    @classmethod
    def of(cls, effects: Sequence[Effect], parts: Sequence[Problem]) -> Forms:
        """The forms of these recordings, with the constants that suit them all."""
        found: dict[str, list[tuple[int, Mapping[str, float]]]] = {}
        for part in parts:
            for hypothesis in hypotheses_of(effects, part):
                found.setdefault(hypothesis.label, []).append((len(part.scene), hypothesis.constants))
        return cls(tuple(effects), {label: _common(each) for label, each in found.items()})

    def on(
        self, parts: Sequence[Problem], names: Sequence[str], only: Sequence[JointHypothesis] | None = None
    ) -> list[JointHypothesis]:
        """The forms on some of the recordings; ``only``: of those that are like these."""
        bases = None if only is None else {form.base for form in only}
        counts, offsets = [len(part.scene) for part in parts], offsets_s([part.scene for part in parts])
        found = []
        for effect in self.effects:
            if only is not None and all(form.effect != effect.name for form in only):
                continue
            each = [self._of_part(effect, part, name, bases) for part, name in zip(parts, names, strict=True)]
            for label in dict.fromkeys(label for one in each for label in one):
                found += _forms([one.get(label) for one in each], names, counts, offsets, effect.of_one_recording)
        return found if only is None else [form for form in found if any(like(one, [form]) for one in only)]

    def _of_part(self, effect: Effect, part: Problem, name: str, bases: set[str] | None) -> dict[str, Hypothesis]:
        """One recording's hypotheses by label, under the constants that all share."""
        plain = {form.label: form for form in hypotheses_of([effect], part)}
        by_constants: dict[tuple[tuple[str, float], ...], list[str]] = {}
        found = {}
        for label, constants in self.constants.items():
            if _effect_of(label) != effect.name or not (bases is None or label in bases):
                continue
            if label in plain and not constants:
                found[label] = plain[label]
            else:
                by_constants.setdefault(tuple(sorted(constants.items())), []).append(label)
        for key, labels in by_constants.items():
            warmed = self._warmed.setdefault((name, key), Warmed(MOST_WARMED))
            given = replace(part, scene=under(part.scene, started(part.scene, dict(key)), warmed))
            forms = {form.label: form for form in hypotheses_of([effect], given)}
            found |= {label: _as_on(plain.get(label), forms[label]) for label in labels if label in forms}
        return found


def _as_on(plain: Hypothesis | None, given: Hypothesis) -> Hypothesis:
    """A form under given constants, with what may be taken for it by the data, which a given model is not asked."""
    return given if plain is None else replace(given, **{name: getattr(plain, name) for name in _BY_THE_DATA})


def _forms(
    parts: Sequence[Hypothesis | None],
    names: Sequence[str],
    counts: Sequence[int],
    offsets: Sequence[float],
    of_one_recording: bool,
) -> list[JointHypothesis]:
    """What the recordings' own hypotheses of one label become together; nothing where one of them lacks it.

    ``of_one_recording``: as of their effect.
    """
    first = next(part for part in parts if part is not None)
    roles = {number.role for number in first.nonlinear}
    changes = bool(roles) and roles <= OF_CHANGES
    if roles & {"frequency", "period"} or (first.proposals is not None and not changes):
        return []
    if changes:
        alone = [[part if k == number else None for k in range(len(parts))] for number, part in enumerate(parts)]
        return [
            joined(part, one, names, counts, offsets, f"in {name}", solo=name)
            for part, one, name in zip(parts, alone, names, strict=True)
            if part is not None
        ]
    if any(part is None for part in parts) or len({_shape(part) for part in parts if part is not None}) > 1:
        return []
    if len(parts) == 1:
        return [joined(first, parts, names, counts, offsets)]
    said = (EACH_ITS_OWN,) if of_one_recording else ("", EACH_ITS_OWN)
    return [joined(first, parts, names, counts, offsets, one) for one in said]


def started(scene: Scene, constants: Mapping[str, float]) -> Mapping[str, float]:
    """Constants with those of a recording's start: what light heats first begins in the light of the first sample."""
    if "mean_light" not in constants or scene.lit is None:
        return constants
    return {**constants, SKIN_START: float(scene.lit[0]) - constants["mean_light"]}


def _effect_of(label: str) -> str:
    return label.partition(" by ")[0].partition("[")[0]


def _shape(form: Hypothesis) -> tuple[tuple[str, tuple[int, ...]], ...]:
    return tuple((block.name, block.shape) for block in form.blocks)


def _common(each: Sequence[tuple[int, Mapping[str, float]]]) -> Mapping[str, float]:
    """The constants of one form that suit all recordings, from (samples, constants) of those that have it."""
    found: dict[str, float] = {}
    for kind in _NUMBERED:
        used = {
            v for _, one in each for k, v in one.items() if k.startswith(f"{kind}_") and k[len(kind) + 1 :].isdigit()
        }
        found |= {f"{kind}_{index}": value for index, value in enumerate(sorted(used))}
    for name in dict.fromkeys(name for _, one in each for name in one):
        if name in found or name in _OF_ONE_RECORDING or _is_numbered(name):
            continue
        values = [(samples, one[name]) for samples, one in each if name in one]
        if name in _LARGEST:
            found[name] = max(value for _, value in values)
        else:
            found[name] = sum(samples * value for samples, value in values) / sum(samples for samples, _ in values)
    return found


def _is_numbered(name: str) -> bool:
    kind, _, number = name.rpartition("_")
    return kind in _NUMBERED and number.isdigit()
