"""Two magnetometers over zenoh, over a serial line and in a replay: each is right, and the magnet near one is named."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

from magcal_service.cli.__main__ import main
from magcal_service.config.settings import Config
from magcal_service.daemon.service import Service
from magcal_service.model import STATE_NAMES
from magcal_service.wire.messages import CalibratedVector, Estimate, MagnetometerSample, Message
from tests.daemon.magnetometer_streams import MAGNET_S, PAIR, pair
from tests.daemon.real_links import ends
from tests.links.link_messages import settle
from tests.recordings.sessions import record

SECONDS = MAGNET_S + 60.0
APART_NT, SHIFTED_S = 150.0, 0.5
ON_THE_WAY = 50  # samples: what a pseudo-terminal holds of their answers is four times that

Row = tuple[str, int, list[float], list[float], str]
"""Of an estimate: source, time [ns], errors, their sigmas, reasons."""


def stream() -> list[Message]:
    return list(pair(SECONDS, APART_NT, SHIFTED_S).messages())


def over(kind: str) -> list[Row]:
    """What the node hears."""
    heard: list[Message] = []
    with ends(kind) as (link, node):
        service = Service(Config(link.address, (PAIR,)), link)

        def answered(samples: int) -> bool:
            for message in link.receive(0.0):
                service.handle(message)
            heard.extend(node.receive(0.0))
            return sum(isinstance(one, CalibratedVector) for one in heard) >= samples

        sent = 0
        for message in stream():
            sent += isinstance(message, MagnetometerSample)
            node.send(message)
            assert settle(lambda wanted=sent - ON_THE_WAY: answered(wanted))
        assert settle(lambda: answered(sent))
    return [
        (one.source, one.time_ns, [*one.bias_nt, *one.D], sigmas(one), " ".join(one.reasons))
        for one in heard
        if isinstance(one, Estimate)
    ]


def sigmas(estimate: Estimate) -> list[float]:
    on_diagonal = np.equal(*np.triu_indices(len(STATE_NAMES)))
    return np.sqrt(np.array(estimate.covariance)[on_diagonal]).tolist()


def in_a_replay(folder: Path) -> list[Row]:
    """Of a recorded session of both."""
    (file,) = record(folder / "rec", stream(), [PAIR], csv=folder / "live.csv")
    assert main(["replay", str(file), "--out", str(folder / "rows.csv")]) in (0, 3)
    with (folder / "rows.csv").open(newline="") as rows:
        return [
            (
                "mag2" if row["craft"] == "pair/mag2" else "magcal",
                int(row["time_ns"]),
                [float(row[name]) for name in STATE_NAMES],
                [float(row[f"sigma_{name}"]) for name in STATE_NAMES],
                row["reasons"],
            )
            for row in csv.DictReader(rows)
        ]


@pytest.mark.parametrize("kind", ["zenoh", "serial", "replay"])
def test_each_is_right_within_its_sigma_and_the_magnet_is_named_within_a_minute(kind: str, tmp_path: Path) -> None:
    simulation = pair(SECONDS, APART_NT, SHIFTED_S)
    magnet_ns = simulation.truth.start_ns + round(MAGNET_S * 1e9)
    rows = in_a_replay(tmp_path) if kind == "replay" else over(kind)
    for source, sensor in (("magcal", simulation.truth.sensor), ("mag2", simulation.truth.beside[0].sensor)):
        _, _, found, sigma, _ = [row for row in rows if row[0] == source and row[1] < magnet_ns][-1]
        error = (np.array(found) - np.array([*sensor.bias_nt, *sensor.D])) / np.array(sigma)
        assert np.abs(error).max() < 3.5
    named = [(source, time_ns) for source, time_ns, *_, reasons in rows if "local_disturbance" in reasons]
    assert {source for source, _ in named} == {"mag2"}
    assert 0 < named[0][1] - magnet_ns <= 60 * 10**9
