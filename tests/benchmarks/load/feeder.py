"""Many craft fed at 1 Hz by one zenoh session, in a process of its own: ``python -m tests.benchmarks.load.feeder``.

Standard input: one JSON object, the phases; standard output: one JSON object, what was answered in each and how late.
It puts plainly, as zenoh-pico does, and subscribes to vectors and statuses of all craft at once: a ``Link`` for a
thousand craft in one session would measure what its declarations cost that session.
"""

from __future__ import annotations

import json
import sys
import time
from dataclasses import replace
from itertools import pairwise

import zenoh
from zenoh import handlers

from magcal_service.wire.codec import decode, encode
from magcal_service.wire.keys import ROOT, key_of
from magcal_service.wire.messages import CalibratedVector, MagnetometerSample, Message, Status
from tests.benchmarks.load.served import percentile
from tests.daemon.service_processes import stream

_SLICE_S = 0.005


class Feeder:
    """Sends each craft's reference and sample of each second, spread evenly over it, and keeps when vectors came."""

    def __init__(self, session: zenoh.Session, crafts: list[str]) -> None:
        self._session, self._crafts = session, crafts
        messages = stream(seconds=300)
        self._samples = [one for one in messages if isinstance(one, MagnetometerSample)]
        self._references: list[Message] = [one for one in messages if not isinstance(one, MagnetometerSample)]
        self.sent_s: dict[tuple[str, int], float] = {}
        self.heard_s: dict[tuple[str, int], float] = {}
        self.told: dict[str, int] = {}  # counters of the newest status
        self.text = ""
        self._second = 0
        self._held = [
            session.declare_subscriber(f"{ROOT}/*/{key}", handlers.Callback(self._arrived, indirect=False))
            for key in ("result/calibrated/*", "result/status/*")
        ]

    def _arrived(self, sample: zenoh.Sample) -> None:
        message = decode(sample.payload.to_bytes())
        if isinstance(message, CalibratedVector):
            self.heard_s[message.craft, message.sequence] = time.monotonic()
        elif isinstance(message, Status):
            self.told, self.text = dict(message.counters), message.text

    def phase(self, count: int, seconds: int) -> None:
        """Feed the first ``count`` craft for so long."""
        begun_s, sent = time.monotonic(), 0
        while sent < count * seconds:
            due = min(count * seconds, int((time.monotonic() - begun_s) * count) + 1)
            for number in range(sent, due):
                second, craft = divmod(number, count)
                self._send(self._crafts[craft], self._second + second)
            sent = due
            time.sleep(_SLICE_S)
        self._second += seconds

    def _send(self, craft: str, second: int) -> None:
        self._put(replace(self._references[second], craft=craft))
        sample = replace(self._samples[second], craft=craft)
        self.sent_s[craft, sample.sequence] = time.monotonic()
        self._put(sample)

    def _put(self, message: Message) -> None:
        self._session.put(key_of(message), encode(message))

    def report(self, from_s: float, until_s: float) -> dict[str, float]:
        """Of the samples sent in an interval of the monotonic clock: how many, answered, quantiles of the delay [s]."""
        sent = {key: sent_s for key, sent_s in self.sent_s.items() if from_s <= sent_s < until_s}
        late = [self.heard_s[key] - sent_s for key, sent_s in sent.items() if key in self.heard_s]
        shares = dict.fromkeys((craft for craft, _ in sent), 0)
        for craft, sequence in sent:
            shares[craft] += (craft, sequence) in self.heard_s
        return {
            "sent": len(sent),
            "answered": len(late),
            "p50_s": percentile(late, 0.5),
            "p99_s": percentile(late, 0.99),
            "least_of_a_craft": min(shares.values()),
            "most_of_a_craft": max(shares.values()),
        }


def main() -> None:
    """Feed as asked."""
    order = json.loads(sys.stdin.read())
    connect = f'connect: {{endpoints: ["{order["endpoint"]}"]}}'
    config = zenoh.Config.from_json5(f'{{mode: "client", {connect}, scouting: {{multicast: {{enabled: false}}}}}}')
    with zenoh.open(config) as session:
        feeder = Feeder(session, order["crafts"])
        time.sleep(3.0)  # the daemon's wait for joining nodes is over
        edges = []
        for phase in order["phases"]:
            print("phase", flush=True)
            edges.append(time.monotonic())
            feeder.phase(phase["craft"], phase["seconds"])
        print("phase", flush=True)
        edges.append(time.monotonic())
        time.sleep(order["settle_s"])
        phases = [
            {**feeder.report(begun_s, ended_s), "took_s": ended_s - begun_s} for begun_s, ended_s in pairwise(edges)
        ]
        after = feeder.report(edges[-2] + 10.0, edges[-1])
    print(json.dumps({"phases": phases, "after_10_s": after, "told": feeder.told, "text": feeder.text}), flush=True)


if __name__ == "__main__":
    main()
