"""Betaflight's command line: ``set mag_calibration = X,Y,Z``, offsets in counts of the sensor, subtracted.

Scale and non-orthogonality have no place there, so what they would have corrected is told.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from magcal_service.base.errors import Fault, InputRefusedError
from magcal_service.offline.exports.form import Exported, Form, Wanted, about, refuse_beyond
from magcal_service.offline.given import Given

_EARTH_NT: Final = 50_000.0
"""A middling field of the Earth: where what is left out is told [nT]."""

_MOST_LEFT_NT: Final = 500.0
"""1 % of it, half a degree of heading: more left out is said as not to be trusted [nT]."""

_LARGEST: Final = 32_767  # counts: the setting holds 16 bits


def _make(given: Given, wanted: Wanted) -> Exported:
    if wanted.lsb_nt is None:
        accepted = "its offsets are in counts: give the nT of one count, such as --lsb-nt 150 for 0.15 uT"
        raise InputRefusedError([Fault("--format", "betaflight without --lsb-nt", accepted)])
    counts = np.rint(given.offset_nt / wanted.lsb_nt).astype(int).tolist()
    for axis, value in zip("XYZ", counts, strict=True):
        refuse_beyond("Betaflight", f"mag_calibration {axis}", value, -_LARGEST, _LARGEST, "counts")
    eigenvalues = np.linalg.eigvalsh(given.matrix)
    left_nt = _EARTH_NT * float(np.max(np.abs(eigenvalues / eigenvalues.mean() - 1.0)))  # a common scale turns nothing
    remark = f"scale and non-orthogonality have no place in Betaflight: up to {left_nt:.0f} nT of 50 uT stay wrong"
    lines = [f"# {line}" for line in about(given)]
    lines += [f"# one count is {wanted.lsb_nt:g} nT; field = raw - mag_calibration; {remark}"]
    lines.append(f"set mag_calibration = {','.join(map(str, counts))}")
    return Exported("\n".join([*lines, "save"]) + "\n", remark, left_nt > _MOST_LEFT_NT)


BETAFLIGHT = Form("betaflight", "a command of its line: offsets alone, in counts (--lsb-nt)", _make)
