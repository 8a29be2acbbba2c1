"""What a configuration names, checked as far as it can be before the daemon serves: for ``magcal run --check``."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

from magcal_service.base.errors import ConfigError, Fault, MagcalError
from magcal_service.config.address import parse_address
from magcal_service.config.private_files import read_key
from magcal_service.config.settings import Config
from magcal_service.daemon.run import check_directories, check_history
from magcal_service.links.checking import check_link


class CheckFailedError(MagcalError):
    """A configuration that the daemon would not serve by: every fault that was found, a line each."""


def check_daemon(config: Config) -> list[str]:
    """Check folders, files, permissions, keys, addresses and extras; nothing is opened to others, nothing written.

    Returns what was checked, a line each.  Raises ``CheckFailedError`` with every fault.
    """
    names = [craft.name for craft in config.crafts]
    checks: list[Callable[[], object]] = [lambda: check_directories(config), lambda: _check_record(config)]
    checks.append(lambda: check_history(config, check_link(config.link, names)))
    checks += [lambda one=address: check_link(one, names) for address in config.output.links]  # type: ignore[misc]
    checks += [lambda: _check_state(config), lambda: _check_csv(config.output.csv)]
    faults = []
    for check in checks:
        try:
            check()
        except MagcalError as error:
            faults.append(str(error))
    if faults:
        raise CheckFailedError("\n".join(faults))
    return _checked(config, names)


def _checked(config: Config, names: list[str]) -> list[str]:
    lines = [f"craft: {', '.join(names)}", f"link: {config.link} (not opened)"]
    lines += [f"output link: {address}" for address in config.output.links]
    physics = [(one.name, one.physics) for one in config.crafts if one.physics is not None]
    lines += [f"physics of {name}: {said}" for name, of in physics for said in (of.path, *of.doubts)]
    named = {
        "estimates": config.output.csv,
        "recordings": None if config.record is None else config.record.directory,
        "state": None if config.state is None else config.state.directory,
    }
    lines += _undriven(config)
    return [*lines, *(f"{what}: {path}" for what, path in named.items() if path is not None), "sound"]


def _undriven(config: Config) -> list[str]:
    """Which effects of a ``physics.toml`` follow channels that the recording on the link does not have, a line each.

    What a link that is not a recording will bring, nobody knows yet.
    """
    address = parse_address(config.link)
    if address.scheme != "recording" or not any(craft.physics for craft in config.crafts):
        return []
    from magcal_service.links.recording import RecordingLink
    from magcal_service.physics.apply.lacking import undriven_lines
    from magcal_service.physics.apply.model_file import parse_model

    with RecordingLink(address, [craft.name for craft in config.crafts]) as link:
        channels, found = link.driving, []
    for craft in config.crafts:
        if craft.physics is not None:
            model = parse_model(craft.physics.text.encode(), craft.physics.name)
            found += undriven_lines(craft.physics.name, model, channels)
    return found


def _check_state(config: Config) -> None:
    if config.state is None:
        return
    _check_folder("state.directory", config.state.directory)
    if config.state.key is not None:
        read_key(config.state.key)
    if config.state.counters is not None:
        _check_folder("state.counters", config.state.counters)


def _check_record(config: Config) -> None:
    if config.record is None:
        return
    import magcal_service.recordings.recorder  # noqa: F401 - a missing extra is told

    _check_folder("record.directory", config.record.directory)


def _check_csv(path: Path | None) -> None:
    if path is None:
        return
    if path.is_dir():
        raise ConfigError([Fault("output.csv", str(path), "it is a folder; a file is accepted")])
    if not path.parent.is_dir():
        raise ConfigError([Fault("output.csv", str(path), f"there is no folder {path.parent}; make it first")])
    if not os.access(path if path.exists() else path.parent, os.W_OK):
        raise ConfigError([Fault("output.csv", str(path), "a file that this user can write is accepted")])


def _check_folder(field: str, folder: Path) -> None:
    """Refuse a folder that this user can neither write nor make."""
    there = next(place for place in (folder.absolute(), *folder.absolute().parents) if place.exists())
    if not there.is_dir() or not os.access(there, os.W_OK | os.X_OK):
        accepted = f"a folder that this user can make and write is accepted; {there} is none"
        raise ConfigError([Fault(field, str(folder), accepted)])
