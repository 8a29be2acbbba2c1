"""Stands in for ``magcal run`` where a test needs a daemon that misbehaves on purpose.

    python fake_daemon.py MODE --config FILE

It answers each sample with its own vector and a made-up estimate.  MODE: ``polite``, ``slow`` (5 ms a sample),
``dies`` (after 50 samples), ``deaf`` (every fifth sample unanswered), ``rude`` (ends with code 5 when asked to stop),
``mute`` (statuses only).
"""

from __future__ import annotations

import signal
import sys
import threading
import time
from pathlib import Path

from magcal_service.config.reader import load_config
from magcal_service.links import Link, Role, open_link
from magcal_service.wire.messages import CalibratedVector, Estimate, MagnetometerSample, Status, Verdict

VARIANCES = (100.0,) * 3 + (1e-8,) * 6
COVARIANCE = tuple(VARIANCES[row] if column == row else 0.0 for row in range(9) for column in range(row, 9))


def status(craft: str, sequence: int) -> Status:
    return Status(
        craft=craft, source="fake", sequence=sequence, time_ns=time.time_ns(), uptime_s=0.0, verdict=Verdict.CONVERGING
    )


def answer(link: Link, sample: MagnetometerSample, tick: int) -> None:
    stamp = {"craft": sample.craft, "time_ns": sample.time_ns}
    link.send(
        CalibratedVector(
            **stamp,
            source=sample.source,
            sequence=sample.sequence,
            field_body_nt=sample.field_body_nt,
            covariance_nt2=(1.0, 0.0, 0.0, 1.0, 0.0, 1.0),
            verdict=Verdict.TRUSTED,
        )
    )
    link.send(
        Estimate(
            **stamp,
            source="magcal",
            sequence=tick,
            method="made-up",
            tick=tick,
            bias_nt=(5000.0, 3000.0, 4000.0),
            D=(0.05, 0.10, 0.05, 0.05, 0.05, 0.05),
            covariance=COVARIANCE,
            verdict=Verdict.TRUSTED,
            residual_rms_nt=300.0,
            noise_nt=300.0,
            samples_used=tick,
        )
    )


def main() -> int:
    mode, config = sys.argv[1], load_config(Path(sys.argv[3]))
    stop = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: stop.set())
    ticks, statuses, craft = 0, 0, config.crafts[0].name
    with open_link(config.link, Role.SERVICE, crafts=[craft]) as link:
        while not stop.is_set():
            if not ticks:
                link.send(status(craft, statuses))
                statuses += 1
            for message in link.receive(0.05):
                if isinstance(message, MagnetometerSample):
                    ticks += 1
                    time.sleep(0.005 if mode == "slow" else 0.0)
                    if mode != "mute" and not (mode == "deaf" and ticks % 5 == 0):
                        answer(link, message, ticks)
            if mode == "dies" and ticks >= 50:
                print("the fake daemon gives up", file=sys.stderr)
                return 9
    return 5 if mode == "rude" else 0


if __name__ == "__main__":
    sys.exit(main())
