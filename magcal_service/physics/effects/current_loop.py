"""Currents in the harness and the solar arrays: each circuit adds a field in a fixed direction of the body."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from magcal_service.model import Array
from magcal_service.physics.acting import LIGHT, ActsOn, Direct, Term, Watched, direct
from magcal_service.physics.columns import Columns, along_axes
from magcal_service.physics.drivers import readout
from magcal_service.physics.drivers.proportion import apart_in, named
from magcal_service.physics.held import TOGETHER, Form, HeldAt, at_zero_of
from magcal_service.physics.interface import Block, Effect, Hypothesis, Nonlinear
from magcal_service.physics.saying import AXES
from magcal_service.physics.scene.scene import Scene, is_sun_vector
from magcal_service.physics.scene.sunlight import first_order

_MOST_PER_A_NT: Final = 5000.0
"""Field per ampere at most [nT/A]: a single wire 4 cm away whose return is far, mu0 / (2 pi r)."""

_MOST_NT: Final = 30_000.0
"""rms of the field of a recorded current at most [nT]: 0.6 of the Earth's, where ArduPilot's test of motors calls a
compass unusable (documentation of compassmot)."""

_MOST_GUESSED_NT: Final = 2000.0
"""The same of an array's current that is inferred: 10 A in a loop of 10 cm2 at 10 cm."""

_LAGS: Final = np.array([0.5, 1.0, 2.0, 4.0])
"""Time constants that are tried, in samples: drivers of sensors average over a few."""

_SLOW_S, _SLOW_SHARE = 60.0, 0.2
"""Time over which a record changes by less than so much of its range, if it is warmth [s]: parts take two minutes and
more for most of a change, a load or a panel in the Sun of a craft that turns takes none."""

_REGULATED_S: Final = np.array([7.5, 15.0, 30.0, 60.0, 120.0])
"""Time constants of an inferred array's current [s]: the penumbra of a low orbit takes 10 to 20 s, regulators that seek
the point of most power tens; a sensor's warmth takes at least 120 (``TIME_CONSTANTS_S``)."""

_LIMITS: Final = np.array([0.2, 0.35, 0.5, 0.65, 0.8, 0.95, 1.1])
"""Most that flows of an inferred array's current, in full suns on one panel: what loads and a battery that is full
take; three panels at once give 1.7."""

_MOST_TOGETHER: Final = 12
"""Circuits that are tried all at once: 36 amplitudes; more of them explain one another."""

_FACES: Final = 3  # records of cells from which on they tell a direction
_SHADE: Final = 0.05  # of its largest, what a cell gives in the shade at the most; a choice

_OFTEN_IN_SHADE: Final = 0.2
"""Share of the rows in which a face is in the shade at the least, and in the Sun; choice: in orbit half is usual."""

_NO_SUN: Final = 0.05  # share of sunlight below which it is as good as none
_DARK_THERE: Final = 0.9
"""Of the rows in the Earth's shadow, in how many a cell gives nothing at the least: times and places err by a minute in
an orbit's half hour of shadow; a load is on there as elsewhere."""

_LIKE_CURRENTS: Final = ("counts", "dimensionless", "fraction", "power")
"""Kinds of channels that may go along with a current though they are none: raw readings, states, duties, loads."""


def _fixed(signals: Array) -> Callable[[Array], Columns]:
    return lambda _: along_axes(signals)


def _hypotheses(scene: Scene) -> Iterator[Hypothesis]:
    yield from _by_channel(scene)
    yield from _together(scene)
    yield from _alike(scene)
    yield from _lagging(scene)
    for plain in (*_by_channel(scene), *_alike(scene)):
        yield readout.late(scene, plain)
        yield from readout.noisy(scene, plain)
    for hypothesis in _inferred(scene):
        yield replace(hypothesis, largest_nt=_MOST_GUESSED_NT)


