"""Recordings that are to be diagnosed together: read, named, inspected, and refused where they are not of one craft."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from magcal_service.errors import Fault, InputRefusedError
from magcal_service.recordings.inspect.inspection import Inspection, inspect
from magcal_service.recordings.reader import read_recording
from magcal_service.recordings.recording import Recording
from magcal_service.recordings.usable import refuse_hopeless


@dataclass(frozen=True, slots=True, eq=False)
class Gathered:
    """Recordings of one craft, with a name for each and what was found on it."""

    recordings: tuple[Recording, ...]
    names: tuple[str, ...]
    inspections: tuple[Inspection, ...]


def gather(given: Sequence[Recording | Path | str], craft: str | None = None) -> Gathered:
    """Read recordings, and look at each.

    Parameters
    ----------
    given: recordings, or the descriptors or sessions to read them from.
    craft: which craft of sessions that hold several.

    Raises ``InputRefusedError`` where there are fewer than two, one is given twice, they say that they are of different
    craft, or one of them is refused alone: the fault begins with its file.
    """
    if len(given) < 2:
        raise InputRefusedError([Fault("number of recordings", len(given), "two or more are diagnosed together")])
    recordings = tuple(one if isinstance(one, Recording) else read_recording(one, craft) for one in given)
    names = _names(recordings)
    _refuse_doubled(recordings, names)
    _refuse_strangers(recordings, names)
    inspections = tuple(inspect(recording) for recording in recordings)
    for inspection in inspections:
        refuse_hopeless(inspection.to_diagnose, inspection.lines())
    return Gathered(recordings, names, inspections)


def _names(recordings: Sequence[Recording]) -> tuple[str, ...]:
    """A short name for each: its descriptor's, with the folder's where those repeat, with a number where both do."""
    paths = [recording.descriptor.path for recording in recordings]
    names = [path.stem for path in paths]
    counts = Counter(names)
    names = [
        f"{path.resolve().parent.name}-{name}" if counts[name] > 1 else name
        for path, name in zip(paths, names, strict=True)
    ]
    counts = Counter(names)
    return tuple(f"{name}-{index}" if counts[name] > 1 else name for index, name in enumerate(names, start=1))


def _refuse_doubled(recordings: Sequence[Recording], names: Sequence[str]) -> None:
    """A recording that is there twice would prove itself."""
    for index, recording in enumerate(recordings):
        for name, other in zip(names[:index], recordings[:index], strict=True):
            same = len(recording) == len(other) and np.array_equal(recording.time_ns, other.time_ns)
            if same and np.array_equal(recording.field_body_nt, other.field_body_nt):
                accepted = f"the same samples as {name}; give each recording once"
                raise InputRefusedError([Fault("recordings", names[index], accepted)])


def _refuse_strangers(recordings: Sequence[Recording], names: Sequence[str]) -> None:
    """Craft are told apart by their names, where recordings have them."""
    told = {
        name: recording.craft.name if recording.craft is not None else recording.descriptor.craft
        for name, recording in zip(names, recordings, strict=True)
    }
    known = {name: craft for name, craft in told.items() if craft is not None}
    if len(set(known.values())) > 1:
        listed = ", ".join(f"{name} of {craft}" for name, craft in known.items())
        raise InputRefusedError([Fault("craft", listed, "recordings of one craft; add --separately for several")])
