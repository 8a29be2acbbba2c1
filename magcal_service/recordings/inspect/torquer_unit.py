"""The unit of recorded torquers, by their size and by how far the field follows them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from magcal_service.base.units import CHANNEL_UNITS
from magcal_service.model import Array
from magcal_service.recordings.inspect.finding import Code, Seen
from magcal_service.recordings.inspect.log import Log
from magcal_service.samples.ellipsoid import fitted

_MOST_AM2: Final = 15.0
"""Largest moment of a small craft's torquer [A m2].

Source: NASA, State-of-the-Art of Small Spacecraft Technology, guidance, navigation and control: 0.15 to 15 A m2.
"""

_TONNE_AM2: Final = 100.0  # rods beyond are those of craft of a tonne (makers list 110, 140, 400 A m2)

_LEAST_AM2: Final = 2e-3
"""Full scale below which no coil is a torquer [A m2]: those on a PocketQube's boards have 6 to 14 mA m2."""

_FAR_NT: Final = 200.0
"""Field of 1 A m2 on its axis at 1 m [nT], 2e-7 T m3/(A m2) / r^3: a small craft's torquers are nearer."""

_NEAR_NT: Final = 1e6
"""The same at 6 cm: of coils that small it is 10 uT at the most, of a rod of 0.2 A m2 it would be 0.2 mT."""

_INSIDE_NT: Final = 1e7
"""The same at 27 mm, and what is in the middle of a coil as small: nearer there is no room for a sensor."""

_LEAST_HELD: Final = 0.2
"""Share of what the nine errors leave (in squares) that the torquers have to hold for their size to be believed."""

_BY_CHANCE: Final = 0.5
"""Of that, what the same commands may hold at another time: where they hold as much at all of ``_LATER``, it is their
kind that does, as of commands that turn with the craft."""

_LATER: Final = (0, 7, 18, 41)
"""Rows beyond a third of the log by which they are shifted; choice: no cycle of commands divides all of them."""

_KNOTS: Final = 7
"""Of a course of the bias; choice: what goes as slowly as a sixth of the log is no torquer's."""

_FEWEST: Final = 200  # rows; choice: ten numbers of the ellipsoid and nine of the coils are of no use with fewer
_MOST: Final = 20_000  # rows: more only take time


@dataclass(frozen=True, slots=True)
class _Follows:
    """How far the field follows torquers, between what they alone can hold of the residual and their fitted matrix:
    where the craft hardly turns, parts of that cancel in the magnitude and are of any size.

    Parameters
    ----------
    share: of the squares of what the nine errors leave, what they hold.
    least, most: field of the strongest coil [nT/(A m2)].
    """

    share: float
    least: float
    most: float


def torquer_unit(log: Log) -> Iterator[Seen]:
    """Torquers a thousand times stronger or weaker than any, as their numbers or the field beside them have it.

    Where the field does not follow them, only numbers that no small craft's torquers have are asked about: nothing
    else depends on the unit then.
    """
    for channel in log.recording.channels.values():
        if channel.spec.quantity != "magnetic moment":
            continue
        moment = CHANNEL_UNITS[channel.spec.unit].to_base(channel.values[log.rows])
        sizes = np.abs(moment[np.isfinite(moment)])
        largest = float(sizes.max()) if len(sizes) else 0.0
        if largest == 0.0:
            continue
        follows = _follows(log, moment / largest, largest)
        says, unit = _doubt(largest, follows)
        if unit:
            name, is_other = channel.spec.name, channel.spec.unit != unit
            says = f"by its unit {channel.spec.unit} the channel {name} has up to {largest:.3g} A m2{says}"
            says += f": likely it is in {unit}" if is_other else ": likely its unit or its factor is another one"
            advice = f'if it is so, write unit = "{unit}"' if is_other else "its unit, and factor"
            yield Seen(Code.TORQUER_UNIT, False, log.rows, says, f"check channels.{name}: {advice}")


