"""Does the field turn as ``[craft.spin]`` says: about that axis, in that sense, at that rate?

A craft that spins at rate w about a sees the field turn by -w about a.  Of samples about a quarter of a turn apart the
differences d of two in a row give the turn in the step, phi, and its axis:

    mean of d1 x d2 / |d1| |d2| = u sin(phi)        mean of d1 . d2 / |d1| |d2| = cos(phi)

Neither bias nor the length of the field matters, and a spike is one pair of many.
Steps of more than half a turn are compared modulo a turn; where the
stated turn in a step is near a half or whole one, the sense is not to be seen, and nothing is said.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from magcal_service.base.snapshot import Stateful
from magcal_service.config.settings import SpinConfig
from magcal_service.wire.messages import Vector

_SLOWEST_RPM: Final = 0.25
"""Below it the orbit's own turn of the field, up to 0.15 deg/s, is more than a tenth of the spin."""

_STEP_TURN: Final = 0.22
"""Length of a step [turns]: where samples allow, a little below a quarter."""

_MEMORY: Final = 64
"""Pairs of steps over which sums are kept."""

_FEWEST: Final = 48
"""Pairs of steps before anything is said."""

_STEADY: Final = 0.7
"""Of |sum d x d| to the sum of |d x d| from which on the field turns about a steady axis; of noise it is 0.15."""

_CLEAN: Final = 0.95
"""The same for the rate: noise as large as a third of d makes phi larger by a tenth, and the axis less steady."""

_UNSEEN: Final = 0.25
"""Angle [rad] from a half or whole turn in a step within which the sense does not show."""

_ASIDE: Final = math.cos(math.radians(30.0))
"""Of the angle between the axes from which on they differ; scale factors of 0.3 tilt an axis by 15 degrees."""

_RATE: Final = 0.1
"""Share of the stated rate by which the field's may differ: a window of two turns misses by a fifth of a turn then."""

_ORBIT_RPM: Final = 0.03
"""What the field's own turn along the orbit adds to a rate [rpm]: 0.18 deg/s."""

_UNEVEN: Final = 0.03
"""Share by which the two steps of a pair may differ in length."""


@dataclass(init=False, repr=False, eq=False)
class SpinSenseMemory:
    """What of ``SpinSense`` outlives a restart, saved and restored whole."""

    said: str
    _times: list[float]
    _fields: list[Vector]
    _sums: list[float]
    _seen: int


class SpinSense(Stateful, SpinSenseMemory):
    """The turn of one craft's measured vectors against the stated spin.

    Parameters
    ----------
    spin: as configured.

    Attributes
    ----------
    said: how the field turns instead, in words; empty where it turns as stated, or that does not show.
    """

    def __init__(self, spin: SpinConfig) -> None:
        self._spin = spin
        self._wanted_s = _STEP_TURN * 60.0 / abs(spin.rate_rpm)
        self._axis_length = math.sqrt(sum(a * a for a in spin.axis))
        self.said = ""
        self._times, self._fields = [], []
        self._sums = [0.0] * 6  # means of d1 x d2 (3), |d1 x d2|, d1.d2 over |d1| |d2|, length of a step [s]
        self._seen = 0

    def interrupt(self) -> None:
        """A pause lies before the next sample."""
        self._times, self._fields = [], []

    def push(self, time_s: float, field_nt: Vector) -> None:
        """Take a measured vector (3,) [nT], in order of time [s]."""
        if abs(self._spin.rate_rpm) < _SLOWEST_RPM or (self._times and time_s - self._times[-1] < self._wanted_s):
            return
        self._times.append(time_s)
        self._fields.append(field_nt)
        if len(self._times) < 3:
            return
        first_s, then_s = self._times[1] - self._times[0], self._times[2] - self._times[1]
        if abs(then_s - first_s) <= _UNEVEN * then_s:
            self._add(then_s)
        del self._times[0], self._fields[0]

    def _add(self, step_s: float) -> None:
        (ax, ay, az), (bx, by, bz), (cx, cy, cz) = self._fields
        ux, uy, uz, vx, vy, vz = bx - ax, by - ay, bz - az, cx - bx, cy - by, cz - bz
        x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        length = math.sqrt((ux * ux + uy * uy + uz * uz) * (vx * vx + vy * vy + vz * vz))
        if length == 0.0:
            return
        x, y, z, along = x / length, y / length, z / length, (ux * vx + uy * vy + uz * vz) / length
        new = (x, y, z, math.sqrt(x * x + y * y + z * z), along, step_s)
        self._seen += 1
        share = 1.0 / min(self._seen, _MEMORY)
        self._sums = [old + share * (value - old) for old, value in zip(self._sums, new, strict=True)]
        if self._seen >= _FEWEST:
            self.said = self._compared()

    def _compared(self) -> str:
        x, y, z, total, cosine, step_s = self._sums
        sine = math.sqrt(x * x + y * y + z * z)
        if sine <= _STEADY * total:
            return ""
        stated = abs(self._spin.rate_rpm) / 60.0 * step_s * math.tau
        expected = stated % math.tau
        sense = math.copysign(1.0, self._spin.rate_rpm)
        if expected > math.pi:
            expected, sense = math.tau - expected, -sense
        if not _UNSEEN < expected < math.pi - _UNSEEN:
            return ""
        axis_x, axis_y, axis_z = self._spin.axis
        along = -sense * (axis_x * x + axis_y * y + axis_z * z) / sine
        length = self._axis_length
        if abs(along) < _ASIDE * length:
            axis = ", ".join(f"{-sense * one / sine:.2f}" for one in (x, y, z))
            return f"the field shows a spin about ({axis}), which is {_degrees(abs(along) / length)} degrees aside"
        if along < 0.0:
            return f"the field turns in the other sense than stated, or by more than half a turn in {step_s:.3g} s"
        found = math.atan2(sine, cosine)
        allowed = _RATE * stated + _ORBIT_RPM / 60.0 * step_s * math.tau
        if abs(found - expected) <= allowed or sine < _CLEAN * total:
            return ""
        turn = stated + (found - expected if stated % math.tau <= math.pi else expected - found)
        rpm = turn / math.tau / step_s * 60.0
        stated_rpm = f"stated are {abs(self._spin.rate_rpm):g} rpm"
        return f"the field turns at {rpm:.2f} rpm, or whole turns in {step_s:.3g} s faster; {stated_rpm}"


def _degrees(cosine: float) -> int:
    return round(math.degrees(math.acos(min(1.0, cosine))))
