"""``inspect``: every check in turn, each on the rows that those before it left."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from magcal_service.base.errors import printable
from magcal_service.base.progress import each
from magcal_service.recordings.inspect.account import Account
from magcal_service.recordings.inspect.axes import axes_by_attitude, axes_by_gyro, axes_changed
from magcal_service.recordings.inspect.bursts import bursts
from magcal_service.recordings.inspect.current_unit import current_unit
from magcal_service.recordings.inspect.finding import Finding, Seen, Spoils
from magcal_service.recordings.inspect.gyro_unit import gyro_unit
from magcal_service.recordings.inspect.log import Log
from magcal_service.recordings.inspect.orbits import heights_and_times, longitude_sign
from magcal_service.recordings.inspect.places import position_jump, position_still, position_zero
from magcal_service.recordings.inspect.ranges import saturated, start_transient, stuck_axis, wrapped
from magcal_service.recordings.inspect.readings import held_readings, sentinels, zero_rows
from magcal_service.recordings.inspect.references import field_scale, reference_repeats, shifted_columns
from magcal_service.recordings.inspect.times import shared_times, time_epoch, time_order, time_unit
from magcal_service.recordings.inspect.torquer_unit import torquer_unit
from magcal_service.recordings.recording import Recording, Reference
from magcal_service.recordings.specs import ModelReference
from magcal_service.recordings.usable import FEWEST_SAMPLES

Check = Callable[[Log], Iterator[Seen]]

CHECKS: Final[tuple[Check, ...]] = (
    zero_rows,
    sentinels,
    wrapped,
    time_epoch,
    time_order,
    time_unit,
    shared_times,
    position_zero,
    position_jump,
    position_still,
    heights_and_times,
    longitude_sign,
    shifted_columns,
    field_scale,
    held_readings,
    bursts,
    reference_repeats,
    saturated,
    stuck_axis,
    start_transient,
    gyro_unit,
    torquer_unit,
    current_unit,
    axes_by_gyro,
    axes_by_attitude,
    axes_changed,
)
"""In this order: what a later one looks at has no rows that an earlier one is certain of."""


_ONLY_DIAGNOSE: Final = (
    "diagnose also leaves out single spikes, rows at an edge of a recorded command and in a weak field, and thins out "
    "a long log; it says how many of each"
)
"""What becomes of rows only where they are diagnosed (``account.WHY``)."""


@dataclass(frozen=True, eq=False)
class Inspection:
    """What was found on a recording.

    Parameters
    ----------
    recording: as it was read.
    findings: every defect, in the order of the checks.
    left_out: (n,) rows that are not used.
    no_place, no_reference: (n,) rows whose place or reference is not used.
    clipped: (n,) rows that a diagnosis names the cause of, left out of every other fit.
    """

    recording: Recording
    findings: tuple[Finding, ...]
    left_out: NDArray[np.bool_]
    no_place: NDArray[np.bool_]
    no_reference: NDArray[np.bool_]
    clipped: NDArray[np.bool_]

    @cached_property
    def open(self) -> tuple[Finding, ...]:
        """What is only likely, and was not accepted in the descriptor: it has to be answered first."""
        accepted = self.recording.descriptor.accepted
        return tuple(one for one in self.findings if not one.certain and one.code not in accepted)

    @cached_property
    def usable(self) -> Recording:
        """The recording without what is certainly none; the same object where that is nothing."""
        return self._without(self.left_out | self.clipped)

    @property
    def to_replay(self) -> Recording:
        """What goes through the service: a recorded session's messages as they were, for the service judges itself."""
        return self.recording if self.recording.stream is not None else self.usable

    @cached_property
    def to_diagnose(self) -> Recording:
        """As ``usable``, with the rows whose cause a diagnosis names itself."""
        return self._without(self.left_out)

    def _without(self, rows: NDArray[np.bool_]) -> Recording:
        recording = self.recording
        if self.no_reference.any():
            recording = replace(recording, reference=_forget(recording.reference, self.no_reference))
        if self.no_place.any():
            if _is_modelled(recording) or np.count_nonzero(self.no_place) < 0.5 * len(recording):
                rows = rows | self.no_place
            else:
                recording = replace(recording, position=None)
        return recording.select(~rows) if rows.any() else recording

    @cached_property
    def account(self) -> Account:
        """What becomes of the log's rows before a fit."""
        return self._account(self.usable)

    @cached_property
    def account_to_diagnose(self) -> Account:
        """As ``account``, of the rows that a diagnosis begins with."""
        return self._account(self.to_diagnose)

    def _account(self, kept: Recording) -> Account:
        times = len(np.unique(kept.time_ns))
        left_out = {
            "unreadable": self.recording.report.refused,
            "defect": len(self.recording) - len(kept),
            "same_time": len(kept) - times,
            "no_reference": times - len(kept.sorted_unique()),
        }
        return Account(self.recording.report.refused + len(self.recording), left_out)

    def to_dict(self) -> dict[str, Any]:
        """What ``inspect --json`` writes."""
        return {
            "usable": self.account.used >= FEWEST_SAMPLES and not self.open,
            **self.account.to_dict(),
            "findings": [one.to_dict() for one in self.findings],
        }

    def lines(self) -> list[str]:
        """The findings in words, one or two lines each; nothing where there are none."""
        return [f"found: {one}" for one in self.findings]

    def summary(self) -> str:
        """One line: what there is, and what has to be answered; more on what becomes of the rows."""
        count = len(self.findings)
        found = "no defect found" if not count else f"{count} {'defect' if count == 1 else 'defects'} found"
        questions = f"; answer first: {', '.join(one.code for one in self.open)}" if self.open else ""
        lines = [f"{found}; {self.account.used} of {self.account.rows} rows can be used{questions}"]
        lines += [f"left out: {self.account.why}"] if self.account.why else []
        more = self.account_to_diagnose.used - self.account.used
        lines += (
            [f"diagnose also looks at {more} more, stuck or saturated, to name the cause; no fit uses them"]
            if more
            else []
        )
        return "\n".join([*lines, _ONLY_DIAGNOSE])


