"""How loose a protection level is where a hazard is there and only just not seen: a flight's largest unseen size.

Each hazard is given to simulated flights by plain arithmetic, none of it the protector's, at sizes that close in on the
largest one of which no vector or estimate is doubtful.  On that flight the level stands beside the error that it guards
against.  A hazard that is not seen at the largest size that is held possible is not just below detection: its level
guards against what physics bounds, and it is told apart.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from magcal_service.config.settings import TrustConfig
from magcal_service.daemon.pipeline import Pipeline
from magcal_service.model import Array
from magcal_service.studies.unseen.flight import Heard, Sent, begin, hear
from magcal_service.studies.unseen.motion import Motion, field_eci_nt
from magcal_service.studies.unseen.score import COVERED_SIGMA
from magcal_service.trust import hazards
from magcal_service.trust.hazard_look import Look
from magcal_service.trust.hazards import Hazard
from magcal_service.wire.messages import Verdict

FLIGHT_S: Final = 9000
"""Of a flight [s]: one and a half orbits, as in the study ``integrity``."""

STEP_S: Final = 3000.0
"""Time of a step [s]: craft that spin or tumble are trusted before, and an orbit is left to see it."""

NOISES_NT: Final = (100.0, 300.0)  # of the figures in docs/integrity.md
MOTIONS: Final = (Motion.SPIN, Motion.TUMBLE)  # one that looks down is hardly ever trusted

NEAR: Final = 0.5
"""Share of the alarm's evidence from which on a hazard is just below detection: its size is 0.7 of what is seen."""

_CLOSE: Final = 1.1
"""Ratio of the smallest size that was seen to the largest that was not at which the search ends."""

_CLOSE_EVIDENCE: Final = 0.85
"""Share of the alarm's evidence at which it ends as well: within 8 % of the size that is seen."""

_MOST_FLIGHTS: Final = 9
"""Flights of one search at most: most need three."""

_OWN_NT: Final = TrustConfig().disturbance_nt
_ORBIT_S: Final = 5740.0  # at 550 km
_SUN_ECI: Final = np.array([0.36, 0.8, 0.48])  # a unit vector, as good as another

Spoil = Callable[[Sent, float], None]


def _late(sent: Sent, size: float) -> None:
    """The reference of where the craft was so long before [s]: shifted by whole seconds, and by a part of one."""
    index = np.arange(len(sent.time_s), dtype=np.float64) - size
    known = np.clip(index, 0.0, None)
    lower = np.minimum(known.astype(int), len(index) - 2)
    share = (known - lower)[:, None]
    sent.reference_nt[:] = (1.0 - share) * sent.reference_nt[lower] + share * sent.reference_nt[lower + 1]
    sent.reference_sent &= index >= 0.0


def _displaced(sent: Sent, size: float) -> None:
    place = sent.track.position_eci_km
    sent.reference_nt[:] = field_eci_nt(place * (1.0 + size / np.linalg.norm(place, axis=1)[:, None]))


def _scaled(sent: Sent, size: float) -> None:
    sent.reference_nt *= 1.0 + size


def _towards(sent: Sent) -> Array:
    vector = sent.rng.standard_normal(3)
    return np.asarray(vector / np.linalg.norm(vector))


def _wave(sent: Sent) -> Array:
    """From 0 to 1 and back with the orbit (n,), its phase drawn."""
    phase = sent.rng.uniform(0.0, 2.0 * math.pi)
    return np.asarray(0.5 + 0.5 * np.sin(2.0 * math.pi * sent.time_s / _ORBIT_S + phase))


def _panel(sent: Sent) -> Array:
    """Of one panel (n,), by the Sun's angle as the craft turns; no eclipse."""
    sun = np.einsum("nij,j->ni", sent.track.body_from_eci, _SUN_ECI)
    return np.maximum(sun[:, 0], 0.0)


def _field(course: Callable[[Sent], Array]) -> Spoil:
    def spoil(sent: Sent, size: float) -> None:
        sent.disturbance_nt += size * np.outer(course(sent), _towards(sent))

    return spoil


def _gain(course: Callable[[Sent], Array], *, one_axis: bool) -> Spoil:
    def spoil(sent: Sent, size: float) -> None:
        axes = np.eye(3)[sent.rng.integers(3)] if one_axis else _towards(sent)
        sent.gain += size * np.outer(course(sent), axes)

    return spoil


def _stepped(sent: Sent) -> Array:
    return np.asarray(sent.time_s >= STEP_S, dtype=np.float64)


def _hours(sent: Sent) -> Array:
    return np.asarray(sent.time_s / 3600.0)


@dataclass(frozen=True, slots=True)
class Given:
    """A hazard as it is given to a flight.

    Parameters
    ----------
    spoil: gives it, of a size.
    unit: of the size.
    largest: that the level has to hold; of a reading where ``of_reading``, relative then.
    first: share of that at which the search begins at 100 nT of noise.
    since_s: from when on it acts [s].
    of_reading: whether ``largest`` is divided by the largest reading.
    """

    spoil: Spoil
    unit: str
    largest: float
    first: float
    since_s: float = 0.0
    of_reading: bool = False


