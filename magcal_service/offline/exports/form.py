"""What the forms share: what is asked for, what comes out, and the lines that say what the numbers are."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from magcal_service.base.errors import Fault, InputRefusedError
from magcal_service.base.version import __version__
from magcal_service.model import STATE_NAMES, STATE_SIZE
from magcal_service.offline.given import Given
from magcal_service.offline.result_head import EQUATION
from magcal_service.physics.apply.advice import DO_NOT
from magcal_service.physics.catalogue import held_at
from magcal_service.physics.held import held_in_words

_REMEDY = "degauss or move the sensor, or calibrate it elsewhere"


@dataclass(frozen=True, slots=True)
class Wanted:
    """What a form may be told.

    Parameters
    ----------
    index: which compass of the autopilot it is, from 0.
    lsb_nt: nT of one count of the sensor, for a form in counts; None where not told.
    """

    index: int = 0
    lsb_nt: float | None = None


@dataclass(frozen=True, slots=True)
class Exported:
    """One form of the nine numbers.

    Parameters
    ----------
    text: the file's content.
    remark: what the form cannot carry, for people; empty where it carries all.
    lossy: whether what it cannot carry is more than it may be trusted without.
    """

    text: str
    remark: str = ""
    lossy: bool = False


@dataclass(frozen=True, slots=True)
class Form:
    """One target.

    Parameters
    ----------
    name: as ``--format`` takes it.
    says: what it is, in a line.
    make: gives the content.  It raises ``InputRefusedError`` where the target takes no such numbers.
    """

    name: str
    says: str
    make: Callable[[Given, Wanted], Exported]


def about(given: Given) -> list[str]:
    """Equation, units, frame, sign convention, where the numbers are from and how far to trust them, a line each."""
    lines = [
        f"magcal {__version__}: nine errors of a magnetometer, from {given.name}",
        f"sha256 of that file: {given.sha256}",
        f"{EQUATION}: B measured, w calibrated, both in nT in the sensor's own axes; b is subtracted after the matrix",
    ]
    lines += [f"DO NOT FLY THIS: {doubt.removeprefix(f'{DO_NOT}: ')}" for doubt in given.doubts()]
    return list(map(_plain, [*lines, *left_out(given)]))


def left_out(given: Given) -> list[str]:
    """What nine numbers do not hold of a physics file, and where they are right without it; nothing where they do."""
    if given.model is None or not given.model.terms:
        return []
    effects = ", ".join(dict.fromkeys(term.effect for term in given.model.terms))
    lines = [f"not in these numbers: {effects}; they hold for B less the field of these, which {given.name} has"]
    held = held_in_words(held_at(given.model.terms))
    return [*lines, f"without that they hold at {held}"] if held else lines


def _plain(text: str) -> str:
    """A line that stays one, and ends no comment, whatever was in the file."""
    return "".join(one if one.isprintable() else "?" for one in text).replace("*/", "* /")


def numbers(given: Given) -> list[tuple[str, float, float, str]]:
    """Name, value, 1 sigma and unit of each of the nine, in the order of ``model.STATE_NAMES``."""
    sigma = given.covariance.diagonal() ** 0.5
    units = ["nT"] * 3 + ["1"] * (STATE_SIZE - 3)
    return list(zip(STATE_NAMES, given.x.tolist(), sigma.tolist(), units, strict=True))


def refuse_beyond(
    form: str, name: str, value: float, low: float, high: float, unit: str, remedy: str = _REMEDY
) -> None:
    """Raise ``InputRefusedError`` for a number that a target does not take."""
    if not low <= value <= high:
        accepted = f"{form} takes {low:g} to {high:g} {unit}; {remedy}"
        raise InputRefusedError([Fault(name, f"{value:.6g} {unit}", accepted)])
