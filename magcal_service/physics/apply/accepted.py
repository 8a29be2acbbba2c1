"""Whether the terms of a ``physics.toml`` are forms of the catalogue: told where the file is read, before any sample.

A form exists where the catalogue makes it, and it is made on a scene.  So each term is looked up on stand-ins: an orbit
with everything recorded, whose channels have the driver's name, every kind of quantity, and as many columns as asked.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cache
from typing import Final

import numpy as np

from magcal_service.base.typed_toml import Table, nearest
from magcal_service.base.units import CHANNEL_UNITS
from magcal_service.earth import geomagnetic
from magcal_service.model import Array
from magcal_service.physics.apply.physics_model import ModelTerm
from magcal_service.physics.catalogue import effect_named
from magcal_service.physics.interface import WHOLE, Block, Hypothesis, Nonlinear
from magcal_service.physics.scene.scene import SKIN_START, SUN_AHEAD, Scene, Telemetry
from magcal_service.wire.kinds import MAX_SAMPLE_FIELD_NT, MAX_VALUES

NEXT_STEP: Final = "correct it, or have the file made again by magcal diagnose"
"""What to do about a term that is no form of the catalogue."""

_ANY: Final = "sun"
"""Name of a channel that whatever follows a channel can follow: a Sun sensor is known by its name."""

_OF_THE_RECORDING: Final = (SUN_AHEAD, SKIN_START)
"""Constants that any form may have beside its own: what a recording's light and shadow have shown."""

_MOST_PLACES: Final = {"column": MAX_VALUES - 1, "face": 5, "axis": 2}
_PLACES: Final = re.compile(r"(column|face|axis)(_\d+)?")
"""Constants that count columns of a channel, faces of the craft or axes of the sensor, from 0; each with its most."""

_ROWS, _STEP_S = 640, 9.0
"""Rows of a stand-in and the time between them [s]: an orbit, close enough for a dipole that is held for 10 s."""

_ORIGIN_NS: Final = 1_742_472_000 * 10**9  # 2025-03-20T12:00:00Z, within the field model's years
_RADIUS_KM, _ORBIT_RAD_S, _INCLINATION_RAD = 6878.0, 1.1068e-3, 0.9  # a circle 500 km high, through the shadow


_LARGEST_NT: Final = MAX_SAMPLE_FIELD_NT
"""Of an amplitude in nT that has no narrower range of its own: more is no reading of a magnetometer."""

_SLACK_SIGMA: Final = 3.0
"""Of its own sigma, how far beyond its range an amplitude may be: the last refit may move it over the edge."""

_SLACK: Final = 0.2  # of the range, the most that this is; choice: more is another number

_CLOSE: Final = 1e-9  # by which a number may be beyond an end of its range, for it was found in other units

_ABOVE_0: Final = math.ulp(0.0)

_CONSTANTS: Final[Mapping[str, tuple[float, float, str]]] = {
    "averaged": (1.0, 1.0, "1 is accepted; leave it out where values were held"),
    "turns_between": (1.0, 1.0, "1 is accepted; leave it out otherwise"),
    "smoothed_over": (1.0, math.inf, "1 or more is accepted; leave it out where nothing is smoothed"),
    "record_noise": (0.0, math.inf, "0 or more is accepted"),
    "record_noise_a": (0.0, math.inf, "0 or more is accepted"),
    "zero_degc": (-273.15, math.inf, "-273.15 or more is accepted"),
    "mean_light": (0.0, 1.0, "0 to 1 is accepted"),
    "induced": (0.0, 1.0, "0 to 1 is accepted"),
    "order": (1.0, 2.0, "1 to 2 is accepted"),
    "largest_am2": (_ABOVE_0, math.inf, "more than 0 is accepted"),
    "scale_nt": (_ABOVE_0, _LARGEST_NT, "more than 0, and up to 1e6, is accepted"),
    "full_scale_nt": (_ABOVE_0, _LARGEST_NT, "more than 0, and up to 1e6, is accepted"),
    "full_sun": (_ABOVE_0, math.inf, "more than 0 is accepted"),
    "period_s": (_ABOVE_0, math.inf, "more than 0 is accepted"),
    "span_s": (_ABOVE_0, math.inf, "more than 0 is accepted"),
}
"""Constants that are sizes, shares or switches: from and to, and what is said where they are not."""


