"""What names or answers say, and the numbers contradict: an answer is taken all the same, with the two figures."""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from magcal_service.recordings.describe.draft import Draft, Question
from magcal_service.recordings.describe.field import size_of
from magcal_service.recordings.describe.magnetometer import Magnetometer
from magcal_service.recordings.describe.place import Place

FloatArray = npt.NDArray[np.float64]

_OFF: Final = 5.0  # times the reference or a part of it: no bias or scale of a sensor, and less than units differ by

_MODEL_NT: Final = 5.0
"""Rms from IGRF [nT]: crust, currents and the model's own errors are tens of nT, and a sensor has errors besides."""

_LEAST_ROWS: Final = 20  # choice: fewer may agree by chance


def warn_of_unit(draft: Draft, found: list[Magnetometer], model_nt: FloatArray | None) -> None:
    """Say where the answered unit makes a sensor's field much stronger or weaker than the reference."""
    answer = draft.answers.get("magnetometer.unit")
    expected = draft.reference_nt
    if expected is None and model_nt is not None:
        expected = float(np.nanquantile(model_nt, 0.8))
    for one in found if expected is not None else []:
        size = size_of(one.triple.values)
        if answer is None or not one.answered or size is None or expected is None:
            continue
        amount = size.best * one.unit_nt
        if not expected / _OFF <= amount <= expected * _OFF:
            text = f"{size.shown} is {_text(amount)} nT, where the reference has {_text(expected)} nT"
            draft.said.append(f"warning: by your answer magnetometer.unit={answer} of {one.triple.label} {text}")


def doubt_model(draft: Draft, found: list[Magnetometer], place: Place | None, model_nt: FloatArray | None) -> None:
    """Ask for the sensor's columns where those called a magnetometer hold the field model itself."""
    if model_nt is None or place is None or (place.cartesian_km is None and place.altitude_km is None):
        return
    for one in found:
        length = np.sqrt((one.field_nt**2).sum(axis=1))
        off = (length - model_nt)[np.isfinite(length - model_nt)]
        if len(off) < _LEAST_ROWS or float(np.sqrt(np.mean(off**2))) > _MODEL_NT:
            continue
        rms = _text(float(np.sqrt(np.mean(off**2))))
        says = (
            f"{one.triple.label} have the length of IGRF within {rms} nT: a model's field, for no sensor is so near it"
        )
        if draft.answers.get("magnetometer.columns") is not None:
            draft.said.append(f"warning: by your answer magnetometer.columns: {says}")
            continue
        asks = f"{says}. Which columns did a sensor measure?"
        draft.ask(Question("magnetometer.columns", asks, (), "mx,my,mz"))


def _text(amount_nt: float) -> str:
    return f"{amount_nt:.3g}" if amount_nt < 100.0 else f"{amount_nt:.0f}"
