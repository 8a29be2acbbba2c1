"""The end of ``magcal diagnose`` on a terminal: a dozen lines."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from magcal_service.diagnosis.diagnose import Diagnosis, Verdict
from magcal_service.diagnosis.doubts import SURE
from magcal_service.diagnosis.entry import Entry
from magcal_service.diagnosis.mounting import mounting_of
from magcal_service.diagnosis.rows import account_of
from magcal_service.diagnosis.words import (
    IN_DOUBT,
    belief,
    compared_with,
    modelled_sentence,
    next_step,
    noise_of,
    not_borne_out,
    not_told_from,
    remaining,
    verdict_sentence,
)
from magcal_service.model import BIAS, Array
from magcal_service.physics.apply.advice import DO_NOT, advice, in_line, in_order
from magcal_service.physics.held import held_in_words

_MOST_EFFECTS: Final = 3
"""Effects that the terminal describes: as many as a search keeps (``MOST_EFFECTS``); sample faults come on top."""

_WORSE: Final = 1.02
"""Times the simulation's held-out rms, from which on it is said that nine errors fitted anew do worse."""

_MOST_LINES: Final = 8
"""Of the verdict's sentence; choice: a class of four names with their titles takes five."""

_WIDTH: Final = 118
"""Columns of the terminal's lines; choice: narrower than the usual 120, so that nothing wraps again."""


def summary(
    diagnosis: Diagnosis, found: Sequence[Entry], held_out: Mapping[str, float], files: Sequence[Path]
) -> list[str]:
    """What was found, how much better it fits, what remains, and where the files are."""
    lines = [verdict_line(diagnosis.verdict, diagnosis.reasons)]
    lines += reason_lines(advice(diagnosis.reasons, diagnosis.concerned))
    sentence = verdict_sentence(diagnosis, found, held_out)
    lines += wrapped(sentence, most=_MOST_LINES)
    for entry in found[:_MOST_EFFECTS]:
        lines += _of(entry, entry.says[1:].removesuffix(".") in sentence)
    if len(found) > _MOST_EFFECTS:
        lines.append(f"  and {len(found) - _MOST_EFFECTS} more, in the files")
    compared = compared_with(has_simulation=diagnosis.has_simulation)
    lines += wrapped(
        f"rms on held-out rows: {held_out['simulation']:.1f} nT {compared}, {held_out['recalibrated']:.1f} "
        f"nT recalibrated, {held_out['with_effects']:.1f} nT with effects; noise {noise_of(diagnosis)}",
        "",
    )
    if held_out["recalibrated"] > _WORSE * held_out["simulation"]:
        lines.append(f"  recalibrated is worse than {compared} on these rows: what is missing moves it")
    lines += _vectors(diagnosis)
    if diagnosis.fit.terms:
        before, after = diagnosis.prepared.baseline.x[BIAS], diagnosis.fit.x[BIAS]
        misled = diagnosis.misled
        lines += wrapped(f"vectors without these effects: {misled}", "")
        start = ", at the start of the recording" if misled.from_start else ""
        at = f", at {held_in_words(diagnosis.held_at)}" if diagnosis.held_at else ""
        lines += wrapped(f"bias: {_vector(after)} nT{start}{at}; by nine errors alone {_vector(before)} nT", "")
    if diagnosis.prepared.sun is not None:
        lines += wrapped(f"Sun: {diagnosis.prepared.sun}", "")
    if diagnosis.verdict is not Verdict.UNKNOWN or sentence == IN_DOUBT:  # else the sentence has said it
        lines.append(f"left: {remaining(diagnosis)}")
    if diagnosis.modelled is not None:
        lines += wrapped(modelled_sentence(diagnosis.modelled), "", most=4)
    for line in diagnosis.made_where:
        lines += wrapped(line, "")
    lines += wrapped(f"rows: {account_of(diagnosis.inspection, diagnosis.prepared)}", "", most=3)
    lines.append("files: " + ", ".join(str(path) for path in files))
    return lines


def verdict_line(verdict: Verdict, reasons: Sequence[str]) -> str:
    """The verdict, and that it is no answer where something speaks against it."""
    return f"verdict: {verdict}{', not trusted' if reasons else ''}"


def reason_lines(against: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    """Every reason against acting on a result (``advice``), with what would lift it."""
    if against:
        yield f"  {DO_NOT}:"
    for one in in_order(against):
        yield from wrapped(in_line(one), "    ", most=4)


def _of(entry: Entry, is_said: bool) -> Iterator[str]:
    """Lines of an effect; what it is and how large only where the verdict has not said it."""
    yield from wrapped(f"{entry.effect}: {entry.extent}; {belief(entry)}")
    yield from wrapped("" if is_said else entry.says, "    ", most=4)
    yield from wrapped(_alike(entry), "    ")
    if entry.record_next:
        yield from wrapped(f"next time: {entry.record_next}", "    ", most=3)
    if len(entry.members) > 1 or entry.probability < SURE:
        parts = filter(None, (not_told_from(entry), f"what would tell: {next_step(entry)}"))
        yield from wrapped("; ".join(parts), "    ", most=3)


def _vectors(diagnosis: Diagnosis) -> Iterator[str]:
    """What whole vectors have said of the mounting, or that they were not to be compared."""
    mounting = mounting_of(diagnosis.fit)
    if mounting is not None:
        yield (
            f"mounting: the sensor is turned by {mounting.angle_deg:.2f} deg against the body, "
            f"1 sigma {float(mounting.sigma_deg.max()):.2f} deg"
        )
    if diagnosis.refused:
        yield f"compared by {not_borne_out(diagnosis)}"


def _alike(entry: Entry) -> str:
    """Channels that drive it as well, in a sentence; empty where there is one only."""
    if len(entry.drivers) < 2:
        return ""
    names = [name.partition(":")[2] for name, _ in entry.drivers]
    return f"driven by one of {', '.join(names)}, which this recording cannot tell apart"


def wrapped(text: str, indent: str = "  ", most: int = 2) -> list[str]:
    """Two lines or ``most``: a summary is short, the report holds the rest."""
    return textwrap.wrap(
        text, _WIDTH, initial_indent=indent, subsequent_indent=indent, max_lines=most, placeholder=" ..."
    )


def _vector(values: Array) -> str:
    return "(" + ", ".join(f"{value:.1f}" for value in values.tolist()) + ")"
