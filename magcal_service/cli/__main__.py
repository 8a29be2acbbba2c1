"""The ``magcal`` command: parse, call, print.

Exit codes: 0 done; 2 the input or the configuration was refused, with one line per fault on stderr; 3 done, but the
result must not be trusted, with the reasons in the output.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence

from magcal_service.base.errors import MagcalError
from magcal_service.base.progress import showing
from magcal_service.base.version import __version__
from magcal_service.cli.apply import add_apply
from magcal_service.cli.calibrate import add_calibrate
from magcal_service.cli.common import DONE, Parser, add_quiet, described, subparsers
from magcal_service.cli.completion import add_completion, magcal_names
from magcal_service.cli.describe import add_describe
from magcal_service.cli.diagnose import add_diagnose
from magcal_service.cli.export import add_export
from magcal_service.cli.inspect import add_inspect
from magcal_service.cli.output import standard_output
from magcal_service.cli.plot import add_plot
from magcal_service.cli.record import add_record
from magcal_service.cli.reference import add_reference
from magcal_service.cli.replay import add_replay
from magcal_service.cli.run import add_run
from magcal_service.cli.send import add_send
from magcal_service.cli.status import add_status
from magcal_service.cli.study import add_study
from magcal_service.cli.view import add_view
from magcal_service.cli.watch import add_watch
from magcal_service.cli.xtce import add_xtce

# Matrices of nine rows gain nothing from threads, and waiting for them costs a quarter of a replay's time.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; returns its exit code."""
    options = whole_parser().parse_args(arguments)
    try:
        with standard_output(endless=getattr(options, "endless", False)), showing(getattr(options, "quiet", True)):
            code: int = options.command(options)
    except MagcalError as error:
        print(error, file=sys.stderr)
        return error.exit_code
    except KeyboardInterrupt:
        print("interrupted: what was asked for is not done", file=sys.stderr)
        return 130
    except BrokenPipeError:  # whoever read what has no end has seen enough
        return DONE
    return code


def whole_parser() -> Parser:
    """The parser of every command."""
    parser = Parser(prog="magcal", description="Real-time magnetometer calibration without attitude.")
    parser.examples = ("magcal calibrate output/paper/RECORDING.toml", "magcal calibrate --help")
    parser.add_argument("--version", action="version", version=f"magcal {__version__}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    add_run(commands.add_parser("run", help="the daemon: samples in, calibrated vectors and estimates out"))
    add_replay(commands.add_parser("replay", help="send a recording through the daemon's own path"))
    add_calibrate(commands.add_parser("calibrate", help="estimate the nine errors of a whole recording"))
    add_diagnose(commands.add_parser("diagnose", help="name the physics that a simulation left out, and show the gain"))
    add_describe(commands.add_parser("describe", help="a descriptor of a raw log: what is sure, and what is asked"))
    add_inspect(commands.add_parser("inspect", help="what is wrong with a recording itself, before any physics"))
    add_apply(commands.add_parser("apply", help="the calibrated vectors of a recording, by a result that is given"))
    add_export(commands.add_parser("export", help="the nine numbers of a result for flight software"))
    add_plot(commands.add_parser("plot", help="a figure for a paper: of a recording, a result, a diagnosis or a study"))
    add_study(
        commands.add_parser(
            "study", help="Monte-Carlo studies of the estimators, and real recordings held against what is known"
        )
    )
    add_status(commands.add_parser("status", help="ask a running daemon; exit code 3 where it is not healthy"))
    add_reference(commands.add_parser("reference", help="send the reference field of a craft that has none"))
    add_send(commands.add_parser("send", help="give a running daemon a command, and print its answer"))
    add_view(commands.add_parser("view", help="a live page in the browser, of a running daemon or of a recording"))
    add_watch(commands.add_parser("watch", help="a running daemon or a recording, live in a terminal of 80 by 24"))
    add_record(commands.add_parser("record", help="recorded sessions: info, check, export, recover, join, describe"))
    add_xtce(commands.add_parser("xtce", help="the telemetry of a ccsds: output link, described for mission control"))
    completion = commands.add_parser("completion", help="what completes these commands in a shell")
    add_completion(completion, parser, magcal_names)
    add_quiet(subparsers(parser))
    described(parser)
    return parser


if __name__ == "__main__":
    sys.exit(main())