GIVEN: Final = {
    Hazard.REFERENCE_LATE: Given(_late, "s", hazards.LATE_S, 0.005),
    Hazard.REFERENCE_DISPLACED: Given(_displaced, "km", hazards.DISPLACED_KM, 1.0),
    Hazard.REFERENCE_SCALED: Given(_scaled, "", hazards.SCALED, 1.0),
    Hazard.BIAS_STEP: Given(_field(_stepped), "nT", _OWN_NT, 0.2, STEP_S),
    Hazard.BIAS_DRIFT: Given(_field(_hours), "nT/h", hazards.DRIFT_NT_PER_H, 0.02),
    Hazard.ORBIT_BIAS: Given(_field(_wave), "nT", _OWN_NT, 0.2),
    Hazard.ORBIT_GAIN: Given(_gain(_wave, one_axis=False), "", _OWN_NT, 0.3, of_reading=True),
    Hazard.PANEL_CURRENT: Given(_field(_panel), "nT", _OWN_NT, 0.2),
    Hazard.GAIN_STEP: Given(_gain(_stepped, one_axis=True), "", _OWN_NT, 0.3, STEP_S, of_reading=True),
}


@dataclass(frozen=True, slots=True, eq=False)
class Flight:
    """One flight with a hazard of a size.

    Parameters
    ----------
    size: of the hazard.
    doubted_s: when it was first doubtful after the hazard had begun [s]; nan for never: the flight ended there.
    evidence: the protector's, at each vector (n,), in units of the alarm's.
    own_nt: its level for this hazard alone, of a step for one of its age, at each vector (n,) [nT]; NaN while unknown.
    heard: everything else.
    active: vectors that were trusted while the hazard acted (n,).
    """

    size: float
    doubted_s: float
    evidence: Array
    own_nt: Array
    heard: Heard
    active: Any


@dataclass(frozen=True, slots=True)
class Case:
    """Which flights: the hazard, how the craft turns, its noise [nT], and the seed's number."""

    hazard: Hazard
    motion: Motion
    noise_nt: float
    number: int = 0

    def fly(self, size: float) -> Flight:
        """One flight, up to the first doubt."""
        given = GIVEN[self.hazard]
        entropy = (zlib.crc32(self.hazard.encode()), int(self.noise_nt), self.number)
        sent = begin(self.motion, self.noise_nt, FLIGHT_S, np.random.SeedSequence(entropy))
        given.spoil(sent, size)
        evidence: list[float] = []
        own_nt: list[float] = []
        doubted_s, latest = math.nan, None

        def ends(time_s: float, pipeline: Pipeline) -> bool:
            nonlocal doubted_s, latest
            protector = pipeline.monitor.protector
            evidence.append(protector.evidence)
            own_nt.append(own_nt[-1] if own_nt else math.nan)
            if protector.level is not latest:  # a look has been
                latest, look = protector.level, protector.looked()
                own_nt[-1] = math.nan if look is None else self._own_nt(look, time_s)
            if time_s >= given.since_s and pipeline.trust.verdict is Verdict.DOUBTFUL:
                doubted_s = time_s
            return not math.isnan(doubted_s)

        heard = hear(sent, ends)
        active = heard.trusted & (heard.time_s >= given.since_s) & np.isfinite(heard.protection_nt)
        return Flight(size, doubted_s, np.array(evidence), np.array(own_nt), heard, active)

    def _own_nt(self, look: Look, time_s: float) -> float:
        """The level for this hazard alone; of a step for one as old as it is: the larger of the two nearest in age."""
        levels = look.levels.get(self.hazard)
        if levels is None:
            return math.nan
        if not GIVEN[self.hazard].since_s:
            return float(levels.max())
        newer = int(np.count_nonzero(look.ages > time_s - STEP_S))
        both = levels.reshape(len(look.ages), -1)[max(newer - 1, 0) : newer + 1]
        return float(both.max())

    def largest(self) -> float:
        """Size that the level has to hold."""
        given = GIVEN[self.hazard]
        if not given.of_reading:
            return given.largest
        entropy = (zlib.crc32(self.hazard.encode()), int(self.noise_nt), self.number)
        sent = begin(self.motion, self.noise_nt, FLIGHT_S, np.random.SeedSequence(entropy))
        return given.largest / float(np.linalg.norm(sent.readings(np.zeros_like(sent.noise)), axis=1).max())


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """What a search has found.

    Parameters
    ----------
    case: of which.
    largest: size that is held possible.
    unseen: the flight with the largest size that was not seen.
    seen_size: the smallest that was seen; nan where the largest possible one was not.
    flights: how many were flown.
    """

    case: Case
    largest: float
    unseen: Flight
    seen_size: float
    flights: int

    @property
    def bounded(self) -> bool:
        """Whether the hazard is as large as is held possible, and still not seen."""
        return math.isnan(self.seen_size)

    def ratios(self, *, near: bool = False, own: bool = False) -> Array:
        """Level over error while trusted (m,).

        Parameters
        ----------
        near: only while the evidence is just below the alarm's.
        own: the level for this hazard alone, instead of the one for all.
        """
        heard = self.unseen.heard
        rows = self.unseen.active & (heard.error_nt > 0.0)
        if near:
            rows &= self.unseen.evidence >= NEAR
        return np.asarray((self.unseen.own_nt if own else heard.protection_nt)[rows] / heard.error_nt[rows])


