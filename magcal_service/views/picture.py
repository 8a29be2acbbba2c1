"""One magnetometer on one screen: verdict, nine errors, field before and after, coverage, counters, events."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass
from typing import Any, Final

from magcal_service.views.field import FieldView
from magcal_service.views.series import Row
from magcal_service.views.sphere import AROUND, BANDS, CELLS
from magcal_service.views.state import Magnetometer
from magcal_service.views.text import BARS, Line, Span, Style, bars, columns, cut, fitted, wrapped
from magcal_service.wire.messages import Status, Verdict

WIDTH, HEIGHT = 80, 24
"""The smallest screen that the picture is made for; a larger one has longer traces and more events."""

_LABEL: Final = 10  # columns left of a trace
_FIGURE: Final = 32  # columns right of a trace
_RECENT: Final = 300  # rows that the figures beside before and after are of
_OLD_S: Final = 60.0  # sample time between a status and the newest estimate from which that is said
_TOGETHER: Final = 3  # bands of the sphere in one row of the screen
_SIDES: Final = BANDS // _TOGETHER  # rows of the screen that show the sphere
_STYLES: Final = {
    Verdict.NOT_STARTED: Style.DIM,
    Verdict.CONVERGING: Style.WAIT,
    Verdict.TRUSTED: Style.GOOD,
    Verdict.DOUBTFUL: Style.BAD,
}
_FIRST: Final = ("accepted", "ticks", "rejected", "strayed")
"""Counters that are shown whatever they say."""

_LESS: Final = ("tick_late_", "rss_kb", "open_files", "threads", "running", "compensating", "protection_nt", "troubles")
"""Those that are no count, or are said elsewhere."""


_COUNTED_OF: Final = {"reference": ("ticks", "s with one"), "samples": ("accepted", "accepted")}
"""The counter of a status that says whether the daemon has what was not heard here: no tick is without a reference."""

_OF_LIVE: Final = ("tick_late_", "link.")
"""Those that say nothing of a recording."""


@dataclass(frozen=True, slots=True)
class Frame:
    """What is around the magnetometer that is shown.

    Parameters
    ----------
    where: the link's address, or the recording.
    now_s: the clock [s].
    silence: why nothing comes, where that is known.
    place: which one this is of how many, from 1.
    recorded: whether it is a recording that plays.
    ended: whether all of it was played.
    keys: what the keys do, for the last line; empty where there are none.
    listened_s: how long a single picture has listened [s]; None where somebody keeps looking.
    """

    where: str
    now_s: float
    silence: str = ""
    place: tuple[int, int] = (1, 1)
    recorded: bool = False
    ended: bool = False
    keys: str = ""
    listened_s: float | None = None


def picture(one: Magnetometer | None, frame: Frame, width: int, height: int, marks: str = BARS) -> list[Line]:
    """The lines of a screen, each in ``width`` columns, ``height`` of them at most.

    Parameters
    ----------
    one: the magnetometer; None while none is known.
    marks: what traces are drawn with, from low to high.
    """
    last = [[Span(frame.keys, Style.DIM)]] if frame.keys else []
    room = max(height - len(last), 0)
    lines = _nothing(frame, width) if one is None else _of(one, frame, width, room, marks)
    return [fitted(line, width) for line in [*lines[:room], *last]]


def _nothing(frame: Frame, width: int) -> list[Line]:
    waiting = "the recording has no result" if frame.ended else "waiting for the first result"
    return [_heading("magcal watch", frame.where, waiting, Style.WAIT, width), *_entry("", frame.silence, width, 4)]


def _of(one: Magnetometer, frame: Frame, width: int, height: int, marks: str) -> list[Line]:
    shown, field = one.result.shown(one.craft.start_ns), one.craft.field_of(one.label)
    above = [
        *_top(one, shown, frame, width),
        [],
        *_errors(shown),
        [],
        *_traces(field, shown, max(width - _LABEL - _FIGURE, 8), marks, _Unheard(frame.listened_s, one.result.status)),
        [],
        *_coverage_and_counters(one, field, shown, width, marks, frame.recorded),
    ]
    return [*above, *_events(one, max(height - len(above), 1))]


def _heading(name: str, where: str, state: str, style: Style, width: int) -> Line:
    room = width - columns(name) - columns(state) - 4
    shown = cut(where, room)
    return [
        Span(name, Style.BOLD),
        Span("  " + shown + " " * max(room - columns(shown), 0) + "  ", Style.DIM),
        Span(state, style),
    ]


def _top(one: Magnetometer, shown: Mapping[str, Any], frame: Frame, width: int) -> list[Line]:
    """Who, how fresh; the verdict, its reasons, what to do, what the model leaves out."""
    stale = _is_stale(one, frame)
    state, style = _freshness(one, shown, frame)
    number, of = frame.place
    name = one.label if of == 1 else f"{one.label} ({number} of {of})"
    lines = [_heading(name, frame.where, state, style, width), _verdict(shown, stale)]
    if stale:
        return [*lines, *_entry("link", frame.silence or "no results come", width, 3, Style.BAD)]
    lines += _reasons(shown, width)
    lines += _entry("recording", "; ".join(shown["defects"]), width, 2, Style.BAD)
    finding = shown["finding"]
    if finding is None:
        return lines
    command = f"run: {finding['command']}"
    return [*lines, *_entry("model", finding["what"], width, 1, Style.BAD), *_entry("", command, width, 1, Style.BAD)]


def _reasons(shown: Mapping[str, Any], width: int) -> list[Line]:
    """All reasons and the advice to the first; what the status says where there are none, or there is trouble."""
    if shown["reasons"]:
        codes, advice = ", ".join(reason for reason, _ in shown["reasons"]), shown["reasons"][0][1]
        return [*_entry("why", codes, width, 1), *_entry("do", advice or "look it up in docs/trust.md", width, 2)]
    if shown["verdict"] == Verdict.TRUSTED and not shown["counters"].get("troubles", 0):
        return [*_entry("why", "every question is answered well", width, 1), *_entry("do", "nothing", width, 1)]
    return _entry("status", shown["status"] or "awaited: the daemon sends one every output.status_period_s", width, 3)


def _is_stale(one: Magnetometer, frame: Frame) -> bool:
    return one.craft.pulse.is_stale(frame.now_s) and not frame.recorded


def _freshness(one: Magnetometer, shown: Mapping[str, Any], frame: Frame) -> tuple[str, Style]:
    if frame.recorded:
        return "end of the recording" if frame.ended else "playing a recording", Style.BOLD
    if _is_stale(one, frame):
        age_s = one.craft.pulse.age_s(frame.now_s)
        came = f"nothing came for {duration(age_s)}" if math.isfinite(age_s) else "no result came"
        return f"STALE: {came}", Style.BAD
    troubles = shown["counters"].get("troubles", 0)
    return (f"live, troubles: {troubles} (magcal status)", Style.WAIT) if troubles else ("live", Style.GOOD)


def _verdict(shown: Mapping[str, Any], stale: bool) -> Line:
    """The newest verdict; of stale data what it was."""
    verdict = Verdict(shown["verdict"])
    name = str(verdict).upper()
    line = [
        Span(f"{'verdict':<{_LABEL}}"),
        Span(f"was {name}", Style.DIM) if stale else Span(name, _STYLES[verdict]),
    ]
    if shown["protection_nt"] is not None:
        by = f" ({shown['protection_by']})" if shown["protection_by"] else ""
        line.append(Span(f", protected to {math.ceil(shown['protection_nt'])} nT{by}"))
    elif verdict is Verdict.TRUSTED:
        line.append(Span(", no protection level"))
    if shown["method"]:
        line.append(Span(f", {shown['method']}, tick {shown['ticks']}", Style.DIM))
    return line


def _entry(name: str, text: str, width: int, rows: int, style: Style = Style.PLAIN) -> list[Line]:
    """A text beside its name, in at most ``rows`` lines; none where it is empty."""
    names = [name, *[""] * rows]
    return [
        [Span(f"{name:<{_LABEL}}"), Span(part, style)]
        for name, part in zip(names, wrapped(text, width - _LABEL, rows), strict=False)
    ]


def _errors(shown: Mapping[str, Any]) -> list[Line]:
    """The nine errors with 3 sigma, in three rows; before the start, where there are none, that they are awaited."""
    if not shown["started"]:
        return _entry("errors", "awaited: there is no number before the filter starts", WIDTH, 1, Style.DIM)
    lines: list[Line] = [[Span(f"{'errors':<{_LABEL}}estimate, 3 sigma; D has no unit", Style.DIM)]]
    for row in range(3):
        cells = [_cell(*shown["nine"][place]) for place in (row, row + 3, row + 6)]
        lines.append([Span("  " + "   ".join(f"{cell:<24}" for cell in cells).rstrip())])
    return lines


def _cell(name: str, value: str, limit: str, unit: str) -> str:
    ends = f" {unit}" if unit != "-" else ""
    return f"{name} {value:>8} +-{limit:>7}{ends}" if limit else f"{name} {value}"


@dataclass(frozen=True, slots=True)
class _Unheard:
    """What is said of a trace that has no value: how long somebody listened, and what the daemon has counted."""

    listened_s: float | None
    status: Status | None

    def of(self, what: str) -> str:
        """``what``: reference, samples or calibrated vectors."""
        if self.listened_s is None:
            return f"no {what} over this link so far"
        heard = f"no {what} heard in {self.listened_s:.1f} s"
        if self.status is None:
            return f"{heard}, and no status"
        counter, means = _COUNTED_OF.get(what, ("", ""))
        count = self.status.counters.get(counter)
        return heard if count is None else f"{heard}; the status counts {count} {means}"


def _traces(field: FieldView | None, shown: Mapping[str, Any], width: int, marks: str, unheard: _Unheard) -> list[Line]:
    """|H|, what |B| is off it before and after on one scale, and the newest residual on its own."""
    whole, recent = ([], []) if field is None else (field.whole.rows, list(field.recent.rows))
    span_s = (recent[-1][0] or 0.0) if recent else 0.0
    lines = [
        _range("|H|", _column(whole, 3), unheard.of("reference"), span_s, width, marks),
        *_off(whole, recent, width, marks, unheard),
    ]
    residual = _chunks(_column(recent, 4), width)
    if shown["started"] and residual:
        figure = f"{shown['residual_rms_nt']:8.1f} nT rms, noise {shown['noise_nt']:.1f}"
        lines.append(_trace("residual", residual, 0.0, max(_finite(residual), default=0.0), width, figure, marks))
    return lines


def _off(whole: Sequence[Row], recent: Sequence[Row], width: int, marks: str, unheard: _Unheard) -> list[Line]:
    traces = {name: _chunks(_off_by(whole, place), width) for name, place in (("before", 1), ("after", 2))}
    most = max(_finite([value for trace in traces.values() for value in trace]), default=0.0)
    lines = []
    for (name, trace), place in zip(traces.items(), (1, 2), strict=True):
        newest = _rms(_off_by(recent[-_RECENT:], place))
        if not math.isnan(newest):
            lines.append(_trace(name, trace, 0.0, most, width, f"{newest:8.1f} nT rms off |H|", marks))
        elif name == "after":
            lines.append(_range(name, _column(whole, 2), unheard.of("calibrated vectors"), 0.0, width, marks))
        else:
            lines.append(_range(name, _column(whole, 1), unheard.of("samples"), 0.0, width, marks))
    return lines


def _column(rows: Sequence[Row], place: int) -> list[float]:
    return [math.nan if row[place] is None else float(row[place] or 0.0) for row in rows]


def _off_by(rows: Sequence[Row], place: int) -> list[float]:
    """|B| - |H| [nT] of each row; NaN where one of them is unknown."""
    return [one - other for one, other in zip(_column(rows, place), _column(rows, 3), strict=True)]


def _finite(values: Sequence[float]) -> list[float]:
    return [value for value in values if not math.isnan(value)]


def _rms(values: Sequence[float]) -> float:
    known = _finite(values)
    return math.sqrt(sum(value * value for value in known) / len(known)) if known else math.nan


def _chunks(values: Sequence[float], most: int) -> list[float]:
    """The rms of at most so many stretches of equal length, from the first to the newest."""
    held = len(values)
    shown = min(held, most)
    return [_rms(values[at * held // shown : (at + 1) * held // shown]) for at in range(shown)]


def _range(name: str, values: Sequence[float], lacking: str, span_s: float, width: int, marks: str) -> Line:
    """A trace between its lowest and its highest value; ``lacking`` where there is none."""
    known = _finite(values)
    if not known:
        return [Span(f"{name:<{_LABEL}}"), Span(lacking, Style.DIM)]
    figure = f"{min(known):.0f} to {max(known):.0f} nT"
    figure += f" in {duration(span_s)}" if span_s else ""
    return _trace(name, _chunks(values, width), min(known), max(known), width, figure, marks)


def _trace(name: str, values: Sequence[float], low: float, high: float, width: int, figure: str, marks: str) -> Line:
    drawn = bars(values, low, high, marks)
    return [Span(f"{name:<{_LABEL}}"), Span(f"{drawn:<{width}}", Style.BAR), Span("  " + figure)]


def _coverage_and_counters(
    one: Magnetometer, field: FieldView | None, shown: Mapping[str, Any], width: int, marks: str, recorded: bool
) -> list[Line]:
    """Where the field came from, beside what was counted, and when that was where it is long ago."""
    seen = field.sphere.seen if field is not None else frozenset[int]()
    share = f"field came from {len(seen) / CELLS:.0%} of sides" if seen else "sides of the field: awaited"
    left = [f"{share:<32}", *(f"  {row:<30}" for row in (_sides(seen, marks) if seen else [""] * _SIDES))]
    counters = shown["counters"]
    counted = _counted(
        {name: count for name, count in counters.items() if not (recorded and name.startswith(_OF_LIVE))}
    )
    estimate, status = one.result.estimate, one.result.status
    if estimate is not None and status is not None and (old_s := (estimate.time_ns - status.time_ns) * 1e-9) > _OLD_S:
        counted.insert(0, f"counted {duration(old_s)} ago")
    rows = _packed(counted, width - 33, len(left)) or ["counters: awaited, in a status"]
    rows += [""] * (len(left) - len(rows))
    shown_rows = zip(left, rows, strict=True)
    return [[Span(side, Style.BAR), Span(" " + row)] for side, row in shown_rows if side.strip() or row]


def _sides(seen: Set[int], marks: str) -> list[str]:
    """Four rows from +z to -z; each mark is as high as the share of its cells in which the field has pointed."""
    rows = list[str]()
    for row in reversed(range(_SIDES)):
        bands = range(row * _TOGETHER, (row + 1) * _TOGETHER)
        counts = [sum(band * AROUND + place in seen for band in bands) for place in range(AROUND)]
        name = "+z" if not rows else "-z" if row == 0 else "  "
        shares = bars([float(count) for count in counts], 0.0, float(_TOGETHER), marks)
        rows.append(f"{name} " + "".join(mark if count else "." for mark, count in zip(shares, counts, strict=True)))
    return rows


def _counted(counters: Mapping[str, int]) -> list[str]:
    """Counters that are worth a place: some always, others where they are not zero, the link's last."""
    first = [name for name in _FIRST if name in counters]
    rest = [name for name, count in counters.items() if count and name not in _FIRST and not name.startswith(_LESS)]
    rest.sort(key=lambda name: (name.startswith("link."), name))
    late = counters.get("tick_late_p99_us")
    tail = [] if late is None else [f"p99 late {late / 1e3:.1f} ms"]
    return [*(f"{name} {counters[name]}" for name in first), *tail, *(f"{name} {counters[name]}" for name in rest)]


