"""What several commands share: exit codes, help texts, the words of a verdict."""

from __future__ import annotations

import argparse
import math
import signal
import sys
import threading
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext, redirect_stdout
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final, NoReturn

from magcal_service.base.errors import ConfigError, Fault, FileFault
from magcal_service.watch.diagnosing import of_recording

if TYPE_CHECKING:
    from magcal_service.many.executor import Executor
    from magcal_service.offline.each import Asked
    from magcal_service.recordings.recording import Recording

DONE: Final = 0  # of the contract, as the other two
REFUSED: Final = 2  # what argparse ends with for a wrong argument
NOT_TRUSTED: Final = 3  # done, but the reason not to use the result is in the output
CRAFT_HELP: Final = "which craft of a session that holds several"
RECORDING_HELP: Final = "the recording, by its descriptor or as a recorded session"
STDOUT: Final = Path("-")
"""What stands for standard output in ``--json -``."""
SOURCE_HELP: Final = "which magnetometer of a craft that has several, by the source of its samples"


class Parser(argparse.ArgumentParser):
    """A command's parser, which says what was probably meant by what it does not know.

    ``examples`` are whole command lines; ``more`` gives the text below them, worked out when the help is asked for.
    ``others`` are the commands of the same program, by name.
    """

    examples: Sequence[str] = ()
    more: Callable[[], str] | None = None
    others: Mapping[str, Parser] = MappingProxyType({})
    _given: Sequence[str] = ()

    def parse_known_args(  # type: ignore[override]
        self, args: Sequence[str] | None = None, namespace: argparse.Namespace | None = None
    ) -> tuple[argparse.Namespace, list[str]]:
        """As argparse's; what is not known is refused by the command that was given it."""
        self._given = tuple(sys.argv[1:] if args is None else args)
        options, unknown = super().parse_known_args(self._given, namespace)
        if unknown:
            self.error(f"unrecognized arguments: {' '.join(unknown)}")
        return options, unknown

    def error(self, message: str) -> NoReturn:
        """As argparse's, with what was probably meant."""
        from magcal_service.cli.meant import hints

        super().error("\n".join([message, *hints(self, self._given, self.others)]))

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        if action.choices is not None and value not in action.choices:
            from magcal_service.base.typed_toml import nearest

            raise argparse.ArgumentError(action, f"{value!r} is refused; {nearest(str(value), action.choices)}")

    def format_help(self) -> str:
        """The help of argparse, the examples, and ``more``."""
        shown = "".join(f"  {example}\n" for example in self.examples)
        text = super().format_help() + (f"\nexamples:\n{shown}" if shown else "")
        return text + (self.more() if self.more is not None else "")


def subparsers(parser: argparse.ArgumentParser) -> dict[str, Parser]:
    """The commands of a parser by name; none where it has none."""
    found: dict[str, Parser] = {}
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            found |= action.choices
    return found


_SHOWING: Final = ("apply", "calibrate", "describe", "diagnose", "inspect", "plot", "record", "replay", "study")
"""Commands that may take more than two seconds, and say how far they are."""


def add_quiet(commands: dict[str, Parser]) -> None:
    """``--quiet`` of the commands that show how far they are, sub-commands included."""
    for command in (commands[name] for name in _SHOWING):
        for one in subparsers(command).values() or (command,):
            one.add_argument("--quiet", action="store_true", help="do not show how far it is, on stderr")


def described(parser: Parser, others: Mapping[str, Parser] | None = None) -> None:
    """Let the help of every command begin with the line that stands for it in the list of commands, and every command
    know the ``others`` of its program."""
    parser.others = others = subparsers(parser) if others is None else others
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for entry in action._choices_actions:
                command = action.choices[entry.dest]
                command.description = command.description or entry.help
                described(command, others)


@contextmanager
def beside_json(path: Path | None) -> Iterator[None]:
    """Within, what is said for people goes to stderr where the JSON goes to stdout (``--json -``)."""
    with redirect_stdout(sys.stderr) if path == STDOUT else nullcontext():
        yield


def end_by_signal(stop: threading.Event) -> None:
    """Set ``stop`` where the process is told to end, or its terminal is closed and no ``nohup`` has it go on."""
    numbers = [signal.SIGTERM, signal.SIGINT]
    if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:
        numbers.append(signal.SIGHUP)
    for number in numbers:
        signal.signal(number, lambda *_: stop.set())


def write_json(path: Path | None, text: str) -> None:
    """Write to a file, to standard output where it is ``-``, nowhere without one; raises ``InputRefusedError``."""
    if path is not None:
        write_text(None if path == STDOUT else path, text)


def write_text(path: Path | None, text: str) -> None:
    """Write to a file, to standard output without one; raises ``InputRefusedError``."""
    from magcal_service.base.errors import unwritable

    if path is None:
        sys.stdout.write(text)
        return
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise unwritable(path, error) from None


def source_lines(recording: Recording) -> list[str]:
    """Whose samples were read, where the craft has several magnetometers."""
    if not recording.others:
        return []
    return [f"magnetometer {recording.source}; --source chooses another: {', '.join(recording.others)}"]


