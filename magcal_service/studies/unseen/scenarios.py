"""What may be wrong in a flight, each in plain arithmetic of its own: no code of the catalogue of effects is used.

A scenario spoils what is sent (``flight.Sent``), and says from when on it does.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from types import MappingProxyType
from typing import Final

import numpy as np

from magcal_service.model import Array
from magcal_service.studies.unseen.faults import (
    HALF,
    clipped,
    clock,
    corrupted,
    dead,
    held_readings,
    noise_misstated,
    other_axis,
    spin,
    stuck,
    turned_axes,
)
from magcal_service.studies.unseen.flight import Sent
from magcal_service.studies.unseen.motion import field_eci_nt

_HOUR_S: Final = 3600.0  # seconds
_ORBIT_S: Final = 5740.0
"""An hour, and an orbit at 550 km [s]."""
_X, _Y, _Z = np.eye(3)
_ONE_SIDE: Final = np.array([0.6, -0.48, 0.64])


class Group(StrEnum):
    """What is wrong."""

    CLEAN = "clean"
    REFERENCE = "reference"
    BIAS = "bias"
    GAIN = "gain"
    CURRENT = "current"
    SENSOR = "sensor"
    SETTINGS = "settings"


@dataclass(frozen=True, slots=True)
class Scenario:
    """One thing that is wrong.

    Parameters
    ----------
    group: what kind of thing.
    says: what is done, in a few words.
    spoil: does it.
    since: share of the flight from which on it is there; 1 for what is clean.
    spinning: it means something for a craft that spins only.
    promised: a protection level has to hold it: it is on the list of docs/integrity.md and no larger than told there.
    unobservable: nothing that is sent could show it (docs/trust.md): it counts for no promise.
    """

    group: Group
    says: str
    spoil: Callable[[Sent], None]
    since: float = 0.0
    unobservable: bool = False
    spinning: bool = False
    promised: bool = False


def _nothing(_: Sent) -> None:
    """As it should be."""


# Clean


def _spikes(sent: Sent) -> None:
    hit = sent.rng.random(len(sent.noise)) < 0.01
    sent.noise[hit] += sent.rng.normal(0.0, 20_000.0, (int(hit.sum()), 3))


def _rounded(sent: Sent) -> None:
    sent.step_nt = 50.0


def _gaps(sent: Sent) -> None:
    sent.sample_sent &= sent.rng.random(len(sent.sample_sent)) > 0.2


def _pauses(sent: Sent) -> None:
    sent.sample_sent &= np.mod(sent.time_s, 1500.0) > 240.0


def _heavy(sent: Sent) -> None:
    sent.noise[:] = sent.noise_nt * sent.rng.standard_t(4.0, sent.noise.shape) / np.sqrt(2.0)


def _slow_sensor(sent: Sent) -> None:
    sent.sample_sent &= np.mod(sent.time_s, 4.0) == 0.0


# Reference


def _reference_at(ahead_s: Array | float) -> Callable[[Sent], None]:
    """The reference of where the craft is that much later, by differences of the field along its way."""

    def spoil(sent: Sent) -> None:
        slope = np.gradient(sent.reference_nt, axis=0)
        sent.reference_nt += slope * np.broadcast_to(ahead_s, len(slope))[:, None]

    return spoil


def _lagging(until_s: float) -> Callable[[Sent], None]:
    def spoil(sent: Sent) -> None:
        _reference_at(-until_s * sent.time_s / sent.time_s[-1])(sent)

    return spoil


def _displaced(across_km: float, up_km: float) -> Callable[[Sent], None]:
    def spoil(sent: Sent) -> None:
        place = sent.track.position_eci_km
        up = place / np.linalg.norm(place, axis=1)[:, None]
        across = np.cross(place[0], place[len(place) // 5])
        across /= np.linalg.norm(across)
        sent.reference_nt[:] = field_eci_nt(place + up_km * up + across_km * across)

    return spoil


def _scaled(by: float) -> Callable[[Sent], None]:
    def spoil(sent: Sent) -> None:
        sent.reference_nt *= 1.0 + by

    return spoil


def _frozen_reference(sent: Sent) -> None:
    late = sent.late(HALF) > 0.0
    sent.reference_nt[late] = sent.reference_nt[late][0]


def _held_reference(sent: Sent) -> None:
    index = np.arange(len(sent.reference_nt))
    sent.reference_nt[:] = sent.reference_nt[index - index % 60]


def _glitches(sent: Sent) -> None:
    at = np.isin(sent.time_s, (40.0, 300.0, 900.0))
    sent.reference_nt[at] += 15_000.0 * _X


def _doubled_reference(sent: Sent) -> None:
    """Two sources of one name take turns, the other one a minute behind in place."""
    index = np.arange(len(sent.reference_nt))
    sent.reference_nt[:] = sent.reference_nt[np.maximum(index - 60 * (index % 2), 0)]


def _rough_reference(sent: Sent) -> None:
    sent.reference_nt += sent.rng.normal(0.0, 100.0, sent.reference_nt.shape)


def _rare_reference(sent: Sent) -> None:
    sent.reference_sent &= np.mod(sent.time_s, 10.0) == 0.0


def _no_reference(sent: Sent) -> None:
    sent.reference_sent &= sent.late(HALF) == 0.0


# Bias, gain and currents


def _field(course: Callable[[Sent], Array], towards: Array = _ONE_SIDE) -> Callable[[Sent], None]:
    """A field fixed in the body that follows a course (n,) [nT]."""

    def spoil(sent: Sent) -> None:
        sent.disturbance_nt += np.outer(course(sent), towards)

    return spoil


def _gained(course: Callable[[Sent], Array], axes: Array = _X) -> Callable[[Sent], None]:
    """A gain that follows a course (n,)."""

    def spoil(sent: Sent) -> None:
        sent.gain += np.outer(course(sent), axes)

    return spoil


def _step(size: float, since: float = HALF) -> Callable[[Sent], Array]:
    return lambda sent: size * sent.late(since)


def _drift(per_hour: float) -> Callable[[Sent], Array]:
    return lambda sent: per_hour * sent.time_s / _HOUR_S


def _wave(size: float, period_s: float = _ORBIT_S) -> Callable[[Sent], Array]:
    return lambda sent: size * np.sin(2.0 * np.pi * sent.time_s / period_s + 0.7)


def _in_light(size: float) -> Callable[[Sent], Array]:
    return lambda sent: size * (np.mod(sent.time_s, _ORBIT_S) < _ORBIT_S - 2100.0)


def _duty(size: float, period_s: float, share: float = 0.5) -> Callable[[Sent], Array]:
    return lambda sent: size * (np.mod(sent.time_s, period_s) < share * period_s)


def _panels(size: float) -> Callable[[Sent], Array]:
    """The current of one panel in sunlight without an eclipse: by the Sun's angle, as the craft turns."""

    def course(sent: Sent) -> Array:
        sun = np.einsum("nij,j->ni", sent.track.body_from_eci, np.array([0.36, 0.8, 0.48]))
        return np.asarray(size * np.maximum(sun[:, 0], 0.0))

    return course


