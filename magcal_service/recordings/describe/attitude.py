"""A quaternion in a log: four columns of length 1; its order and direction by what it does to the measured field."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from magcal_service.base.errors import Fault, InputRefusedError
from magcal_service.recordings.describe.columns import Column, Log, words_of
from magcal_service.recordings.describe.draft import Draft, Question, answered
from magcal_service.recordings.describe.place import Place

FloatArray = npt.NDArray[np.float64]

_ORDERS: Final = ("wxyz", "xyzw")
_QUATERNION: Final = {"q", "quat", "quaternion", "att", "attitude", "orientation", "rot", "rotation"}
_LEFT: Final = 0.25  # of the field's variance: what a right reading may leave
_BETTER: Final = 0.4  # of what the next best reading leaves
_ACROSS: Final = 0.6  # of the horizontal field: what may stand across magnetic north
_FEWEST: Final = 50  # rows


@dataclass(frozen=True, slots=True)
class _Reading:
    """One order and direction: what it leaves of the field's variance, and the steady field in the outer axes."""

    order: str
    outward: bool
    left: float
    steady: FloatArray


def find_attitude(draft: Draft, field: FloatArray | None, place: Place | None) -> set[int]:
    """Put the attitude into the draft, or ask; the numbers of its columns, also where it is left out."""
    answers = draft.answers.beginning("channels.attitude")
    whole = _parts(answers)
    columns = None
    if "columns" in whole:
        columns = tuple(draft.named("channels.attitude.columns", whole["columns"], (4,)))
    columns = columns or _four(draft.log)
    if columns is None and whole:
        accepted = "no four columns are called a quaternion and have length 1; name them: --answer "
        accepted += "channels.attitude.columns=NAME,NAME,NAME,NAME"
        raise InputRefusedError([Fault("--answer channels.attitude", ", ".join(whole.values()), accepted)])
    if columns is None:
        return set()
    numbers = {column.number for column in columns}
    label = ", ".join(column.label for column in columns)
    order = whole.get("order") or _order_by_names(columns)
    reading = None
    if field is not None and not (place is not None and place.in_orbit):
        reading = _by_field(columns, field, order)
    order = order or (reading.order if reading is not None else "")
    axes = _outer_axes(reading, place)
    start, end = whole.get("from"), whole.get("to")
    if start is None and end is None and reading is not None and axes:
        start, end = ("body", axes) if reading.outward else (axes, "body")
    if not (order and start and end):
        what = "its order and direction" if not order else "from which axes to which it leads"
        asks = f"{label} are a quaternion (length 1), but neither names nor numbers tell {what}"
        candidates = ((f"{order or 'wxyz'},body,ned", "order, from, to; orders wxyz xyzw; axes body eci ecef ned enu"),)
        draft.ask(Question("channels.attitude", asks, candidates, candidates[0][0], needed=False))
        return numbers
    value = {"columns": draft.names(columns), "order": order, "from": start, "to": end}
    draft.put("channels", "attitude", value)
    why = "the names and a length of 1 say a quaternion"
    if reading is not None and "from" not in whole:
        why += "; so read, it holds the measured field still and north where it belongs, and in no other way"
    if whole:
        why += f"; {answered('channels.attitude')}"
    draft.conclude("channels.attitude", f"{label}, {order}, {start} to {end}", why)
    return numbers


def _parts(answers: dict[str, str]) -> dict[str, str]:
    """What was answered of the attitude: in one, or key by key."""
    parts = {key[1:]: value for key, value in answers.items() if key.startswith(".")}
    if "" in answers:
        given = [part.strip() for part in answers[""].split(",")]
        if len(given) != 3 or given[0] not in _ORDERS:
            accepted = "order, from and to are accepted, such as wxyz,body,ned"
            raise InputRefusedError([Fault("--answer channels.attitude", answers[""], accepted)])
        parts |= dict(zip(("order", "from", "to"), given, strict=True))
    return parts


