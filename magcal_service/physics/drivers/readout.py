"""A record that is not what flows at its row: read out before it and held, averaged, or with noise of its own."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import Final

import numpy as np

from magcal_service.model import Array
from magcal_service.physics.columns import Columns, along_axes
from magcal_service.physics.interface import Hypothesis, Nonlinear, Values
from magcal_service.physics.scene.scene import Scene, Telemetry
from magcal_service.physics.scene.smooth import expected_course, mean_over, noise_of

_LATE_S: Final = np.array([0.0, 3.0, 10.0, 30.0, 90.0])
_HELD_S: Final = np.array([0.0, 10.0, 30.0, 60.0])
"""How long before its row a record was taken at the least, and for how long it is held until the next [s]: housekeeping
is read out every few seconds to a minute."""

_LATE: Final = "recorded late"
"""Ends the form of a record that was read out before its row, and held until the next readout."""

_WITH_NOISE: Final = "recorded with noise"
"""Ends the form of a record that has noise of its own."""

_AVERAGED: Final = "averaged"
"""Constant: 1 where hardly a row of the record repeats the one before, so that nothing was held; else not there."""

_BY_CHANCE: Final = 0.05
"""Share of rows that may be the one before by their last digit; of a record held for two rows every other is."""

_FEWEST_READOUTS: Final = 30  # changes of value, and values, from which on how far apart they are is a rule; a choice
_MOST_LOST: Final = 0.5  # share of its evidence that a held record is given at the most; choice: half has to be seen

RECORD_NEXT: Final = (
    "read {channel} out with every sample: its record is {late_s.size} older than its row, and a mean over "
    "{averaged_s.size}",
    "read {channel} out with every sample: its record is {late_s.size} older than its row, and held for {held_s.size}",
    "record {channel} with less noise than {record_noise_a.size}, as by a mean of more readings",
    "record {channel} with less noise than {record_noise.size}, as by a mean of more readings",
)
"""What to record otherwise, as ``Effect.record_next`` has it."""


def late(scene: Scene, plain: Hypothesis) -> Hypothesis:
    """A form by a channel whose record was taken before its row, and held: what flows is between its values of rows to
    come.

    A mean over the time that values are held for is a straight line from one readout to the next.  As it is recorded, a
    held value is wrong wherever the current has changed since, and the field per ampere comes out small.

    Source: regression on the expected driver, not on its record, has no such bias (Berkson 1950, Journal of the
    American Statistical Association 45, 164-180).
    """
    channel, columns = _of(scene, plain)
    signal = channel.values[:, columns]
    averaged = scene.constant(_AVERAGED, 0.0 if scene.is_given else _hardly_repeats(scene, channel, columns))
    return replace(
        plain,
        columns=_ahead(scene, signal),
        variant=_form(plain, _LATE),
        nonlinear=(Nonlinear("late_s", "s", _LATE_S, spans=True), Nonlinear("held_s", "s", _HELD_S, spans=True)),
        constants={**plain.constants, **({_AVERAGED: averaged} if averaged else {})},
        refines=plain.label,
    )


def noisy(scene: Scene, plain: Hypothesis) -> Iterator[Hypothesis]:
    """A form by one column of a channel whose record has noise of its own: what flows is what it lets expect
    (``expected_course``).

    As it is recorded, a field per ampere comes out small by the noise's share of its variance.  What a record lets
    expect of several currents that go along with one another is another question: what one lacks, the others hold.
    """
    channel, columns = _of(scene, plain)
    own = noise_in(scene, channel, columns[0]) if len(columns) == 1 else 0.0
    if own == 0.0 and not (scene.is_given and len(columns) == 1):
        return
    name = "record_noise_a" if channel.quantity == "current" else "record_noise"
    yield replace(
        plain,
        columns=_expected(scene, channel, columns[0], own),
        variant=_form(plain, _WITH_NOISE),
        constants={**plain.constants, name: float(f"{own:.3g}")},
        refines=plain.label,
    )


def noise_in(scene: Scene, channel: Telemetry, column: int) -> float:
    """Noise of its own that a column's record has, 1 sigma; 0 where it has hardly any."""
    return scene.once(f"noise of {channel.name} {column}", partial(noise_of, channel.values[:, column]))


def lost_by_hold(scene: Scene, channel: Telemetry) -> float:
    """Share of a record's variance, in its column that loses most, by which it is not what flows at its rows, where its
    values are held from one readout to the next: half of the mean square of the steps, as of a course without a memory.

    It is held where values, of which there are many, change after two rows or more, or multiples of that; a load is
    constant for any time, and one on a beat goes between two levels.
    """

    def found() -> float:
        whole = np.mean((channel.values - channel.values.mean(axis=0)) ** 2, axis=0)
        step = np.diff(channel.values, axis=0)
        changes = np.flatnonzero(np.any(step != 0.0, axis=1))
        if len(changes) < _FEWEST_READOUTS or len(np.unique(channel.values, axis=0)) < _FEWEST_READOUTS:
            return 0.0
        held = float(np.percentile(np.diff(changes), 5.0))
        readouts = (changes - changes[0]) / held
        if held < 2.0 or float(np.mean(np.abs(readouts - np.rint(readouts)) > 0.25)) > _BY_CHANCE:
            return 0.0
        squares = np.sum(step[changes] ** 2, axis=0) / max(float(readouts[-1]), 1.0)
        return float(np.max(0.5 * squares / np.maximum(whole, 1e-300)).clip(0.0, _MOST_LOST))

    return scene.once(f"lost by hold {channel.name}", found)


def derived(parameters: Values) -> Values:
    """Of a record that is not held, over how long it is averaged."""
    return {"averaged_s": parameters["held_s"]} if {_AVERAGED, "held_s"} <= set(parameters) else {}


def live_as(form: str) -> str:
    """How a form acts on a stream, where that is otherwise."""
    if not form.endswith((_LATE, _WITH_NOISE)):
        return ""
    return "the record as its row has it, for later rows have not come"


def _of(scene: Scene, plain: Hypothesis) -> tuple[Telemetry, list[int]]:
    """The channel that a form follows, and which of its columns."""
    return scene.channels[plain.driver.partition(":")[2]], [int(column) for column in plain.constants.values()]


def _form(plain: Hypothesis, added: str) -> str:
    return ", ".join(filter(None, (plain.variant, added)))


def _hardly_repeats(scene: Scene, channel: Telemetry, columns: Sequence[int]) -> float:
    """1 where hardly a row of some columns is that before it, else 0."""

    def found() -> float:
        signal = channel.values[:, list(columns)]
        return float(np.mean(np.all(signal[1:] == signal[:-1], axis=1)) < _BY_CHANCE)

    return scene.once(f"hardly repeats {channel.name} {list(columns)}", found)


def _expected(scene: Scene, channel: Telemetry, column: int, noise: float) -> Callable[[Array], Columns]:
    """What a column's record lets expect; in a stream, as the row has it."""
    values = channel.values[:, column]

    def expected() -> Array:
        if scene.memory is not None or noise == 0.0:
            return values
        return scene.once(f"expected {channel.name} {column}", partial(expected_course, values))

    return lambda _: along_axes(expected()[:, None])


def _ahead(scene: Scene, signal: Array) -> Callable[[Array], Columns]:
    """Means of a signal (n, k) over rows to come; in a stream, where none has come yet, as the row has it."""

    def columns(theta: Array) -> Columns:
        if scene.memory is not None:
            return along_axes(signal)
        late_s, held_s = theta.tolist()
        return along_axes(mean_over(scene.time_s, signal, scene.time_s + late_s, held_s))

    return columns
