"""Who must not get in, at a daemon with certificates and access rules that is at work."""

from __future__ import annotations

import contextlib
import itertools
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from magcal_service.links import Role, open_link
from magcal_service.wire.messages import Command, MagnetometerSample
from tests.daemon.service_processes import free_port, stream, write_config
from tests.faults.bench import Daemons, Feeder, Witness
from tests.faults.faults import Fault, Outcome
from tests.security.rogue_links import PATIENCE_S, Blunt, expire, make_certificates, shipped

RATE_HZ = 200.0


class Guarded:
    """A daemon behind TLS at work: certificates, the daemon, and a feeder with its certificate."""

    def __init__(self, folder: Path, port: int, certificates: Path, node: Witness, feeder: Feeder) -> None:
        self.folder, self.port, self.certificates, self.node, self.feeder = folder, port, certificates, node, feeder

    def client(self, name: str, certificates: Path | None = None) -> Path:
        """The shipped client configuration for a name."""
        source = certificates or self.certificates
        out = self.folder / f"{source.name}-{name}.json5"
        return shipped("zenoh-tls-client.json5", source, out, **{"magcal-feeder": name})

    def denied(self, name: str) -> int:
        """What the status counts."""
        return self.node.counters().get(f"link.denied.{name}", 0)

    def knock(self, config: Path, name: str, what: Callable[[int], Command | MagnetometerSample]) -> None:
        """Somebody sends until the status counts it under this name."""
        address = f"zenoh:tls/127.0.0.1:{self.port}?config={config}"
        with open_link(address, Role.NODE, crafts=["paper"]) as rogue:
            self._until_denied(name, lambda number: rogue.send(what(number)))

    def put(self, config: Path, name: str, what: Callable[[int], Command | MagnetometerSample]) -> None:
        """The same of somebody who is let in and puts what no rule allows."""
        with Blunt(self.port, config) as rogue:
            self._until_denied(name, lambda number: rogue.put(what(number)))

    def _until_denied(self, name: str, send: Callable[[int], None]) -> None:
        deadline_s = time.monotonic() + PATIENCE_S
        for number in itertools.count():
            send(number)
            time.sleep(0.05)
            if self.denied(name):
                return
            if time.monotonic() > deadline_s:
                raise TimeoutError(f"{name} is not counted: {self.node.counters()}")


@contextlib.contextmanager
def guarded(folder: Path, outcome: Outcome, quick: bool) -> Iterator[Guarded]:
    """The daemon at work; on leaving, the books are closed."""
    certificates = make_certificates(folder / "tls")
    port = free_port()
    service = shipped("zenoh-tls.json5", certificates, folder / "service.json5")
    client = shipped("zenoh-tls-client.json5", certificates, folder / "feeder.json5")
    config = write_config(folder, f"zenoh:tls/127.0.0.1:{port}?config={service}")
    with Daemons(config), Witness(f"zenoh:tls/127.0.0.1:{port}?config={client}") as node:
        node.until_heard()
        with Feeder(node, stream(seconds=1200)[: 600 if quick else 2400], RATE_HZ) as feeder:
            yield Guarded(folder, port, certificates, node, feeder)
            feeder.close_books()
        outcome.fed, outcome.accepted, outcome.refused = node.sent, node.counters()["accepted"], node.refused
        denied = {name: count for name, count in node.counters().items() if name.startswith("link.denied.")}
        outcome.notes.append(f"the status counts {denied}")
        outcome.expect(len(node.first_s) == node.sent, "a vector is missing")
    outcome.balance()


def _sample(number: int) -> MagnetometerSample:
    field_body_nt = (1000.0, 2000.0, 3000.0 + number)
    return MagnetometerSample(craft="paper", source="mag", sequence=number, time_ns=number, field_body_nt=field_body_nt)


def _command(number: int) -> Command:
    return Command(craft="paper", source="rogue", sequence=number, time_ns=0, name="reset")


def expired_certificate(folder: Path, quick: bool) -> Outcome:
    """A former feeder, whose certificate has ended, sends samples."""
    outcome = Outcome(Fault.EXPIRED_CERTIFICATE, "zenoh, TLS")
    with guarded(folder, outcome, quick) as daemon:
        expired = expire(daemon.certificates, folder / "expired")
        daemon.knock(daemon.client("magcal-feeder", expired), "expired_certificate", _sample)
    return outcome


def rogue(folder: Path, quick: bool) -> Outcome:
    """Samples with no certificate, with a foreign one, with a viewer's; commands with a feeder's."""
    outcome = Outcome(Fault.ROGUE, "zenoh, TLS")
    with guarded(folder, outcome, quick) as daemon:
        bare = folder / "bare.json5"
        lines = daemon.client("magcal-feeder").read_text().splitlines()
        kept = [line for line in lines if "connect_" not in line or "verify" in line]
        bare.write_text("\n".join(kept).replace("enable_mtls: true", "enable_mtls: false"))
        daemon.knock(bare, "no_certificate", _sample)
        foreign = make_certificates(folder / "foreign")
        (foreign / "ca.pem").write_bytes((daemon.certificates / "ca.pem").read_bytes())
        daemon.knock(daemon.client("magcal-feeder", foreign), "wrong_certificate", _sample)
        daemon.put(daemon.client("magcal-viewer"), "sample", _sample)
        daemon.put(daemon.client("magcal-feeder"), "command", _command)
        counters = daemon.node.counters()
        outcome.expect(not counters.get("commands"), "a command of one who may not was carried out")
    return outcome
