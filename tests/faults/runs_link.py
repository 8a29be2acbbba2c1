"""Links that are cut, spoilt and talked over."""

from __future__ import annotations

import random
import time
from collections.abc import Callable
from pathlib import Path

import zenoh

from magcal_service.wire.codec import encode
from magcal_service.wire.framing import ReceivedFrame, unpack_frame
from magcal_service.wire.keys import key_of
from magcal_service.wire.messages import MagnetometerSample
from tests.daemon.service_processes import CutCable, free_port, stream, write_config
from tests.faults.bench import Cable, Daemons, Feeder, Proxy, Witness
from tests.faults.faults import Fault, Outcome

RATE_HZ = 200.0


def cut_network(folder: Path, quick: bool) -> Outcome:
    """A TCP connection that is cut for a while, what is under way included."""
    outcome = Outcome(Fault.CUT_NETWORK, "zenoh")
    cuts = 1 if quick else 5
    port = free_port()
    config = write_config(folder, f"zenoh:tcp/127.0.0.1:{port}?history=1000")
    with Daemons(config), Proxy(port) as proxy, Witness(f"zenoh:tcp/127.0.0.1:{proxy.port}") as node:
        node.until_heard()
        with Feeder(node, stream(seconds=1800)[: 600 * (cuts + 1)], RATE_HZ) as feeder:
            for cut in range(cuts):
                feeder.reach(200 + 600 * cut)
                proxy.cut.set()
                time.sleep(1.0)
                node.mark()
                proxy.cut.clear()
                feeder.until(lambda: node.marked_s is None, "no vector after the cut")
            feeder.close_books()
        outcome.fed, outcome.accepted, outcome.refused = node.sent, node.counters()["accepted"], node.refused
        outcome.used(node.counters())
        outcome.recovered_s = max(node.recovered_s, default=None)
    outcome.balance()
    outcome.notes.append(f"{cuts} cuts of 1 s; {node.sent - len(node.first_s)} vectors did not reach the node")
    return outcome


def cut_serial(folder: Path, quick: bool) -> Outcome:
    """A cable that is pulled out for a while."""
    outcome = Outcome(Fault.CUT_SERIAL, "serial", in_flight=50)
    with CutCable() as cable:
        config = write_config(folder, f"serial:{cable.paths[0]}")
        with Daemons(config), Witness(f"serial:{cable.paths[1]}") as node:
            node.until_heard()
            messages = stream(seconds=600)[: 400 if quick else 1200]
            with Feeder(node, messages[:200], RATE_HZ) as feeder:
                feeder.settle()
            cable.cut.set()
            node.send(messages[200:300])
            node.listen(1.0)
            cable.cut.clear()
            node.mark()
            with Feeder(node, messages[300:], RATE_HZ) as feeder:
                feeder.close_books(lambda: outcome.in_flight)
            outcome.fed, outcome.accepted, outcome.refused = node.sent, node.counters()["accepted"], node.refused
            outcome.recovered_s = max(node.recovered_s, default=None)
            counted = node.counters().get("link.lost", 0)
    outcome.balance()
    outcome.expect(counted == 100, f"the daemon counts {counted} lost messages of 100")
    outcome.notes.append(f"100 messages sent while it was out; the daemon counts {counted} of them as lost")
    return outcome


class Frames:
    """What goes over a cable, frame by frame.

    Parameters
    ----------
    spoil: what becomes of one frame, with its delimiters, and whether it is spoilt.
    """

    def __init__(self, spoil: Callable[[bytes], tuple[bytes, bool]]) -> None:
        self._spoil = spoil
        self._rest = b""
        self.on = False
        self.spoilt: list[ReceivedFrame] = []

    def samples(self) -> int:
        """How many of those that were spoilt were samples of the magnetometer."""
        return sum(frame.kind == 1 for frame in self.spoilt)

    def __call__(self, data: bytes) -> bytes:
        """Bytes in, bytes out, as soon as a frame is whole."""
        *bodies, self._rest = (self._rest + data).split(b"\0")
        return b"".join(self._passed(body) for body in bodies if body)

    def _passed(self, body: bytes) -> bytes:
        frame = b"\0" + body + b"\0"
        if not self.on:
            return frame
        result, spoilt = self._spoil(frame)
        if spoilt:
            whole = unpack_frame(body)
            assert isinstance(whole, ReceivedFrame)
            self.spoilt.append(whole)
        return result


