"""``magcal diagnose``: read, diagnose, write the files, sum up."""

from __future__ import annotations

import hashlib
import json
import shlex
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from magcal_service.base.disk import write_whole
from magcal_service.base.errors import unwritable
from magcal_service.diagnosis.content import as_json
from magcal_service.diagnosis.diagnose import Diagnosis, Verdict, diagnose
from magcal_service.diagnosis.entry import Entry
from magcal_service.diagnosis.handover import write_model
from magcal_service.diagnosis.report.frame import Origin, check_packages
from magcal_service.diagnosis.report.page import report
from magcal_service.diagnosis.result import entries, held_out_rms
from magcal_service.diagnosis.simulation import simulation_errors
from magcal_service.diagnosis.stages import WRITING
from magcal_service.diagnosis.summary import summary
from magcal_service.model import Array
from magcal_service.offline.result_files import (
    CALIBRATION,
    DIAGNOSIS,
    PHYSICS,
    REPORT,
    earlier_files,
    prepare_folder,
    remove,
    removed_line,
)
from magcal_service.recordings.inspect.inspection import Inspection, inspect
from magcal_service.recordings.reader import read_recording
from magcal_service.recordings.recording import Recording
from magcal_service.recordings.usable import refuse_hopeless


@dataclass(frozen=True, slots=True, eq=False)
class Request:
    """What is asked for.

    Parameters
    ----------
    recording: descriptor or session.
    out: folder for the files; made where it is not there.
    simulation: scenario to compare with, by file or name; None: the forward model as calibrated.
    craft: which craft of a session that holds several.
    source: which magnetometer of a craft that has several.
    """

    recording: Path
    out: Path
    simulation: str | None = None
    craft: str | None = None
    source: str | None = None

    @property
    def command(self) -> str:
        """The command line that does this."""
        parts = ["diagnose", str(self.recording), "--out", str(self.out)]
        parts += ["--simulation", self.simulation] if self.simulation is not None else []
        return command_line(parts + self._which)

    @property
    def _which(self) -> list[str]:
        parts = ["--craft", self.craft] if self.craft is not None else []
        return parts + (["--source", self.source] if self.source is not None else [])

    def onward(self, diagnosis: Diagnosis) -> tuple[str, ...]:
        """What to do with a result that may be acted on; none where it may not: its reasons hold their remedies."""
        if not diagnosis.trusted:
            return ()
        found, physics = diagnosis.verdict is not Verdict.NONE, self.out / PHYSICS
        given = physics if found else self.out / CALIBRATION
        commands = [] if found else [["calibrate", str(self.recording), *self._which, "--json", str(given)]]
        commands += [applying(self.recording, self._which, given)]
        if diagnosis.fit.terms or diagnosis.modelled is not None:
            return (*map(command_line, commands), in_flight(physics))
        return tuple(map(command_line, [*commands, ["export", str(given), "--format", "c-header"]]))


def applying(recording: Path, which: Sequence[str], given: Path) -> list[str]:
    """The command that gives a recording's calibrated vectors by a file, beside which they are written."""
    return ["apply", str(recording), *which, "--with", str(given), "--out", str(given.with_name("vectors.csv"))]


def command_line(command: Sequence[str]) -> str:
    """A command as a shell takes it."""
    return shlex.join(["magcal", *command])


def next_lines(onward: Sequence[str]) -> list[str]:
    """What to do next, at the end of a summary."""
    return [f"{'      ' if number else 'next: '}{line}" for number, line in enumerate(onward)]


def in_flight(physics: Path) -> str:
    """The line of a daemon's configuration by which it compensates what was found."""
    return f"in flight: physics = {json.dumps(str(physics.resolve()))} under [[craft]] of the daemon's configuration"


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """What came of it: the diagnosis, its entries, the files that were written, and the summary's lines."""

    diagnosis: Diagnosis
    found: tuple[Entry, ...]
    files: tuple[Path, ...]
    lines: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Made:
    """A diagnosis whose files are not written yet: their contents by name, what was said of the recording, and what to
    do next."""

    diagnosis: Diagnosis
    found: tuple[Entry, ...]
    contents: dict[str, str]
    lines: tuple[str, ...]
    onward: tuple[str, ...]


def run(request: Request, progress: Callable[[str], None]) -> Outcome:
    """Do it all; ``progress`` is called at each step.

    What an earlier run has left is removed once the input is accepted.

    Raises ``InputRefusedError`` where the recording, the scenario or the folder is refused, ``ExtraMissingError``
    without what the report is drawn with.
    """
    check_packages()
    prepare_folder(request.out)
    accepted = _accepted(request)
    earlier = earlier_files(request.out)
    remove(earlier)
    made = _made(request, accepted, progress)
    files = tuple(write(request.out / name, content) for name, content in made.contents.items())
    lines = [*made.lines, *summary(made.diagnosis, made.found, held_out_rms(made.diagnosis), files)]
    lines += [*next_lines(made.onward)]
    lines += removed_line(request.out, earlier, files)
    return Outcome(made.diagnosis, made.found, files, tuple(lines))


def make(request: Request, progress: Callable[[str], None]) -> Made:
    """Everything but to write the files; ``progress`` is called at each step.  Raises as ``run``."""
    return _made(request, _accepted(request), progress)


@dataclass(frozen=True, slots=True, eq=False)
class _Accepted:
    """An input that can be diagnosed; ``simulation`` (9,) where one was given."""

    recording: Recording
    inspection: Inspection
    simulation: Array | None


def _accepted(request: Request) -> _Accepted:
    simulation = None if request.simulation is None else simulation_errors(request.simulation)
    recording = read_recording(request.recording, request.craft, source=request.source)
    inspection = inspect(recording)
    refuse_hopeless(inspection.to_diagnose, inspection.lines())
    return _Accepted(recording, inspection, simulation)


def _made(request: Request, accepted: _Accepted, progress: Callable[[str], None]) -> Made:
    recording, inspection = accepted.recording, accepted.inspection
    diagnosis = diagnose(recording, accepted.simulation, progress=progress, inspection=inspection)
    progress(WRITING)
    found = entries(diagnosis)
    content = as_json(diagnosis, found)
    onward = request.onward(diagnosis)
    origin = replace(_origin(request, *recording.descriptor.files), onward=onward)
    contents = {
        DIAGNOSIS: content,
        REPORT: report(diagnosis, found, content, origin),
        PHYSICS: write_model(diagnosis, found, recording.name, recording.of_craft or ""),
    }
    return Made(diagnosis, found, contents, (*recording.report.lines(), *inspection.lines()), onward)


def _origin(request: Request, *files: Path) -> Origin:
    """What the report says of where it comes from; a session without a descriptor is one file."""
    paths = [path for path in dict.fromkeys([request.recording, *files]) if path.is_file()]
    digests = tuple((path.name, digest(path)) for path in paths)
    return Origin(str(request.recording), request.command, digests, request.simulation or "")


def digest(path: Path) -> str:
    """SHA-256 of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def write(path: Path, content: str) -> Path:
    """Write one of the files as a whole; raises ``InputRefusedError`` where that fails."""
    try:
        write_whole(path, content.encode())
    except OSError as exc:
        raise unwritable(path, exc) from None
    return path
