"""``magcal diagnose`` of several recordings: read, diagnose together, write the files, sum up."""

from __future__ import annotations

import shlex
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from magcal_service.diagnosis.command import JSON, PHYSICS, REPORT, digest, prepare_folder, write
from magcal_service.diagnosis.joint.diagnose import JointDiagnosis, diagnose_together
from magcal_service.diagnosis.joint.gather import Gathered, gather
from magcal_service.diagnosis.joint.page import report
from magcal_service.diagnosis.joint.result import as_json, model_of, summary
from magcal_service.diagnosis.report.page import Origin, check_packages
from magcal_service.physics.apply.model_file import text_of


@dataclass(frozen=True, slots=True, eq=False)
class JointRequest:
    """What is asked for.

    Parameters
    ----------
    recordings: descriptors or sessions, two or more.
    out: folder for the files; made where it is not there.
    craft: which craft of sessions that hold several.
    """

    recordings: tuple[Path, ...]
    out: Path
    craft: str | None = None

    @property
    def command(self) -> str:
        """The command line that does this."""
        parts = ["magcal", "diagnose", *map(str, self.recordings), "--out", str(self.out)]
        return shlex.join([*parts, *(["--craft", self.craft] if self.craft is not None else [])])


@dataclass(frozen=True, slots=True, eq=False)
class JointOutcome:
    """What came of it: the diagnosis and the summary's lines."""

    diagnosis: JointDiagnosis
    lines: tuple[str, ...]


def run_together(request: JointRequest, tell: Callable[[str], None]) -> JointOutcome:
    """Do it all; ``tell`` hears of each step.

    Raises ``InputRefusedError`` where a recording, their number or the folder is refused, ``ExtraMissingError`` without
    what the report is drawn with.
    """
    check_packages()
    prepare_folder(request.out)
    gathered = gather(request.recordings, request.craft)
    diagnosis = diagnose_together(gathered.inspections, gathered.names, progress=tell)
    tell("writing the results")
    contents = {
        JSON: as_json(diagnosis),
        REPORT: report(diagnosis, _origin(request, gathered)),
        PHYSICS: text_of(model_of(diagnosis)),
    }
    files = [write(request.out / name, content) for name, content in contents.items()]
    pairs = zip(gathered.names, gathered.recordings, gathered.inspections, strict=True)
    said = [f"{name}: {line}" for name, one, found in pairs for line in [*one.report.lines(), *found.lines()]]
    return JointOutcome(diagnosis, (*said, *summary(diagnosis, files)))


def _origin(request: JointRequest, gathered: Gathered) -> Origin:
    files = [file for recording in gathered.recordings for file in recording.descriptor.files]
    paths = [path for path in dict.fromkeys([*request.recordings, *files]) if path.is_file()]
    return Origin(", ".join(gathered.names), request.command, tuple((path.name, digest(path)) for path in paths))
