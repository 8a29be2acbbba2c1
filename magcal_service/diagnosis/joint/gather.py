"""Recordings that are to be diagnosed together: read, named, inspected, and refused where they are not of one craft."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from magcal_service.base.errors import Fault, InputRefusedError
from magcal_service.recordings.inspect.inspection import Inspection, inspect
from magcal_service.recordings.reader import read_recording
from magcal_service.recordings.recording import Recording
from magcal_service.recordings.usable import refuse_hopeless


@dataclass(frozen=True, slots=True, eq=False)
class Gathered:
    """Recordings of one craft, with a name for each and what was found on it.

    ``assumed`` says which of them do not name their craft; empty where all do.
    """

    recordings: tuple[Recording, ...]
    names: tuple[str, ...]
    inspections: tuple[Inspection, ...]
    assumed: str = ""


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
    assumed = _of_one_craft(recordings, names)
    inspections = tuple(inspect(recording) for recording in recordings)
    for inspection in inspections:
        refuse_hopeless(inspection.to_diagnose, inspection.lines())
    return Gathered(recordings, names, inspections, assumed)


def _names(recordings: Sequence[Recording]) -> tuple[str, ...]:
    """A short name for each: its descriptor's; where those repeat, with the folder's, or with a number if both do."""
    paths = [recording.descriptor.path for recording in recordings]
    stems = Counter(path.stem for path in paths)
    longer = [f"{path.resolve().parent.name}-{path.stem}" for path in paths]
    counts = Counter(longer)
    return tuple(
        path.stem if stems[path.stem] == 1 else name if counts[name] == 1 else f"{path.stem}-{index}"
        for index, (path, name) in enumerate(zip(paths, longer, strict=True), start=1)
    )


def _refuse_doubled(recordings: Sequence[Recording], names: Sequence[str]) -> None:
    """A recording that is there twice would prove itself."""
    for index, recording in enumerate(recordings):
        for name, other in zip(names[:index], recordings[:index], strict=True):
            same = len(recording) == len(other) and np.array_equal(recording.time_ns, other.time_ns)
            if same and np.array_equal(recording.field_body_nt, other.field_body_nt):
                accepted = f"the same samples as {name}; give each recording once"
                raise InputRefusedError([Fault("recordings", names[index], accepted)])


def _of_one_craft(recordings: Sequence[Recording], names: Sequence[str]) -> str:
    """Refuse recordings that name different craft; what is assumed of those that name none, in a sentence."""
    told = {name: recording.of_craft for name, recording in zip(names, recordings, strict=True)}
    known = {name: craft for name, craft in told.items() if craft is not None}
    if len(set(known.values())) > 1:
        listed = ", ".join(f"{name} of {craft}" for name, craft in known.items())
        accepted = "recordings of one craft are diagnosed together; leave the others out, or add --separately"
        raise InputRefusedError([Fault("craft", listed, accepted)])
    unnamed = [name for name, craft in told.items() if craft is None]
    if not unnamed:
        return ""
    if not known:
        return (
            f"nothing says that {', '.join(unnamed)} are of one craft (what is found common holds only then): "
            'write craft = "NAME" under [samples] of each descriptor, or add --separately'
        )
    craft = next(iter(known.values()))
    verb = "is" if len(unnamed) == 1 else "are"
    return (
        f"nothing says of which craft {', '.join(unnamed)} {verb}; {craft} is taken, as "
        f'the others say they are: write craft = "{craft}" under [samples] there if that is so, else leave it out'
    )
