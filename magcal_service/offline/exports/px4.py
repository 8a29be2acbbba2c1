"""Parameters of PX4: field = SCALE (raw - OFF), SCALE of X, Y, ZSCALE and, off the diagonal, X, Y, ZODIAG (xy, xz, yz).

Source: ``Magnetometer::Correct`` and ``set_offdiagonal`` of PX4's sensor calibration; offsets in Gauss.  The file is in
the form of QGroundControl: vehicle, component, name, value, type 9 (a 32-bit float).  Values always have a point:
mavros takes one without for a whole number, and 1e-05 for none.
"""

from __future__ import annotations

from typing import Final

from magcal_service.offline.exports.form import Exported, Form, Wanted, about, refuse_beyond
from magcal_service.offline.given import Given

NT_PER_GAUSS: Final = 1e5  # by definition

_SCALES: Final = (0.1, 3.0)
"""What PX4 takes for ``CAL_MAG0_XSCALE``."""

_MOST: Final = 3  # compasses after the first


def _make(given: Given, wanted: Wanted) -> Exported:
    refuse_beyond("PX4", "--index", wanted.index, 0, _MOST, "compasses after the first", "choose one of them")
    matrix, nth = given.matrix, f"CAL_MAG{wanted.index}"
    found = {f"{nth}_{axis}OFF": one / NT_PER_GAUSS for axis, one in zip("XYZ", given.offset_nt.tolist(), strict=True)}
    for axis, value in zip("XYZ", matrix.diagonal().tolist(), strict=True):
        refuse_beyond("PX4", f"{nth}_{axis}SCALE", value, *_SCALES, "")
        found[f"{nth}_{axis}SCALE"] = value
    found |= {
        f"{nth}_{axis}ODIAG": float(one)
        for axis, one in zip("XYZ", (matrix[0, 1], matrix[0, 2], matrix[1, 2]), strict=True)
    }
    lines = [f"# {line}" for line in about(given)]
    lines.append("# field = SCALE (raw - OFF) in Gauss, SCALE of XSCALE, YSCALE, ZSCALE and XODIAG (xy), YODIAG (xz),")
    lines.append(f"# ZODIAG (yz), before {nth}_ROT; they act where {nth}_ID is that of the sensor")
    lines += [f"1\t1\t{name}\t{value:.9f}\t9" for name, value in found.items()]
    return Exported("\n".join(lines) + "\n")


PX4 = Form("px4", "a parameter file of QGroundControl: CAL_MAG0_*OFF, *SCALE, *ODIAG [Gauss, -]", _make)
