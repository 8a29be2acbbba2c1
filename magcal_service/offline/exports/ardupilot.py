"""Parameters of ArduPilot: field = [[DIA_X, ODI_X, ODI_Y], [ODI_X, DIA_Y, ODI_Z], [ODI_Y, ODI_Z, DIA_Z]] (raw + OFS).

Source: ``AP_Compass_Backend::correct_field`` of ArduPilot 4; offsets and field in mGauss.  The scale factor
``COMPASS_SCALE`` is set to 0, which leaves it out.
"""

from __future__ import annotations

import math
from typing import Final

from magcal_service.offline.exports.form import Exported, Form, Wanted, about, refuse_beyond
from magcal_service.offline.given import Given

NT_PER_MILLIGAUSS: Final = 100.0  # by definition

_LARGEST_OFFSET: Final = 1800.0
"""Default of ``COMPASS_OFFS_MAX`` [mGauss]: with a longer offset the autopilot does not arm."""

_INDICES: Final = ("", "2", "3")
"""What follows the names of the first, second and third compass."""


def _make(given: Given, wanted: Wanted) -> Exported:
    refuse_beyond(
        "ArduPilot", "--index", wanted.index, 0, len(_INDICES) - 1, "compasses after the first", "choose one of them"
    )
    nth, matrix = _INDICES[wanted.index], given.matrix
    offsets = (-given.offset_nt / NT_PER_MILLIGAUSS).tolist()
    lines = [f"# {line}" for line in about(given)]
    lines.append(
        "# field = M (raw + OFS) in mGauss, M of DIA (diagonal) and ODI (xy, xz, yz); raw in the board's axes:"
    )
    lines.append("# right where the log that was calibrated has the axes that COMPASS_ORIENT gives")
    length = math.hypot(*offsets)
    refuse_beyond("ArduPilot", f"length of COMPASS_OFS{nth}", length, 0.0, _LARGEST_OFFSET, "mGauss")
    for axis, value in zip("XYZ", offsets, strict=True):
        lines.append(f"COMPASS_OFS{nth}_{axis},{value:.4f}")
    for axis, value in zip("XYZ", matrix.diagonal().tolist(), strict=True):
        lines.append(f"COMPASS_DIA{nth}_{axis},{value:.8f}")
    for axis, value in zip("XYZ", (matrix[0, 1], matrix[0, 2], matrix[1, 2]), strict=True):
        lines.append(f"COMPASS_ODI{nth}_{axis},{value:.8f}")
    lines.append(f"COMPASS_SCALE{nth},0.0")
    return Exported("\n".join(lines) + "\n")


ARDUPILOT = Form("ardupilot", "a .param file: COMPASS_OFS, _DIA, _ODI [mGauss, -]", _make)
