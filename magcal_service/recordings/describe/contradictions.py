"""An answer is taken even where the numbers contradict it; then the two figures are said."""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from magcal_service.base.units import FIELD_NT, FieldUnit
from magcal_service.recordings.describe.draft import Draft
from magcal_service.recordings.describe.field import size_of
from magcal_service.recordings.describe.magnetometer import Magnetometer

_OFF: Final = 5.0  # times the reference or a part of it: no bias or scale of a sensor, and less than units differ by


def warn_of_unit(draft: Draft, found: list[Magnetometer], model_nt: npt.NDArray[np.float64] | None) -> None:
    """Say where the answered unit makes a sensor's field much stronger or weaker than the reference."""
    answer = draft.answers.get("magnetometer.unit")
    expected = draft.reference_nt
    if expected is None and model_nt is not None:
        expected = float(np.nanquantile(model_nt, 0.8))
    for one in found if expected is not None else []:
        size = size_of(one.triple.values)
        if one.unit != answer or size is None or expected is None:
            continue
        amount = size.best * FIELD_NT[FieldUnit(answer)]
        if not expected / _OFF <= amount <= expected * _OFF:
            shown = "the radius of their sphere" if size.radius is not None else "most"
            text = f"{shown} is {_text(amount)} nT, where the reference has {_text(expected)} nT"
            draft.said.append(f"warning: by your answer magnetometer.unit={answer} of {one.triple.label} {text}")


def _text(amount_nt: float) -> str:
    return f"{amount_nt:.3g}" if amount_nt < 100.0 else f"{amount_nt:.0f}"
