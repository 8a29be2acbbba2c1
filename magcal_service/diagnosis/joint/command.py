"""``magcal diagnose`` of several recordings: read, diagnose together, write the files, sum up."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from magcal_service.diagnosis.command import applying, command_line, digest, in_flight, next_lines, write
from magcal_service.diagnosis.joint.diagnose import JointDiagnosis, diagnose_together
from magcal_service.diagnosis.joint.gather import Gathered, gather
from magcal_service.diagnosis.joint.page import report
from magcal_service.diagnosis.joint.result import as_json, model_of
from magcal_service.diagnosis.joint.words import summary
from magcal_service.diagnosis.report.frame import Origin, check_packages
from magcal_service.diagnosis.rows import account_of
from magcal_service.diagnosis.stages import WRITING
from magcal_service.offline.result_files import (
    DIAGNOSIS,
    PHYSICS,
    REPORT,
    earlier_files,
    prepare_folder,
    remove,
    removed_line,
)
from magcal_service.physics.apply.model_file import text_of
from magcal_service.physics.apply.physics_model import PhysicsModel


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
        return command_line(["diagnose", *map(str, self.recordings), "--out", str(self.out), *self._which])

    @property
    def _which(self) -> list[str]:
        return ["--craft", self.craft] if self.craft is not None else []

    def onward(self, diagnosis: JointDiagnosis, model: PhysicsModel) -> tuple[str, ...]:
        """What to do with a result that may be acted on, first with the latest recording, whose nine errors the model
        begins from; none where it may not."""
        if not (diagnosis.trusted and model.terms):
            return ()
        physics = self.out / PHYSICS
        return command_line(applying(self.recordings[diagnosis.latest], self._which, physics)), in_flight(physics)


@dataclass(frozen=True, slots=True, eq=False)
class JointOutcome:
    """What came of it: the diagnosis and the summary's lines."""

    diagnosis: JointDiagnosis
    lines: tuple[str, ...]


def run_together(request: JointRequest, progress: Callable[[str], None]) -> JointOutcome:
    """Do it all; ``progress`` is called at each step.

    What an earlier run has left is removed once the input is accepted.

    Raises ``InputRefusedError`` where a recording, their number or the folder is refused, ``ExtraMissingError`` without
    what the report is drawn with.
    """
    check_packages()
    prepare_folder(request.out)
    gathered = gather(request.recordings, request.craft)
    earlier = earlier_files(request.out)
    remove(earlier)
    diagnosis = diagnose_together(gathered.inspections, gathered.names, progress=progress, assumed=gathered.assumed)
    progress(WRITING)
    model = model_of(diagnosis)
    onward = request.onward(diagnosis, model)
    contents = {
        DIAGNOSIS: as_json(diagnosis),
        REPORT: report(diagnosis, replace(_origin(request, gathered), onward=onward)),
        PHYSICS: text_of(model),
    }
    files = [write(request.out / name, content) for name, content in contents.items()]
    said = []
    for recording, one in zip(gathered.recordings, diagnosis.recordings, strict=True):
        rows = f"rows: {account_of(one.inspection, one.prepared)}"
        said += [f"{one.name}: {line}" for line in [*recording.report.lines(), *one.inspection.lines(), rows]]
    lines = [
        *said,
        *summary(diagnosis, files),
        *next_lines(onward),
        *removed_line(request.out, earlier, files),
    ]
    return JointOutcome(diagnosis, tuple(lines))


def _origin(request: JointRequest, gathered: Gathered) -> Origin:
    files = [file for recording in gathered.recordings for file in recording.descriptor.files]
    paths = [path for path in dict.fromkeys([*request.recordings, *files]) if path.is_file()]
    return Origin(", ".join(gathered.names), request.command, tuple((path.name, digest(path)) for path in paths))