def within(low: float, high: float, accepted: str = "") -> Callable[[str], float]:
    """The type of an argument that is a number from ``low`` to ``high``; ``accepted`` says so in other words."""

    def number(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not low <= value <= high:
            words = accepted or f"{low:g} to {high:g}"
            raise argparse.ArgumentTypeError(f"{text!r} is refused; {words} is accepted")
        return value

    return number


def port_number(text: str) -> int:
    """The type of an argument that is a TCP port, 0 included."""
    if not (text.isascii() and text.isdigit() and len(text) <= 5 and int(text) <= 65535):
        raise argparse.ArgumentTypeError(f"{text!r} is refused; 0 to 65535 is accepted")
    return int(text)


REPLAY_SPEED: Final = within(0.0, 1e6, "0 (as fast as it goes) to 1e6")
"""The speed of a replay, times real time."""


def add_executor(parser: argparse.ArgumentParser) -> None:
    """The arguments that say where many pieces of work are done, beside the command's own ``--out``."""
    engines = "processes of this machine, or the workers of a dask scheduler (default: pool)"
    parser.add_argument("--executor", metavar="pool|dask://HOST:PORT", help=engines)
    parser.add_argument("--workers", type=int, metavar="N", help="processes of the pool (default: one per core)")
    kept = "do not do again what is finished in the folder of --out already"
    parser.add_argument("--resume", action="store_true", help=kept)


def executor_of(options: argparse.Namespace) -> Executor:
    """What ``add_executor`` and ``--out`` ask for; raises ``ConfigError``."""
    from magcal_service.many.executor import POOL, Executor, engine_for
    from magcal_service.many.store import FOLDER, Store
    from magcal_service.offline.result_files import prepare_folder

    engine = engine_for(options.executor or POOL, options.workers)
    if options.out is not None:
        prepare_folder(options.out)
        return Executor(engine, Store(options.out / FOLDER, reuse=options.resume))
    if options.resume:
        accepted = "finished pieces are kept in the folder of --out; name that folder"
        raise ConfigError([Fault("--resume", "no --out", accepted)])
    return Executor(engine)


def refuse_executor(options: argparse.Namespace, accepted: str) -> None:
    """Refuse the arguments of ``add_executor`` where one recording is worked on alone; raises ``ConfigError``."""
    given = {"--executor": options.executor, "--workers": options.workers, "--resume": options.resume or None}
    faults = [Fault(name, value, accepted) for name, value in given.items() if value is not None]
    if faults:
        raise ConfigError(faults)


def refuse_unwritable(path: Path | None, *inputs: Path | None) -> None:
    """Refuse before the work is done an output file that plainly cannot be written after it.

    Nor may it be one of the ``inputs``, nor a file that one of them names, such as the log of a descriptor.
    """
    from magcal_service.base.errors import InputRefusedError, unwritable

    if path is None or path == STDOUT:
        return
    if path.is_dir():
        raise InputRefusedError([FileFault.of_folder(str(path), "give a file that can be written")])
    if not path.parent.is_dir():
        raise unwritable(path, FileNotFoundError())
    for one in filter(None, inputs):
        for file in _read_with(one):
            if path.exists() and file.exists() and path.samefile(file):
                accepted = f"it is read ({one}), and would be gone; give another file"
                raise InputRefusedError([Fault(str(path), "the input itself", accepted)])


def _read_with(path: Path) -> Iterator[Path]:
    """An input, and the files beside it that a descriptor or a configuration names in any of its texts."""
    yield path
    if path.suffix.lower() != ".toml":
        return
    try:
        if path.stat().st_size > _LARGEST_TOML:
            return
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return  # whoever reads it says so
    open_values: list[object] = [content]
    while open_values:
        value = open_values.pop()
        if isinstance(value, dict):
            open_values += value.values()
        elif isinstance(value, list):
            open_values += value
        elif isinstance(value, str) and value and "\0" not in value and len(value) < _LONGEST_NAME:
            yield path.parent / value


_LARGEST_TOML: Final = 1 << 20  # 1 MiB, as the readers take
_LONGEST_NAME: Final = 4096  # of a path, as the kernel takes


def print_asked(asked: Asked) -> int:
    """Print the table of many recordings, faults on stderr; the exit code of them together."""
    print("\n".join(asked.table()))
    if asked.faults:
        print("\n".join(asked.faults), file=sys.stderr)
    return asked.exit_code


def methods_text() -> str:
    """Every method with its one line and what it needs beside field and reference, for a command's help."""
    from magcal_service.estimators import methods

    width = max(len(method.name) for method in methods())
    lines = (
        f"  {method.name:<{width}}  {method.summary}" + (f" (needs a channel: {method.needs})" if method.needs else "")
        for method in methods()
    )
    return "\nmethods:\n" + "\n".join(lines) + "\n"


def check_method(config: Path, name: str) -> None:
    """Refuse an unknown method by the file and field that name it, before anything is opened."""
    from magcal_service.estimators import find_method

    try:
        find_method(name)
    except ConfigError as error:
        fault = error.faults[0]
        raise ConfigError([Fault(f"{config.name}: craft.filter.method", fault.value, fault.accepted)]) from None


def verdict_text(verdict: str, reasons: Sequence[str], remedy: str, model: str, recording: Path) -> str:
    """The verdict with its reasons, what the model seems to leave out, and the remedy, a line each.

    The command that diagnoses is that of this ``recording``.
    """
    model = of_recording(model, str(recording))
    text = f"verdict: {verdict}"
    if reasons:
        text += f" ({', '.join(reasons)})"
    return "\n".join(filter(None, (text, model, remedy and f"remedy: {remedy}")))