def check_forms(tables: Iterable[Table], terms: Iterable[ModelTerm]) -> None:
    """Add to each term's table a fault for whatever keeps it from being a form of the catalogue."""
    for table, term in zip(tables, terms, strict=True):
        _check(table, term)


def _check(table: Table, term: ModelTerm) -> None:
    if not _check_places(table, term):
        return
    named = [form for form in _forms(term, term.constants) if form.driver == term.driver]
    form = _likest(named, term)
    if form is None or not _is_whole(form, term):  # constants that are missing may have left out what they choose
        searched = [form for form in _forms(term, None) if form.driver == term.driver]
        form = _likest([*named, *searched], term)
        if form is None:
            _refuse_form(table, term, {one.variant for one in (*named, *searched)})
            return
    _Check(table, term, form).all()


def _check_places(table: Table, term: ModelTerm) -> bool:
    """Whether every constant that counts something has a number that can be there; else its fault is added."""
    sound = True
    for name, value in term.constants.items():
        counted = _PLACES.fullmatch(name)
        most = _MOST_PLACES[counted[1]] if counted else 0
        if counted and counted[1] == "column":  # of several channels they are counted through
            most = (most + 1) * (term.driver.count("+") + 1) - 1
        if counted and not (0.0 <= value <= most and value == int(value)):
            table.refuse(f"constants.{name}", value, f"a whole number from 0 to {most} is accepted; {NEXT_STEP}")
            sound = False
    return sound


def _likest(forms: Iterable[Hypothesis], term: ModelTerm) -> Hypothesis | None:
    """The form of a term's name that has most numbers in common with it and fewest beyond: channels of other kinds, or
    with more columns, have other ones.  None where none is named so."""

    def likeness(form: Hypothesis) -> tuple[int, int, int]:
        constants, given = set(form.constants), set(term.constants)
        return len(set(form.block_names) & set(term.amplitudes)), len(constants & given), -len(constants - given)

    return max((form for form in forms if form.variant == term.variant), key=likeness, default=None)


def _is_whole(form: Hypothesis, term: ModelTerm) -> bool:
    """Whether a term has every amplitude and constant of a form."""
    return set(form.block_names) <= set(term.amplitudes) and set(form.constants) <= set(term.constants)


def _refuse_form(table: Table, term: ModelTerm, variants: set[str]) -> None:
    """Add the fault of a name, a driver or a form that the catalogue does not have.

    ``variants``: those by the term's driver.
    """
    if variants:
        leave = "leave it out for the plain form; " if "" in variants else ""
        accepted = f"of {_described(term)}, {leave}{nearest(term.variant, variants)}; {NEXT_STEP}"
        table.refuse_or_lack("variant", accepted)
        return
    by_any = replace(term, driver=f"channel:{_ANY}")
    drivers = {_kind(form.driver) for form in _forms(by_any, None)}
    if drivers:
        named = ", and a channel that it follows is named as what it is" if _is_channel(term) else ""
        accepted = f"{term.effect} follows {' or '.join(sorted(drivers))}{named}; {NEXT_STEP}"
        table.refuse("driver", term.driver, accepted)
        return
    accepted = f"an effect that acts as a field is accepted; {term.effect} can be a [[note]]; {NEXT_STEP}"
    table.refuse("name", term.effect, accepted)


def _described(term: ModelTerm) -> str:
    """A term by its effect and driver."""
    return term.effect if term.driver == "none" else f"{term.effect} by {term.driver}"


def _is_channel(term: ModelTerm) -> bool:
    return term.driver.startswith("channel:")


def _kind(driver: str) -> str:
    return "channel:NAME" if driver.startswith("channel:") else driver


