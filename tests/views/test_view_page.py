"""The page's server: who may read it and give commands, and what it makes of a recording."""

from __future__ import annotations

import asyncio
import contextlib
import json
import socket
import time
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("aiohttp", reason="the extra view is not installed")

import aiohttp
import numpy as np

from magcal_service.links import Link, Role, open_link
from magcal_service.offline.replay import craft_of
from magcal_service.recordings.inspect.inspection import inspect
from magcal_service.recordings.reader import read_recording
from magcal_service.views.feed import Feed
from magcal_service.views.server import Offer, serve
from magcal_service.views.sources import Flight, LiveSource, ReplaySource, heard_until
from magcal_service.wire.messages import CalibratedVector, Command, Message
from tests.cli.cli_inputs import run
from tests.diagnosis.diagnosis_runs import recorded
from tests.views.view_messages import estimate, second_of

READS = Offer()


@contextlib.asynccontextmanager
async def served(name: str, offer: Offer = READS, port: int = 0) -> AsyncIterator[tuple[str, Link, Link]]:
    """A page of a live link: its address, and the ends of daemon and node."""
    with (
        open_link(f"loop:{name}", Role.VIEWER) as viewer,
        open_link(f"loop:{name}", Role.SERVICE) as daemon,
        open_link(f"loop:{name}", Role.NODE) as node,
    ):
        told: asyncio.Future[str] = asyncio.get_running_loop().create_future()
        stopped = asyncio.Event()
        task = asyncio.create_task(serve(LiveSource(viewer), port, offer, told.set_result, stopped))
        await asyncio.wait([told, task], return_when=asyncio.FIRST_COMPLETED)
        try:
            yield await told, daemon, node
        finally:
            stopped.set()
            await task


def fly(daemon: Link, node: Link, seconds: range, craft: str = "demo") -> None:
    """Send these seconds of a craft, each from the end that it comes from."""
    for second in seconds:
        for message in second_of(second, craft, ripple_nt=40.0):
            (daemon if isinstance(message, CalibratedVector) else node).send(message)
        daemon.send(estimate(second, craft))


async def first_update(session: aiohttp.ClientSession, address: str) -> dict[str, Any]:
    """The first update that a reader gets."""
    async with session.get(f"{address}events") as response:
        line = await response.content.readline()
    update: dict[str, Any] = json.loads(line.removeprefix(b"data: "))
    return update


def test_only_this_machine_s_own_name_is_answered_and_every_answer_forbids_the_rest() -> None:
    async def ask() -> None:
        async with served("guard") as (address, _, _), aiohttp.ClientSession() as session:
            async with session.get(address, headers={"Host": "elsewhere.example"}) as refused:
                assert refused.status == 403
            for path, status_code in (("", 200), ("view.js", 200), ("../server.py", 404), ("command", 404)):
                async with session.get(address + path) as response:
                    assert response.status == status_code
                    policy = response.headers["Content-Security-Policy"]
                    assert policy.startswith("default-src 'none'")
                    assert "unsafe" not in policy

    asyncio.run(ask())


def test_commands_are_taken_only_where_allowed_and_only_from_the_page() -> None:
    async def ask() -> None:
        body = {"craft": "demo", "name": "freeze"}
        async with (
            served("reads") as (address, _, _),
            aiohttp.ClientSession() as session,
            session.post(f"{address}command", json=body, headers={"Origin": address[:-1]}) as response,
        ):
            assert response.status == 404
        async with (
            served("writes", Offer(commands=True)) as (address, daemon, node),
            aiohttp.ClientSession() as session,
        ):
            fly(daemon, node, range(2))
            while not (await first_update(session, address))["list"]:
                await asyncio.sleep(0.01)
            for origin, asked, expected in (
                ("http://elsewhere.example", body, 403),
                (address[:-1], body | {"name": "load_physics"}, 400),
                (address[:-1], body | {"craft": "nobody"}, 400),
                (address[:-1], body, 202),
            ):
                async with session.post(f"{address}command", json=asked, headers={"Origin": origin}) as response:
                    assert response.status == expected
            given = [one for one in await asyncio.to_thread(daemon.receive, 2.0) if isinstance(one, Command)]
            while not given:
                given = [one for one in await asyncio.to_thread(daemon.receive, 2.0) if isinstance(one, Command)]
            assert [(one.craft, one.name) for one in given] == [("demo", "freeze")]

    asyncio.run(ask())


def test_a_replay_gives_each_input_once_and_before_its_answer() -> None:
    inputs = [one for second in range(4) for one in second_of(second)]
    vectors = [one for one in inputs if isinstance(one, CalibratedVector)]
    taken: list[Message] = []
    until = heard_until((one for one in inputs if one not in vectors), taken.append)
    for vector in (vectors[0], vectors[2], vectors[1], vectors[3]):
        until(vector)
        assert (vector.sequence, vector.source) in {(one.sequence, one.source) for one in taken}
    assert taken == [one for one in inputs if one not in vectors]


def test_a_replayed_recording_shows_its_raw_samples_beside_what_came_of_them(tmp_path: Path) -> None:
    inspection = inspect(read_recording(recorded("paper", 450.0, tmp_path)))
    source = ReplaySource("log.toml", [Flight(inspection, craft_of(inspection.to_replay))], 0.0)
    source.start()
    while not source.origin.has_ended:
        time.sleep(0.01)
    update = Feed().update(source.views, time.monotonic())
    rows = update["recent"]["rows"]
    measured = np.linalg.norm(inspection.recording.field_body_nt, axis=1)
    assert source.origin.note == ""
    assert len(rows) >= 449
    assert [row[1] for row in rows] == pytest.approx(measured[: len(rows)], abs=0.1)
    settled = [row[4] for row in rows if row[4] is not None]
    assert 200.0 < np.std(settled) < 400.0  # the scenario's noise is 300 nT
    assert update["result"]["counters"]["ticks"] == 450


def test_a_port_that_is_taken_is_refused() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        done = run("view", "--port", taken.getsockname()[1], "--link", "loop:nobody")
    assert (done.code, done.out, done.err.count("\n")) == (2, "", 1)
    assert done.err.startswith("--port: ")


def test_what_a_source_cannot_take_is_refused() -> None:
    for given, field in ((("log.toml", "--allow-commands"), "--allow-commands"), (("--source", "mag2"), "--source")):
        done = run("view", *given)
        assert (done.code, done.err.partition(":")[0]) == (2, field)
