"""Messages and waiting, for the tests of the links."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable

from magcal_service.links import Link
from magcal_service.wire.messages import (
    CalibratedVector,
    Clock,
    Command,
    CommandReply,
    Estimate,
    Frame,
    MagnetometerSample,
    Message,
    PositionSample,
    ReferenceSample,
    Status,
    TelemetrySample,
    Verdict,
)

WAIT_S = 120.0  # no test waits this long unless it fails
SOON_S = 3.0  # at once, on a machine whose processors are busy with other work
SECOND_NS = 1_000_000_000
START_NS = 1_800_000_000 * SECOND_NS


def sample(sequence: int, craft: str = "alpha", source: str = "mag", start_ns: int = START_NS) -> MagnetometerSample:
    """A magnetometer sample whose content follows from its number."""
    time_ns = start_ns + sequence * SECOND_NS
    field_body_nt = (20000.0 + sequence, -0.125 * sequence, 1e-3)
    return MagnetometerSample(
        craft=craft, source=source, sequence=sequence, time_ns=time_ns, field_body_nt=field_body_nt
    )


def estimate(sequence: int, craft: str = "alpha") -> Estimate:
    """An estimate whose tick is its number."""
    return Estimate(
        craft=craft,
        source="magcal",
        sequence=sequence,
        time_ns=START_NS + sequence * SECOND_NS,
        method="ukf",
        tick=sequence,
        bias_nt=(5000.0, 3000.0, 4000.0),
        D=(0.05, 0.1, 0.05, 0.05, 0.05, 0.05),
        covariance=tuple(float(i) for i in range(45)),
        verdict=Verdict.CONVERGING,
        reasons=("coverage",),
        remedy="wait for more of the orbit",
    )


def command(sequence: int, craft: str = "alpha") -> Command:
    """A command to the daemon."""
    return Command(craft=craft, source="ops", sequence=sequence, time_ns=START_NS, name="status", arguments={"n": 1})


def vector(sequence: int, craft: str = "alpha") -> CalibratedVector:
    """A calibrated vector whose content follows from its number."""
    return CalibratedVector(
        craft=craft,
        source="mag",
        sequence=sequence,
        time_ns=START_NS + sequence * SECOND_NS,
        field_body_nt=(1.0, 2.0, 3.0 + sequence),
        covariance_nt2=(4.0, 0.0, 0.0, 4.0, 0.0, 4.0),
        verdict=Verdict.TRUSTED,
    )


SAMPLES: tuple[Message, ...] = (
    sample(1),
    ReferenceSample(
        craft="alpha",
        source="ref",
        sequence=2,
        time_ns=-5,
        clock=Clock.ELAPSED,
        field_nt=(1.0, 2.0, 3.0),
        frame=Frame.ECI,
    ),
    ReferenceSample(craft="alpha", source="ref", sequence=3, time_ns=START_NS, magnitude_nt=48000.25),
    PositionSample(
        craft="alpha", source="gps", sequence=4, time_ns=START_NS, position_km=(7000.0, 1.0, -2.0), frame=Frame.ECEF
    ),
    TelemetrySample(
        craft="alpha", source="eps", sequence=5, time_ns=START_NS, channel="i_bus", unit="A", values=(0.25, -0.5)
    ),
)

RESULTS: tuple[Message, ...] = (
    vector(1),
    estimate(2),
    Status(
        craft="alpha",
        source="magcal",
        sequence=3,
        time_ns=START_NS,
        uptime_s=12.5,
        verdict=Verdict.DOUBTFUL,
        counters={"received": 7, "refused.too_large": 1},
        text="ready",
    ),
    CommandReply(
        craft="alpha",
        source="magcal",
        sequence=4,
        time_ns=START_NS,
        name="status",
        command_source="ops",
        command_sequence=9,
        accepted=True,
    ),
)


def gather(link: Link, count: int, timeout_s: float = WAIT_S) -> list[Message]:
    """What arrives until there are ``count`` messages or ``timeout_s`` [s] are over."""
    messages: list[Message] = []
    deadline_s = time.monotonic() + timeout_s
    while len(messages) < count and time.monotonic() < deadline_s:
        messages += link.receive(min(0.2, timeout_s))
    return messages


def settle(condition: Callable[[], bool], timeout_s: float = WAIT_S) -> bool:
    """Wait until the condition holds; say whether it did in time."""
    deadline_s = time.monotonic() + timeout_s
    while not condition():
        if time.monotonic() >= deadline_s:
            return False
        time.sleep(0.005)
    return True


def flows(source: Link, target: Link, message: Callable[[int], Message], first: int = 0) -> int:
    """Send numbered messages until one arrives; the number of the last one sent."""
    for number in range(first, first + 200):
        source.send(message(number))
        source.receive(0.0)
        if target.receive(0.05):
            return number
    raise AssertionError("nothing flows")


def free_port() -> int:
    """A port on 127.0.0.1 that was free a moment ago."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
