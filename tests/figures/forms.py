"""The forms of every effect, as the catalogue makes them on scenes that offer all that it asks for."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Final

import numpy as np

from magcal_service.physics.acting import ActsOn
from magcal_service.physics.catalogue import catalogue
from magcal_service.physics.interface import Effect, Hypothesis
from magcal_service.physics.scene.scene import Scene
from tests.figures.markdown import table
from tests.physics.scenes import scene

_FOLLOWS: Final = {"channel": "a recorded channel", "inferred": "inferred {}", "none": "-"}
_SOUGHT: Final = {
    ActsOn.SAMPLES: "in the samples themselves",
    ActsOn.ATTITUDE: "in how the craft turns",
    ActsOn.NOISE: "in the noise",
    ActsOn.FIELD: "in when it acts, beside the names",
}
"""Where an effect is found that is no field, or whose field is another each time."""

_COUNTED: Final = re.compile(r"\d+")


def scenes() -> tuple[Scene, ...]:
    """With all telemetry and attitude, with records that have noise of their own, and with places alone: some forms
    stand in for what is not recorded."""
    of, rng = scene(), np.random.default_rng(8916)
    noisy = {
        name: replace(one, values=one.values + 0.1 * rng.standard_normal(one.values.shape))
        for name, one in of.channels.items()
        if one.quantity == "current"
    }
    return of, replace(of, channels=noisy), replace(of, channels={}, body_from_eci=None)


def forms_of(effect: Effect) -> Iterator[Hypothesis]:
    """Every form of an effect, once, on the scenes."""
    known: set[tuple[str, str]] = set()
    for one in scenes():
        for form in effect.hypotheses(one):
            key = _follows(form), form.variant
            if key not in known:
                known.add(key)
                yield form


def forms() -> str:
    """Of each effect, by what it follows: its forms by ``variant``, and the numbers that each has fitted."""
    rows = []
    for effect in catalogue():
        drivers: dict[str, dict[str, list[str]]] = {}
        for form in forms_of(effect):
            alike = drivers.setdefault(_follows(form), {})
            alike.setdefault(_numbers(form), []).append(form.variant)
        for follows, alike in drivers.items():
            for numbers, variants in alike.items():
                rows.append([f"`{effect.name}`", follows, _named(variants), numbers])
        if effect.find is not None:
            fitted = {name for alike in drivers.values() for numbers in alike for name in numbers.split(", ")}
            found = [name for name in effect.units if f"`{name}`" not in fitted]
            rows.append([f"`{effect.name}`", "-", f"sought {_SOUGHT[effect.acts_on]}", _listed(found)])
    return table(["effect", "follows", "forms (`variant`)", "numbers"], rows)


def _follows(form: Hypothesis) -> str:
    kind, _, name = form.driver.partition(":")
    return _FOLLOWS[kind].format(name.replace("_", " "))


def _numbers(form: Hypothesis) -> str:
    """Numbers of a form that are in ``parameters`` of the JSON, each once."""
    return _listed([*(block.name for block in form.blocks), *(number.name for number in form.nonlinear)])


def _listed(names: Iterable[str]) -> str:
    return ", ".join(f"`{name}`" for name in dict.fromkeys(names))


def _named(variants: list[str]) -> str:
    """Variants with those that differ in a number alone as one, with its range."""
    counted: dict[str, list[int]] = {}
    for variant in variants:
        counted.setdefault(_COUNTED.sub("N", variant), []).extend(map(int, _COUNTED.findall(variant)))
    return "; ".join(_ranged(words, numbers) for words, numbers in counted.items())


def _ranged(words: str, numbers: list[int]) -> str:
    if not numbers:
        return words or "*plain*"
    few = min(numbers) == max(numbers)
    return words.replace("N", str(min(numbers)) if few else f"{min(numbers)} to {max(numbers)}")