def _by_channel(scene: Scene) -> Iterator[Hypothesis]:
    """The circuits of every current's record, all together and each by itself."""
    for channel in scene.of_quantity("current"):
        own = apart_in(scene, channel)
        circuits = [column for column in scene.chosen("column", list(own)) if column < channel.values.shape[1]]
        if not circuits:
            continue
        is_one = len(circuits) == 1 and not own.get(circuits[0])
        shape = (3,) if is_one else (len(circuits), 3)
        rows = (_named(circuits, own, [f"circuit {column + 1}" for column in range(channel.values.shape[1])]), AXES)
        block = Block("nt_per_a", "nT/A", shape, _MOST_PER_A_NT, labels=rows[2 - len(shape) :])
        yield Hypothesis(
            "current_loop",
            f"channel:{channel.name}",
            _fixed(channel.values[:, circuits]),
            (block,),
            largest_nt=_largest(channel.values[:, circuits]),
            constants={f"column_{index}": float(column) for index, column in enumerate(circuits)},
            as_well=("sun_disturbance",) if _may_be_the_sun(scene, channel.values[:, circuits]) else (),
        )
        for column in circuits if len(circuits) > 1 or scene.is_given else ():
            one = Block("nt_per_a", "nT/A", most=_MOST_PER_A_NT)
            signal, name = channel.values[:, [column]], f"channel:{channel.name}"
            yield Hypothesis(
                "current_loop",
                name,
                _fixed(signal),
                (one,),
                f"circuit {column + 1}",
                largest_nt=_largest(signal),
                constants={"column_0": float(column)},
                as_well=("sun_disturbance",) if _may_be_the_sun(scene, signal) else (),
            )


def _may_be_the_sun(scene: Scene, values: Array) -> bool:
    """Whether records (n, k) may stand for the Sun's direction: those of cells on three faces and more tell it, where
    nothing else does, and one of them goes along with it."""
    is_told = scene.sun_body is not None and scene.lit is not None  # without places the shadow is not known
    if not scene.in_orbit or is_told or any(map(is_sun_vector, scene.channels.values())):
        return False

    def faces() -> int:
        each = (c.values for c in scene.of_quantity("current", *_LIKE_CURRENTS))
        return sum(int(np.count_nonzero(_shaded(scene, one))) for one in each)

    return bool(_shaded(scene, values).all()) and scene.once("faces in the Sun", faces) >= _FACES


def _shaded(scene: Scene, values: Array) -> NDArray[np.bool_]:
    """Which of records (n, k) are nothing for a good part of the time, the Earth's shadow included where that is known,
    and something at others."""
    is_dark = np.abs(values) < _SHADE * np.max(np.abs(values), axis=0)
    in_shade = np.mean(is_dark, axis=0)
    found = (in_shade > _OFTEN_IN_SHADE) & (in_shade < 1.0 - _OFTEN_IN_SHADE)
    no_sun = np.zeros(0, dtype=bool) if scene.lit is None or not scene.eclipses else scene.lit < _NO_SUN
    if no_sun.any():
        found &= np.mean(is_dark[no_sun], axis=0) > _DARK_THERE
    return np.asarray(found)


def _named(used: Sequence[int], own: Mapping[int, Sequence[int]], names: Sequence[str]) -> tuple[str, ...]:
    """Names of the columns that are used, each with those in proportion to it."""
    return tuple(named(names[column], [names[other] for other in own.get(column, ())]) for column in used)


def _largest(currents: Array) -> float:
    """rms that the field of currents (n, k) may have [nT]."""
    return min(_MOST_NT, _MOST_PER_A_NT * float(np.sqrt(np.mean(currents**2) * currents.shape[1])))


def _alike(scene: Scene) -> Iterator[Hypothesis]:
    """Channels of other units that may go along with a current, each by itself."""
    for channel in scene.of_quantity(*_LIKE_CURRENTS):
        if is_sun_vector(channel):
            continue
        for column in range(channel.values.shape[1]):
            if not scene.is_given and not channel.varies[column]:
                continue
            several = channel.values.shape[1] > 1
            yield Hypothesis(
                "current_loop",
                f"channel:{channel.name}",
                _fixed(channel.values[:, column : column + 1]),
                (Block("nt_per_unit", "nT/unit"),),
                f"column {column + 1}" if several else "",
                constants={"column_0": float(column)},
                as_well=("thermal_bias",)
                if _may_be_warmth(scene, channel.values[:, column])
                else ("sun_disturbance",)
                if _may_be_the_sun(scene, channel.values[:, [column]])
                else (),
            )