def _doubt(largest: float, follows: _Follows | None) -> tuple[str, str]:
    """What speaks against the unit, and the likelier one; both empty where it may be right."""
    strong = f", and torquers of small craft have {_MOST_AM2:g} A m2 at the most"
    if follows is not None and largest > _MOST_AM2 and follows.most < _FAR_NT:
        near = f", of each of which the field changes by {follows.most:.3g} nT"
        return f"{near}{strong}, and make more than {_FAR_NT:g} nT of each beside a sensor", "mA m2"
    if largest > _TONNE_AM2:
        return strong, "mA m2"
    most_nt = _NEAR_NT if largest < _LEAST_AM2 else _INSIDE_NT
    if follows is not None and follows.least > most_nt:
        near = f", of each of which the field changes by {follows.least:.3g} nT or more"
        return f"{near}, and torquers that a sensor has room beside make {most_nt:.0e} nT of each", "A m2"
    return "", ""


def _follows(log: Log, moment: Array, largest: float) -> _Follows | None:
    """How far the field follows moments (m, k), of the ``largest`` [A m2]; None where it is not seen to.

    Commands act from their row on, or from the next one: the better of the two counts.
    """
    known = np.flatnonzero(np.isfinite(log.magnitude_nt) & np.isfinite(moment).all(axis=1))[:_MOST]
    if len(known) < _FEWEST:
        return None
    field, magnitude, moment = log.field_nt[known], log.magnitude_nt[known], moment[known]
    moment = moment[:, np.std(moment, axis=0) > 0.0]
    if not moment.shape[1]:
        return None
    ellipsoid = fitted(field, magnitude)
    along, left = ellipsoid.gradient(field, magnitude), ellipsoid.residual(field, magnitude)
    own = _own(field, magnitude, along)
    left = left - own @ np.linalg.lstsq(own, left, rcond=None)[0]
    best = max((_held(own, along, np.roll(moment, shift, axis=0), left) for shift in (0, 1)), key=lambda one: one.share)
    if best.share < _LEAST_HELD:
        return None
    best = replace(best, least=best.least / largest, most=best.most / largest)
    later = (_held(own, along, np.roll(moment, len(moment) // 3 + more, axis=0), left) for more in _LATER)
    return best if min(one.share for one in later) < _BY_CHANCE * best.share else None


def _own(field: Array, magnitude: Array, along: Array) -> Array:
    """(n, k) what nine errors, and a bias that goes slowly, can do to the magnitude, to first order, each of size 1."""
    b = field / float(np.mean(magnitude))
    x, y, z = b.T
    columns = np.stack([x * x, y * y, z * z, x * y, x * z, y * z, x, y, z, np.ones(len(b))], axis=1)
    place = np.linspace(0.0, _KNOTS - 1.0, len(b))
    course = np.maximum(1.0 - np.abs(place[:, None] - np.arange(_KNOTS)), 0.0)
    slow = (along[:, :, None] * course[:, None, :]).reshape(len(b), -1)
    return np.concatenate([columns / magnitude[:, None] * float(np.mean(magnitude)), slow], axis=1)


def _held(own: Array, along: Array, moment: Array, left: Array) -> _Follows:
    """What moments (n, k) hold of what the nine errors leave (n,); sizes are of a moment of 1."""
    coils = (along[:, :, None] * moment[:, None, :]).reshape(len(left), -1)
    columns = np.concatenate([own, coils], axis=1)
    solution = np.linalg.lstsq(columns, left, rcond=1e-9)[0]
    after = left - columns @ solution
    squares = float(left @ left)
    held = max(squares - float(after @ after), 0.0)
    matrix = solution[own.shape[1] :].reshape(3, -1)
    return _Follows(
        share=held / max(squares, 1e-300),
        least=math.sqrt(held / float((moment**2).sum())),
        most=float(np.linalg.norm(matrix, axis=0).max()),
    )
