"""Live compensation: subtract the disturbances that ``physics.toml`` models from every sample, correct every reference.

A sample becomes B' = B - (I + D)^-1 d with D and d of the model; a reference gets the magnitude, or the time, that the
model gives it.  Drivers are the newest values on the link: a channel is held until its next value, a
position carried on along a straight line.  An effect whose driver is missing or stale, whose numbers do not fit its
form or its driver, or whose disturbance is absurdly large, is left out and named in ``missing``.  Effects with a memory
carry it from sample to sample (``scene.Memory``).

Error of holding a channel: its rate times its age; a channel that turns with the craft has to be sent with the samples.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

from magcal_service import geomagnetic
from magcal_service.model import Array, calibrate, d_matrix
from magcal_service.physics.acting import ActsOn
from magcal_service.physics.apply.forward import Bound, DriverMissingError, MisfitError, bind, described
from magcal_service.physics.apply.model_file import ModelSpin, ModelTerm, PhysicsModel
from magcal_service.physics.catalogue import effect_named
from magcal_service.physics.scene.scene import Memory, Scene, Telemetry
from magcal_service.physics.scene.steady_spin import attitude_of, turns_of
from magcal_service.snapshot import Stateful
from magcal_service.units import CHANNEL_UNITS
from magcal_service.wire.kinds import MAX_SAMPLE_FIELD_NT
from magcal_service.wire.messages import (
    Clock,
    Frame,
    MagnetometerSample,
    PositionSample,
    ReferenceSample,
    TelemetrySample,
    Vector,
)

_MOST_CHANNELS: Final = 64
"""Channels kept: a source that makes up names cannot fill the memory; more than any craft's model needs."""

_STALE_PACES: Final = 3.0
"""Intervals of a channel after which it is stale: two values may be lost. Choice: fewer drop out with single losses."""

_STALE_S: Final = (2.0, 120.0)
"""A channel is not stale before the first and is after the second [s], whatever its interval."""

_SLOW: Final = {"temperature": 30.0}
"""What changes slowly is held so long at least [s]: minutes of time constant make it tenths of a kelvin."""

_POSITION_S: Final = 120.0
"""Time for which a position is carried on along a line [s]; after that the path has bent by 60 km in a low orbit."""

_WARM: Final = 3.0
"""Time constants after which a temperature that began unknown is known to 5 %."""

_AXIS_RAD: Final = 0.1
"""1 sigma to which the spin axis in space has to be known [rad]: the Sun on a panel is then right to a tenth."""

_AXIS_MEMORY: Final = 10.0
"""Samples that count as one for it: what the model does not hold of w along the axis changes slowly."""

_AXIS_LENGTH: Final = 0.1
"""By how much it may miss the length of 1: more is no turn about the model's axis of the body."""

_ABSURD_NT: Final = 1e100
"""No disturbance reaches it; its products still fit a double."""

_MOST_GROWTH: Final = 0.5
"""Share of the magnitude by which a reference may be wrong."""

_MOST_SHIFT_S: Final = 3600.0
"""By how much time tags may disagree [s]."""

_AT_START_S: Final = 60.0
"""How close to the model's start a daemon has to begin to take the start temperature from it [s].

Choice: half of the shortest time constant that is searched; later, what was free at the start has decayed unseen.
"""

_WARMTH: Final = "inferred:temperature"
"""Driver of the effects whose temperature at the start is not known elsewhere."""

_KNOT_S: Final = 10.0
"""Time between the places that give the direction of flight, and age up to which a reference vector is used [s].

In a low orbit the path bends by 0.6 degrees in 10 s, and H turns by at most 1.3.
"""

_GROWTH_NS: Final = 1_000_000_000
"""How long a computed growth of the reference is held [ns]: the length of a tick; each takes a scene."""


@dataclass(frozen=True, slots=True)
class Held:
    """The newest value of a channel, in its base unit, and the interval [s] to the one before."""

    time_ns: int
    pace_s: float
    quantity: str
    values: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Place:
    """A position, Earth-fixed [km]."""

    time_ns: int
    ecef_km: Vector


@dataclass(frozen=True, slots=True)
class Row:
    """A sample as it was measured [nT]."""

    time_ns: int
    field_nt: Vector


