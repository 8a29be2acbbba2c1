"""``magcal record``: look into recorded sessions, mend them, hand them on.  Parse, call, print."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import TYPE_CHECKING, Final

from magcal_service.base.errors import Fault, FileFault, InputRefusedError
from magcal_service.cli.common import DONE, NOT_TRUSTED, SOURCE_HELP, Parser

if TYPE_CHECKING:
    from magcal_service.recordings.mcap_reader import McapReader

_FILE_HELP: Final = "a recorded session"


def add_record(record: Parser) -> None:
    """The sub-commands of ``magcal record``."""
    record.examples = ("magcal record info session.mcap",)
    commands = record.add_subparsers(required=True, metavar="WHAT")

    info = commands.add_parser("info", help="what is in a session file, and whether it is sound (exit code 3 if not)")
    info.add_argument("file", type=Path, metavar="FILE.mcap", help=_FILE_HELP)
    info.add_argument("--json", action="store_true", help="as one JSON object")
    info.examples = ("magcal record info session.mcap",)
    info.set_defaults(command=_info)

    export = commands.add_parser("export", help="a table for other programs")
    export.add_argument("file", type=Path, metavar="FILE.mcap", help=_FILE_HELP)
    export.add_argument("--out", type=Path, required=True, metavar="X.csv|X.parquet", help="the table to write")
    export.add_argument("--kind", default="samples", help="samples (default), or a kind of message such as estimate")
    export.add_argument("--craft", metavar="NAME", help="whose; needed for samples where there are several")
    export.add_argument("--source", metavar="NAME", help=SOURCE_HELP)
    export.examples = ("magcal record export session.mcap --out samples.csv",)
    export.set_defaults(command=_export)

    recover = commands.add_parser(
        "recover", help="a sound file of all that can be read (exit code 3 if it was damaged)"
    )
    recover.add_argument("file", type=Path, metavar="FILE.mcap", help=_FILE_HELP)
    recover.add_argument("--out", type=Path, metavar="OUT.mcap", help="default: FILE.recovered.mcap")
    recover.examples = ("magcal record recover session.mcap --out sound.mcap",)
    recover.set_defaults(command=_recover)

    join = commands.add_parser("join", help="the parts of a session as one file, in the order given")
    join.add_argument("files", type=Path, nargs="+", metavar="FILE.mcap", help=_FILE_HELP)
    join.add_argument("--out", type=Path, required=True, metavar="OUT.mcap", help="the file to write")
    join.examples = ("magcal record join part1.mcap part2.mcap --out session.mcap",)
    join.set_defaults(command=_join)

    check = commands.add_parser(
        "check", help="replay, and compare with the recorded estimates (exit code 3 if not equal)"
    )
    check.add_argument("file", type=Path, metavar="FILE.mcap", help=_FILE_HELP)
    check.add_argument("--craft", metavar="NAME", help="needed where there are several")
    check.examples = ("magcal record check session.mcap",)
    check.set_defaults(command=_check)

    describe = commands.add_parser("describe", help="a RECORDING.toml of one craft of a session, to be edited")
    describe.add_argument("file", type=Path, metavar="FILE.mcap", help=_FILE_HELP)
    describe.add_argument("--craft", metavar="NAME", help="needed where there are several")
    describe.examples = ("magcal record describe session.mcap --craft demo",)
    describe.set_defaults(command=_describe)


def _info(options: argparse.Namespace) -> int:
    from magcal_service.recordings.session_info import session_info

    info = session_info(options.file)
    print(info.as_json() if options.json else "\n".join(info.lines()), end="" if options.json else "\n")
    return DONE if info.sound else NOT_TRUSTED


def _export(options: argparse.Namespace) -> int:
    from magcal_service.recordings.export import export

    rows = export(options.file, options.out, options.kind, options.craft, options.source)
    print(f"{rows} rows: {options.out}")
    return DONE


def _recover(options: argparse.Namespace) -> int:
    from magcal_service.recordings.session_files import recover

    out = options.out or options.file.with_suffix(".recovered.mcap")
    _refuse_itself(out, [options.file])
    try:
        recovered = recover(options.file, out)
    except OSError as error:
        raise _unusable(options.file, error) from None
    print(recovered)
    return DONE if recovered.messages and recovered.undamaged else NOT_TRUSTED


def _join(options: argparse.Namespace) -> int:
    from contextlib import ExitStack

    from magcal_service.recordings.mcap import SESSION
    from magcal_service.recordings.mcap_reader import McapReader
    from magcal_service.recordings.session_files import rewrite

    _refuse_itself(options.out, options.files)
    readers: list[McapReader] = []
    with ExitStack() as stack:
        for path in options.files:
            try:
                readers.append(McapReader(stack.enter_context(path.open("rb")), str(path)))
            except OSError as error:
                raise _unusable(path, error) from None
        try:
            messages = rewrite(readers, options.out)
        except OSError as error:
            raise _unusable(options.out, error) from None
    print(f"{messages} records: {options.out}")
    sessions = {content.get("session") for reader in readers for name, content in reader.metadata if name == SESSION}
    if len(sessions) > 1:
        print(f"of {len(sessions)} sessions: the service began anew between them, a replay of the file does not")
    unsound = [reader.name for reader in readers if not reader.sound]
    if unsound:
        print(f"not all could be read of: {', '.join(unsound)}")
    return NOT_TRUSTED if unsound or not messages else DONE


def _describe(options: argparse.Namespace) -> int:
    from magcal_service.recordings.session_arrays import session_recording

    recording = session_recording(options.file, craft=options.craft)
    descriptor = recording.descriptor
    lines = ["version = 1", "[samples]", f"file = {json.dumps(options.file.name)}"]
    lines.append(f"craft = {json.dumps(recording.stream[0].craft)}" if recording.stream else "")
    stated = {name: getattr(descriptor.magnetometer, name) for name in ("noise_nt", "range_nt")}
    known = [f"{name} = {value!r}" for name, value in stated.items() if value is not None]
    lines += ["[magnetometer]", *known] if known else []
    if descriptor.spin is not None:
        lines += ["[spin]", f"axis = {list(descriptor.spin.axis)!r}", f"rate_rpm = {descriptor.spin.rate_rpm!r}"]
    print("\n".join(filter(None, lines)))
    return DONE


def _check(options: argparse.Namespace) -> int:
    from magcal_service.offline.replay_check import check_session

    check = check_session(options.file, options.craft)
    print(check)
    return DONE if check.same else NOT_TRUSTED


def _refuse_itself(out: Path, sources: list[Path]) -> None:
    if any(out.exists() and source.exists() and out.samefile(source) for source in sources):
        raise InputRefusedError([Fault("--out", str(out), "another file than the one that is read is accepted")])


def _unusable(path: Path, error: OSError) -> InputRefusedError:
    return InputRefusedError([FileFault(str(path), error, "give a file that can be read and written")])
