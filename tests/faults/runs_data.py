"""Clocks that step and numbers that wrap."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from magcal_service.wire.messages import Message
from tests.daemon.service_processes import free_port, stream, write_config
from tests.faults.bench import Daemons, Feeder, Witness, with_recording
from tests.faults.faults import Fault, Outcome

SECOND_NS = 1_000_000_000
RATE_HZ = 400.0
LAST_SEQUENCE = (1 << 32) - 1

# A daemon whose wall clock goes wrong: an hour ahead or back, as soon as a file is there.
STEPPED = """
import pathlib, sys, time
true_s, true_ns, flag, step_s = time.time, time.time_ns, pathlib.Path({flag!r}), {step_s}
time.time = lambda: true_s() + step_s * flag.exists()
time.time_ns = lambda: true_ns() + int(step_s * 1e9) * flag.exists()
from magcal_service.cli.__main__ import main
sys.exit(main())
"""


def _fed(
    outcome: Outcome, folder: Path, messages: Sequence[Message], command: Sequence[str] | None = None
) -> dict[str, int]:
    """Feed all over zenoh to one daemon; its counters at the end."""
    address = f"zenoh:tcp/127.0.0.1:{free_port()}"
    config = with_recording(write_config(folder, address), folder / "record")
    with Daemons(config, command) as daemons, Witness(address) as node:
        node.until_heard()
        with Feeder(node, messages[: len(messages) // 2], RATE_HZ) as feeder:
            feeder.settle()
        (folder / "stepped").touch()
        node.mark()
        with Feeder(node, messages[len(messages) // 2 :], RATE_HZ) as feeder:
            feeder.close_books()
        daemons.process.check()
        outcome.fed, outcome.accepted, outcome.refused = node.sent, node.counters()["accepted"], node.refused
        outcome.recovered_s = max(node.recovered_s, default=None)
        return node.counters()


def _step(fault: Fault, step_s: int, folder: Path, quick: bool) -> Outcome:
    outcome = Outcome(fault, "zenoh")
    messages = stream(seconds=600)[: 600 if quick else 1200]
    half = len(messages) // 2
    stepped = [replace(message, time_ns=message.time_ns + step_s * SECOND_NS) for message in messages[half:]]
    code = STEPPED.format(flag=str(folder / "stepped"), step_s=step_s)
    counters = _fed(outcome, folder, [*messages[:half], *stepped], [sys.executable, "-c", code, "run"])
    outcome.balance()
    outcome.expect(outcome.refused <= 20, f"{outcome.refused} samples are refused before the step is believed")
    told = {name: count for name, count in counters.items() if name.startswith(("time_", "clock_", "ticks_"))}
    outcome.notes.append(f"a step of {step_s} s of the node's clock and of the daemon's wall clock: {told}")
    return outcome


def clock_step_ahead(folder: Path, quick: bool) -> Outcome:
    """Both clocks an hour ahead in the middle of the flight."""
    return _step(Fault.CLOCK_STEP_AHEAD, 3600, folder, quick)


def clock_step_back(folder: Path, quick: bool) -> Outcome:
    """Both clocks an hour back in the middle of the flight."""
    return _step(Fault.CLOCK_STEP_BACK, -3600, folder, quick)


def wrap(folder: Path, quick: bool) -> Outcome:
    """The sequence numbers wrap in the first half; in the middle the time starts again from 0."""
    outcome = Outcome(Fault.WRAP, "zenoh")
    messages = stream(seconds=600)[: 600 if quick else 1200]
    half = len(messages) // 2
    first_ns = messages[half].time_ns
    wrapped = [
        replace(
            message,
            sequence=(LAST_SEQUENCE - 50 + message.sequence) & LAST_SEQUENCE,
            time_ns=message.time_ns if number < half else message.time_ns - first_ns,
        )
        for number, message in enumerate(messages)
    ]
    counters = _fed(outcome, folder, wrapped)
    lost, restarted = counters.get("link.lost", 0), counters.get("link.restarted", 0)
    outcome.balance()
    outcome.expect((lost, restarted) == (0, 0), f"the wrap counts as {lost} lost, {restarted} restarted")
    outcome.expect(outcome.refused <= 20, f"{outcome.refused} samples are refused before the step is believed")
    outcome.notes.append(
        f"sequences from {LAST_SEQUENCE - 50} through 0; {outcome.refused} refused at the wrap of time"
    )
    return outcome