def _may_be_warmth(scene: Scene, values: Array) -> bool:
    """Whether a record (n,) in the unit of neither heat nor a current changes as slowly as warmth does."""
    rows = max(round(_SLOW_S / scene.period_s), 1)
    if scene.is_given or len(values) <= rows:
        return False
    changes = np.abs(values[rows:] - values[:-rows])
    return float(np.quantile(changes, 0.99)) < _SLOW_SHARE * float(np.ptp(values))


def _lagging(scene: Scene) -> Iterator[Hypothesis]:
    """Every circuit as it comes through a filter: of the current's record, or of the magnetometer."""
    number = Nonlinear("lag_s", "s", _LAGS * scene.period_s)
    for channel in scene.of_quantity("current", *_LIKE_CURRENTS):
        signal, is_current = channel.values, channel.quantity == "current"
        if is_sun_vector(channel) or signal.shape[1] > 1:
            continue
        if not scene.is_given and not channel.varies[0]:
            continue
        driver = f"channel:{channel.name}"
        yield Hypothesis(
            "current_loop",
            driver,
            _lagged(scene, signal[:, 0]),
            (Block("nt_per_a", "nT/A", most=_MOST_PER_A_NT) if is_current else Block("nt_per_unit", "nT/unit"),),
            "lagging",
            (number,),
            largest_nt=_largest(signal) if is_current else _MOST_NT,
            refines=f"current_loop by {driver}",
            as_well=("thermal_bias",)
            if not is_current and _may_be_warmth(scene, signal[:, 0])
            else ("sun_disturbance",)
            if _may_be_the_sun(scene, signal)
            else (),
        )


def _lagged(scene: Scene, signal: Array, key: str = "lagging") -> Callable[[Array], Columns]:
    def columns(theta: Array) -> Columns:
        tau_s = max(float(theta[0]), 1e-3 * scene.period_s)
        found = first_order(scene.time_s, signal, tau_s, scene.begin(key, float(signal[0])))
        scene.keep(key, found)
        return along_axes(found)

    return columns


def _together(scene: Scene) -> Iterator[Hypothesis]:
    """All circuits of all current channels at once."""
    channels = [c for c in scene.of_quantity("current") if float(np.std(c.values)) > 0.0 or scene.is_given]
    moving = sum(int(np.count_nonzero(channel.varies)) for channel in channels)
    if len(channels) < 2 or (moving > _MOST_TOGETHER and not scene.is_given):
        return
    own = apart_in(scene, *channels)
    names = [f"{c.name} {index + 1}" for c in channels for index in range(c.values.shape[1])]
    used = [column for column in scene.chosen("column", list(own)) if column < len(names)]
    if len(used) < 2:
        return
    signals = np.concatenate([channel.values for channel in channels], axis=1)
    driver = "channel:" + "+".join(channel.name for channel in channels)
    labels = (_named(used, own, names), AXES)
    block = Block("nt_per_a", "nT/A", (len(used), 3), _MOST_PER_A_NT, labels=labels)
    constants = {f"column_{i}": float(column) for i, column in enumerate(used)}
    yield Hypothesis(
        "current_loop",
        driver,
        _fixed(signals[:, used]),
        (block,),
        TOGETHER,
        (),
        constants,
        largest_nt=_largest(signals[:, used]),
        as_well=("sun_disturbance",) if _may_be_the_sun(scene, signals[:, used]) else (),
    )


