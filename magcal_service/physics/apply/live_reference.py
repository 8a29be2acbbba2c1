"""A reference as the model corrects it: brought to the time that it is of, and to the magnitude that acts."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from magcal_service.earth import geomagnetic
from magcal_service.model import Array
from magcal_service.physics.apply.empirical import NAME, Empirical
from magcal_service.physics.apply.forward import DriverMissingError, MisfitError, bind
from magcal_service.physics.apply.live_curves import added_now, name_of
from magcal_service.physics.apply.live_drivers import Held
from magcal_service.physics.apply.model_file import ModelTerm
from magcal_service.physics.catalogue import effect_named
from magcal_service.physics.scene.scene import Scene
from magcal_service.wire.messages import Clock, Frame, ReferenceSample

KNOT_S: Final = 10.0
"""Time between the places that give the direction of flight, and age up to which a reference vector is used [s].

In a low orbit the path bends by 0.6 degrees in 10 s, and H turns by at most 1.3.
"""

GROWTH_NS: Final = 1_000_000_000
"""How long a computed growth of the reference is held [ns]: the length of a tick; each takes a scene."""

_MOST_GROWTH: Final = 0.5
"""Share of the magnitude by which a reference may be wrong."""

_MOST_SHIFT_S: Final = 3600.0
"""By how much time tags may disagree [s]."""

Track = Callable[[list[int]], NDArray[np.float64] | None]
"""Positions (n, 3), Earth-fixed [km], at times [ns]; None where there are none."""


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


def magnitude_of(sample: ReferenceSample) -> float:
    """|H| of a reference [nT]."""
    return sample.magnitude_nt or 0.0 if sample.field_nt is None else float(np.linalg.norm(np.array(sample.field_nt)))


def grown(sample: ReferenceSample, growth_nt: float) -> ReferenceSample:
    """The reference with its magnitude larger by so much [nT], its direction kept."""
    magnitude = magnitude_of(sample)
    factor = 1.0 + growth_nt / max(magnitude, 1.0)
    if sample.field_nt is None:
        return replace(sample, magnitude_nt=magnitude * factor)
    x, y, z = (np.array(sample.field_nt) * factor).tolist()
    return replace(sample, field_nt=(x, y, z))


def growth_of(
    terms: Sequence[ModelTerm],
    curves: Sequence[Empirical],
    channels: Mapping[str, Held],
    sample: ReferenceSample,
    track: Track,
    origin_ns: int,
) -> tuple[float, list[str]]:
    """Growth of the magnitude by a model's terms and curves [nT], and the names of what is left out.

    Left out is what needs the orbit ahead, what has no driver and what is absurdly large.

    Parameters
    ----------
    terms, curves: those that act on the reference.
    channels: the newest values.
    sample: the reference.
    track: where the craft was.
    origin_ns: the model's.
    """
    scene = _scene(sample, track, origin_ns)
    magnitude = magnitude_of(sample)
    total, missing = 0.0, []
    for term in terms:
        try:
            if {term.driver, term.variant} & set(effect_named(term.effect).not_live):
                raise DriverMissingError(f"{term.effect}, {term.variant}: needs the orbit ahead")
            with np.errstate(all="ignore"):
                growth = float(np.broadcast_to(bind(term, scene).disturbance()[1], 3)[-1])
            total = _more(term.effect, total, growth, magnitude)
        except (DriverMissingError, MisfitError):
            missing.append(term.effect)
    for curve in curves:
        try:
            _, growth = added_now(curve, channels, scene, sample.time_ns, np.zeros(3))
            total = _more(NAME, total, growth, magnitude)
        except (DriverMissingError, MisfitError) as error:
            missing.append(name_of(error))
    return total, missing


def _more(name: str, total: float, growth: float, magnitude: float) -> float:
    """The sum [nT]; MisfitError where the reference would grow absurdly."""
    if not abs(total + growth) <= _MOST_GROWTH * magnitude:
        raise MisfitError(f"{name}: the reference would grow by {growth:g} nT")
    return total + growth


def _scene(sample: ReferenceSample, track: Track, origin_ns: int) -> Scene:
    """The reference with two earlier places, for the direction of flight."""
    times_ns = [sample.time_ns - round(k * KNOT_S * 1e9) for k in (2, 1, 0)]
    magnitude = magnitude_of(sample)
    along = np.tile([magnitude, 0.0, 0.0], (3, 1))
    return Scene(
        time_s=np.array([(time_ns - origin_ns) * 1e-9 for time_ns in times_ns]),
        origin_ns=origin_ns,
        utc=sample.clock is Clock.UTC,
        field_nt=along,
        calibrated_nt=along,
        clean_field_nt=along,
        magnitude_nt=np.full(3, magnitude),
        reference_eci_nt=_inertial(sample, times_ns),
        position_ecef_km=track(times_ns),
    )


def _inertial(sample: ReferenceSample, times_ns: list[int]) -> Array | None:
    """The reference's vector in space at the times (n, 3) [nT]; None where it cannot be known."""
    if sample.field_nt is None:
        return None
    held = np.tile(np.array(sample.field_nt), (len(times_ns), 1))
    if sample.frame is Frame.ECI:
        return held
    if sample.frame is Frame.ECEF and sample.clock is Clock.UTC:
        return geomagnetic.eci_from_ecef(np.array(times_ns), held)
    return None
