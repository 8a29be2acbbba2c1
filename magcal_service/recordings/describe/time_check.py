"""Whether a log's times agree with what else it says of them: another column, a stated rate, the way of an orbit."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
import numpy.typing as npt

from magcal_service.recordings.describe.columns import Column, Log
from magcal_service.recordings.describe.draft import Draft, Question
from magcal_service.recordings.describe.over_ground import moves_as_orbit
from magcal_service.recordings.describe.time_numbers import Form, S, in_form, is_named, rises
from magcal_service.recordings.describe.times_found import Times

FloatArray = npt.NDArray[np.float64]

_RATE: Final = re.compile(
    r"(?:rate|freq\w*|fs)\b[^0-9\n]{0,24}([0-9]+(?:\.[0-9]+)?)\s*(?:hz|sps|samples)", re.IGNORECASE
)
_AGREES: Final = 1.25  # between two clocks, or a rate and what was kept of it: less than any two units differ by
_EXACTLY: Final = 1.1  # between the clocks' ratio and that of two units
_APART_S: Final = 10.0  # between two columns of instants: more than telemetry takes on its way through a craft
_QUARTER_S: Final = 900.0  # zones of the world differ by whole quarters of an hour
_ZONE_S: Final = 30.0  # off such a quarter
_COARSE_S: Final = 60.0  # a column of dates or minutes is no witness of seconds
_WIDE_DEG: Final = 20.0  # more than anything but an orbit comes round


def stated_rates(log: Log) -> set[float]:
    """Rows a second that the lines before the rows state."""
    return {float(rate) for rate in _RATE.findall("\n".join(log.layout.preamble))}


def agrees(draft: Draft, form: Form, forms: Sequence[Form]) -> bool:
    """Whether nothing contradicts a form that is sure; asks where something does."""
    if form.absolute:
        others = [one for one in forms if one.sure and one.absolute and not set(one.columns) & set(form.columns)]
        agree = all(_instants(draft, form, other) for other in others)
    else:
        agree = all(_clocks(draft, form, other) for other in _named_clocks(draft.log, form))
    return agree and _rate(draft, form)


def _named_clocks(log: Log, form: Form) -> list[Form]:
    """Other columns that rise and whose names say a unit of time, each in that unit."""
    rising = [c for c in log.columns if c.unit in S and c.numeric and c not in form.columns and rises(c.values)]
    return [told for column in rising if (told := in_form(column, f"elapsed_{column.unit}")) is not None]


def _steps(log: Log, *times: FloatArray) -> tuple[float, ...]:
    """How far each runs over the steps between neighbouring rows that all of them have."""
    steps = [np.diff(one) for one in times]
    good = log.neighbours() & np.all([np.isfinite(step) & (step >= 0.0) for step in steps], axis=0)
    return tuple(float(step[good].sum()) for step in steps)


def _clocks(draft: Draft, form: Form, other: Form) -> bool:
    """Whether two elapsed times run equally fast."""
    ours, theirs = _steps(draft.log, form.times, other.times)
    if ours <= 0.0 or theirs <= 0.0 or 1.0 / _AGREES < ours / theirs < _AGREES:
        return True
    named = is_named(form.columns[0]) and is_named(other.columns[0])
    if not named and _units_apart(ours / theirs) is None:
        return True  # a count of something else
    _ask_column(draft, form, other, f"{other.columns[0].label} runs {_text(theirs / ours)} times as fast as")
    return False


def _text(ratio: float) -> str:
    return f"{ratio:.3g}" if ratio < 1e4 else f"{ratio:.0e}"


def _units_apart(ratio: float) -> float | None:
    """The ratio of two units of time that a ratio is; None where it is none."""
    known = sorted({one / other for one in S.values() for other in S.values()} - {1.0})
    near = [one for one in known if 1.0 / _EXACTLY < ratio / one < _EXACTLY]
    return near[0] if near else None


def _instants(draft: Draft, form: Form, other: Form) -> bool:
    """Whether two columns of instants are the same ones; a difference that is no zone's is said only."""
    if _resolution(form.times) >= _COARSE_S or _resolution(other.times) >= _COARSE_S:
        return True
    apart = other.times - form.times
    apart = apart[np.isfinite(apart)]
    usual = float(np.median(apart)) if apart.size else 0.0
    if abs(usual) < _APART_S:
        return True
    label = " + ".join(column.label for column in other.columns)
    ours = " + ".join(column.label for column in form.columns)
    quarters = round(usual / _QUARTER_S)
    steady = float(np.quantile(np.abs(apart - usual), 0.9)) < _ZONE_S
    if not quarters or not steady or abs(usual - quarters * _QUARTER_S) > _ZONE_S:
        draft.said.append(f"time: {label} is {usual:.6g} s beside {ours}, which is taken")
        return True
    _ask_column(draft, form, other, f"{label} is {quarters * _QUARTER_S / 3600.0:+g} h beside")
    return False


