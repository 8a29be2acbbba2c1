"""A real daemon behind TLS or passwords, and everybody who may or may not talk to it."""

from __future__ import annotations

import contextlib
import json
import shutil
import socket
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Self

import zenoh

from magcal_service.links import Link, Role, open_link
from magcal_service.wire.codec import encode
from magcal_service.wire.keys import key_of
from magcal_service.wire.messages import Command, MagnetometerSample, Message, Status
from sim_sensor.demo.daemon_process import DaemonProcess

DEPLOY = Path(__file__).resolve().parents[2] / "deploy"
PATIENCE_S = 120.0  # where forty processes want two cores a daemon takes 60 s to start
STATUS_PERIOD_S = 1.0
CRAFT = f'\n[[craft]]\nname = "demo"\n[output]\nstatus_period_s = {STATUS_PERIOD_S}\n'


def free_port() -> int:
    """A port of 127.0.0.1 that was free a moment ago."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def make_certificates(folder: Path) -> Path:
    """An authority and its certificates, by the shipped script."""
    subprocess.run([DEPLOY / "make-certificates.sh", folder], check=True, capture_output=True, timeout=60)
    return folder


def expire(certificates: Path, folder: Path, name: str = "magcal-feeder") -> Path:
    """The key of one name with a certificate that the same authority signed and that ends at once."""
    folder.mkdir()
    shutil.copy(certificates / f"{name}.key", folder)
    shutil.copy(certificates / "ca.pem", folder)
    (folder / "extensions").write_text(f"basicConstraints=critical,CA:FALSE\nsubjectAltName=DNS:{name}\n")
    request = ["openssl", "req", "-new", "-key", folder / f"{name}.key", "-subj", f"/CN={name}"]
    csr = subprocess.run(request, check=True, capture_output=True, timeout=60).stdout
    sign = ["openssl", "x509", "-req", "-CA", certificates / "ca.pem", "-CAkey", certificates / "ca.key", "-days", "0"]
    sign += ["-set_serial", "77", "-extfile", folder / "extensions", "-out", folder / f"{name}.pem"]
    subprocess.run(sign, check=True, capture_output=True, timeout=60, input=csr)
    check = ["openssl", "x509", "-checkend", "0", "-noout", "-in", folder / f"{name}.pem"]
    while subprocess.run(check, check=False, capture_output=True, timeout=60).returncode == 0:
        time.sleep(0.1)
    time.sleep(1.1)  # its last second has to be over
    return folder


def shipped(name: str, certificates: Path, out: Path, **replaced: str) -> Path:
    """A shipped zenoh configuration with other certificates, and other texts, in place of the installed ones."""
    text = (DEPLOY / "config" / name).read_text()
    text = text.replace("/run/credentials/magcal.service/service.key", str(certificates / "magcal-service.key"))
    text = text.replace("/run/credentials/magcal.service/users", str(certificates / "users"))
    text = text.replace("/etc/magcal/tls", str(certificates))
    for old, new in replaced.items():
        assert old in text
        text = text.replace(old, new)
    out.write_text(text)
    out.chmod(0o600)
    return out


def sample(sequence: int = 0) -> MagnetometerSample:
    """A sample of the craft."""
    field_body_nt = (20000.0 + sequence, -5000.0, 40000.0)
    return MagnetometerSample(
        craft="demo", source="mag", sequence=sequence, time_ns=sequence * 10**9, field_body_nt=field_body_nt
    )


def command(sequence: int = 0, name: str = "status") -> Command:
    """A command to the craft."""
    return Command(craft="demo", source="console", sequence=sequence, time_ns=0, name=name)


class Door:
    """The daemon and the one who watches its status.

    Parameters
    ----------
    port: where it listens.
    watcher: the link of somebody who may look.
    log: the daemon's log.
    """

    def __init__(self, port: int, watcher: Link, log: Path) -> None:
        self.port, self.watcher, self.log = port, watcher, log
        self.heard: list[Message] = []
        self.counters: dict[str, int] = {}

    def listen(self) -> None:
        """Take in what arrives within a tenth of a second."""
        for message in self.watcher.receive(0.1):
            self.heard.append(message)
            if isinstance(message, Status):
                self.counters = dict(message.counters)

    def until(self, told: str, what: Callable[[], bool]) -> None:
        """Listen until it is so."""
        deadline = time.monotonic() + PATIENCE_S
        while not what():
            assert time.monotonic() < deadline, f"{told}: {self.counters}\n{self.log.read_text()[-2000:]}"
            self.listen()

    def rest(self) -> None:
        """Listen for two periods of the status: what was sent before has been counted."""
        deadline = time.monotonic() + 2.5 * STATUS_PERIOD_S
        while time.monotonic() < deadline:
            self.listen()

    def denied(self, name: str) -> int:
        """What the status has counted as ``link.denied.<name>``."""
        return self.counters.get(f"link.denied.{name}", 0)


@contextlib.contextmanager
def door(folder: Path, daemon_config: Path, watcher_config: Path) -> Iterator[Door]:
    """``magcal run`` with a zenoh configuration, watched by somebody who may."""
    port = free_port()
    link = f"zenoh:tls/127.0.0.1:{port}?mode=peer&listen=yes&config={daemon_config}"
    config = folder / "magcal.toml"
    config.write_text(f"version = 1\nlink = {json.dumps(link)}\n{CRAFT}")
    with DaemonProcess(config, folder / "daemon.log") as process:
        deadline = time.monotonic() + PATIENCE_S
        while '"text": "serving' not in process.log.read_text():
            process.check()
            assert time.monotonic() < deadline
            time.sleep(0.05)
        address = f"zenoh:tls/127.0.0.1:{port}?config={watcher_config}"
        with open_link(address, Role.VIEWER, crafts=["demo"]) as watcher:
            found = Door(port, watcher, process.log)
            found.until("no status", lambda: bool(found.counters))
            yield found
            process.check()


@contextlib.contextmanager
def caller(door: Door, config: Path, role: Role) -> Iterator[Link]:
    """Somebody at the door with a zenoh configuration."""
    with open_link(f"zenoh:tls/127.0.0.1:{door.port}?config={config}", role, crafts=["demo"]) as link:
        yield link


class Blunt:
    """One who puts straight on the wire, at a port of 127.0.0.1, with a zenoh configuration.

    A node's link would not do for what a rule denies: its publisher asks who subscribes, is shown nobody, and puts
    nothing more, so that what reaches the daemon is what was put before the answer came.
    """

    def __init__(self, port: int, config: Path) -> None:
        settings = zenoh.Config.from_file(config)
        settings.insert_json5("mode", '"client"')
        settings.insert_json5("connect/endpoints", json.dumps([f"tls/127.0.0.1:{port}"]))
        settings.insert_json5("connect/timeout_ms", str(int(1000 * PATIENCE_S)))
        self._session = zenoh.open(settings)

    def put(self, message: Message) -> None:
        """Put one message on its key."""
        self._session.put(key_of(message), encode(message))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._session.close()  # type: ignore[no-untyped-call]


def knock_raw(port: int, data: bytes) -> None:
    """Somebody at the door who speaks no TLS."""
    with socket.create_connection(("127.0.0.1", port), timeout=5.0) as connection:
        connection.sendall(data)
        with contextlib.suppress(OSError):
            connection.recv(1024)