def search(case: Case) -> Found | None:
    """The largest size that no vector and no estimate is doubtful at; None where each size was seen."""
    largest = case.largest()
    unseen: Flight | None = None
    seen_size, size = math.nan, min(largest, largest * GIVEN[case.hazard].first * case.noise_nt / 100.0)
    for flown in range(1, _MOST_FLIGHTS + 1):
        flight = case.fly(size)
        if math.isnan(flight.doubted_s):
            unseen = flight
        else:
            seen_size = size
        if unseen is None:
            size /= 4.0
            continue
        most = float(unseen.evidence.max())
        if unseen.size == largest or unseen.size * _CLOSE >= seen_size or _CLOSE_EVIDENCE <= most < 1.0:
            return Found(case, largest, unseen, seen_size, flown)
        size = unseen.size * 0.97 / math.sqrt(max(most, 1e-2))  # evidence goes with the square of the size
        if flight is not unseen or not size > unseen.size:
            size = math.sqrt(unseen.size * seen_size)
        if not math.isnan(seen_size):
            size = min(max(size, unseen.size * math.sqrt(_CLOSE)), seen_size / math.sqrt(_CLOSE))
        size = min(size, largest)
    return None if unseen is None else Found(case, largest, unseen, seen_size, _MOST_FLIGHTS)


Row = dict[str, Any]


def row_of(found: Found) -> Row:
    """A search's figures: sizes, and medians over the trusted time of the flight with the largest unseen size."""
    case, flight = found.case, found.unseen
    heard, active = flight.heard, flight.active

    def middle(values: Array) -> float | None:
        return float(np.median(values)) if len(values) else None

    return {
        "hazard": str(case.hazard),
        "motion": str(case.motion),
        "noise_nt": case.noise_nt,
        "unit": GIVEN[case.hazard].unit,
        "largest": found.largest,
        "unseen": flight.size,
        "bounded": found.bounded and flight.size == found.largest,
        "evidence": float(flight.evidence.max()),
        "trusted_s": int(active.sum()),
        "beyond_s": int((active & (heard.error_nt > heard.protection_nt + COVERED_SIGMA * heard.sigma_nt)).sum()),
        "error_nt": middle(heard.error_nt[active]),
        "level_nt": middle(heard.protection_nt[active]),
        "own_nt": middle(flight.own_nt[active]),
        "ratio": middle(found.ratios()),
        "own_ratio": middle(found.ratios(own=True)),
        "near_s": len(found.ratios(near=True)),
        "near_ratio": middle(found.ratios(near=True)),
        "near_own_ratio": middle(found.ratios(near=True, own=True)),
    }


def medians(rows: list[Row]) -> dict[str, float | int | None]:
    """Over the medians of all flights whose hazard could be seen, were it larger."""
    seen = [row for row in rows if not row["bounded"]]
    figures: dict[str, float | int | None] = {"searches": len(rows), "limited by detection": len(seen)}
    for name, key in OVER_ALL.items():
        known = [row[key] for row in seen if row[key] is not None]
        figures[name] = float(np.median(known)) if known else None
    return figures


OVER_ALL: Final = {
    "level over error": "ratio",
    "level over error, just below the alarm": "near_ratio",
    "level for this hazard over error": "own_ratio",
    "level for this hazard over error, just below the alarm": "near_own_ratio",
}


def new_step_row(motion: Motion, noise_nt: float, flights: int) -> Row:
    """A bias step of ``disturbance_nt``, which the published level always holds: from its second to the first doubt.

    Medians over the flights' medians; flights that were not trusted then are in none.
    """
    ratios, unseen_s, beyond_s = [], [], 0
    for number in range(flights):
        flight = Case(Hazard.BIAS_STEP, motion, noise_nt, number).fly(_OWN_NT)
        heard, rows = flight.heard, flight.active
        if not rows.any():
            continue
        ratios.append(float(np.median(heard.protection_nt[rows] / heard.error_nt[rows])))
        unseen_s.append(int(rows.sum()))
        beyond_s += int((rows & (heard.error_nt > heard.protection_nt + COVERED_SIGMA * heard.sigma_nt)).sum())
    return {
        "motion": str(motion),
        "noise_nt": noise_nt,
        "flights": len(ratios),
        "unseen_s": float(np.median(unseen_s)) if unseen_s else None,
        "ratio": float(np.median(ratios)) if ratios else None,
        "largest_ratio": max(ratios, default=None),
        "beyond_s": beyond_s,
    }


def cases(names: list[str]) -> list[Case]:
    """Every hazard, or those named, in all motions and noises in which it is looked for."""
    return [
        Case(hazard, motion, noise_nt)
        for noise_nt in NOISES_NT
        for hazard in GIVEN
        for motion in MOTIONS
        if (not names or hazard in names) and (hazard is not Hazard.PANEL_CURRENT or motion is Motion.SPIN)
    ]
