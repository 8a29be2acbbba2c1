"""Health figures of the daemon: lateness of its ticks, resources of its process, faults of each craft."""

from __future__ import annotations

import os
import time
from bisect import bisect_left
from collections import deque
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from magcal_service.daemon.pipeline import Pipeline
from magcal_service.wire.messages import Verdict

SILENT_S: Final = 60.0
"""A craft of which no sample was accepted for longer than this is unhealthy."""

_RECENT: Final = 512
"""Ticks over which the quantiles are taken: eight minutes of one craft at 1 Hz."""

BOUNDS_S: Final = tuple(round(mantissa * 10.0**power, 6) for power in range(-4, 1) for mantissa in (1.0, 2.0, 5.0))
"""Upper edges of the histogram of lateness, from 0.1 ms to 5 s [s]."""

_PAGE_BYTES: Final = os.sysconf("SC_PAGE_SIZE")


class TickLateness:
    """Delay from the arrival of a tick's last message to the publication of its estimate, at the most.

    A message that was there when the daemon polled is taken as there since its last poll, so a queue in front of
    the daemon is in it.

    Attributes
    ----------
    counts: ticks by the bucket of ``BOUNDS_S``; the last one is beyond.
    total_s: sum of all [s].
    """

    def __init__(self) -> None:
        self.counts = [0] * (len(BOUNDS_S) + 1)
        self.total_s = 0.0
        self._recent: deque[float] = deque(maxlen=_RECENT)
        self._arrived_s = self._polled_s = time.monotonic()

    def polled(self, began_s: float) -> None:
        """Messages were fetched; ``began_s`` is the monotonic time at which the daemon asked for them."""
        now_s = time.monotonic()
        self._arrived_s = self._polled_s if now_s - began_s < 1e-3 else now_s
        self._polled_s = now_s

    def note(self) -> None:
        """An estimate was published."""
        late_s = time.monotonic() - self._arrived_s
        self.counts[bisect_left(BOUNDS_S, late_s)] += 1
        self.total_s += late_s
        self._recent.append(late_s)

    def quantiles_s(self) -> tuple[float, float]:
        """p50 and p99 of the newest ticks [s]; zeros before any."""
        if not self._recent:
            return 0.0, 0.0
        half, most = np.quantile(np.array(self._recent), [0.5, 0.99]).tolist()
        return half, most


@dataclass(frozen=True, slots=True)
class Process:
    """What the process uses: resident memory [bytes], open files, threads."""

    rss_bytes: int
    open_files: int
    threads: int

    @classmethod
    def now(cls) -> Process:
        """As the kernel reports it; zeros on one that has no /proc."""
        try:
            resident = int(Path("/proc/self/statm").read_text().split()[1]) * _PAGE_BYTES
            return cls(resident, len(os.listdir("/proc/self/fd")), len(os.listdir("/proc/self/task")))
        except (OSError, ValueError, IndexError):
            return cls(0, 0, 0)


class Flow:
    """When each craft last had a sample accepted, by the monotonic clock."""

    def __init__(self) -> None:
        self._since: dict[str, tuple[int, float]] = {}
        self._began_s = time.monotonic()

    def silent_s(self, pipeline: Pipeline) -> float:
        """How long no sample of a craft has been accepted [s], to within the interval of the calls."""
        accepted, now_s = pipeline.ticks.counters["accepted"], time.monotonic()
        before, since_s = self._since.get(pipeline.label, (0, self._began_s))
        if accepted != before:
            before, since_s = accepted, now_s
        self._since[pipeline.label] = (before, since_s)
        return now_s - since_s


def troubles(pipeline: Pipeline, silent_s: float) -> list[str]:
    """Faults of a craft, each in a few words; none where its vectors can be used as their verdict says."""
    found = []
    if silent_s > SILENT_S:
        found.append(f"no sample for {silent_s:.0f} s")
    if pipeline.trust.verdict in (Verdict.NOT_STARTED, Verdict.DOUBTFUL):
        found.append(f"{pipeline.trust.verdict}: {', '.join(pipeline.trust.reasons) or 'no reason given'}")
    if pipeline.failure and pipeline.trust.verdict is Verdict.NOT_STARTED:
        found.append(f"failed: {pipeline.failure}")
    return found