def _spoil(chance: random.Random) -> Callable[[bytes], tuple[bytes, bool]]:
    """Every fourth frame gets a flipped bit, another is cut short."""

    def spoil(frame: bytes) -> tuple[bytes, bool]:
        fate = chance.random()
        place = chance.randrange(2, len(frame) - 1)
        if fate < 0.15:
            flipped = bytearray(frame)
            flipped[place] ^= 1 << chance.randrange(8)
            return bytes(flipped), True
        if fate < 0.3:
            return frame[:place], True
        return frame, False

    return spoil


def _noise(chance: random.Random) -> Callable[[bytes], tuple[bytes, bool]]:
    """Noise behind half of the frames, and in the middle of every tenth."""

    def spoil(frame: bytes) -> tuple[bytes, bool]:
        noise = chance.randbytes(chance.randrange(1, 60))
        fate = chance.random()
        if fate < 0.1:
            place = chance.randrange(2, len(frame) - 1)
            return frame[:place] + noise + frame[place:], True
        return (frame + noise, False) if fate < 0.6 else (frame, False)

    return spoil


def corrupt_frames(folder: Path, quick: bool) -> Outcome:
    """Flipped bits and cut frames on a serial line."""
    return _spoilt_line(Outcome(Fault.CORRUPT_FRAMES, "serial"), folder, Frames(_spoil(random.Random(7))), quick)


def garbage(folder: Path, quick: bool) -> Outcome:
    """Noise on a serial line that is talking, between the frames and within."""
    return _spoilt_line(Outcome(Fault.GARBAGE, "serial"), folder, Frames(_noise(random.Random(8))), quick)


def _spoilt_line(outcome: Outcome, folder: Path, frames: Frames, quick: bool) -> Outcome:
    messages = stream(seconds=1200)[: 500 if quick else 2400]
    with Cable(frames) as cable:
        config = write_config(folder, f"serial:{cable.paths[0]}")
        with Daemons(config), Witness(f"serial:{cable.paths[1]}") as node:
            node.until_heard()
            frames.on = True
            with Feeder(node, messages[:-20], RATE_HZ) as feeder:
                feeder.settle(frames.samples)
            frames.on = False
            with Feeder(node, messages[-20:], RATE_HZ) as feeder:
                feeder.close_books(frames.samples)
            counters = node.counters()
            outcome.fed, outcome.accepted, outcome.refused = node.sent, counters["accepted"], node.refused
    refusals = sum(count for name, count in counters.items() if name.startswith("link.refused."))
    outcome.in_flight = frames.samples()
    outcome.balance()
    invented = set(node.first_s) - set(node.sent_s)
    outcome.expect(not invented, f"vectors for samples that nobody sent: {sorted(invented)[:5]}")
    lost = counters.get("link.lost", 0)
    outcome.expect(lost == len(frames.spoilt), f"{lost} counted as lost, {len(frames.spoilt)} spoilt")
    outcome.expect(refusals >= len(frames.spoilt) // 2, f"{refusals} refusals for {len(frames.spoilt)} spoilt frames")
    outcome.notes.append(
        f"{len(frames.spoilt)} frames spoilt, {refusals} refusals counted, {lost} messages counted as lost"
    )
    return outcome


def corrupt_payloads(folder: Path, quick: bool) -> Outcome:
    """Payloads on the right key that are no messages: cut short, with bytes behind, random."""
    outcome = Outcome(Fault.CORRUPT_PAYLOADS, "zenoh")
    chance = random.Random(9)
    port = free_port()
    address = f"zenoh:tcp/127.0.0.1:{port}"
    messages = stream(seconds=600)[: 400 if quick else 1200]
    put = 200 if quick else 2000
    with Daemons(write_config(folder, address)), Witness(address) as node, zenoh.open(_client(port)) as rogue:
        node.until_heard()
        with Feeder(node, messages, RATE_HZ) as feeder:
            for _ in range(put):
                message = chance.choice(messages)
                payload = encode(message)
                cut = payload[: chance.randrange(len(payload))]
                rogue.put(key_of(message), chance.choice([cut, payload + b"\0", chance.randbytes(60), b"\xc1" + cut]))
                time.sleep(0.001)
            feeder.close_books()
        counters = node.counters()
        outcome.fed, outcome.accepted, outcome.refused = node.sent, counters["accepted"], node.refused
    counted = sum(count for name, count in counters.items() if name.startswith("link.refused."))
    outcome.balance()
    outcome.expect(counted == put, f"{counted} of {put} spoilt payloads counted")
    outcome.notes.append(f"{put} spoilt payloads put, {counted} counted as refused")
    sent = sum(isinstance(message, MagnetometerSample) for message in messages)
    outcome.expect(outcome.fed == sent, "the node did not send all")
    return outcome


def _client(port: int) -> zenoh.Config:
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", f'["tcp/127.0.0.1:{port}"]')
    config.insert_json5("scouting/multicast/enabled", "false")
    return config
