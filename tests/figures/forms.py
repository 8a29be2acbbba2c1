"""The forms of every effect, as the catalogue makes them on scenes that offer all that it asks for."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Final

import numpy as np

from magcal_service.model import Array
from magcal_service.physics.acting import ActsOn
from magcal_service.physics.catalogue import catalogue
from magcal_service.physics.interface import Effect, Hypothesis
from magcal_service.physics.scene.scene import Scene
from tests.figures.markdown import table
from tests.physics.scenes import scene

_FOLLOWS: Final = {"channel": "`channel:NAME`", "inferred": "`inferred:{}`", "none": "`none`"}
_SOUGHT: Final = {
    ActsOn.SAMPLES: "in the samples themselves",
    ActsOn.ATTITUDE: "in how the craft turns",
    ActsOn.NOISE: "in the noise",
    ActsOn.FIELD: "in when it acts, beside the names",
}
"""Where an effect is found that is no field, or whose field is another each time."""

_COUNTED: Final = re.compile(r"\d+")

MEANS: Final = {
    "column N": "of a channel with several columns that one, from 1 (the constant `column` counts from 0)",
    "circuit N": "of a channel of currents, the column of that number, from 1 (`column_0` counts from 0)",
    "all circuits": "every column of every current, each with a field of its own",
    "lagging": "the field comes after the record, by a filter with the time constant `lag_s`",
    "recorded late": "the record is `late_s` older than its row, and held (or averaged) for `held_s`",
    "recorded with noise": "the record has noise of its own, which would make the field per ampere come out small",
    "lit or not": "the array's current is on in light and off in shadow",
    "late": "the current of the array comes and goes with the time constant `lag_s`",
    "panel, panels": "half waves of the Sun on a face of the craft, or on two opposite ones with a field each",
    "sum of panels": "one current of all panels, or of those across two axes",
    "every panel its own circuit": "each face that sees the Sun has a field of its own",
    "limited": "the sum goes no higher than `limit` of full sun on one panel",
    "settling": "warm or cold at the start, and answering to nothing since: it dies away with `time_constant_s`",
    "answer to light": "a temperature that nobody recorded, from sunlight: a skin (`skin_s`) heats the sensor "
    "(`time_constant_s`); what it had at the start dies away (`start_`)",
    "one gain": "the same gain for all three axes, in place of one for each",
    "of the field alone": "it acts on the field, and not on the bias: the bias arises behind the stage that changes",
    "quadratic": "as time and its square go on",
    "relaxing": "from the start towards an end, with `time_constant_s`",
    "relaxing from an instant": "the same from `from_s` on",
    "over a while": "from one value to another between `from_s` and `to_s`",
    "switched at N instants": "on at the first instant, off at the second, and so on: one size",
    "steps at N instants": "at each instant a step of its own",
    "axis x behind": "that axis, or y or z so, answers later than the other two, as it does inside a loop of metal",
    "with cross terms": "beside the cube of each axis what the other two axes make in it, the same both ways",
    "with cross terms of each axis": "each way by itself, which only whole vectors show",
    "by the field's size": "one factor for all axes, by the square of the field's length",
    "uniform": "currents far above, without what they induce in the Earth; plain forms have that",
    "changing": "a straight line over the recording",
    "curved": "a parabola over the recording",
    "storm": "a polynomial of the fourth degree over the recording",
    "gradual": "a part that forgets smoothly, in place of the sharp one",
    "rods along the axes": "three rods, each remembering the field along one axis",
    "one strip": "one part that remembers the field along any direction",
    "geodetic as geocentric": "latitude and height above the ellipsoid were read as those from the Earth's centre",
    "radial, along, cross": "places are off outwards, ahead on the track, to its left",
    "dipole": "by the gradient of a dipole, where no date tells the field model's",
    "radial and along": "both",
    "three axes": "all three",
    "growing": "and more so with every hour",
    "growing along": "of these, along the track more so with every hour",
    "growing faster": "with the square of the hours as well",
    "far along": "ahead or behind by minutes of flight",
    "by decades": "coefficients that are many years old: the mean change since",
    "degree N": "a series that was cut after this degree",
    "by the steps": "the turn that a late sensor loses is taken from samples that follow one another",
    "from its start": "and it held something else when the recording began",
    "average of samples": "a sensor, or the software that reads it out, averages samples",
    "soft knee of N": "readings of an axis that bend before the end of the range",
    "second degree": "and products of two components of the Sun's direction",
    "second degree and light": "and the light itself",
    "ahead of the attitude": "samples are of a later time than the attitude recorded with them",
    "behind the attitude": "of an earlier time",
    "of whole vectors": "beside a recorded attitude: the whole vector lags, in direction and length",
    "with drift": "and the clocks drift apart",
    "by minutes": "the reference is that of another time, minutes away",
    "commands after their rows": "a command that a row holds was given after its sample",
    "with remanence": "and the core keeps a field with the sign of the last command",
    "regular duty": "torquers on for `on_share` of each `period_s`",
    "sign of dB/dt": "torquers that detumble, driven against the change of the field",
    "sign of dB/dt on a duty": "the same for a part of each period",
    "momentum dumped at intervals": "torquers that turn stored momentum away, for a part of each period",
    "in any direction": "the angular momentum may point along any axis of the body",
    "held": "each command is held for `hold_s`",
}
"""What the parts of a form's name mean; of numbers and letters that are counted stands N."""

_LETTERS: Final = re.compile(r"(?<=of )[xyz]$")


def scenes() -> tuple[Scene, ...]:
    """With all telemetry and attitude, with records that have noise of their own, with places alone, and with two
    temperatures: some forms stand in for what is not recorded."""
    of, rng = scene(), np.random.default_rng(8916)
    noisy = {
        name: replace(one, values=one.values + 0.1 * rng.standard_normal(one.values.shape))
        for name, one in of.channels.items()
        if one.quantity == "current"
    }
    places = replace(of, channels={}, body_from_eci=None)
    warm = {"temperature": replace(of.channels["temperature"], values=_two_columns(of.channels["temperature"].values))}
    return of, replace(of, channels=noisy), places, replace(of, channels=warm), replace(places, utc=False)


def _two_columns(values: Array) -> Array:
    return np.concatenate([values, values**2], axis=1)


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
            rows.append([f"`{effect.name}`", "", f"sought {_SOUGHT[effect.acts_on]}", _listed(found)])
    return table(["effect (`name`)", "`driver`", "forms (`variant`)", "numbers"], rows)


def words() -> str:
    """What the parts of the forms' names mean, a part a line."""
    return table(["part of a `variant`", "what it says"], [[one, says] for one, says in MEANS.items()])


def parts_of(variant: str) -> list[str]:
    """The parts of a form's name, as ``MEANS`` has them."""
    found = []
    for part in variant.split(", "):
        part = _LETTERS.sub("N", _COUNTED.sub("N", part))
        named = {"radial": "radial, along, cross", "along": "radial, along, cross", "cross": "radial, along, cross"}
        part = "panel, panels" if part.startswith(("panel ", "panels ")) else named.get(part, part)
        part = "axis x behind" if part.endswith(" behind") else part
        found.append("sum of panels" if part.startswith("sum of ") else part)
    return found


def _follows(form: Hypothesis) -> str:
    kind, _, name = form.driver.partition(":")
    return _FOLLOWS[kind].format(name)


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