def _is_modelled(recording: Recording) -> bool:
    return isinstance(recording.descriptor.reference, ModelReference)


def _forget(reference: Reference, rows: NDArray[np.bool_]) -> Reference:
    """The reference without that of some rows (n,)."""
    magnitude_nt = np.where(rows, np.nan, reference.magnitude_nt)
    vector_nt = None if reference.vector_nt is None else np.where(rows[:, None], np.nan, reference.vector_nt)
    return Reference(magnitude_nt, vector_nt, reference.frame)


def inspect(recording: Recording) -> Inspection:
    """Look at a recording's rows before any physics; nothing is repaired, and nothing but numpy is needed."""
    count = len(recording)
    spoiled = {part: np.zeros(count, dtype=np.bool_) for part in Spoils}
    good = np.ones(count, dtype=np.bool_)
    findings: list[Finding] = []
    for check in each(CHECKS, "inspecting", "checks"):
        log = Log(recording, np.flatnonzero(good))
        for seen in check(log) if len(log) else ():
            if not seen.certain and any(one.code is seen.code and not one.certain for one in findings):
                continue  # asked already
            findings.append(_finding(recording, seen))
            if seen.certain:
                spoiled[seen.spoils][seen.rows] = True
        good = ~(spoiled[Spoils.ROW] | spoiled[Spoils.SAMPLES])
        if _is_modelled(recording):
            good &= ~spoiled[Spoils.PLACE]
    return Inspection(
        recording,
        tuple(findings),
        left_out=spoiled[Spoils.ROW],
        no_place=spoiled[Spoils.PLACE],
        no_reference=spoiled[Spoils.REFERENCE],
        clipped=spoiled[Spoils.SAMPLES],
    )


def _finding(recording: Recording, seen: Seen) -> Finding:
    entry = seen.refused
    if entry is not None:
        return Finding(seen.code, seen.certain, entry.count, entry.first_line, seen.says, seen.remedy)
    first = int(np.min(seen.rows)) if len(seen.rows) else 0
    line = first + 1 if recording.lines is None else int(recording.lines[first])
    return Finding(seen.code, seen.certain, len(seen.rows), line, printable(seen.says), printable(seen.remedy))