@dataclass(init=False, repr=False, eq=False)
class CompensationMemory:
    """What of ``Compensation`` outlives a restart, saved and restored whole."""

    _channels: dict[str, Held]
    _places: list[Place]
    _last: Row | None
    _reference: Vector | None
    _reference_ns: int
    _growth_nt: float
    _growth_ns: int
    _begun_ns: int
    _states: list[dict[str, Array]]
    _missing_field: list[str]
    _missing_reference: list[str]
    _start: Array
    _start_covariance: Array
    _start_fields: Array
    _axis_sums: Array
    _decay: Array
    _mean_decay: Array
    _decays: int
    _start_known: bool
    _start_free: bool


class Compensation(Stateful, CompensationMemory):
    """One craft's compensation.

    Parameters
    ----------
    model: from ``physics.toml``.

    Attributes
    ----------
    missing: effects that the newest sample or reference was not corrected for.
    """

    def __init__(self, model: PhysicsModel) -> None:
        self.model = model
        self._field_terms = tuple(term for term in model.terms if not _acts_on(term).is_reference)
        self._growth_terms = tuple(term for term in model.terms if _acts_on(term) is ActsOn.REFERENCE)
        self._time_terms = tuple(term for term in model.terms if _acts_on(term) is ActsOn.REFERENCE_TIME)
        self._direct = tuple(effect_named(term.effect).direct(term) for term in self._field_terms)
        self._needs_scene = not all(self._direct)
        self._channels = {}
        self._places = []
        self._last = None
        self._reference = None
        self._reference_ns = self._growth_ns = self._begun_ns = 0
        self._growth_nt = 0.0
        self._states = [{} for _ in model.terms]
        self._missing_field, self._missing_reference = [], []
        self._groups = _groups_of(self._field_terms)
        count = len(set(self._groups.values()))
        self._start, self._start_covariance = np.zeros(count), np.zeros((count, count))
        self._start_fields = np.zeros((count, 3))
        self._decay, self._mean_decay, self._decays = np.ones(count), np.ones(count), 0
        self._start_known = self._start_free = False
        self._axis_sums = np.zeros((5, 5))  # of h, v and 1: products of the field's direction and w along the axis

    @property
    def missing(self) -> tuple[str, ...]:
        """Names of the effects that are not compensated for want of their driver."""
        return tuple(sorted({*self._missing_field, *self._missing_reference}))

    # Temperatures at the start

    def begins_elsewhere(self, sample: MagnetometerSample) -> bool:
        """Whether a stream begins with this sample, and its temperature or spin axis then is not known to the model."""
        unknown = bool(self._groups) or (self._needs_scene and self.model.spin is not None)
        return unknown and not self._begun_ns and not self._is_at_start(sample.time_ns)

    def _is_at_start(self, time_ns: int) -> bool:
        """Whether a time is that of the model's start."""
        return abs(time_ns - self.model.origin_ns) < 1e9 * _AT_START_S

    def free_start(self) -> None:
        """Take the start as zero and tell its fields (``start_fields``), until it is given."""
        self._start = np.zeros_like(self._start)
        self._start_known, self._start_free = False, True

    def take_start(self, other: Compensation) -> None:
        """The start that another has been given."""
        self.give_start(other._start, other._start_covariance)

    def give_start(self, start: Array, covariance: Array) -> None:
        """Take a start (k,) with covariance (k, k) from now on, in units of the swing between light and shadow."""
        self._start, self._start_covariance = start, covariance
        self._start_known, self._start_free = True, False

    @property
    def start(self) -> Array:
        """The start (k,) that was given, in units of the swing between light and shadow."""
        return self._start

    @property
    def start_terms(self) -> tuple[str, ...]:
        """Effects whose temperature at the start has to be known."""
        return tuple(sorted({self._field_terms[index].effect for index in self._groups}))

    @property
    def start_fields(self) -> Array:
        """What one unit of each start adds to the newest sample, g (k, 3) [nT], sensor axes."""
        return np.asarray(self._start_fields @ self._inverse.T)

    @property
    def start_variance(self) -> Array | None:
        """Covariance (3, 3) [nT^2] of the newest calibrated vector by what is not known of the start; None: none.

        Nine errors that were learned from all samples so far hold the mean of what a wrong start has left in them, so
        what is wrong with a vector is how far the start's decay is from its mean.
        """
        if not self._start_known:
            return None
        left = self._start_fields * ((self._decay - self._mean_decay) / np.maximum(self._decay, 1e-12))[:, None]
        return np.asarray(left.T @ self._start_covariance @ left)

    @property
    def wait_s(self) -> float:
        """How much later a reference for a sample comes than it would without a time offset [s]."""
        return max(0.0, sum(shifts_s(self._time_terms, 0.0)[0]))

    # Inputs

    def telemetry(self, sample: TelemetrySample) -> None:
        """Take a channel's value."""
        unit = CHANNEL_UNITS.get(sample.unit)
        before = self._channels.get(sample.channel)
        if unit is None or (before is None and len(self._channels) >= _MOST_CHANNELS):
            return
        if before is not None and sample.time_ns <= before.time_ns:
            if before.time_ns - sample.time_ns < 1e9 * _STALE_S[1]:
                return  # late or doubled; older than that, the clock was set back
            before = None
        pace_s = _STALE_S[1] if before is None else (sample.time_ns - before.time_ns) * 1e-9
        values = tuple(unit.to_base(sample.values).tolist())
        self._channels[sample.channel] = Held(sample.time_ns, pace_s, unit.quantity, values)

    def position(self, sample: PositionSample) -> None:
        """Take a position."""
        if self._places and abs(sample.time_ns - self._places[-1].time_ns) > 1e9 * _POSITION_S:
            self._places.clear()
        if self._places and sample.time_ns <= self._places[-1].time_ns:
            return
        km = np.array([sample.position_km])
        if sample.frame is not Frame.ECEF:
            if sample.clock is not Clock.UTC:
                return
            km = geomagnetic.ecef_from_eci(np.array([sample.time_ns]), km)
        x, y, z = km[0].tolist()
        self._places = [*self._places[-1:], Place(sample.time_ns, (x, y, z))]

    def reference(self, sample: ReferenceSample) -> ReferenceSample:
        """The reference as the model corrects it."""
        if sample.field_nt is not None and sample.frame is Frame.ECI:
            self._reference, self._reference_ns = sample.field_nt, sample.time_ns
        shift_s, unfit = shifts_s(self._time_terms, (sample.time_ns - self.model.origin_ns) * 1e-9)
        sample = replace(sample, time_ns=sample.time_ns - sum(round(one_s * 1e9) for one_s in shift_s))
        sample = self._grown(sample) if self._growth_terms else sample
        of_time = {term.effect for term in self._time_terms}
        self._missing_reference = [*(name for name in self._missing_reference if name not in of_time), *unfit]
        return sample

    def correct(self, sample: MagnetometerSample) -> MagnetometerSample:
        """The sample less the model's disturbances."""
        if not self._field_terms:
            return sample
        self._begun_ns = self._begun_ns or sample.time_ns
        in_order = self._last is None or sample.time_ns > self._last.time_ns
        row = Row(sample.time_ns, sample.field_body_nt)
        scene = self._scene_of(row, sample.clock, in_order=in_order) if self._needs_scene else None
        corrected, missing = sample.field_body_nt, []
        if self._groups:
            self._start_fields = np.zeros_like(self._start_fields)
        for index, term in enumerate(self._field_terms):
            try:
                d = (
                    self._now(index, row)
                    if scene is None or self._direct[index]
                    else self._on(scene, index, row, in_order)
                )
                corrected = self._without(corrected, d, term)
            except (DriverMissingError, MisfitError):
                missing.append(term.effect)
        if in_order:
            self._last = row
        if in_order and self._groups:
            self._decays += 1
            self._mean_decay = self._mean_decay + (self._decay - self._mean_decay) / self._decays
        self._missing_field = missing
        return replace(sample, field_body_nt=corrected)

    def _without(self, measured: Vector, d: Sequence[float], term: ModelTerm) -> Vector:
        """B - (I + D)^-1 d (3,) [nT]; MisfitError where that is no reading that a sensor could give."""
        b1, b2, b3 = measured
        limit = MAX_SAMPLE_FIELD_NT
        if sum(map(abs, d)) < _ABSURD_NT:  # beyond it, or not a number, the product would overflow
            o1, o2, o3 = (self._inverse @ d).tolist()
            x, y, z = b1 - o1, b2 - o2, b3 - o3
        else:
            x, y, z = d
        if not (-limit <= x <= limit and -limit <= y <= limit and -limit <= z <= limit):
            raise MisfitError(f"{term.effect}: without it the sample would be {(x, y, z)}")
        return x, y, z

    def _now(self, index: int, row: Row) -> list[float]:
        """Disturbance of a direct term at this moment (3,) [nT]: the channel's newest value, no scene."""
        form = self._direct[index]
        assert form is not None
        held = self._channels.get(form.channel)
        if held is None or held.quantity != form.quantity or max(form.columns) >= len(held.values):
            raise DriverMissingError(f"{self._field_terms[index].effect}: channel {form.channel} is not there")
        if abs(row.time_ns - held.time_ns) * 1e-9 > stale_after_s(held.pace_s, held.quantity):
            raise DriverMissingError(f"{self._field_terms[index].effect}: channel {form.channel} is stale")
        return form.field(held.values, row.field_nt)

    def _on(self, scene: Scene | None, index: int, row: Row, in_order: bool) -> list[float]:
        """Disturbance of a term at the newest sample of a scene (3,) [nT]; not finite where its numbers are absurd."""
        assert scene is not None
        begins_anew = index in self._groups and (self._start_free or self._start_known)
        memory = Memory(-1, self._states[index] if in_order else dict(self._states[index]), begins_anew)
        with np.errstate(all="ignore"):
            bound = self._bound(self._field_terms[index], scene, memory, row.time_ns)
            if begins_anew:
                return self._from_start(bound, self._groups[index], memory)
            found: list[float] = bound.disturbance()[0][-1].tolist()
        return found

    def _from_start(self, bound: Bound, group: int, memory: Memory) -> list[float]:
        """Disturbance (3,) [nT] of a term whose start is estimated: its amplitudes act on the start's decay as well."""
        columns = bound.hypothesis.columns(bound.theta)
        own = bound.amplitudes[: len(bound.amplitudes) // 2]
        none = np.zeros_like(own)
        by_light, by_start = (columns.field(np.concatenate(pair))[-1] for pair in ((own, none), (none, own)))
        self._start_fields[group] += by_start
        self._decay[group] = float(memory.states["decay"])
        found: list[float] = (by_light + self._start[group] * by_start).tolist()
        return found

    def _scene_of(self, row: Row, clock: Clock, *, in_order: bool) -> Scene:
        return self._scene([self._last, row] if self._last is not None and in_order else [row], clock)

    @cached_property
    def _inverse(self) -> Array:
        """(I + D)^-1."""
        return np.asarray(np.linalg.inv(np.eye(3) + d_matrix(self.model.x)))

    # Application

    def _bound(self, term: ModelTerm, scene: Scene, memory: Memory, time_ns: int) -> Bound:
        effect = effect_named(term.effect)
        if {term.driver, term.variant} & set(effect.not_live) or (effect.needs_rate and scene.rate_body is None):
            raise DriverMissingError(f"{term.effect}, {described(term)}: cannot be followed live")
        if term.driver == _WARMTH and not memory.begins_anew and not self._is_warm(term, time_ns):
            raise DriverMissingError(f"{term.effect}: its temperature at the start is not known yet")
        return bind(term, scene, memory)

    def _is_warm(self, term: ModelTerm, time_ns: int) -> bool:
        """Whether an inferred temperature is known: from the model's start on, or once its start has decayed."""
        if self._is_at_start(self._begun_ns):
            return True
        settled_s = _WARM * sum(term.nonlinear.get(name, 0.0) for name in ("time_constant_s", "skin_s"))
        return (time_ns - self._begun_ns) * 1e-9 > settled_s

    def _scene(self, rows: list[Row], clock: Clock) -> Scene:
        """The sample, and the one before it, with the drivers of this moment."""
        measured = np.array([row.field_nt for row in rows])
        calibrated = calibrate(self.model.x, measured)
        times_ns = [row.time_ns for row in rows]
        now_ns = times_ns[-1]
        utc = clock is Clock.UTC
        same = utc is (self.model.clock is Clock.UTC)
        origin_ns = self.model.origin_ns if same else self._begun_ns
        spin = self.model.spin
        attitude = self._attitude(calibrated, now_ns) if utc else None
        return Scene(
            time_s=np.array([(time_ns - origin_ns) * 1e-9 for time_ns in times_ns]),
            origin_ns=origin_ns,
            utc=utc,
            field_nt=measured,
            calibrated_nt=calibrated,
            clean_field_nt=measured,
            magnitude_nt=np.linalg.norm(calibrated, axis=1),
            position_ecef_km=self._place(times_ns),
            channels={
                name: Telemetry(name, held.quantity, np.tile(np.array(held.values), (len(rows), 1)))
                for name, held in self._channels.items()
                if abs(now_ns - held.time_ns) * 1e-9 <= stale_after_s(held.pace_s, held.quantity)
            },
            body_from_eci=attitude,
            turning_rad_s=None if spin is None else spin.rate_rad_s * np.array(spin.axis_body),
        )

    def _place(self, times_ns: list[int]) -> NDArray[np.float64] | None:
        """Positions (n, 3) along the line through the last two, or None."""
        if not self._places or abs(times_ns[-1] - self._places[-1].time_ns) * 1e-9 > _POSITION_S:
            return None
        last = self._places[-1]
        place = np.array(last.ecef_km)
        velocity = np.zeros(3)
        if len(self._places) > 1:
            before = self._places[0]
            velocity = (place - np.array(before.ecef_km)) / (last.time_ns - before.time_ns)
        return np.stack([place + velocity * (time_ns - last.time_ns) for time_ns in times_ns])

    def _attitude(self, calibrated: Array, now_ns: int) -> Array | None:
        """(n, 3, 3) from the model's spin axis and each sample's phase; None without axis or reference."""
        spin = self.model.spin
        if spin is None or self._reference is None or abs(now_ns - self._reference_ns) > 1e9 * _KNOT_S:
            return None
        body, inertial = np.array(spin.axis_body), self._axis_eci(calibrated[-1], spin)
        if inertial is None:
            return None
        reference = np.broadcast_to(np.array(self._reference), calibrated.shape)
        turn, _ = turns_of(calibrated, reference, body, inertial)
        return attitude_of(body, inertial, np.angle(turn))

    def _axis_eci(self, calibrated: Array, spin: ModelSpin) -> Array | None:
        """The spin axis in space (3,): the model's at its start; elsewhere that of this stream, None until it is known.

        With a the axis in the body and c in space, w . a = H . c at every instant, whatever the phase: a line through
        the origin in H / |H| and (w . a) / |H|, by least squares on all samples so far.
        """
        if self._is_at_start(self._begun_ns):
            return np.array(spin.axis_eci)
        size = float(np.linalg.norm(self._reference or (0.0, 0.0, 0.0)))
        if size == 0.0:
            return None
        row = np.array([*(np.array(self._reference) / size), float(calibrated @ np.array(spin.axis_body)) / size, 1.0])
        self._axis_sums = self._axis_sums + np.outer(row, row)
        count = float(self._axis_sums[4, 4])
        normal = self._axis_sums[:3, :3] + 1e-9 * np.eye(3)
        axis = np.linalg.solve(normal, self._axis_sums[:3, 3])
        left = max(float(self._axis_sums[3, 3] - self._axis_sums[:3, 3] @ axis), 0.0) / count
        variance = _AXIS_MEMORY * left * float(np.linalg.eigvalsh(np.linalg.inv(normal))[-1])
        length = float(np.linalg.norm(axis))
        if count < _AXIS_MEMORY or variance > _AXIS_RAD**2 or abs(length - 1.0) > _AXIS_LENGTH:
            return None
        return np.asarray(axis / length)

    def _grown(self, sample: ReferenceSample) -> ReferenceSample:
        """The reference brought to the magnitude that acts; computed once a second, held in between."""
        vector = None if sample.field_nt is None else np.array(sample.field_nt)
        magnitude = float(np.linalg.norm(vector)) if vector is not None else sample.magnitude_nt or 0.0
        if abs(sample.time_ns - self._growth_ns) >= _GROWTH_NS:
            self._growth_ns = sample.time_ns
            self._growth_nt = self._growth(sample, vector, magnitude)
        factor = 1.0 + self._growth_nt / max(magnitude, 1.0)
        if vector is None:
            return replace(sample, magnitude_nt=magnitude * factor)
        x, y, z = (vector * factor).tolist()
        return replace(sample, field_nt=(x, y, z))

    def _growth(self, sample: ReferenceSample, vector: Array | None, magnitude: float) -> float:
        """Growth of the magnitude [nT]; the scene has two earlier places, for the direction of flight."""
        times_ns = [sample.time_ns - round(k * _KNOT_S * 1e9) for k in (2, 1, 0)]
        along = np.tile([magnitude, 0.0, 0.0], (3, 1))
        inertial = None
        if vector is not None and sample.frame is Frame.ECI:
            inertial = np.tile(vector, (3, 1))
        elif vector is not None and sample.frame is Frame.ECEF and sample.clock is Clock.UTC:
            inertial = geomagnetic.eci_from_ecef(np.array(times_ns), np.tile(vector, (3, 1)))
        scene = Scene(
            time_s=np.array([(time_ns - self.model.origin_ns) * 1e-9 for time_ns in times_ns]),
            origin_ns=self.model.origin_ns,
            utc=sample.clock is Clock.UTC,
            field_nt=along,
            calibrated_nt=along,
            clean_field_nt=along,
            magnitude_nt=np.full(3, magnitude),
            reference_eci_nt=inertial,
            position_ecef_km=self._place(times_ns),
        )
        total, missing = 0.0, []
        for term in self._growth_terms:
            try:
                if {term.driver, term.variant} & set(effect_named(term.effect).not_live):
                    raise DriverMissingError(f"{term.effect}, {term.variant}: needs the orbit ahead")
                with np.errstate(all="ignore"):
                    growth = float(np.broadcast_to(bind(term, scene).disturbance()[1], 3)[-1])
                if not abs(total + growth) <= _MOST_GROWTH * magnitude:
                    raise MisfitError(f"{term.effect}: the reference would grow by {growth:g} nT")
                total += growth
            except (DriverMissingError, MisfitError):
                missing.append(term.effect)
        self._missing_reference = missing
        return total


def _groups_of(terms: Sequence[ModelTerm]) -> dict[int, int]:
    """For each term (by its place) that an inferred temperature drives, the number of its temperature among others."""
    numbers: dict[tuple[float, ...], int] = {}
    found = {}
    for index, term in enumerate(terms):
        if term.driver == _WARMTH:
            constants = tuple(term.nonlinear.get(name, 0.0) for name in ("time_constant_s", "skin_s"))
            found[index] = numbers.setdefault(constants, len(numbers))
    return found


def _acts_on(term: ModelTerm) -> ActsOn:
    return effect_named(term.effect).acts_on


def shifts_s(terms: Sequence[ModelTerm], elapsed_s: float) -> tuple[list[float], list[str]]:
    """By how much each term's reference is late [s], so long after the model's origin; and what does not fit."""
    found, unfit = [], []
    for term in terms:
        drift_ppm = term.amplitudes.get("drift_ppm", np.float64(0.0))
        shift_s = np.asarray(term.amplitudes.get("offset_s", np.nan) + drift_ppm * 1e-6 * elapsed_s)
        if shift_s.ndim == 0 and abs(float(shift_s)) <= _MOST_SHIFT_S:
            found.append(float(shift_s))
        else:
            unfit.append(term.effect)
    return found, unfit


def stale_after_s(pace_s: float, quantity: str) -> float:
    """Age [s] beyond which a channel of a quantity that comes every ``pace_s`` is no driver any more."""
    return min(max(_STALE_PACES * pace_s, _SLOW.get(quantity, _STALE_S[0])), _STALE_S[1])
