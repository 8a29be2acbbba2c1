"""Which run tries which fault."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

from tests.faults import runs_data, runs_disk, runs_door, runs_link, runs_load, runs_process
from tests.faults.faults import Fault, Outcome

RUNS: Mapping[Fault, Callable[[Path, bool], Outcome]] = {
    Fault.KILL_DAEMON: runs_process.kill_daemon,
    Fault.KILL_OFTEN: runs_process.kill_often,
    Fault.STOP_DAEMON: runs_process.stop_daemon,
    Fault.STOP_NODE: runs_process.stop_node,
    Fault.CUT_NETWORK: runs_link.cut_network,
    Fault.CUT_SERIAL: runs_link.cut_serial,
    Fault.RESTART_ROUTER: runs_process.restart_router,
    Fault.CORRUPT_FRAMES: runs_link.corrupt_frames,
    Fault.CORRUPT_PAYLOADS: runs_link.corrupt_payloads,
    Fault.FLOOD: runs_load.flood,
    Fault.SLOW_CONSUMER: runs_process.slow_consumer,
    Fault.DISK_FULL: runs_disk.disk_full,
    Fault.CLOCK_STEP_AHEAD: runs_data.clock_step_ahead,
    Fault.CLOCK_STEP_BACK: runs_data.clock_step_back,
    Fault.WRAP: runs_data.wrap,
    Fault.HALF_CHECKPOINT: runs_disk.half_checkpoint,
    Fault.HALF_RECORDING: runs_disk.half_recording,
    Fault.GARBAGE: runs_link.garbage,
    Fault.EXPIRED_CERTIFICATE: runs_door.expired_certificate,
    Fault.ROGUE: runs_door.rogue,
}
"""For each fault a function of a folder to work in and whether to be quick."""
