"""Latitude and longitude exchanged: what the field says of it, where a place within both ranges does not tell."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np
import numpy.typing as npt

from magcal_service.recordings.describe.draft import Draft, Question
from magcal_service.recordings.describe.expected import expected_nt
from magcal_service.recordings.describe.field import differs_from_model, scale_by_model, size_of
from magcal_service.recordings.describe.magnetometer import Magnetometer
from magcal_service.recordings.describe.over_ground import POLE_DEG
from magcal_service.recordings.describe.place import Place
from magcal_service.recordings.describe.times_found import Times

FloatArray = npt.NDArray[np.float64]

_STATED: Final = (0.03, 0.08)
"""Of the field, by a reference: as near the exchanged place's model has to be, and as far the given one's. IGRF is
within 1 % nearly everywhere."""

_MEASURED: Final = (0.08, 0.2)
"""The same by the radius of a turned sensor's sphere, whose scale is mostly within 5 %."""


def doubt_order(draft: Draft, times: Times | None, place: Place | None, found: list[Magnetometer]) -> None:
    """Ask which is the latitude where the field is that of the place with both exchanged, and not the given one's."""
    key = "position.columns"
    if place is None or place.latitude_deg is None or place.longitude_deg is None or not found:
        return
    asked = draft.answers.get(key) is not None or any(one.key == key for one in draft.questions)
    if asked or float(np.nanmax(np.abs(place.longitude_deg))) > POLE_DEG:
        return
    exchanged = replace(place, latitude_deg=place.longitude_deg, longitude_deg=place.latitude_deg)
    given_nt, exchanged_nt = expected_nt(times, place), expected_nt(times, exchanged)
    if given_nt is None or exchanged_nt is None:
        return
    why = _along_the_way(found[0].field_nt, given_nt, exchanged_nt) or _by_strength(
        draft, found[0], given_nt, exchanged_nt
    )
    if not why:
        return
    latitude, longitude = (draft.log.columns[number - 1] for number in place.columns[:2])
    asks = f"are {latitude.label}, {longitude.label} latitude and longitude as they are called? {why}"
    as_called, other = ",".join(draft.names((latitude, longitude))), ",".join(draft.names((longitude, latitude)))
    candidates = ((other, "the same two the other way round"), (as_called, "as they are called"))
    draft.ask(Question(key, asks, candidates, other))


def _along_the_way(field_nt: FloatArray | None, given_nt: FloatArray, exchanged_nt: FloatArray) -> str:
    """Whether the measured length follows the model of the exchanged place, and not that of the given one."""
    if field_nt is None or not differs_from_model(field_nt, given_nt) or scale_by_model(field_nt, exchanged_nt) is None:
        return ""
    return "the measured length follows IGRF along the way only the other way round"


def _by_strength(draft: Draft, one: Magnetometer, given_nt: FloatArray, exchanged_nt: FloatArray) -> str:
    """Whether the reference, or else the turned sensor, has the strength of the exchanged place and not the given."""
    given, exchanged = (float(np.nanquantile(model, 0.8)) for model in (given_nt, exchanged_nt))
    size = None if one.field_nt is None else size_of(one.field_nt)
    if draft.reference_nt is not None:
        what, strength, (near, far) = "the reference has", draft.reference_nt, _STATED
    elif size is not None and size.radius is not None:
        what, strength, (near, far) = "the turned sensor's sphere is of", size.radius, _MEASURED
    else:
        return ""
    if abs(exchanged / strength - 1.0) > near or abs(given / strength - 1.0) < far:
        return ""
    models = f"IGRF has {given / 1e3:.3g} uT there and {exchanged / 1e3:.3g} uT the other way round"
    return f"{what} {strength / 1e3:.3g} uT; {models}"