def _inferred(scene: Scene) -> Iterator[Hypothesis]:
    """Array currents from light and, with the attitude known, from the Sun's angle on panels along the body axes."""
    if scene.lit is None:
        return
    block, driver = Block("nt_full_sun", "nT"), "inferred:array_current"
    if scene.eclipses:
        lit = Hypothesis("current_loop", driver, _fixed(scene.lit[:, None]), (block,), "lit or not")
        yield lit
        number = Nonlinear("lag_s", "s", _REGULATED_S, spans=True)
        late = _lagged(scene, scene.lit, "regulated")
        yield replace(lit, columns=late, variant="lit or not, late", nonlinear=(number,), refines=lit.label)
    if scene.sun_body is None:
        return
    faces = np.concatenate([np.maximum(scene.sun_body, 0.0), np.maximum(-scene.sun_body, 0.0)], axis=1)
    faces = faces * scene.lit[:, None]
    names = ("+x", "+y", "+z", "-x", "-y", "-z")
    used = [i for i in range(6) if float(np.std(faces[:, i])) > 0.02 or scene.is_given]
    for i in used:
        yield Hypothesis("current_loop", driver, _fixed(faces[:, [i]]), (block,), f"panel {names[i]}")
    sides = (("x", (0, 3)), ("y", (1, 4)), ("z", (2, 5)))
    for name, pair in sides:
        if all(i in used for i in pair):
            both = Block("nt_full_sun", "nT", (2, 3), labels=((f"panel +{name}", f"panel -{name}"), AXES))
            yield Hypothesis("current_loop", driver, _fixed(faces[:, pair]), (both,), f"panels +-{name}")
    used = scene.chosen("face", used)
    if len(used) >= 3:
        yield from _strings(faces, used, scene.is_given)
        every = Block("nt_full_sun", "nT", (len(used), 3), labels=(tuple(f"panel {names[i]}" for i in used), AXES))
        yield Hypothesis(
            "current_loop",
            driver,
            _fixed(faces[:, used]),
            (every,),
            "every panel its own circuit",
            constants=_faces(used),
            if_none=(("sun_disturbance", _alike_on_both_sides(used)),),
        )


def _alike_on_both_sides(used: Sequence[int]) -> Array:
    """(c, 3 p) weights of the sums over the panels of both sides, on each axis of the sensor: nothing where all that
    they do is linear in the Sun's direction."""
    pairs = [[float(face % 3 == side) for face in used] for side in range(3)]
    both = np.array([pair for pair in pairs if sum(pair) == 2.0])
    return np.kron(both.reshape(-1, len(used)), np.eye(3))


def _strings(faces: Array, used: Sequence[int], is_given: bool) -> Iterator[Hypothesis]:
    """One current of all panels, or of those on the sides of two axes; each as it is where the loads and the battery
    take no more of it."""
    choices = {"all panels": list(used)}
    for left_out, axes in enumerate(("y and z", "x and z", "x and y")):
        some = [face for face in used if face % 3 != left_out]
        if is_given:  # a model's are those that it names, whatever they were of
            choices[f"panels across {axes}"] = list(used)
        elif 2 < len(some) < len(used):
            choices[f"panels across {axes}"] = some
    block, driver = Block("nt_full_sun", "nT"), "inferred:array_current"
    limit = Nonlinear("limit", "1", _LIMITS, spans=True)
    for of, some in choices.items():
        total, constants = faces[:, some].sum(axis=1, keepdims=True), _faces(some)
        whole = Hypothesis("current_loop", driver, _fixed(total), (block,), f"sum of {of}", constants=constants)
        yield whole
        form = f"sum of {of}, limited"
        yield replace(whole, columns=_limited(total), variant=form, nonlinear=(limit,), refines=whole.label)


def _limited(total: Array) -> Callable[[Array], Columns]:
    return lambda theta: along_axes(np.minimum(total, float(theta[0])))


def _faces(used: Sequence[int]) -> dict[str, float]:
    return {f"face_{index}": float(face) for index, face in enumerate(used)}


def _direct(term: Term) -> Direct | None:
    """By the circuits of one channel; all channels together need a scene."""
    if "+" in term.driver:
        return None
    keys = [f"column_{index}" for index in range(len(term.constants))]
    columns = [int(term.constants[key]) for key in keys if key in term.constants]
    return direct(term, "current", "nt_per_a", columns)


