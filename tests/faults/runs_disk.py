"""Disks that are full, and files that were half written."""

from __future__ import annotations

import random
import resource
import time
from functools import partial
from pathlib import Path

from magcal_service.recordings.session_info import session_info
from tests.daemon.service_processes import free_port, stream, write_config
from tests.faults.bench import RECORD_FLUSH_S, Daemons, Feeder, Witness, with_recording
from tests.faults.faults import Fault, Outcome
from tests.faults.runs_process import (
    HISTORY,
    SETTLED_S,
    fly,
    newest_number,
    same_as_uninterrupted,
    uninterrupted,
    with_state,
)

RATE_HZ = 300.0


def disk_full(folder: Path, quick: bool) -> Outcome:
    """No file may grow further (RLIMIT_FSIZE, errors as from a full disk) for the middle third of the flight."""
    outcome = Outcome(Fault.DISK_FULL, "zenoh")
    address = f"zenoh:tcp/127.0.0.1:{free_port()}"
    rows = folder / "rows.csv"
    config = with_recording(write_config(folder, address, csv=rows), folder / "record")
    messages = stream(seconds=1200)[: 900 if quick else 2400]
    third = len(messages) // 3
    with Daemons(config) as daemons, Witness(address) as node:
        node.until_heard()
        with Feeder(node, messages, RATE_HZ) as feeder:
            feeder.reach(third)
            resource.prlimit(daemons.process.pid, resource.RLIMIT_FSIZE, (1024, resource.RLIM_INFINITY))
            feeder.until(lambda: node.counters().get("record.stopped", 0) > 0, "the recording does not stop")
            told = node.status["paper"].text
            feeder.reach(2 * third)
            resource.prlimit(daemons.process.pid, resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY,) * 2)
            written = node.counters().get("record.written", 0)
            freed_s = time.monotonic()
            feeder.until(lambda: node.counters().get("record.written", 0) > written, "the recording does not go on")
            again_s = time.monotonic() - freed_s
            feeder.close_books()
        daemons.process.check()
        outcome.fed, outcome.accepted, outcome.refused = node.sent, node.counters()["accepted"], node.refused
        counters = node.counters()
    outcome.balance()
    outcome.expect(len(node.first_s) == node.sent, "a vector is missing")
    outcome.expect("not recording" in told, f"the status does not say it: {told}")
    outcome.expect(counters.get("csv_lost", 0) > 0, "rows went on without a disk")
    outcome.notes.append(
        f"status: {told!r}; recording again {again_s:.1f} s after there was room; {counters['record.written']} records "
        f"written, {counters.get('record.dropped', 0)} dropped, {counters.get('csv_lost', 0)} rows not written"
    )
    return outcome


def half_recording(folder: Path, quick: bool) -> Outcome:
    """SIGKILL while it records, the file's end cut off at random besides, and a new start."""
    outcome = Outcome(Fault.HALF_RECORDING, "zenoh")
    address = f"zenoh:tcp/127.0.0.1:{free_port()}"
    records = folder / "record"
    config = with_recording(write_config(folder, f"{address}?history=1000"), records)
    messages = stream(seconds=600)[: 600 if quick else 1200]
    with Daemons(config) as daemons, Witness(address) as node:
        node.until_heard()
        with Feeder(node, messages, RATE_HZ) as feeder:
            feeder.reach(len(messages) // 2)
            flushed = node.counters().get("record.written", 0)
            daemons.kill()
            (half,) = records.glob("*.mcap")
            cut = random.Random(10).randrange(1, 200)
            size = half.stat().st_size
            with half.open("r+b") as file:
                file.truncate(size - cut)
            daemons.start()
            feeder.close_books()
        outcome.fed, outcome.accepted = node.sent, node.counters()["accepted"]
        outcome.used(node.counters())
        recovered = node.counters().get("record.recovered", 0)
    (mended,) = records.glob("*.recovered.mcap")
    chunk = 4 * RATE_HZ * RECORD_FLUSH_S  # a sample, a reference, a vector and an estimate for each second of flight
    outcome.balance()
    outcome.expect(session_info(mended).sound, "the recovered file is not sound")
    outcome.expect(recovered >= flushed - chunk, f"{recovered} records recovered of {flushed} that were flushed")
    outcome.notes.append(f"{flushed} records on disk by its last status, {cut} bytes cut off, {recovered} recovered")
    return outcome


def half_checkpoint(folder: Path, quick: bool) -> Outcome:
    """SIGKILL, then the newest state is cut short, and another time a bit of it is altered.

    At 3 samples a second, what is sent within two checkpoints and a start is within the history that is asked for.
    """
    outcome = Outcome(Fault.HALF_CHECKPOINT, "zenoh")
    state = folder / "state"
    address = f"zenoh:tcp/127.0.0.1:{free_port()}"
    config = with_state(write_config(folder, f"{address}?history={HISTORY}"), state)
    messages = stream(seconds=SETTLED_S + (200 if quick else 300))
    chance = random.Random(11)
    dropped = 0
    with Daemons(config) as daemons, Witness(address) as node:
        node.until_heard()
        fly(node, messages[: 2 * SETTLED_S], state)
        with Feeder(node, messages[2 * SETTLED_S :], 6.0) as feeder:
            for spoil in (_cut, _alter):
                wanted = newest_number(state) + 2  # one to be spoilt, and one before it that is not
                feeder.until(partial(_has_reached, state, wanted), "no second checkpoint")
                node.mark()
                daemons.kill()
                newest = max(state.rglob("*.state"))
                newest.write_bytes(spoil(newest.read_bytes(), chance))
                daemons.start()
                feeder.fresh_status()
                dropped += node.counters().get("state.dropped", 0)
            feeder.close_books()
        outcome.fed, outcome.accepted = node.sent, node.counters()["accepted"]
        outcome.used(node.counters())
        outcome.recovered_s = max(node.recovered_s, default=None)
    outcome.balance()
    outcome.expect(dropped == 2, f"{dropped} of 2 spoilt states were dropped")
    outcome.notes.append(f"{dropped} spoilt states dropped, the one before taken instead")
    same_as_uninterrupted(outcome, node, uninterrupted(config, messages))
    return outcome


def _has_reached(state: Path, number: int) -> bool:
    return newest_number(state) >= number


def _cut(content: bytes, chance: random.Random) -> bytes:
    return content[: chance.randrange(len(content))]


def _alter(content: bytes, chance: random.Random) -> bytes:
    place = chance.randrange(len(content))
    return content[:place] + bytes([content[place] ^ 0x10]) + content[place + 1 :]
