"""What a recording offers to the catalogue: samples, reference, place, light, telemetry, and the field's direction.

A scene is the samples of one recording (or of one moment of a live stream) with everything derived that a driver may
need, each computed once and only when used; None where the recording does not hold it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from magcal_service.earth import geomagnetic
from magcal_service.model import Array
from magcal_service.physics.scene import main_field, motion, sunlight
from magcal_service.physics.scene.memory import AT_START_S, Memory
from magcal_service.physics.scene.recent import Recent
from magcal_service.physics.scene.vectors import Vectors

KEPT = (
    "memo",
    "_places",
    "period_s",
    "pauses",
    "time_ns",
    "magnitude_slope",
    "magnitude_bend",
    "position_eci_km",
    "sun_eci",
    "lit",
    "sun_body",
    "_warmed",
    "_skins",
    "eclipses",
    "dipole_eci",
    "knots",
    "has_model",
)
"""Results of a scene that do not depend on the calibrated vectors."""

SUN_AHEAD: Final = "sun_ahead_deg"
"""Constant of a model that was found under a Sun other than the date's: see ``Scene.sun_ahead_deg``."""

SKIN_START: Final = "skin_start"
"""Constant of a model of several recordings: what light heats first, at the origin, over the mean light."""

BEND_S: Final = 120.0
"""Width over which a derivative is derived again [s]: an eighth of a radian of a low orbit, which loses 0.1 % of it."""

_LEAST_SWING: Final = 1e-3  # of a channel's largest value: less is its last digit

MOST_WARMED: Final = 96
"""Answers to light that are kept: more than the pairs of time constants on a grid, which are tried again and again."""

MOST_SKINS: Final = 16
"""Answers of a skin alone that are kept: those of a grid, and of one number about its best while the other is tried."""

Warmed = Recent[tuple[float, float], tuple[Array, Array]]
"""Answers to light with their decays, by time constant and skin."""

T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class Telemetry:
    """One channel on the samples' times: kind by its unit, and values (n, k) in the base unit without gaps."""

    name: str
    quantity: str
    values: Array

    @cached_property
    def swings(self) -> tuple[Array, Array]:
        """Standard deviation and largest absolute value (k,) of each column, asked for whenever forms are made anew."""
        return np.std(self.values, axis=0), np.abs(self.values).max(axis=0)

    @property
    def varies(self) -> NDArray[np.bool_]:
        """Which columns (k,) change, by more than a thousandth of their largest value."""
        spread, largest = self.swings
        return np.asarray(spread > _LEAST_SWING * largest)


def is_sun_vector(channel: Telemetry) -> bool:
    """Whether a channel is the Sun's direction in the body, by its name, its kind and its three columns."""
    name = channel.name.lower()
    named = "sun" in name or "photo" in name or "css" in name
    return channel.values.shape[1] == 3 and named and channel.quantity in ("dimensionless", "counts", "irradiance", "")


