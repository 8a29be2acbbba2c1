"""The daemon from its configuration: what is checked and opened before the service serves, and closed after it."""

from __future__ import annotations

import logging
import threading
from contextlib import ExitStack
from typing import TYPE_CHECKING

from magcal_service.base.errors import ConfigError, Fault
from magcal_service.config.daemon_settings import StateConfig
from magcal_service.config.private_files import check_input, check_state_directory, check_way
from magcal_service.config.settings import Config
from magcal_service.daemon import notify
from magcal_service.daemon.checkpoints.store import Checkpoints
from magcal_service.daemon.command_limit import CommandLimit
from magcal_service.daemon.estimate_csv import EstimateCsv
from magcal_service.daemon.health.metrics_server import MetricsServer
from magcal_service.daemon.outputs import Outputs
from magcal_service.daemon.service import Service
from magcal_service.links import Role, open_link
from magcal_service.ticks.reference_track import REMEMBERED

if TYPE_CHECKING:
    from magcal_service.recordings.recorder import Recorder

log = logging.getLogger("magcal")


def _csv(config: Config, stack: ExitStack) -> EstimateCsv | None:
    path = config.output.csv
    return None if path is None else stack.enter_context(EstimateCsv(path, append=True))


def _recorder(config: Config, stack: ExitStack) -> Recorder | None:
    if config.record is None:
        return None
    from magcal_service.recordings.recorder import (
        open_recorder,  # the packages of its extra are loaded where it is asked for
    )

    return stack.enter_context(open_recorder(config.record, config.crafts))


def check_directories(config: Config) -> None:
    """Reject folders, and files on the way to them, that anybody could replace before anything is read from them."""
    if config.record is not None and config.record.directory.exists():
        check_state_directory(config.record.directory)
    if config.state is not None:
        _check_counters(config.state)
        crafts = [config.state.directory / craft.name for craft in config.crafts]
        beside = [folder for craft in crafts if craft.is_dir() for folder in sorted(craft.iterdir()) if folder.is_dir()]
        counters = [] if config.state.counters is None else [config.state.counters]
        for folder in (config.state.directory, *crafts, *beside, *counters):
            check_way(folder)
            if folder.exists():
                check_state_directory(folder)
    for craft in config.crafts:
        if craft.physics is not None:
            check_input(craft.physics.path)


def _check_counters(state: StateConfig) -> None:
    """Reject a folder of counters that whoever may write the checkpoints can write as well."""
    if state.counters is not None and state.counters.resolve().is_relative_to(state.directory.resolve()):
        accepted = f"a folder outside {state.directory} is accepted: whoever can write that one could write it too"
        raise ConfigError([Fault("state.counters", str(state.counters), accepted)])


def check_history(config: Config, history: int) -> None:
    """Reject a longer history than the samples that a state keeps: what lies before would be used twice."""
    if config.state is not None and history > REMEMBERED:
        accepted = f"with [state], history=0 to history={REMEMBERED} is accepted"
        raise ConfigError([Fault("link", f"history={history}", accepted)])


def run_daemon(config: Config, stop: threading.Event) -> None:
    """Open what the configuration names and serve until ``stop`` is set.

    Raises ``LinkAddressError``, ``LinkError`` or ``InputRefusedError`` where something cannot be opened at all.
    """
    crafts = [craft.name for craft in config.crafts]
    check_directories(config)
    with ExitStack() as stack:
        checkpoints = None
        if config.state is not None:  # first of all: another daemon's files are not to be touched
            checkpoints = stack.enter_context(Checkpoints(config.state, config.crafts))
        csv, recorder = _csv(config, stack), _recorder(config, stack)
        link = stack.enter_context(open_link(config.link, Role.SERVICE, crafts=crafts))
        check_history(config, link.history)
        metrics = None if config.health.metrics is None else stack.enter_context(MetricsServer(config.health.metrics))
        outputs = stack.enter_context(Outputs(config.output.links, crafts)) if config.output.links else None
        service = Service(config, link, csv, recorder, checkpoints, metrics, outputs=outputs)
        if link.live:
            service.limit = CommandLimit(config.commands, service.counters)
        service.restore()
        log.info("serving %s on %s", ", ".join(crafts), ", ".join((config.link, *config.output.links)))
        for warning in link.warnings:
            log.warning("%s: %s", config.link, warning)
        notify.notify(notify.READY)
        service.run(stop)
        notify.notify(notify.STOPPING)
        log.info("stopped")
