"""More than the daemon can take."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from magcal_service.links import Link, Role, open_link
from magcal_service.wire.messages import Status
from tests.daemon.service_processes import free_port, stream, write_config
from tests.faults.bench import Daemons, Feeder, Witness
from tests.faults.faults import Fault, Outcome

ROOT = Path(__file__).resolve().parents[2]
FLOOD_HZ = 10_000

# Puts the samples of one craft on zenoh as fast as asked, encoded beforehand; prints how many it put and in what time.
FLOOD = """
import sys, time, zenoh
from magcal_service.wire.codec import encode
from magcal_service.wire.messages import MagnetometerSample, ReferenceSample
port, seconds, rate_hz = int(sys.argv[1]), float(sys.argv[2]), int(sys.argv[3])
def sample(number):
    return encode(MagnetometerSample(craft="flood", source="mag", sequence=number, time_ns=number * 10**9 // rate_hz,
                                     field_body_nt=(20000.0 + number % 100, -5000.0, 40000.0)))
def reference(number):
    return encode(ReferenceSample(craft="flood", source="ref", sequence=number, time_ns=number * 10**9,
                                  magnitude_nt=45000.0))
payloads = [sample(number) for number in range(int(seconds * rate_hz))]
config = zenoh.Config()
config.insert_json5("mode", '"client"')
config.insert_json5("connect/endpoints", f'["tcp/127.0.0.1:{port}"]')
config.insert_json5("scouting/multicast/enabled", "false")
with zenoh.open(config) as session:
    publisher = session.declare_publisher("magcal/v1/flood/sample/magnetometer/mag")
    time.sleep(0.5)
    print("open", flush=True)
    begun_s = time.monotonic()
    for number, payload in enumerate(payloads):
        if number % rate_hz == 0:
            session.put("magcal/v1/flood/sample/reference/ref", reference(number // rate_hz))
        publisher.put(payload)
        ahead_s = number / rate_hz - (time.monotonic() - begun_s)
        if ahead_s > 0.002:
            time.sleep(ahead_s)
    print(len(payloads), time.monotonic() - begun_s, flush=True)
"""


def percentile(values: list[float], share: float) -> float:
    """The value that this share of all does not exceed."""
    return sorted(values)[min(len(values) - 1, int(share * len(values)))]


def flood(folder: Path, quick: bool) -> Outcome:
    """One craft at 10 kHz, another at 1 Hz: the calm one's vectors and estimates, and how late they are.

    How late they are without a flood is measured first; where other work keeps the machine busy, three times that is
    allowed.
    """
    outcome = Outcome(Fault.FLOOD, "zenoh")
    calm, seconds = (5, 8) if quick else (20, 60)
    messages = stream(seconds=600)[: 2 * (calm + seconds)]
    port = free_port()
    address = f"zenoh:tcp/127.0.0.1:{port}"
    config = write_config(folder, address, crafts=("paper", "flood"))
    with Daemons(config), Witness(address) as node:
        node.until_heard()
        with Feeder(node, messages[: 2 * calm], 2.0) as feeder:
            feeder.settle()
        calm_s = _ticks(node)
        command = [sys.executable, "-c", FLOOD, str(port), str(seconds), str(FLOOD_HZ)]
        with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True) as flooder:
            assert flooder.stdout is not None
            assert flooder.stdout.readline() == "open\n"
            with Feeder(node, messages[2 * calm :], 2.0) as feeder:
                feeder.settle()
                put, took_s = flooder.stdout.readline().split()
                feeder.close_books()
        outcome.fed, outcome.accepted, outcome.refused = node.sent, node.counters()["accepted"], node.refused
        late_s = [node.first_s[key] - sent_s for key, sent_s in node.sent_s.items() if key in node.first_s][calm:]
        ticks_s = _ticks(node)[len(calm_s) :]
        with open_link(address, Role.VIEWER, crafts=["flood"]) as viewer:
            flooded = _newest_status(viewer)
    outcome.balance()
    late_ms, tick_ms, calm_ms = (1e3 * percentile(values, 0.99) for values in (late_s, ticks_s, calm_s))
    estimates = len(ticks_s) + len(calm_s)
    outcome.expect(estimates >= outcome.fed - 2, f"{estimates} estimates for {outcome.fed} seconds")
    allowed_ms = max(100.0, 3.0 * calm_ms)
    outcome.expect(tick_ms < allowed_ms, f"p99 of the estimates' lateness is {tick_ms:.0f} ms, {calm_ms:.0f} ms before")
    told = {name: flooded.get(name, 0) for name in ("accepted", "crowded", "ticks", "link.overflow", "link.lost")}
    outcome.notes.append(f"the flood put {put} samples in {float(took_s):.1f} s; what became of them: {told}")
    outcome.notes.append(
        f"the calm craft's p99 lateness: vector {late_ms:.1f} ms, estimate {tick_ms:.1f} ms, before it {calm_ms:.1f} ms"
    )
    return outcome


def _newest_status(viewer: Link) -> dict[str, int]:
    """The counters of the status that a late joiner gets at once."""
    for _ in range(100):
        for message in viewer.receive(0.2):
            if isinstance(message, Status):
                return dict(message.counters)
    raise TimeoutError("no status of the flooding craft")


def _ticks(node: Witness) -> list[float]:
    """How late each estimate of the calm craft came after the sample that closed its tick [s]."""
    sent_s = sorted(node.sent_s.values())
    return [min(heard_s - one for one in sent_s if one <= heard_s) for heard_s in node.estimate_s["paper"]]
