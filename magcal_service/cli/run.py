"""``magcal run``: the daemon."""

from __future__ import annotations

import argparse
import threading
from pathlib import Path

from magcal_service.cli.common import DONE, Parser, check_method, end_by_signal


def add_run(parser: Parser) -> None:
    """The arguments of ``magcal run``."""
    parser.add_argument("--config", type=Path, required=True, metavar="FILE", help="TOML configuration")
    checked = "read and check the configuration, its files and who may touch them; then end without serving (0 or 2)"
    parser.add_argument("--check", action="store_true", help=checked)
    parser.examples = (
        "magcal run --config deploy/config/zenoh-peer.toml",
        "magcal run --check --config deploy/config/zenoh-peer.toml",
    )
    parser.set_defaults(command=_run, endless=True)


def _run(options: argparse.Namespace) -> int:
    from magcal_service.base import log
    from magcal_service.config.private_files import check_unaltered
    from magcal_service.config.reader import load_config
    from magcal_service.daemon.check import check_daemon
    from magcal_service.daemon.run import run_daemon

    config = load_config(options.config)
    check_unaltered(options.config)
    for craft in config.crafts:
        check_method(options.config, craft.filter.method)
    if options.check:
        print("\n".join(check_daemon(config)))
        return DONE
    stop = threading.Event()
    end_by_signal(stop)
    log.to_stderr()
    run_daemon(config, stop)
    return DONE