def _four(log: Log) -> tuple[Column, Column, Column, Column] | None:
    """Four neighbouring columns that are called a quaternion and have length 1."""
    for a, b, c, d in zip(log.columns, log.columns[1:], log.columns[2:], log.columns[3:], strict=False):
        four = (a, b, c, d)
        if all(
            column.numeric and set(words_of(column.name)) & (_QUATERNION | {"qw", "qx", "qy", "qz"}) for column in four
        ):
            length = np.sqrt(np.sum([column.values**2 for column in four], axis=0))
            good = length[np.isfinite(length)]
            if good.size and float(np.mean(np.abs(good - 1.0) < 0.03)) > 0.9:
                return four
    return None


def _order_by_names(columns: tuple[Column, ...]) -> str:
    last = [column.name.lower().rstrip("_")[-1:] for column in columns]
    text = "".join(last).replace("s", "w").replace("r", "w")
    if text in _ORDERS:
        return text
    text = text.replace("i", "x").replace("j", "y").replace("k", "z")
    return text if text in _ORDERS else ""


def _rotated(q: FloatArray, order: str, vectors: FloatArray, *, outward: bool) -> FloatArray:
    """Vectors (n, 3) turned by quaternions (n, 4)."""
    w, v = (q[:, :1], q[:, 1:]) if order == "wxyz" else (q[:, 3:], q[:, :3])
    v = v if outward else -v
    twice = 2.0 * np.cross(v, vectors)
    return np.asarray(vectors + w * twice + np.cross(v, twice), dtype=np.float64)


def _by_field(columns: tuple[Column, ...], field: FloatArray, order: str) -> _Reading | None:
    """The one reading by which the measured field is a steady one turned, plus a bias; None where none stands out."""
    q = np.stack([column.values for column in columns], axis=-1)
    good = np.flatnonzero(np.isfinite(q).all(axis=1) & np.isfinite(field).all(axis=1))
    if len(good) < _FEWEST:
        return None
    q, vectors = q[good], field[good]
    vectors = vectors / float(np.abs(vectors).max())
    readings = [
        _fit(q, vectors, one, outward=outward)
        for one, outward in itertools.product((order,) if order else _ORDERS, (True, False))
    ]
    readings.sort(key=lambda reading: reading.left)
    best, second = readings[:2]
    return best if best.left < _LEFT and best.left < _BETTER * second.left else None


def _fit(q: FloatArray, vectors: FloatArray, order: str, *, outward: bool) -> _Reading:
    """Least squares for the steady field and the bias: B = A h + b, with A from the outer axes to the body's."""
    axes = [np.broadcast_to(axis, (len(q), 3)) for axis in np.eye(3)]
    turned = np.stack([_rotated(q, order, axis, outward=not outward) for axis in axes], axis=-1)
    bias = np.broadcast_to(np.eye(3), (len(q), 3, 3))
    terms = np.concatenate([turned, bias], axis=2).reshape(-1, 6)
    solution, *_ = np.linalg.lstsq(terms, vectors.reshape(-1), rcond=None)
    rest = vectors.reshape(-1) - terms @ solution
    variance = float(((vectors - vectors.mean(axis=0)) ** 2).sum())
    left = float((rest**2).sum()) / max(variance, 1e-30)
    return _Reading(order, outward, left, solution[:3] / max(float(np.linalg.norm(solution[:3])), 1e-30))


def _outer_axes(reading: _Reading | None, place: Place | None) -> str:
    """``ned`` or ``enu`` by where north and the dip are in the outer axes; empty where neither fits alone."""
    if reading is None:
        return ""
    x, y, z = reading.steady
    fits = []
    if x > 0 and abs(y) < _ACROSS * x:
        fits.append(("ned", 1.0))
    if y > 0 and abs(x) < _ACROSS * y:
        fits.append(("enu", -1.0))
    if place is not None and place.latitude_deg is not None:
        north = float(np.nanmedian(place.latitude_deg)) > 0.0
        fits = [(axes, down) for axes, down in fits if (down * z > 0) == north or abs(z) < 0.2]
    return fits[0][0] if len(fits) == 1 else ""
