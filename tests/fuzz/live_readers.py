"""Readers of what comes while the daemon runs, and of the state it starts from; what must hold of each result."""

from __future__ import annotations

import re
from collections.abc import Hashable
from dataclasses import replace
from functools import cache

from magcal_service.config.address import parse_address
from magcal_service.config.daemon_settings import StateConfig
from magcal_service.config.private_files import read_key
from magcal_service.config.settings import CraftConfig, FilterConfig, SensorConfig, SpinConfig
from magcal_service.daemon.checkpoints.store import Checkpoints
from magcal_service.daemon.pipeline import Pipeline
from magcal_service.links.counter_file import CounterFile
from magcal_service.wire.codec import decode, encode
from magcal_service.wire.framing import StreamDecoder
from magcal_service.wire.messages import Status
from magcal_service.wire.seal import SealGate
from tests.fuzz import dress
from tests.fuzz.inputs import file_of, flight, folder

_DIGITS = re.compile(r"[0-9]+")


def run_payload(data: bytes) -> Hashable:
    """What is accepted is encoded and accepted again as the same."""
    message = decode(data)
    assert repr(decode(encode(message))) == repr(message)
    return type(message)


def _gated() -> StreamDecoder:
    return StreamDecoder(gate=SealGate(dress.KEY, 0, lambda counter: None), refused=lambda command, error: None)


def run_stream(data: bytes) -> Hashable:
    """Whole or in pieces, gated or not: a stream gives messages and counters and never raises."""
    whole, pieces = StreamDecoder(), StreamDecoder()
    messages = whole.feed(data)
    size = 1 + len(data) // 7
    split = [message for at in range(0, len(data), size) for message in pieces.feed(data[at : at + size])]
    assert repr(messages) == repr(split)
    assert whole.counters == pieces.counters
    gated = _gated()
    gated.feed(data)
    return frozenset(whole.counters), frozenset(gated.counters)


def run_pipeline(data: bytes) -> Hashable:
    """Whatever messages come, in whatever order: what goes out can be sent, and the state stays finite."""
    outcomes: list[str] = []
    for craft in (CraftConfig("a"), CraftConfig("a", spin=SpinConfig(), filter=FilterConfig(start_s=10.0))):
        pipeline = Pipeline(craft)
        for message in StreamDecoder().feed(data):
            for answer in pipeline.handle(message):
                encode(answer)
        for answer in pipeline.flush():
            encode(answer)
        assert isinstance(pipeline.status(1.0, pipeline.ticks.counters), Status)
        outcomes += [name for name, count in (pipeline.ticks.counters + pipeline.counters).items() if count]
    return frozenset(outcomes)


def run_counter(data: bytes) -> Hashable:
    """A counter is believed or it is not."""
    last = CounterFile(file_of("counter", data)).last
    assert last is None or 0 <= last < 1 << 64
    return last is None


def run_key(data: bytes) -> Hashable:
    """A key is long enough or refused."""
    path = file_of("key", data)
    path.chmod(0o600)
    key = read_key(path)
    assert len(key) >= 16
    return len(key)


def run_address(data: bytes) -> Hashable:
    """An address is read or refused."""
    return parse_address(data.decode(errors="replace")).scheme


CRAFTS = (
    CraftConfig("a", sensor=SensorConfig(noise_nt=300.0), spin=SpinConfig(), filter=FilterConfig(start_s=10.0)),
    CraftConfig("b", spin=SpinConfig(), filter=FilterConfig(method="spin", start_s=10.0)),
)


@cache
def checkpoints() -> tuple[bytes, ...]:
    """Of two methods, before and after their start."""
    found = []
    for craft in CRAFTS:
        for seconds in (20, 900):
            pipeline, place = Pipeline(craft), folder() / f"made-{craft.name}-{seconds}"
            for message in flight(seconds, "paper"):
                pipeline.handle(replace(message, craft=craft.name))
            Checkpoints(StateConfig(place), (craft,)).save([pipeline])
            found += [path.read_bytes() for path in place.glob("*/*.state")]
    return tuple(found)


def run_checkpoint(data: bytes) -> Hashable:
    """A checkpoint is taken up or dropped; with one that is taken up, all that goes out can be sent."""
    outcomes: list[str] = []
    for craft in CRAFTS:
        place = folder() / "state"
        (place / craft.name).mkdir(parents=True, exist_ok=True)
        (place / craft.name / "0000000001.state").write_bytes(data)
        fresh = Pipeline(craft)
        pipeline, events = Checkpoints(StateConfig(place), (craft,)).restore(fresh)
        outcomes += [_DIGITS.sub("#", event.cause)[:60] for event in events]
        if pipeline is not fresh:
            newest_ns = min(pipeline.last_time_ns, (1 << 63) - 10**11)
            for message in flight(3, "paper"):
                later = replace(message, craft=craft.name, time_ns=newest_ns + message.time_ns % 10**10)
                for answer in pipeline.handle(later):
                    encode(answer)
            encode(pipeline.status(1.0, pipeline.ticks.counters))
            for answer in pipeline.flush():
                encode(answer)
    return tuple(outcomes)