@dataclass(frozen=True, slots=True, eq=False)
class _Check:
    """A term held against the form that it names."""

    table: Table
    term: ModelTerm
    form: Hypothesis

    def all(self) -> None:
        """Add every fault: numbers that are missing, not of the form, of another shape, or that it cannot have."""
        self._names("amplitudes", self.form.block_names, self.term.amplitudes)
        self._shapes("amplitudes", self.term.amplitudes)
        self._shapes("sigma", self.term.sigma)
        self._sizes()
        for name, sigma in self.term.sigma.items():
            if np.any(sigma < 0.0):
                self._refuse(f"sigma.{name}", sigma.tolist(), "a sigma of 0 or more is accepted")
        self._nonlinear()
        self._names("constants", self.form.constants, self.term.constants, _OF_THE_RECORDING)
        self._constants()

    @property
    def _of(self) -> str:
        form = f", form {self.term.variant!r}" if self.term.variant else ""
        return f"of {_described(self.term)}{form}"

    def _refuse(self, key: str, value: object, accepted: str) -> None:
        self.table.refuse(key, value, f"{self._of}, {accepted}; {NEXT_STEP}")

    def _names(self, key: str, wanted: Iterable[str], found: Mapping[str, object], allowed: Iterable[str] = ()) -> None:
        names = list(dict.fromkeys(wanted))
        for name in names:
            if name not in found:
                self.table.lack(f"{key}.{name}", f"it is required {self._of}; {NEXT_STEP}")
        for name, value in found.items():
            if name not in names and name not in allowed:
                shown = value.tolist() if isinstance(value, np.ndarray) else value
                self._refuse(f"{key}.{name}", shown, f"{', '.join(names) or 'none'} is accepted")

    def _shapes(self, key: str, found: Mapping[str, Array]) -> None:
        for block in self.form.blocks:
            if block.name in found and not block.takes(found[block.name].shape):
                value = found[block.name].tolist()
                counted = len(block.shape) > 1 and any(name.startswith("column_") for name in self.form.constants)
                why = "; a row for each of the constants column_0, column_1 ..." if counted else ""
                self._refuse(f"{key}.{block.name}", value, f"{_in_words(block.shape)} is accepted{why}")

    def _nonlinear(self) -> None:
        numbers: dict[str, list[Nonlinear]] = {}
        for number in self.form.nonlinear:
            numbers.setdefault(number.name, []).append(number)
        self._names("nonlinear", numbers, self.term.nonlinear)
        for name, alike in numbers.items():
            if name not in self.term.nonlinear:
                continue
            value = np.asarray(self.term.nonlinear[name])
            shape = () if len(alike) == 1 else (len(alike),)
            if value.size != len(alike):
                self._refuse(f"nonlinear.{name}", value.tolist(), f"{_in_words(shape)} is accepted")
            elif not _within(alike[0], value):
                self._refuse(f"nonlinear.{name}", value.tolist(), f"{_range(alike[0])} is accepted")

    def _sizes(self) -> None:
        """Amplitudes that the physics of the effect never has."""
        for block in self.form.blocks:
            value = self.term.amplitudes.get(block.name)
            if value is None or not block.takes(value.shape):
                continue  # has its fault already
            low, high = self._range(block)
            slack = _SLACK_SIGMA * np.abs(self.term.sigma.get(block.name, np.zeros(1)))
            slack = np.minimum(slack if slack.shape == value.shape else 0.0, _SLACK * (high - low))
            if not ((value >= low - slack) & (value <= high + slack)).all():
                unit = "" if block.unit == "1" else f" {block.unit}"
                accepted = f"{low:.4g} to {high:.4g}{unit} is accepted"
                self._refuse(f"amplitudes.{block.name}", value.tolist(), accepted)

    def _range(self, block: Block) -> tuple[float, float]:
        """What an amplitude lies between by its physics."""
        if self.form.is_whole and block.name == self.form.blocks[0].name:
            return 1.0 - WHOLE, 1.0 + WHOLE
        low, high = max(-block.most, block.least), min(block.most, block.highest)
        return (max(low, -_LARGEST_NT), min(high, _LARGEST_NT)) if block.unit == "nT" else (low, high)

    def _constants(self) -> None:
        for name, value in self.term.constants.items():
            own = self.form.constants.get(name)
            if own is not None and (_PLACES.fullmatch(name) or name == "degree") and value != own:
                self._refuse(f"constants.{name}", value, f"{own:g} is accepted")
            least, most, accepted = _CONSTANTS.get(name, (-math.inf, math.inf, ""))
            if not least <= value <= most:
                self._refuse(f"constants.{name}", value, accepted)


def _is_positive(number: Nonlinear) -> bool:
    return number.role in ("frequency", "period") or bool(len(number.grid) and number.grid.min() > 0.0)


