#!/usr/bin/env python3
"""A zenoh router until SIGTERM or SIGINT: what ``zenohd`` does, from the Python package alone."""

from __future__ import annotations

import argparse
import signal
import sys
import threading
from pathlib import Path

import zenoh

DEFAULT_CONFIG = Path(__file__).with_name("config") / "router.json5"


def load(path: Path, listen: str | None) -> zenoh.Config:
    """The router's configuration; ``listen`` such as ``tcp/127.0.0.1:7447`` replaces the file's endpoints."""
    config = zenoh.Config.from_file(str(path))
    config.insert_json5("mode", '"router"')
    if listen is not None:
        config.insert_json5("listen/endpoints", f'["{listen}"]')
    return config


def main() -> int:
    """Parse, open, wait; 0 after a signal, 2 where the router cannot be opened."""
    parser = argparse.ArgumentParser(description="A zenoh router until SIGTERM or SIGINT.")
    parser.add_argument("--config", type=Path, default=DEFAULT_CONFIG, help="zenoh configuration, JSON5")
    parser.add_argument("--listen", help="endpoint instead of the file's, such as tcp/127.0.0.1:7447")
    arguments = parser.parse_args()
    stop = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stop.set())
    zenoh.try_init_log_from_env()  # RUST_LOG, where it is set, says what is logged
    try:
        with zenoh.open(load(arguments.config, arguments.listen)):
            print("router open", flush=True)
            stop.wait()
    except zenoh.ZError as error:
        reason = str(error).partition(" at /")[0]
        print(f"router: {reason}; check the file and that no other program listens there", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
