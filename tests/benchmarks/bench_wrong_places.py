"""Is a craft trusted whose reference is of wrong places?  ``python -m tests.benchmarks.bench_wrong_places [SEEDS]``.

Flights of a spinning and a tumbling craft (one that points at the Earth is hardly ever trusted, wrong or right) through
the daemon's own pipeline, at 100 nT of noise and for one and a half orbits, with positions that were written or read
wrongly, one every 5 s, of which the pipeline makes the reference; a model of another year is sent as a field.  For each
mistake: how far |H| is off, how many flights were ever trusted, and in how many of them a vector was, while trusted,
further off than its protection level.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from magcal_service.config.settings import ReferenceConfig, ReferenceModel
from magcal_service.earth.geomagnetic import (
    ecef_from_eci,
    ecef_from_geocentric,
    ecef_from_geodetic,
    eci_from_ecef,
    geodetic_from_ecef,
    igrf_ecef_nt,
)
from magcal_service.model import Array
from magcal_service.studies.unseen.flight import Sent, begin, hear
from magcal_service.studies.unseen.motion import Motion

NOISE_NT = 100.0
DURATION_S = 8_600  # one and a half orbits at 550 km
EVERY_S = 5  # of the positions; 10 s are the most that the shipped configuration allows
MOTIONS = (Motion.SPIN, Motion.TUMBLE)
HOUR_NS, YEAR_NS = 3_600_000_000_000, 31_557_600_000_000_000

Mistake = Callable[[Array, Array], Array]
"""From times (n,) [ns] and places (n, 3) ECEF [km], the positions (n, 3) ECEF [km] that are sent; NaN for none."""


def _right(time_ns: Array, ecef_km: Array) -> Array:
    return ecef_km


def _geodetic(change: Callable[[Array, Array, Array], Array]) -> Mistake:
    """Places made of latitude, longitude and height anew, wrongly."""
    return lambda time_ns, ecef_km: change(*geodetic_from_ecef(ecef_km))


def _exchanged(time_ns: Array, ecef_km: Array) -> Array:
    """Where the longitude can be no latitude, the row is refused and there is no position."""
    latitude, longitude, height = geodetic_from_ecef(ecef_km)
    places = np.full(ecef_km.shape, np.nan)
    can = np.abs(longitude) <= 90.0
    places[can] = ecef_from_geodetic(longitude[can], latitude[can], height[can])
    return places


def _late(shift_ns: int) -> Mistake:
    """Inertial places with a date that is off: the Earth has turned further."""
    return lambda time_ns, ecef_km: ecef_from_eci(time_ns + shift_ns, eci_from_ecef(time_ns, ecef_km))


MISTAKES: dict[str, Mistake] = {
    "none": _right,
    "longitude with the other sign": _geodetic(lambda lat, lon, height: ecef_from_geodetic(lat, -lon, height)),
    "latitude with the other sign": _geodetic(lambda lat, lon, height: ecef_from_geodetic(-lat, lon, height)),
    "latitude and longitude exchanged": _exchanged,
    "height in km read as m": _geodetic(lambda lat, lon, height: ecef_from_geodetic(lat, lon, height * 1e-3)),
    "height in km read as miles": _geodetic(lambda lat, lon, height: ecef_from_geodetic(lat, lon, height * 1.609344)),
    "geocentric latitude read as geodetic": lambda time_ns, ecef_km: ecef_from_geodetic(
        np.degrees(np.arcsin(ecef_km[:, 2] / np.linalg.norm(ecef_km, axis=1))), *geodetic_from_ecef(ecef_km)[1:]
    ),
    "geodetic latitude read as geocentric": lambda time_ns, ecef_km: ecef_from_geocentric(
        *geodetic_from_ecef(ecef_km)[:2], np.linalg.norm(ecef_km, axis=1)
    ),
    "inertial places read as Earth-fixed": eci_from_ecef,
    "inertial places, three hours off": _late(3 * HOUR_NS),
    "inertial places, a day off": _late(24 * HOUR_NS),
    "model of a year before": _right,
    "model of ten years before": _right,
    "model of a hundred years before": _right,
}

EPOCHS_NS = {
    "model of a year before": -YEAR_NS,
    "model of ten years before": -10 * YEAR_NS,
    "model of a hundred years before": -100 * YEAR_NS,
}
"""Of the model whose field is sent in place of positions [ns from the flight's time]."""


@dataclass(frozen=True)
class Flown:
    """What became of one flight: |H| off by so much rms [nT], ever trusted, and beyond its level while it was."""

    off_nt: float
    trusted: bool
    at_end: bool
    beyond: bool
    worst_nt: float


def fly(mistake: str, motion: Motion, seed: int, duration_s: int = DURATION_S) -> Flown:
    """One flight; the same way, errors and noise for the same seed."""
    sent = begin(motion, NOISE_NT, duration_s, np.random.SeedSequence(seed))
    off_nt = spoil(sent, mistake)
    heard = hear(sent)
    known = heard.trusted & np.isfinite(heard.protection_nt)
    beyond = known & (heard.error_nt > heard.protection_nt)
    worst = float(heard.error_nt[heard.trusted].max(initial=0.0))
    return Flown(off_nt, bool(heard.trusted.any()), bool(heard.trusted[-1:].any()), bool(beyond.any()), worst)


def spoil(sent: Sent, mistake: str) -> float:
    """Send what a mistake makes of the places; how far |H| is off, rms [nT]."""
    time_ns = sent.track.time_ns
    right = np.linalg.norm(sent.reference_nt, axis=1)
    places = MISTAKES[mistake](time_ns, ecef_from_eci(time_ns, sent.track.position_eci_km))
    known = np.isfinite(places).all(axis=1)
    field = igrf_ecef_nt(time_ns[known] + EPOCHS_NS.get(mistake, 0), places[known])
    sent.reference_sent &= known
    if mistake in EPOCHS_NS:
        sent.reference_nt[known] = eci_from_ecef(time_ns[known], field)
    else:
        sent.reference_sent[np.arange(len(time_ns)) % EVERY_S != 0] = False
        sent.places_ecef_km = places
        sent.config = replace(sent.config, reference=ReferenceConfig(ReferenceModel.IGRF))
    off = np.linalg.norm(field, axis=1) - right[known]
    return math.sqrt(float(np.mean(off**2)))


def main(seeds: int = 3) -> None:
    """Print the table."""
    print(f"{'mistake':38} {'|H| off':>9} {'flights':>8} {'trusted':>8} {'at end':>7} {'beyond':>7} {'worst':>9}")
    total = [0, 0, 0]
    for name in MISTAKES:
        flown = [fly(name, motion, seed) for motion in MOTIONS for seed in range(seeds)]
        trusted, beyond = sum(one.trusted for one in flown), sum(one.beyond for one in flown)
        off, worst = np.mean([one.off_nt for one in flown]), max(one.worst_nt for one in flown)
        at_end = sum(one.at_end for one in flown)
        print(
            f"{name:38} {off:6.0f} nT {len(flown):8} {trusted:8} {at_end:7} {beyond:7} {worst:6.0f} nT",
            flush=True,
        )
        if name != "none":
            total = [total[0] + len(flown), total[1] + trusted, total[2] + beyond]
    print(f"wrong: {total[0]} flights, {total[1]} ever trusted, {total[2]} trusted beyond their protection level")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
