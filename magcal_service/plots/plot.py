"""What a file is, and which figure shows it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from magcal_service.base.errors import Fault, FileFault, InputRefusedError
from magcal_service.base.typed_toml import TomlKind, nearest
from magcal_service.base.typed_toml.kind import refuse_kinds
from magcal_service.offline.given import Given, read_given
from magcal_service.offline.json_file import parsed_json, refuse_others, refuse_strange
from magcal_service.physics.apply.advice import doubts_of
from magcal_service.physics.apply.lacking import undriven_lines
from magcal_service.plots.of_recording import FIGURES, shown
from magcal_service.plots.of_result import of_calibration, of_diagnosis, of_joint_diagnosis
from magcal_service.plots.of_study import of_study
from magcal_service.plots.paper import Sheet
from magcal_service.recordings.reader import read_recording
from magcal_service.recordings.recording import Recording

_ACCEPTED: Final = "a RECORDING.toml, a session .mcap, or the JSON of calibrate, diagnose or study is accepted"

_OF_TOML: Final = "a physics.toml is shown on one: RECORDING.toml --with physics.toml"


def sheet_of(
    path: Path, figure: str | None, given: Path | None, craft: str | None = None, source: str | None = None
) -> Sheet:
    """The figure of a file.

    Parameters
    ----------
    path: a recording, or a result in JSON.
    figure: of a recording one of ``FIGURES``; None: the first.
    given: a result whose nine errors, and effects of a ``physics.toml``, are shown on a recording;
        None: those of a replay.
    craft, source: which one of a recording that holds several.

    Raises ``InputRefusedError`` or ``RecordingError`` for what is none of these or cannot be shown so.
    """
    if path.suffix.lower() == ".json":
        wrong = {"--figure": figure, "--with": given, "--craft": craft, "--source": source}
        accepted = "it goes with a recording; leave it out"
        if faults := [Fault(name, str(value), accepted) for name, value in wrong.items() if value is not None]:
            raise InputRefusedError(faults)
        return _of_json(path)
    name = figure or next(iter(FIGURES))
    if name not in FIGURES:
        raise InputRefusedError([Fault("--figure", name, nearest(name, FIGURES))])
    nine = None if given is None else read_given(given)
    if path.suffix.lower() == ".toml":
        refuse_kinds(path, TomlKind.RECORDING, _OF_TOML)
    recording = read_recording(path, craft, source=source)
    if nine is not None:
        nine.refuse_other_craft(recording)
    return replace(FIGURES[name](shown(recording, nine)), doubts=_doubts(recording, nine))


def _doubts(recording: Recording, nine: Given | None) -> tuple[str, ...]:
    """Why a result that is shown on a recording must not be trusted, or the physics that its session compensated."""
    if nine is not None:
        undriven = () if nine.model is None else undriven_lines(nine.name, nine.model, recording.driving)
        return (*(f"{nine.name}: {one}" for one in nine.doubts()), *undriven)
    physics = None if recording.craft is None else recording.craft.physics
    return () if physics is None else tuple(f"{physics.name}: {one}" for one in physics.doubts)


def _of_json(path: Path) -> Sheet:
    content = parsed_json(_read(path), str(path), _ACCEPTED)
    with _whole(path):
        sheet = _sheet_of(content, path)

    def draw(figure: Any) -> None:
        with _whole(path):
            sheet.draw(figure)

    return replace(sheet, draw=draw)


def _sheet_of(content: dict[str, Any], path: Path) -> Sheet:
    """The figure of a JSON by what is in it."""
    if "study" in content:
        return of_study(content)
    if "effects" in content and "fit" in content:
        sheet = of_joint_diagnosis(content) if "recordings" in content else of_diagnosis(content)
        return replace(
            sheet, doubts=tuple(f"{path.name}: {one}" for one in doubts_of(", ".join(content.get("reasons", ()))))
        )
    if "residual_rms_nt" in content:
        given = read_given(path)
        return replace(of_calibration(content, given), doubts=tuple(f"{path.name}: {one}" for one in given.doubts()))
    refuse_others(content, str(path), _ACCEPTED)
    return refuse_strange(content, str(path), _ACCEPTED)


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise InputRefusedError([FileFault(str(path), error, "give a readable file")]) from None


@contextmanager
def _whole(path: Path) -> Iterator[None]:
    """Refuse a file that lacks what its figure shows, or holds something else in its place."""
    try:
        yield
    except KeyError as error:
        raise InputRefusedError([Fault(str(path), f"without {error}", _ACCEPTED)]) from None
    except (TypeError, AttributeError, ValueError, IndexError) as error:
        raise InputRefusedError([Fault(str(path), f"a value that is none ({error})", _ACCEPTED)]) from None
