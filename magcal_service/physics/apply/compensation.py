"""Live compensation: subtract the disturbances that ``physics.toml`` models from every sample, correct every reference.

A sample becomes B' = B - (I + D)^-1 d with D and d of the model; a reference gets the magnitude, or the time, that the
model gives it.  Drivers are the newest values on the link: a channel is held until its next value, a position carried
on along a straight line.  An effect whose driver is missing or stale, whose numbers do not fit its form or its driver,
or whose disturbance is absurdly large, is left out and named in ``missing``; so is a curve without a name whose driver
is beyond its range.  Effects with a memory carry it from sample to sample (``scene.Memory``).

What a driver is at this moment is in ``live_drivers``, attitude in ``live_spin``, references in ``live_reference``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Final

import numpy as np

from magcal_service.base.snapshot import Stateful
from magcal_service.model import Array, calibrate, d_matrix
from magcal_service.physics.apply.empirical import NAME
from magcal_service.physics.apply.forward import Bound, DriverMissingError, MisfitError, bind, described, less
from magcal_service.physics.apply.lacking import Cause, cause_of, in_words
from magcal_service.physics.apply.live_curves import added_now, name_of
from magcal_service.physics.apply.live_drivers import Held, Place, fresh, hold, positions_km, with_place
from magcal_service.physics.apply.live_reference import GROWTH_NS, KNOT_S, grown, growth_of, shifts_s
from magcal_service.physics.apply.live_spin import attitude, axis_of, axis_sums_with, no_axis_sums
from magcal_service.physics.apply.live_terms import WARMTH, live_terms
from magcal_service.physics.apply.model_file import ModelSpin, ModelTerm, PhysicsModel
from magcal_service.physics.catalogue import effect_named
from magcal_service.physics.scene.memory import AT_START_S, Memory
from magcal_service.physics.scene.scene import Scene
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

_WARM: Final = 3.0
"""Time constants after which a temperature that began unknown is known to 5 %."""

_AXIS_LATER: Final = 1.02
"""Times as many samples before the spin axis in space is worked out again.  Choice: two percent more hardly move it."""

_ABSURD_NT: Final = 1e100
"""No disturbance reaches it; its products still fit a double."""


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
    _axis: Array | None
    _axis_due: float
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

    worked_out = ("_causes",)  # of the newest sample, and again with the next

    def __init__(self, model: PhysicsModel) -> None:
        self.model = model
        self._terms = live_terms(model)
        self._channels = {}
        self._places = []
        self._last = None
        self._reference = None
        self._reference_ns = self._growth_ns = self._begun_ns = 0
        self._growth_nt = 0.0
        self._states = [{} for _ in model.terms]
        self._missing_field, self._missing_reference = [], []
        self._causes: dict[str, tuple[Cause, str]] = {}
        count = len(set(self._terms.groups.values()))
        self._start, self._start_covariance = np.zeros(count), np.zeros((count, count))
        self._start_fields = np.zeros((count, 3))
        self._decay, self._mean_decay, self._decays = np.ones(count), np.ones(count), 0
        self._start_known = self._start_free = False
        self._axis_sums = no_axis_sums()
        self._axis, self._axis_due = None, 0.0

    @property
    def missing(self) -> tuple[str, ...]:
        """Names of the effects that are not compensated for want of their driver."""
        if not self._missing_field and not self._missing_reference:
            return ()
        return tuple(sorted({*self._missing_field, *self._missing_reference}))

    @property
    def causes(self) -> Mapping[str, tuple[Cause, str]]:
        """Of each of ``missing`` that is known why: what kept it out last, and the driver that it is about."""
        return {name: self._causes[name] for name in self.missing if name in self._causes}

    def missing_in_words(self) -> str:
        """``missing``, each with why."""
        named: dict[str, list[str]] = {}
        for name in self.missing:
            cause = self._causes.get(name)
            named.setdefault("" if cause is None else f" ({in_words(*cause, self._channels)})", []).append(name)
        return "; ".join(f"{', '.join(names)}{why}" for why, names in named.items())

    # Temperatures at the start

    def begins_elsewhere(self, sample: MagnetometerSample) -> bool:
        """Whether a stream begins with this sample, and its temperature or spin axis then is not known to the model."""
        unknown = bool(self._terms.groups) or (self._terms.needs_attitude and self.model.spin is not None)
        return unknown and not self._begun_ns and not self._is_at_start(sample.time_ns)

    def _is_at_start(self, time_ns: int) -> bool:
        """Whether a time is that of the model's start."""
        return abs(time_ns - self.model.origin_ns) < 1e9 * AT_START_S

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
        return tuple(sorted({self._terms.field[index].effect for index in self._terms.groups}))

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
        return max(0.0, sum(shifts_s(self._terms.time, 0.0)[0]))

    # Inputs

    def telemetry(self, sample: TelemetrySample) -> None:
        """Take a channel's value."""
        hold(self._channels, sample)

    def position(self, sample: PositionSample) -> None:
        """Take a position."""
        self._places = with_place(self._places, sample)

    def reference(self, sample: ReferenceSample) -> ReferenceSample:
        """The reference as the model corrects it."""
        if sample.field_nt is not None and sample.frame is Frame.ECI:
            self._reference, self._reference_ns = sample.field_nt, sample.time_ns
        shift_s, unfit = shifts_s(self._terms.time, (sample.time_ns - self.model.origin_ns) * 1e-9)
        sample = replace(sample, time_ns=sample.time_ns - sum(round(one_s * 1e9) for one_s in shift_s))
        sample = self._grown(sample) if self._terms.growth or self._terms.grown else sample
        of_time = {term.effect for term in self._terms.time}
        self._missing_reference = [*(name for name in self._missing_reference if name not in of_time), *unfit]
        return sample

    def correct(self, sample: MagnetometerSample) -> MagnetometerSample:
        """The sample less the model's disturbances."""
        if not self._terms.field and not self._terms.curves:
            return sample
        self._begun_ns = self._begun_ns or sample.time_ns
        in_order = self._last is None or sample.time_ns > self._last.time_ns
        row = Row(sample.time_ns, sample.field_body_nt)
        scene = self._scene_of(row, sample.clock, in_order=in_order) if self._terms.needs_scene else None
        corrected, missing = sample.field_body_nt, []
        if self._terms.groups:
            self._start_fields = np.zeros_like(self._start_fields)
        for index, term in enumerate(self._terms.field):
            try:
                d = (
                    self._now(index, row)
                    if scene is None or self._terms.direct[index]
                    else self._on(scene, index, row, in_order)
                )
                corrected = self._without(corrected, d, term.effect)
            except (DriverMissingError, MisfitError) as error:
                missing.append(term.effect)
                self._causes[term.effect] = cause_of(error, term.driver, self._channels, row.time_ns), term.driver
        for curve in self._terms.curves:
            try:
                body, _ = added_now(curve, self._channels, scene, row.time_ns, np.array(row.field_nt))
                corrected = self._without(corrected, body.tolist(), NAME)
            except (DriverMissingError, MisfitError) as error:
                missing.append(name_of(error))
                if missing[-1] == NAME:
                    self._causes[NAME] = cause_of(error, curve.driver, self._channels, row.time_ns), curve.driver
        if in_order:
            self._last = row
        if in_order and self._terms.groups:
            self._decays += 1
            self._mean_decay = self._mean_decay + (self._decay - self._mean_decay) / self._decays
        self._missing_field = missing
        return replace(sample, field_body_nt=corrected)

    def _without(self, measured: Vector, d: Sequence[float], name: str) -> Vector:
        """B - (I + D)^-1 d (3,) [nT]; MisfitError where that is no reading that a sensor could give."""
        b1, b2, b3 = measured
        limit = MAX_SAMPLE_FIELD_NT
        if sum(map(abs, d)) < _ABSURD_NT:  # beyond it, or not a number, the product would overflow
            o1, o2, o3 = (self._inverse @ d).tolist()
            x, y, z = b1 - o1, b2 - o2, b3 - o3
        else:
            x, y, z = d
        if not (-limit <= x <= limit and -limit <= y <= limit and -limit <= z <= limit):
            raise MisfitError(f"{name}: without it the sample would be {(x, y, z)}")
        return x, y, z

    def _now(self, index: int, row: Row) -> list[float]:
        """Disturbance of a direct term at this moment (3,) [nT]: the channel's newest value, no scene."""
        form = self._terms.direct[index]
        assert form is not None
        held = self._channels.get(form.channel)
        if held is None or held.quantity != form.quantity or max(form.columns) >= len(held.values):
            raise DriverMissingError(f"{self._terms.field[index].effect}: channel {form.channel} is not there")
        if held.is_stale(row.time_ns):
            raise DriverMissingError(f"{self._terms.field[index].effect}: channel {form.channel} is stale")
        return form.field(held.values, row.field_nt)

    def _on(self, scene: Scene | None, index: int, row: Row, in_order: bool) -> list[float]:
        """Disturbance of a term at the newest sample of a scene (3,) [nT]; not finite where its numbers are absurd."""
        assert scene is not None
        begins_anew = index in self._terms.groups and (self._start_free or self._start_known)
        memory = Memory(-1, self._states[index] if in_order else dict(self._states[index]), begins_anew)
        with np.errstate(all="ignore"):
            bound = self._bound(self._terms.field[index], scene, memory, row.time_ns)
            if begins_anew:
                return self._from_start(bound, self._terms.groups[index], memory)
            added_nt = bound.disturbance()[0]
            if effect_named(bound.hypothesis.effect).bends:
                scene = less(scene, added_nt, self.model.x)
                added_nt = self._bound(self._terms.field[index], scene, memory, row.time_ns).disturbance()[0]
            found: list[float] = added_nt[-1].tolist()
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
        if term.driver == WARMTH and not memory.begins_anew and not self._is_warm(term, time_ns):
            raise DriverMissingError(f"{term.effect}: its temperature at the start is not known yet")
        return bind(term, scene, memory)

    def _is_warm(self, term: ModelTerm, time_ns: int) -> bool:
        """Whether an inferred temperature is known: from the model's start on, or once its start has decayed."""
        if self._is_at_start(self._begun_ns):
            return True
        settled_s = _WARM * sum(float(np.max(term.nonlinear.get(name, 0.0))) for name in ("time_constant_s", "skin_s"))
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
        return Scene(
            time_s=np.array([(time_ns - origin_ns) * 1e-9 for time_ns in times_ns]),
            origin_ns=origin_ns,
            utc=utc,
            field_nt=measured,
            calibrated_nt=calibrated,
            clean_field_nt=measured,
            magnitude_nt=np.linalg.norm(calibrated, axis=1),
            position_ecef_km=positions_km(self._places, times_ns),
            channels=fresh(self._channels, now_ns, len(rows)),
            body_from_eci=self._attitude(calibrated, now_ns) if utc else None,
            turning_rad_s=None if spin is None else spin.rate_rad_s * np.array(spin.axis_body),
        )

    def _attitude(self, calibrated: Array, now_ns: int) -> Array | None:
        """(n, 3, 3) from the model's spin axis and each sample's phase; None without axis or reference."""
        spin = self.model.spin
        if spin is None or self._reference is None or abs(now_ns - self._reference_ns) > 1e9 * KNOT_S:
            return None
        at_start = self._is_at_start(self._begun_ns)
        inertial = np.array(spin.axis_eci) if at_start else self._axis_of_stream(calibrated[-1], self._reference, spin)
        return None if inertial is None else attitude(calibrated, self._reference, spin, inertial)

    def _axis_of_stream(self, calibrated: Array, reference: Vector, spin: ModelSpin) -> Array | None:
        """The spin axis in space (3,), from this sample w (3,) [nT] and those before; None until it is known."""
        size = float(np.linalg.norm(reference))
        if size == 0.0:
            return None
        along = float(calibrated @ np.array(spin.axis_body)) / size
        self._axis_sums = axis_sums_with(self._axis_sums, np.array(reference) / size, along)
        count = float(self._axis_sums[4, 4])
        if count >= self._axis_due:
            self._axis, self._axis_due = axis_of(self._axis_sums), _AXIS_LATER * count
        return self._axis

    def _grown(self, sample: ReferenceSample) -> ReferenceSample:
        """The reference brought to the magnitude that acts; computed once a second, held in between."""
        if abs(sample.time_ns - self._growth_ns) >= GROWTH_NS:
            self._growth_ns = sample.time_ns
            track = partial(positions_km, self._places)
            self._growth_nt, self._missing_reference = growth_of(
                self._terms.growth, self._terms.grown, self._channels, sample, track, self.model.origin_ns
            )
        return grown(sample, self._growth_nt)