def _packed(parts: Sequence[str], width: int, rows: int) -> list[str]:
    """Texts in at most ``rows`` lines of ``width`` columns, none of them cut in two; how many have no place."""
    lines, left = list[str](), list(parts)
    while left and len(lines) < rows:
        line = left.pop(0)
        while left and len(line) + 2 + len(left[0]) <= width:
            line += f", {left.pop(0)}"
        lines.append(line)
    if left:
        more = f", {len(left)} more"
        lines[-1] = cut(lines[-1], width - len(more)) + more
    return lines


def _events(one: Magnetometer, rows: int) -> list[Line]:
    """The newest events, the newest first; each with how long it lies back by sample time."""
    result = one.result
    newest_ns = max((part.time_ns for part in (result.estimate, result.status) if part is not None), default=0)
    shown = list(reversed(result.events))[:rows]
    return [
        [Span(f"{duration((newest_ns - when_ns) * 1e-9) + ' ago':<{_LABEL}}", Style.DIM), Span(f" {text}")]
        for when_ns, text in shown
    ]


def duration(seconds: float) -> str:
    """A time for people: ``12 s``, ``3.4 min``, ``5.0 h``, ``2.1 d``."""
    for unit, size in (("d", 86_400.0), ("h", 3600.0), ("min", 60.0)):
        if seconds >= 2 * size:
            return f"{seconds / size:.1f} {unit}"
    return f"{max(seconds, 0.0):.0f} s"
