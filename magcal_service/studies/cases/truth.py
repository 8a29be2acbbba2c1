"""What is true of concealed cases, from either form of ``answers.json``."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from magcal_service.base.errors import ConfigError, Fault, FileFault
from magcal_service.physics.effects import (
    bias_step,
    coloured_noise,
    current_loop,
    thermal_bias,
    thermal_scale,
    torquer,
)

ANSWERS: Final = "answers.json"
"""File beside the cases of a folder: what is true of each, by the name of its folder."""

LEAST_DETECTABILITY: Final = 12.0
"""Below it nobody can be asked to find an effect; cases below are diagnosed and counted in no table.

What an effect adds is 12 sigmas in all then, 72 nats before any choice.
"""

GROUPS: Final = (
    "clean",
    "driver recorded or none needed",
    "driver left out",
    "driver left out, not to be guessed",
    "several effects",
    "in no catalogue",
)
"""What a case asks, in the order of the tables."""

_KINDS: Final = {"clean": GROUPS[0], "several": GROUPS[4], "outside": GROUPS[5]}
_NOTHING: Final = ("none", "clean")
_OUTSIDE: Final = "off_catalogue"
_NEARLY_STRUCTURE: Final = (coloured_noise.EFFECT.name,)
"""Of flat answers: noise so slow that ``unknown`` is as right an answer as its name."""


@dataclass(frozen=True, slots=True)
class Put:
    """One effect that was put in: name, parameters, and whether its driver was left out and can be guessed then."""

    effect: str
    parameters: Mapping[str, Any]
    concealed: bool = False
    inferable: bool = True


@dataclass(frozen=True, slots=True)
class Truth:
    """What is true of a case; ``kind`` is ``clean``, ``effect``, ``several`` or ``outside``.

    ``also`` are names that are true besides; ``unknown_is_right`` where that is what ought to be said,
    ``unknown_is_fair`` where structure without a name is there as well.
    """

    regime: str
    kind: str
    effects: tuple[Put, ...]
    also: tuple[str, ...]
    detectability: float
    unknown_is_right: bool = False
    unknown_is_fair: bool = False

    @property
    def names(self) -> set[str]:
        """What may be named."""
        return {effect.effect for effect in self.effects} | set(self.also)

    @property
    def group(self) -> str:
        """What the case asks: one of ``GROUPS``."""
        if self.kind in _KINDS:
            return _KINDS[self.kind]
        if not any(effect.concealed for effect in self.effects):
            return GROUPS[1]
        return GROUPS[2] if all(effect.inferable for effect in self.effects) else GROUPS[3]

    @property
    def put_in(self) -> str:
        """What was put in, in words that other cases share."""
        if self.kind == "several":
            return self.group
        return ", ".join(effect.effect for effect in self.effects) or "nothing"

    @property
    def counts(self) -> bool:
        """Whether it can be asked for: nothing is wrong, or what is wrong can be found."""
        return self.kind == "clean" or self.detectability >= LEAST_DETECTABILITY


def read_answers(folder: Path) -> dict[str, Truth]:
    """The truth of each case of a folder.

    Raises ``ConfigError`` where there is no ``answers.json``, or one of neither form.
    """
    path = folder / ANSWERS
    try:
        answers = json.loads(path.read_text(encoding="utf-8"))
        return {name: _own(answer) if "effects" in answer else _flat(answer) for name, answer in answers.items()}
    except OSError as exc:
        accepted = f"a folder of concealed cases is accepted, with {ANSWERS} beside them; {_MAKE}"
        raise ConfigError([FileFault(f"--recordings: {folder / ANSWERS}", exc, accepted)]) from None
    except (ValueError, KeyError, TypeError, AttributeError) as exc:
        accepted = f"an answer for each case is accepted, in one of the two forms of docs/studies.md; {_MAKE}"
        raise ConfigError([Fault(str(path), f"{type(exc).__name__}: {exc}", accepted)]) from None


_MAKE: Final = "in a checkout `python -m tests.blind` and `python -m tests.regimes` write such folders"


def _own(answer: Mapping[str, Any]) -> Truth:
    effects = tuple(
        Put(one["effect"], one["parameters"], one["driver_concealed"], one["is_inferable"]) for one in answer["effects"]
    )
    off = answer["model_detectability"] >= LEAST_DETECTABILITY
    kind = answer["kind"]
    if kind not in (*_KINDS, "effect"):
        raise ValueError(f"kind {kind!r}")
    return Truth(
        answer["regime"], kind, effects, tuple(answer["also"]), answer["detectability"], kind == "outside", off
    )


_FLAT: Final[Mapping[str, tuple[str, Callable[[Any], Any]]]] = {
    "nT_per_K": ("nt_per_k", lambda value: value),
    "nT_per_A": ("nt_per_a", lambda value: value),
    "reference_late_s": ("offset_s", lambda value: value),
    "at_s": ("at_s", lambda value: value),
    "period_s": ("frequency_hz", lambda value: 1.0 / value),
}
"""Numbers of flat answers: the product's name for each, and how it is worked out."""


def _flat(answer: Mapping[str, Any]) -> Truth:
    name = answer["effect"]
    kind = "clean" if name in _NOTHING else "outside" if name == _OUTSIDE else "effect"
    numbers = {_FLAT[key][0]: _FLAT[key][1](value) for key, value in answer.items() if key in _FLAT}
    if name == bias_step.EFFECT.name:
        numbers["step_nt"] = answer["nT"]
    effects = () if kind == "clean" else (Put(name, numbers, _leaves_out(answer)),)
    structure = name in (_OUTSIDE, *_NEARLY_STRUCTURE)
    return Truth(answer.get("regime", "flat"), kind, effects, (), answer["detectability"], structure)


_DRIVEN: Final = frozenset(module.EFFECT.name for module in (thermal_bias, thermal_scale, current_loop, torquer))
"""Of flat answers: effects with a driver, which say of every case whether drivers are recorded."""


def _leaves_out(answer: Mapping[str, Any]) -> bool:
    return bool(answer["driver_concealed"]) and answer["effect"] in _DRIVEN