def _held_at(form: Form) -> HeldAt:
    """No current: what it is in a recorded channel's unit, or of the arrays."""
    if not form.driver.startswith("channel:"):
        return HeldAt(form.driver, 0.0, "1", "no current of the solar arrays")
    return at_zero_of(form, "A" if "nt_per_a" in form.block_names else "")


EFFECT = Effect(
    name="current_loop",
    acts_on=ActsOn.FIELD,
    watched=((Watched.BIAS_BY, "current"), (Watched.BIAS_BY, LIGHT)),
    title="currents in the harness or the solar arrays",
    switched="the suspected load or array string",
    two_levels=True,
    equation="d = sum_j c_j I_j(t); arrays not recorded: I_j = lit max(0, n_j . s), at most what is taken of it",
    units={
        "nt_per_a": "nT/A",
        "nt_per_unit": "nT/unit",
        "nt_full_sun": "nT",
        "lag_s": "s",
        "late_s": "s",
        "held_s": "s",
        "averaged_s": "s",
        "record_noise_a": "A",
        "record_noise": "1",
        "limit": "1",
    },
    prior=(1.0, _MOST_NT),
    valid="the sensor is at rest against the wires; quasi-static",
    confused_with=("thermal_bias", "sun_disturbance", "torquer"),
    separated_by="an eclipse edge at one sample a second: currents switch with the light",
    or_record=(("current", "a bus current channel"),),
    source="Biot-Savart: 1 A in 10 cm2 at 10 cm: 200 nT; Springmann & Cutler 2012 (RAX); Olsen et al. 2020 (CryoSat-2)",
    says=(
        "Currents make up to {nt_per_a.size} ({nt_per_a.place}), with {driver}, {lag_s.signed} late.",
        "A current or a moved magnet makes up to {nt_per_unit.size} of {driver} ({nt_per_unit.place}), "
        "{lag_s.signed} late.",
        "Currents make up to {nt_per_a.size} ({nt_per_a.place}), with {driver}, read out {late_s.size} before its "
        "row and averaged over {averaged_s.size}.",
        "A current or a moved magnet makes up to {nt_per_unit.size} of {driver} ({nt_per_unit.place}), read "
        "out {late_s.size} before its row and averaged over {averaged_s.size}.",
        "Currents make up to {nt_per_a.size} ({nt_per_a.place}), with {driver}, read out {late_s.size} before its "
        "row and held for {held_s.size}.",
        "A current or a moved magnet makes up to {nt_per_unit.size} of {driver} ({nt_per_unit.place}), read "
        "out {late_s.size} before its row and held for {held_s.size}.",
        "Currents make up to {nt_per_a.size} ({nt_per_a.place}), with {driver}, whose record has noise of "
        "{record_noise_a.size}.",
        "A current or a moved magnet makes up to {nt_per_unit.size} of {driver} ({nt_per_unit.place}), whose record "
        "has noise of {record_noise.size}.",
        "Currents make up to {nt_per_a.size} ({nt_per_a.place}), with {driver}.",
        "A current or a moved magnet makes up to {nt_per_unit.size} of {driver} ({nt_per_unit.place}).",
        "Currents make up to {nt_full_sun.size} in full sun ({nt_full_sun.place}), with {driver}, {lag_s.signed} late.",
        "Currents make up to {nt_full_sun.size} in full sun ({nt_full_sun.place}), with {driver}, which is limited to "
        "{limit.percent} of full sun on one panel.",
        "Currents make up to {nt_full_sun.size} in full sun ({nt_full_sun.place}), with {driver}.",
    ),
    record_next=(*readout.RECORD_NEXT, "read field and {channel} through the same filter: one lags by {lag_s.size}"),
    hypotheses=lambda scene: tuple(_hypotheses(scene)),
    derived=readout.derived,
    direct=_direct,
    held_at=_held_at,
    live_as=readout.live_as,
)