@dataclass(frozen=True, eq=False)
class Scene:
    """Samples in rising time order.

    Parameters
    ----------
    time_s: (n,) seconds since the origin.
    origin_ns: source time of the origin [ns].
    utc: whether the source time is UTC.
    field_nt: (n, 3) measured vector B, sensor axes [nT].
    calibrated_nt, clean_field_nt, moved_s, undisturbed_nt: as ``Vectors``.
    magnitude_nt: (n,) |H_ref| [nT].
    reference_eci_nt: (n, 3) H_ref, ECI [nT], or None where only its magnitude is known.
    position_ecef_km: (n, 3) or None.
    channels: telemetry by name.
    body_from_eci: (n, 3, 3) attitude, recorded or from a steady spin, or None.
    given: constants of a model that is applied here, which replace those of the scene; no effect is then
        left out for lack of change.  None while effects are searched.
    memory: of the one effect that is applied to a stream scene by scene; None for a whole recording.
    in_orbit: whether the craft is in orbit: elsewhere sunlight, currents in space and torquers drive nothing.
    turning_rad_s: (3,) or (n, 3) the craft's turn where neither attitude nor gyro gives it, or None.
    sun_ahead_deg: how far along the ecliptic the Sun stands ahead of where it is at the stated time [deg]; other than 0
        where telemetry shows its light and shadow elsewhere.
    is_solved: whether the attitude was solved from the samples, not recorded.
    """

    time_s: Array
    origin_ns: int
    utc: bool
    field_nt: Array
    calibrated_nt: Array
    clean_field_nt: Array
    magnitude_nt: Array
    reference_eci_nt: Array | None = None
    position_ecef_km: NDArray[np.float64] | None = None
    channels: Mapping[str, Telemetry] = field(default_factory=dict)
    body_from_eci: Array | None = None
    given: Mapping[str, float] | None = None
    memory: Memory | None = None
    turning_rad_s: Array | None = None
    in_orbit: bool = True
    sun_ahead_deg: float = 0.0
    moved_s: Array | None = None
    undisturbed_nt: Array | None = None
    is_solved: bool = False
    memo: dict[str, Any] = field(default_factory=dict, init=False, repr=False)

    def once(self, name: str, make: Callable[[], T]) -> T:
        """The result of ``make``, computed once for this recording, whatever is calibrated meanwhile.

        For what depends on times, places, reference and telemetry alone.
        """
        if name not in self.memo:
            self.memo[name] = make()
        found: T = self.memo[name]
        return found

    def recalibrated(self, found: Vectors) -> Scene:
        """The same recording with other vectors; what does not depend on them is kept."""
        scene = replace(self, **found._asdict())
        for name in KEPT:
            if name in self.__dict__:
                scene.__dict__[name] = self.__dict__[name]
        return scene

    def __len__(self) -> int:
        return len(self.time_s)

    @property
    def free_field_nt(self) -> Array:
        """(n, 3) measured vectors as they would be without what was left out, as far as that is known [nT]."""
        return self.clean_field_nt if self.undisturbed_nt is None else self.undisturbed_nt

    @property
    def is_given(self) -> bool:
        """Whether a known model is applied, rather than one searched."""
        return self.given is not None

    def constant(self, name: str, own: float) -> float:
        """A constant of the model that is applied; ``own`` while one is searched."""
        return own if self.given is None else self.given.get(name, own)

    def chosen(self, name: str, own: Sequence[int]) -> list[int]:
        """Numbers kept as the constants ``NAME_0``, ``NAME_1``, ... of the model that is applied; else ``own``."""
        if self.given is None:
            return [int(number) for number in own]
        keys = (f"{name}_{index}" for index in range(len(self.given)))
        return [int(self.given[key]) for key in keys if key in self.given]

    def begin(self, name: str, default: Array | float) -> Array | float:
        """State at the first row of an effect with a memory, as the scene before it has left it."""
        return default if self.memory is None else self.memory.states.get(name, default)

    def keep(self, name: str, states: Array) -> None:
        """Pass the states (n, ...) of an effect with a memory to the next scene."""
        if self.memory is not None:
            self.memory.states[name] = np.array(states[self.memory.next_row])

    @property
    def quantities(self) -> set[str]:
        """Kinds of what its channels are of."""
        return {channel.quantity for channel in self.channels.values()}

    def of_quantity(self, *quantities: str) -> list[Telemetry]:
        """Channels of these kinds, in the descriptor's order."""
        return [channel for channel in self.channels.values() if channel.quantity in quantities]

    def course_at(self, at_s: float) -> Array:
        """Times (k,) [s] of the recording that a time belongs to: all of them."""
        return self.time_s

    @cached_property
    def period_s(self) -> float:
        """Usual time between samples [s]."""
        return float(np.median(np.diff(self.time_s))) if len(self) > 1 else 1.0

    @cached_property
    def pauses(self) -> NDArray[np.intp]:
        """Rows (k,) that begin a new stretch after a gap of more than ten sample periods, with row 0."""
        return motion.pauses(self.time_s, 10.0 * self.period_s)

    @cached_property
    def time_ns(self) -> NDArray[np.int64]:
        """(n,) source time [ns]."""
        return np.asarray(self.origin_ns + np.rint(self.time_s * 1e9).astype(np.int64), dtype=np.int64)

    @cached_property
    def unit(self) -> Array:
        """(n, 3) direction of the field in the body."""
        return np.asarray(self.calibrated_nt / np.linalg.norm(self.calibrated_nt, axis=1)[:, None])

    def slope(self, values: Array) -> Array:
        """Time derivative of values (n, ...), central, one-sided at the ends of each stretch."""
        return motion.slope(values, self.time_s, self.pauses)

    @cached_property
    def magnitude_slope(self) -> Array:
        """(n,) d|H|/dt [nT/s], over gaps of up to ten usual steps too, as between samples that come in pairs."""
        usual_s = float(np.quantile(np.diff(self.time_s, prepend=self.time_s[:1]), 0.75))
        return motion.slope(self.magnitude_nt, self.time_s, motion.pauses(self.time_s, 10.0 * usual_s))

    @cached_property
    def magnitude_bend(self) -> Array:
        """(n,) d2|H|/dt2 [nT/s2], between means of the slope over a minute: a rounded reference has no other."""
        return self.smooth_slope(self.magnitude_slope)

    def smooth_slope(self, values: Array) -> Array:
        """Time derivative (n,) of values (n,) between their means over a minute before and after."""
        return motion.smooth_slope(values, BEND_S, self.time_s, self.pauses, self.period_s)

    @cached_property
    def rate_body(self) -> Array | None:
        """(n, 3) angular rate [rad/s], body, from a recorded attitude, a gyro channel, or what was solved, or None."""
        has_attitude = self.body_from_eci is not None and self.period_s < 30.0 and self.turning_rad_s is None
        gyros = [channel.values for channel in self.of_quantity("angular rate") if channel.values.shape[1] == 3]
        if gyros and (self.is_solved or not has_attitude):
            return gyros[0]
        if has_attitude:
            assert self.body_from_eci is not None
            return motion.rate_of(self.body_from_eci, self.time_s, self.pauses)
        if self.turning_rad_s is not None:
            return np.broadcast_to(self.turning_rad_s, (len(self), 3))
        return None

    @cached_property
    def field_slope(self) -> Array:
        """(n, 3) dw/dt of the calibrated vector in the body [nT/s].

        With a known rate: -rate x w plus the field's change in space, right however fast the craft turns; without
        one by differences, which are short by 1 - sinc(rate x period).  Where only the magnitude's change is known in
        space, the part along a steady axis is the course of w along it, over a minute or four turns.
        """
        if self.rate_body is None:
            return self.slope(self.calibrated_nt)
        turning: Array = -np.cross(self.rate_body, self.calibrated_nt)
        if self.body_from_eci is not None and self.reference_eci_nt is not None:
            turned: Array = np.einsum("nij,nj->ni", self.body_from_eci, self.slope(self.reference_eci_nt))
            return turning + turned
        found: Array = turning + self.unit * self.magnitude_slope[:, None]
        if self.turning_rad_s is None or self.is_given:
            return found
        mean = np.mean(self.turning_rad_s.reshape(-1, 3), axis=0)
        rate = float(np.linalg.norm(mean))
        axis = mean / max(rate, 1e-12)
        width = max(60.0, 8.0 * np.pi / max(rate, 1e-6))
        along = motion.smooth_slope(self.calibrated_nt @ axis, width, self.time_s, self.pauses, self.period_s)
        corrected: Array = found + (along - found @ axis)[:, None] * axis
        return corrected

    # The Sun

    @cached_property
    def _utc_s(self) -> Array | None:
        return self.time_ns * 1e-9 if self.utc else None

    @cached_property
    def position_eci_km(self) -> NDArray[np.float64] | None:
        """(n, 3) or None without a position or UTC."""
        if self.position_ecef_km is None or not self.utc:
            return None
        return geomagnetic.eci_from_ecef(self.time_ns, self.position_ecef_km)

    @cached_property
    def sun_eci(self) -> Array | None:
        """(n, 3) direction of the Sun, ECI; None without UTC."""
        ahead = math.radians(self.constant(SUN_AHEAD, self.sun_ahead_deg))
        return None if self._utc_s is None else sunlight.sun_eci(self._utc_s, ahead)

    @cached_property
    def lit(self) -> Array | None:
        """(n,) share of sunlight; None without UTC and position."""
        if self.position_eci_km is None or self.sun_eci is None:
            return None
        return sunlight.sunlit(self.position_eci_km, self.sun_eci)

    @cached_property
    def sun_body(self) -> Array | None:
        """(n, 3) direction of the Sun in the body, unit; None without UTC and attitude."""
        if self.sun_eci is None or self.body_from_eci is None:
            return None
        return np.asarray(np.einsum("nij,nj->ni", self.body_from_eci, self.sun_eci))

    @property
    def mean_light(self) -> float:
        """Light that counts as zero of what follows it: the recording's mean."""
        assert self.lit is not None
        return self.constant("mean_light", float(self.lit.mean()))

    def warmed(self, tau_s: float, skin_s: float) -> tuple[Array, Array]:
        """Response (n,) to light of something with a time constant behind a skin with another, and its decay (n,)."""
        return self._warmed.once((tau_s, skin_s), lambda: self._warm(tau_s, skin_s))

    def _warm(self, tau_s: float, skin_s: float) -> tuple[Array, Array]:
        assert self.lit is not None
        drive = lit = self.lit - self.mean_light
        if skin_s > 0.0:
            start = self.begin("skin", self.constant(SKIN_START, 0.0))
            drive = self._skins.once(skin_s, lambda: sunlight.first_order(self.time_s, lit, skin_s, start))
            self.keep("skin", drive)
        answer = sunlight.first_order(self.time_s, drive, tau_s, self.begin("answer", 0.0))
        self.keep("answer", answer)
        return answer, self.settling(tau_s)

    def settling(self, tau_s: float) -> Array:
        """What is left (n,) of a temperature at the start: of the recording, or of a stream that begins elsewhere.

        Before the recording it says nothing: what was warm then did not begin yet.
        """
        if self.memory is None or not self.memory.begins_anew:
            return np.where(self.time_s < -AT_START_S, 0.0, np.exp(-np.maximum(self.time_s, 0.0) / tau_s))
        decay = self.begin("decay", 1.0) * np.exp(-(self.time_s - self.time_s[0]) / tau_s)
        self.keep("decay", decay)
        return np.asarray(decay)

    @cached_property
    def _warmed(self) -> Warmed:
        return Warmed(MOST_WARMED)

    @cached_property
    def _skins(self) -> Recent[float, Array]:
        return Recent(MOST_SKINS)

    @cached_property
    def eclipses(self) -> bool:
        """Whether light changes enough for anything to follow it."""
        if self.is_given:
            return self.lit is not None
        return self.lit is not None and 0.02 < float(self.lit.mean()) < 0.98

    @cached_property
    def dipole_eci(self) -> Array | None:
        """(n, 3) axis of the Earth's dipole, towards geomagnetic north, ECI; None without UTC."""
        if not self.utc:
            return None
        return main_field.dipole_eci(self.time_ns)

    @cached_property
    def knots(self) -> NDArray[np.intp]:
        """Rows (k,) between which a slowly changing field may be interpolated: 10 s apart, and around each gap."""
        return main_field.knots(self.time_s, self.period_s, self.pauses)

    def from_knots(self, values: Array) -> Array:
        """Values (k,) at the knots as (n,) at the samples."""
        return np.asarray(np.interp(self.time_s, self.time_s[self.knots], values))

    def model_magnitude(
        self, places: geomagnetic.Places | None = None, times_ns: NDArray[np.int64] | None = None, degree: int = 13
    ) -> Array:
        """(k,) magnitude of the main field [nT] at the knots, or at other places or times, one a knot."""
        times = self.time_ns[self.knots] if times_ns is None else times_ns
        own = places or self._places
        assert own
        return np.asarray(np.linalg.norm(own.field_nt(times, degree), axis=1))

    @cached_property
    def _places(self) -> geomagnetic.Places | None:
        given = self.position_ecef_km
        return None if given is None else geomagnetic.Places(given[self.knots])

    @cached_property
    def has_model(self) -> bool:
        """Whether the field model can be evaluated here: UTC within its years, a position in its range, its package."""
        if not self.utc or self.position_ecef_km is None:
            return False
        return main_field.is_modelled(self.time_ns[:1], self.position_ecef_km[:1])