def _warmed(size: float) -> Callable[[Sent], Array]:
    """Follows light with a time constant of 20 minutes, as a box on a cold plate does."""

    def course(sent: Sent) -> Array:
        light, warm = _in_light(1.0)(sent), np.empty(len(sent.time_s))
        level = 0.6
        for index, lit in enumerate(light.tolist()):
            warm[index] = level = level + (lit - level) / 1200.0
        return size * warm

    return course


def _cubic(sent: Sent) -> None:
    sent.post.append(lambda field: np.asarray(field * (1.0 - 4e-12 * field**2)))


def _sheared(sent: Sent) -> None:
    late = sent.late(HALF)[:, None] > 0.0
    shear = np.eye(3) + np.array([[0.0, 0.01, 0.0], [0.01, 0.0, 0.0], [0.0, 0.0, 0.0]])
    sent.post.append(lambda field: np.where(late, field @ shear, field))


SCENARIOS: Final[Mapping[str, Scenario]] = MappingProxyType(
    {
        "clean": Scenario(Group.CLEAN, "as it should be", _nothing, 1.0, promised=True),
        "spikes": Scenario(Group.CLEAN, "1 % of the samples with spikes of 20 uT", _spikes, 1.0, promised=True),
        "rounded": Scenario(Group.CLEAN, "readings in steps of 50 nT", _rounded, 1.0, promised=True),
        "gaps": Scenario(Group.CLEAN, "a fifth of the samples lost", _gaps, 1.0, promised=True),
        "pauses": Scenario(Group.CLEAN, "no samples for 4 of every 25 minutes", _pauses, 1.0, promised=True),
        "heavy_tails": Scenario(
            Group.CLEAN, "noise by a t distribution with 4 degrees of freedom", _heavy, 1.0, promised=True
        ),
        "slow_sensor": Scenario(Group.CLEAN, "a sample every 4 s", _slow_sensor, 1.0, promised=True),
        "rare_reference": Scenario(Group.CLEAN, "a reference every 10 s", _rare_reference, 1.0, promised=True),
        "late_5": Scenario(Group.REFERENCE, "5 s late", _reference_at(-5.0), promised=True),
        "late_10": Scenario(Group.REFERENCE, "10 s late", _reference_at(-10.0), promised=True),
        "late_30": Scenario(Group.REFERENCE, "30 s late", _reference_at(-30.0), promised=True),
        "early_10": Scenario(Group.REFERENCE, "10 s early", _reference_at(10.0), promised=True),
        "lagging": Scenario(Group.REFERENCE, "a clock that falls behind by 20 s over the flight", _lagging(20.0)),
        "across_25": Scenario(Group.REFERENCE, "25 km across the track", _displaced(25.0, 0.0)),
        "across_100": Scenario(Group.REFERENCE, "100 km across the track", _displaced(100.0, 0.0)),
        "above_10": Scenario(Group.REFERENCE, "10 km too high", _displaced(0.0, 10.0)),
        "above_50": Scenario(Group.REFERENCE, "50 km too high", _displaced(0.0, 50.0)),
        "rough_reference": Scenario(Group.REFERENCE, "100 nT of noise on it", _rough_reference),
        "glitches": Scenario(Group.REFERENCE, "three glitches of 15 uT", _glitches),
        "doubled_reference": Scenario(
            Group.REFERENCE, "every other one of where the craft was a minute before", _doubled_reference
        ),
        "held_reference": Scenario(Group.REFERENCE, "each held for a minute", _held_reference),
        "frozen_reference": Scenario(Group.REFERENCE, "repeats from half of the flight on", _frozen_reference, HALF),
        "no_reference": Scenario(Group.REFERENCE, "none from half of the flight on", _no_reference, HALF),
        "scaled_05": Scenario(Group.REFERENCE, "0.5 % too large", _scaled(0.005), 0.0, True),
        "scaled_5": Scenario(Group.REFERENCE, "5 % too large", _scaled(0.05), 0.0, True),
        "step_50": Scenario(Group.BIAS, "a step of 50 nT at half", _field(_step(50.0)), HALF, promised=True),
        "step_200": Scenario(Group.BIAS, "a step of 200 nT at half", _field(_step(200.0)), HALF, promised=True),
        "step_1000": Scenario(Group.BIAS, "a step of 1000 nT at half", _field(_step(1000.0)), HALF),
        "early_step": Scenario(Group.BIAS, "a step of 300 nT after 1/20", _field(_step(300.0, 0.05)), 0.05),
        "drift_15": Scenario(Group.BIAS, "a drift of 15 nT/h", _field(_drift(15.0)), promised=True),
        "drift_100": Scenario(Group.BIAS, "a drift of 100 nT/h", _field(_drift(100.0)), promised=True),
        "drift_500": Scenario(Group.BIAS, "a drift of 500 nT/h", _field(_drift(500.0)), promised=True),
        "orbit_100": Scenario(Group.BIAS, "100 nT with the orbit", _field(_wave(100.0)), promised=True),
        "orbit_500": Scenario(Group.BIAS, "500 nT with the orbit", _field(_wave(500.0))),
        "heat_200": Scenario(
            Group.BIAS, "200 nT of warmth that follows light by 20 min", _field(_warmed(200.0)), promised=True
        ),
        "heat_1000": Scenario(Group.BIAS, "1000 nT of warmth that follows light by 20 min", _field(_warmed(1000.0))),
        "wave_600": Scenario(Group.BIAS, "100 nT with a period of 10 min", _field(_wave(100.0, 600.0))),
        "gain_step_01": Scenario(
            Group.GAIN, "a step of 0.1 % on one axis at half", _gained(_step(1e-3)), HALF, promised=True
        ),
        "gain_step_05": Scenario(Group.GAIN, "a step of 0.5 % on one axis at half", _gained(_step(5e-3)), HALF),
        "gain_step_2": Scenario(Group.GAIN, "a step of 2 % on one axis at half", _gained(_step(0.02)), HALF),
        "gain_all": Scenario(Group.GAIN, "a step of 0.5 % on all at half", _gained(_step(5e-3), np.ones(3)), HALF),
        "gain_orbit": Scenario(Group.GAIN, "0.3 % on one axis with the orbit", _gained(_wave(3e-3))),
        "gain_drift": Scenario(Group.GAIN, "0.2 %/h on one axis", _gained(_drift(2e-3))),
        "gain_heat": Scenario(Group.GAIN, "1 % on all with the orbit", _gained(_wave(0.01), np.ones(3))),
        "shear": Scenario(Group.GAIN, "axes that bend by 0.57 deg at half", _sheared, HALF),
        "cubic": Scenario(Group.GAIN, "a response that is 1 % short at 50 uT", _cubic),
        "light_200": Scenario(
            Group.CURRENT, "200 nT in light, none in eclipse", _field(_in_light(200.0)), promised=True
        ),
        "light_1000": Scenario(Group.CURRENT, "1000 nT in light, none in eclipse", _field(_in_light(1000.0))),
        "panels_200": Scenario(Group.CURRENT, "a panel's 200 nT, no eclipse", _field(_panels(200.0))),
        "payload": Scenario(Group.CURRENT, "300 nT for every other minute", _field(_duty(300.0, 120.0))),
        "passes": Scenario(Group.CURRENT, "400 nT for 10 min of every 90", _field(_duty(400.0, 5400.0, 0.11))),
        "torquer": Scenario(Group.CURRENT, "5 uT for 2 s of every 30", _field(_duty(5000.0, 30.0, 2.0 / 30.0))),
        "swapped": Scenario(Group.SENSOR, "x and y change places at half", turned_axes(np.stack([_Y, _X, _Z])), HALF),
        "flipped": Scenario(Group.SENSOR, "x is turned round at half", turned_axes(np.diag([-1.0, 1.0, 1.0])), HALF),
        "stuck": Scenario(Group.SENSOR, "one vector from half on", stuck([0, 1, 2]), HALF),
        "stuck_axis": Scenario(Group.SENSOR, "z stays from half on", stuck([2]), HALF),
        "dead_axis": Scenario(Group.SENSOR, "z reads 0 from half on", dead, HALF),
        "corrupted": Scenario(Group.SENSOR, "one reading in ten points anywhere", corrupted),
        "clipped": Scenario(Group.SENSOR, "nothing beyond 25 uT", clipped),
        "held_readings": Scenario(Group.SENSOR, "each reading four times", held_readings),
        "clock_ahead": Scenario(Group.SENSOR, "sample times 40 s ahead from half on", clock(40.0), HALF),
        "clock_back": Scenario(Group.SENSOR, "sample times 40 s behind from half on", clock(-40.0), HALF),
        "wrong_sense": Scenario(Group.SETTINGS, "the spin's sense is stated wrongly", spin(-1.0), spinning=True),
        "wrong_rate": Scenario(Group.SETTINGS, "the spin's rate is stated 5 % too high", spin(1.05), spinning=True),
        "wrong_axis": Scenario(Group.SETTINGS, "the spin's axis is stated 3 deg off", other_axis, spinning=True),
        "noise_third": Scenario(Group.SETTINGS, "noise_nt is a third of the noise", noise_misstated(1.0 / 3.0)),
        "noise_thrice": Scenario(Group.SETTINGS, "noise_nt is three times the noise", noise_misstated(3.0)),
    }
)
"""Every scenario, by name."""