def _resolution(times: FloatArray) -> float:
    steps = np.abs(np.diff(times[np.isfinite(times)]))
    return float(np.min(steps[steps > 0.0], initial=np.inf))


def _ask_column(draft: Draft, form: Form, other: Form, says: str) -> None:
    label = " + ".join(column.label for column in form.columns)
    asks = f"{says} {label}: one of them is not what its name says. Which is the time?"
    candidates = tuple((",".join(draft.names(one.columns)), f"as {one.pattern or one.format}") for one in (form, other))
    draft.ask(Question("time.columns", asks, candidates, candidates[0][0]))


def _rate(draft: Draft, form: Form) -> bool:
    """Whether the rows come as often as the lines before them state; asks where another unit makes it so."""
    rates = stated_rates(draft.log)
    steps = draft.log.neighbours() & np.isfinite(np.diff(form.times))
    (total,) = _steps(draft.log, form.times)
    if len(rates) != 1 or total <= 0.0:
        return True
    stated, found = rates.pop(), float(steps.sum()) / total
    if 1.0 / _AGREES < found / stated < _AGREES:
        return True
    label = " + ".join(column.label for column in form.columns)
    says = f"the lines before the rows state {stated:g} rows a second, and by {label} there are {found:.4g}"
    units = () if form.absolute else _other_units(form, stated / found)
    if not units:
        draft.said.append(f"time: {says}")
        return True
    candidates = (*units, (form.format, "as its name says"))
    draft.ask(Question("time.format", f"in which unit is {label}? {says}", candidates, candidates[0][0]))
    return False


def _other_units(form: Form, faster: float) -> tuple[tuple[str, str], ...]:
    """The format in which an elapsed time runs so many times as fast as in its own; none where no unit does."""
    own = S[form.format.removeprefix("elapsed_")]
    found = [unit for unit, s in S.items() if s != own and 1.0 / _AGREES < own / s / faster < _AGREES]
    return tuple((f"elapsed_{unit}", "then there are as many") for unit in found)


def doubt_by_way(draft: Draft, times: Times | None, latitude: Column, longitude: Column) -> None:
    """Ask for the unit of an elapsed time with which places [deg] that go round the Earth move as a craft in orbit."""
    if times is None or not times.format.startswith("elapsed_") or draft.answers.get("time.format") is not None:
        return
    lat, lon = latitude.values, longitude.values
    if not np.isfinite(lat).any() or float(np.nanmax(lat) - np.nanmin(lat)) < _WIDE_DEG:
        return
    own = times.format.removeprefix("elapsed_")
    for unit, s in S.items():
        in_unit = replace(times, seconds=times.seconds * (s / S[own]))
        if unit != own and moves_as_orbit(lat, lon, draft.log, in_unit):
            says = f"{latitude.label} and {longitude.label} go round the Earth as a craft in orbit only if it is {unit}"
            candidates = ((f"elapsed_{unit}", "as the places move"), (times.format, "as its name says"))
            draft.ask(Question("time.format", f"in which unit is the time? {says}", candidates, candidates[0][0]))