def _range(number: Nonlinear) -> str:
    """What ``_within`` takes, in words."""
    if number.spans:
        unit = "" if number.unit == "1" else f" {number.unit}"
        return f"{number.grid.min():g} to {number.grid.max():g}{unit}"
    return "more than 0" if _is_positive(number) else "0 or more"


def _within(number: Nonlinear, value: Array) -> bool:
    """Whether a number is one that it can be: in its range where that is known, else with a sign that is sought."""
    if number.spans:
        low, high = float(number.grid.min()), float(number.grid.max())
        return bool(((value >= low - _CLOSE * abs(low)) & (value <= high + _CLOSE * abs(high))).all())
    if number.role in ("frequency", "period"):
        return bool((value > 0.0).all())
    if number.role or not len(number.grid) or number.grid.min() < 0.0:
        return True
    return bool((value > 0.0).all() if _is_positive(number) else (value >= 0.0).all())


def _in_words(shape: tuple[int, ...]) -> str:
    if not shape:
        return "one number"
    *rows, last = shape
    numbers = f"{last} number{'s' * (last > 1)}"
    if not rows:
        return f"an array of {numbers}"
    return f"an array of {' by '.join(map(str, rows))} row{'s' * (rows != [1])} of {numbers}"


# Stand-ins


def _forms(term: ModelTerm, given: Mapping[str, float] | None) -> Iterator[Hypothesis]:
    """Every form that an effect has by a term's driver, under constants; None: as while effects are searched."""
    effect = effect_named(term.effect)
    for scene in _scenes(term):
        yield from effect.hypotheses(replace(scene, given=given))


def _scenes(term: ModelTerm) -> Iterator[Scene]:
    yield from _without_channels()
    kind, _, name = term.driver.partition(":")
    if kind != "channel":
        return
    together = name.split("+")
    for width in sorted({1, 3, _width(term)}):
        for quantity in dict.fromkeys(unit.quantity for unit in CHANNEL_UNITS.values()):
            for names in dict.fromkeys([(name,), tuple(together)]):
                yield replace(_without_channels()[0], channels={one: _channel(one, quantity, width) for one in names})


def _width(term: ModelTerm) -> int:
    """Columns that a channel needs for the column that a term names, as many as the link takes at the most."""
    counted = [int(number) for number in re.findall(r"\d+", term.variant)[:1]]
    counted += [int(value) + 1 for name, value in term.constants.items() if name.startswith("column")]
    return min(max(1, *counted), MAX_VALUES) if counted else 1


def _channel(name: str, quantity: str, width: int) -> Telemetry:
    turns = np.linspace(0.0, 2.0 * np.pi, _ROWS)[:, None] * (1.0 + np.arange(width))
    return Telemetry(name, quantity, 1.0 + np.sin(turns))


@cache
def _without_channels() -> tuple[Scene, Scene]:
    """An orbit with places and attitude, and the same by a clock of which nobody knows the date."""
    time_s = _STEP_S * np.arange(_ROWS)
    time_ns = _ORIGIN_NS + np.rint(time_s * 1e9).astype(np.int64)
    angle, tilt = _ORBIT_RAD_S * time_s, _INCLINATION_RAD
    circle = [np.cos(angle), np.sin(angle) * np.cos(tilt), np.sin(angle) * np.sin(tilt)]
    inertial = _RADIUS_KM * np.stack(circle, axis=1)
    reference = geomagnetic.igrf_eci_nt(time_ns, inertial)
    turn = 0.01 * time_s  # slow enough for the derivatives between rows
    attitude = np.zeros((_ROWS, 3, 3))
    attitude[:, 0, 0] = attitude[:, 1, 1] = np.cos(turn)
    attitude[:, 0, 1], attitude[:, 1, 0] = np.sin(turn), -np.sin(turn)
    attitude[:, 2, 2] = 1.0
    body = np.einsum("nij,nj->ni", attitude, reference)
    dated = Scene(
        time_s=time_s,
        origin_ns=_ORIGIN_NS,
        utc=True,
        field_nt=body,
        calibrated_nt=body,
        clean_field_nt=body,
        magnitude_nt=np.linalg.norm(reference, axis=1),
        reference_eci_nt=reference,
        position_ecef_km=geomagnetic.ecef_from_eci(time_ns, inertial),
        body_from_eci=attitude,
    )
    return dated, replace(dated, utc=False)
