"""Many craft at 1 Hz: how many of their samples are answered, how late, at what cost, and how soon it is over."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

from tests.benchmarks.load.served import ROOT, Served

RECOVERY_S = 15
SETTLE_S = 3.0
CALM = 100


def many_craft(checkout: Path, folder: Path, count: int, seconds: int) -> dict[str, Any]:
    """``count`` craft for ``seconds`` [s], then as many as any daemon carries for ``RECOVERY_S``."""
    crafts = [f"c{number:04}" for number in range(count)]
    calm = min(count, CALM)
    with Served(checkout, folder, crafts) as daemon:
        phases = [{"craft": count, "seconds": seconds}, {"craft": calm, "seconds": RECOVERY_S}]
        order = {"endpoint": daemon.endpoint, "crafts": crafts, "phases": phases, "settle_s": SETTLE_S}
        command = [sys.executable, "-m", "tests.benchmarks.load.feeder"]
        pipe = subprocess.PIPE
        with subprocess.Popen(command, cwd=ROOT, stdin=pipe, stdout=pipe, text=True) as feeder:
            assert feeder.stdin is not None
            assert feeder.stdout is not None
            feeder.stdin.write(json.dumps(order))
            feeder.stdin.close()
            assert feeder.stdout.readline() == "phase\n"
            before_s = daemon.cpu_s()
            assert feeder.stdout.readline() == "phase\n"
            share = daemon.cpu_s() - before_s
            assert feeder.stdout.readline() == "phase\n"
            told = json.loads(feeder.stdout.readline())
    load, after = told["phases"][0], told["after_10_s"]
    return {**load, "cpu": share / load["took_s"], "told": told["told"], "text": told["text"], "after": after}


def line(count: int, of: str, told: dict[str, Any]) -> str:
    """One row of the table."""
    after = told["after"]
    return (
        f"{count:6d} {of:7} {told['answered']:7d} of {told['sent']:6d}"
        f"  p50 {told['p50_s']:7.3f} s  p99 {told['p99_s']:7.3f} s"
        f"  processor {100 * told['cpu']:5.1f} %  of one craft {told['least_of_a_craft']}-{told['most_of_a_craft']}"
        f"  10 s after: {after['answered']} of {after['sent']}, p99 {after['p99_s']:.3f} s"
    )
