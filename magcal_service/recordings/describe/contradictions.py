"""What names or answers say, and the numbers contradict: an answer is taken all the same, with the two figures, but
for a unit by which the field would be hundreds of times the Earth's, or a part of it."""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from magcal_service.base.errors import Fault, InputRefusedError
from magcal_service.base.units import FIELD_NT, FieldUnit
from magcal_service.recordings.describe.draft import Draft, Question
from magcal_service.recordings.describe.field import EARTH_NT, size_of
from magcal_service.recordings.describe.magnetometer import Magnetometer
from magcal_service.recordings.describe.place import Place
from magcal_service.wire.kinds import MAX_SAMPLE_FIELD_NT

FloatArray = npt.NDArray[np.float64]

_OFF: Final = 5.0  # times the reference or a part of it: no bias or scale of a sensor, and less than units differ by

_ABSURD: Final = 100.0
"""Times the reference or a part of it: more than magnets near a sensor do (20), less than units differ by (1000)."""

_MODEL_NT: Final = 5.0
"""Rms from IGRF [nT]: crust, currents and the model's own errors are tens of nT, and a sensor has errors besides."""

_LEAST_ROWS: Final = 20  # choice: fewer may agree by chance


def warn_of_unit(draft: Draft, found: list[Magnetometer], model_nt: FloatArray | None) -> None:
    """Say where the answered unit makes a sensor's field much stronger or weaker than the reference.

    Raises ``InputRefusedError`` where it makes it absurd, so that no row could be used.
    """
    answer = draft.answers.get("magnetometer.unit")
    expected = draft.reference_nt
    if expected is None and model_nt is not None:
        expected = float(np.nanquantile(model_nt, 0.8))
    for one in found:
        size = size_of(one.triple.values)
        if answer is None or not one.answered or size is None:
            continue
        amount = size.best * one.unit_nt
        refuse_absurd("magnetometer.unit", answer, size.of(one.triple.label), size.best, amount, expected)
        if expected is not None and not expected / _OFF <= amount <= expected * _OFF:
            text = f"{size.shown} is {_text(amount)} nT, where the reference has {_text(expected)} nT"
            draft.said.append(f"warning: by your answer magnetometer.unit={answer} of {one.triple.label} {text}")


def refuse_absurd(
    key: str, answer: object, what: str, number: float, amount_nt: float, expected_nt: float | None = None
) -> None:
    """Raise ``InputRefusedError`` where an answered unit makes a field that none near the Earth is.

    Parameters
    ----------
    what: of which numbers, in words; ``number`` is their size as it stands in the log.
    amount_nt: the same by the answer [nT].
    expected_nt: of the reference; None where nobody knows it: what lies near the Earth's is then expected.
    """
    low, high = EARTH_NT if expected_nt is None else (expected_nt, expected_nt)
    if low / _ABSURD <= amount_nt <= min(high * _ABSURD, MAX_SAMPLE_FIELD_NT):
        return
    off = 1.0 if expected_nt is None else _OFF
    near = [str(unit) for unit in FieldUnit if low / off <= number * FIELD_NT[unit] <= high * off]
    usual = "18 to 75 uT are usual near the Earth" if expected_nt is None else f"{_shown(expected_nt)} are expected"
    likely = f"; by the numbers {' or '.join(near)} is likelier" if near else ""
    accepted = (
        f"{what} would be {_shown(amount_nt)}, where {usual}{likely}; of counts give the size of one, as '0.1 uT'"
    )
    raise InputRefusedError([Fault(f"--answer {key}", str(answer), accepted)])


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


def _shown(amount_nt: float) -> str:
    """A field in the unit that keeps its number short."""
    size, unit = next((pair for pair in ((1e9, "T"), (1e6, "mT"), (1e3, "uT")) if amount_nt >= pair[0]), (1.0, "nT"))
    return f"{amount_nt / size:.3g} {unit}"
