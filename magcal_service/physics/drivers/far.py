"""A reference that is off by minutes of the orbit: stale elements, or a clock that was not set.

To first order only the next minute is known; so the field is computed along the recording's track, shifted by
each of a series of steps.  The track continues beyond its ends along a circle in space.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from magcal_service.earth import geomagnetic
from magcal_service.model import Array
from magcal_service.physics.columns import Columns
from magcal_service.physics.interface import Block, Hypothesis, Nonlinear
from magcal_service.physics.scene.scene import Scene

STEP_S: Final = 60.0
"""Between shifts for which the field is computed [s]: 3.8 degrees of a low orbit; cubic curves follow |H| so far."""

_KNOT_S: Final = 30.0  # between rows for which the field is computed; taken as linear between them it is 10 nT off
FARTHEST_S: Final = 1200.0
"""Largest shift that is tried [s].

Choice: more than twice what the station's places were behind (442 to 510 s by element sets, docs/recordings.md);
further, a part of the orbit resembles another and the table grows.
"""

GROWTHS_S_PER_H: Final = np.array([-6.0, -3.0, 0.0, 3.0, 6.0])
LARGEST_NT: Final = 30000.0
"""rms that a whole shift may have [nT]: the difference between any two places of a low orbit."""

SHORTEST_S: Final = 3000.0
"""Half an orbit, below which a shift along it is a slope and a curve, no distinct shape."""

LONGEST_GAP_S: Final = 300.0
"""Over which a track may be taken as straight between two places, its height put right."""

NEAR_S: Final = 120.0
"""Largest shift that a course expanded to second order follows [s]: the third takes 3 % of it there, in low orbit."""

_ARC_S: Final = 120.0  # between the two places that give the track's continuation
_SHIFTS_S: Final = np.arange(-FARTHEST_S - 2.0 * STEP_S, FARTHEST_S + 2.5 * STEP_S, STEP_S)


def within(moved_s: Array) -> Array:
    """Shifts (n,) [s] no larger than an expansion of the course follows."""
    return np.clip(moved_s, -NEAR_S, NEAR_S)


def shifted(scene: Scene, effect: str, variant: str, names: tuple[str, str], with_earth: bool) -> list[Hypothesis]:
    """The effect's form for a large shift; none where place, time or length of the recording do not allow it.

    Parameters
    ----------
    names: of the shift [s] and of its growth [s/h].
    with_earth: whether the Earth turns on meanwhile, as it does for a clock, or not, as for a place along the orbit.
    """
    if not scene.has_model or scene.position_eci_km is None or len(scene) < 200:
        return []
    if float(scene.time_s[-1] - scene.time_s[0]) < SHORTEST_S or float(np.diff(scene.time_s).max()) > LONGEST_GAP_S:
        return []
    later = np.arange(STEP_S, FARTHEST_S + 1.0, STEP_S)
    shift = Nonlinear(names[0], "s", np.concatenate([-later[::-1], later]))
    growth = Nonlinear(names[1], "s/h", GROWTHS_S_PER_H, spans=True)

    def columns(theta: Array) -> Columns:
        knots, table = scene.once(f"shifted {with_earth}", lambda: _table(scene, with_earth))
        times = scene.time_s[knots]
        shift_s = float(theta[0]) + float(theta[1]) * times / 3600.0
        change = np.interp(scene.time_s, times, _between(table, shift_s))
        return Columns(magnitude=change[None])

    block = Block("share", "1", ())
    return [
        Hypothesis(
            effect,
            "none",
            columns,
            (block,),
            variant,
            (shift, growth),
            odds=2.0,
            largest_nt=LARGEST_NT,
            least_nt=STEP_S * float(np.sqrt(np.mean(scene.magnitude_slope**2))),
            is_whole=True,
        )
    ]


def _table(scene: Scene, with_earth: bool) -> tuple[NDArray[np.intp], Array]:
    """Rows (k,) some time apart, and the growth (shifts, k) of |H| [nT] there for every shift."""
    inertial = scene.position_eci_km
    assert inertial is not None
    bins = np.floor(scene.time_s / _KNOT_S)
    knots = np.unique(np.append(np.flatnonzero(np.diff(bins, prepend=bins[0] - 1.0)), len(scene) - 1))
    times_ns = scene.time_ns[knots]

    places, turned_ns = [], []
    for shift_s in _SHIFTS_S.tolist():
        places.append(_ahead(scene, inertial, scene.time_s[knots] + shift_s))
        turned_ns.append(times_ns + round(shift_s * 1e9) if with_earth else times_ns)
    ecef = geomagnetic.ecef_from_eci(np.concatenate(turned_ns), np.concatenate(places))
    field = geomagnetic.igrf_ecef_nt(np.tile(times_ns, len(_SHIFTS_S)), ecef)  # one call: each reads the coefficients
    magnitude = np.linalg.norm(field, axis=1).reshape(len(_SHIFTS_S), -1)
    return knots.astype(np.intp), magnitude - magnitude[len(_SHIFTS_S) // 2]


def _ahead(scene: Scene, inertial: NDArray[np.float64], times_s: Array) -> NDArray[np.float64]:
    """Places (k, 3) [km] in space at times (k,); beyond the recording on the circle that it ends, or begins, on."""
    inside = np.clip(times_s, scene.time_s[0], scene.time_s[-1])
    place = np.stack([np.interp(inside, scene.time_s, column) for column in inertial.T], axis=1)
    for end, row in ((scene.time_s[0], 0), (scene.time_s[-1], len(scene) - 1)):
        beyond = times_s < end if row == 0 else times_s > end
        other = int(np.argmin(np.abs(scene.time_s - (end + (_ARC_S if row == 0 else -_ARC_S)))))
        place[beyond] = _on_circle(
            inertial[other], inertial[row], (times_s[beyond] - end) / (end - scene.time_s[other])
        )
    radius, known = np.linalg.norm(place, axis=1), np.linalg.norm(inertial, axis=1)
    return np.asarray(place * (np.clip(radius, known.min(), known.max()) / radius)[:, None])


def _on_circle(before: Array, at: Array, further: Array) -> NDArray[np.float64]:
    """Places (k, 3) as much ``further`` (k,) along the circle from one place (3,) to another, from the latter on."""
    first = at / np.linalg.norm(at)
    normal = np.cross(before, at)
    size = float(np.linalg.norm(normal))
    across = np.cross(normal / max(size, 1e-12), first)
    angle = math.atan2(size, float(before @ at)) * further
    radius = float(np.linalg.norm(at))
    return np.asarray(radius * (np.cos(angle)[:, None] * first + np.sin(angle)[:, None] * across))


def _between(table: Array, shift_s: Array) -> Array:
    """Values (k,) of a table (shifts, k) at a shift (k,) each, by cubic curves through four (Catmull-Rom)."""
    place = np.clip((shift_s - _SHIFTS_S[0]) / STEP_S, 1.0, len(_SHIFTS_S) - 2.001)
    left = place.astype(np.intp)
    x, column = place - left, np.arange(table.shape[1])
    p0, p1, p2, p3 = (table[left + k, column] for k in (-1, 0, 1, 2))
    curve = 2.0 * p1 + x * (p2 - p0 + x * (2.0 * p0 - 5.0 * p1 + 4.0 * p2 - p3 + x * (3.0 * (p1 - p2) + p3 - p0)))
    return np.asarray(0.5 * curve)
