"""Telemetry for mission control: what is sent, who may read it, and what the plugin of Open MCT makes of it."""

from __future__ import annotations

import asyncio
import json
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("aiohttp", reason="the extra view is not installed")

import aiohttp

from magcal_service.views.history import MOST_RECENT, MOST_WHOLE, History
from magcal_service.views.server import Offer
from magcal_service.views.telemetry import Telemetry
from magcal_service.wire.messages import Verdict
from tests.cli.cli_inputs import run
from tests.figures.pages import ROOT
from tests.views.test_view_page import served
from tests.views.test_views_state import heard
from tests.views.view_messages import BIAS_NT, FIELD_NT, estimate, second_of, status

PLUGIN = ROOT / "deploy/openmct/magcal-plugin.js"
ORIGIN = {"origin": {"kind": "live"}}
ELSEWHERE = "http://127.0.0.1:8080"


def test_results_over_time_are_bounded_and_begin_anew_where_time_goes_back() -> None:
    views, telemetry = heard(1), Telemetry()
    for second in range(3000):
        views.take(estimate(second), 1.0)
    history = views.crafts["demo"].results["demo"].history
    assert (len(history.recent.rows), history.recent.rows[-1][0]) == (MOST_RECENT, 2_999_000.0)
    assert MOST_WHOLE // 2 < len(history.whole.rows) <= MOST_WHOLE
    telemetry.update(views, 1.0)
    views.take(estimate(2990), 1.0)  # late, which is no new beginning
    assert telemetry.update(views, 1.0)["magnetometers"]["demo"]["results"]["recent"]["rows"] == []
    views.take(estimate(5), 1.0)
    sent = telemetry.update(views, 1.0)["magnetometers"]["demo"]["results"]
    assert [(one["anew"], [row[0] for row in one["rows"]]) for one in sent.values()] == [(True, [5000.0])] * 2


def test_before_there_is_an_estimate_no_error_is_telemetry_and_json_has_every_row() -> None:
    history = History()
    history.take(estimate(1, verdict=Verdict.NOT_STARTED), Verdict.NOT_STARTED)
    spoiled = replace(estimate(2), covariance=(-1.0,) * 45, reasons=("unprotected",), protection_nt=None)
    history.take(spoiled, Verdict.DOUBTFUL)
    first, second = history.recent.rows
    assert first[1:19] == (None,) * 18
    assert second[1:] == (*BIAS_NT, *(0.0,) * 6, *(None,) * 10, 0.0, 0.0, 2, 3, 1)


def test_telemetry_is_read_by_the_page_s_own_origin_and_by_those_that_are_allowed(tmp_path: Path) -> None:
    package = tmp_path / "node_modules/openmct/dist"
    package.mkdir(parents=True)
    (package / "openmct.js").write_text("1", encoding="utf-8")
    (tmp_path / "index.html").write_text("<p>", encoding="utf-8")
    (tmp_path / "outside").symlink_to(__file__)

    async def ask() -> None:
        offer = Offer(openmct=tmp_path, origins=(ELSEWHERE,))
        async with served("origins", offer) as (address, _, _), aiohttp.ClientSession() as session:
            for path, origin, allowed in (
                ("telemetry", ELSEWHERE, ELSEWHERE),
                ("telemetry", "http://elsewhere.example", None),
                ("events", ELSEWHERE, None),
            ):
                async with session.get(address + path, headers={"Origin": origin}) as response:
                    assert response.headers.get("Access-Control-Allow-Origin") == allowed
            for path, code, loose in (
                ("", 200, False),
                ("openmct/", 200, True),
                ("openmct/node_modules/openmct/dist/openmct.js", 200, True),
                ("openmct/../server.py", 404, False),
                ("openmct/outside", 404, False),
            ):
                async with session.get(address + path) as response:
                    policy = response.headers["Content-Security-Policy"]
                    assert (response.status, "unsafe" in policy) == (code, loose), path
                    assert policy.startswith("default-src 'none'")

    asyncio.run(ask())


def test_a_folder_without_open_mct_and_commands_beside_one_are_refused(tmp_path: Path) -> None:
    done = run("view", "--openmct", tmp_path)
    assert (done.code, done.err.partition(":")[0]) == (2, "--openmct")
    assert "deploy/openmct/README.md" in done.err
    for name in ("index.html", "node_modules/openmct/dist/openmct.js"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    done = run("view", "--openmct", tmp_path, "--allow-commands")
    assert (done.code, done.err.partition(":")[0]) == (2, "--allow-commands")
    assert run("view", "--allow-origin", "*").code == 2


def plugin(**given: object) -> dict[str, Any]:
    """What the plugin's providers say of these updates."""
    asked = {"plugin": str(PLUGIN), **given}
    driver = Path(__file__).with_name("plugin_driver.js")
    command = ["node", str(driver)]
    done = subprocess.run(command, input=json.dumps(asked), capture_output=True, text=True, timeout=30, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    said: dict[str, Any] = json.loads(done.stdout)
    return said


@pytest.mark.skipif(shutil.which("node") is None, reason="node is not installed")
def test_the_plugin_of_open_mct_shows_what_was_heard() -> None:
    views, telemetry = heard(1000, source="mag/2"), Telemetry()
    heard(1, views, craft="one more")
    said = replace(estimate(999), reasons=("unprotected",), remedy="wait", protection_nt=150.0)
    for one in (*(replace(estimate(second), bias_nt=(float(second), 0.0, 0.0)) for second in range(999)), said):
        views.take(one, 999.0)
    views.take(estimate(3, craft="one more", verdict=Verdict.DOUBTFUL), 999.0)
    views.take(status(999, "model doubtful: heat; run: magcal diagnose RECORDING"), 999.0)
    first = telemetry.update(views, 999.0)
    for second in range(1000, 1003):
        for message in (*second_of(second, source="mag/2"), estimate(second), *second_of(0, craft="late")):
            views.take(message, float(second))
    shown = plugin(
        updates=[first | ORIGIN],
        later=[telemetry.update(views, 1002.0) | ORIGIN, telemetry.update(views, 1099.0) | ORIGIN],
        part={"start": 400_000, "end": 402_000},
        options={"protectionNt": 120},
    )
    seen, points = shown["seen"], shown["points"]

    assert seen["demo.bx"] == {"type": "magcal.point", "name": "bx", "location": "magcal:demo.nine"}
    assert {key: one["name"] for key, one in seen.items() if one["location"] == "magcal:_root"} == {
        "_verdicts": "Verdicts",
        "_craft.demo": "demo",
        "_craft.one_20_more": "one more",
    }
    assert {one["type"] for one in seen.values()} == {
        "folder",
        "magcal.point",
        "LadTable",
        "telemetry.plot.overlay",
        "flexible-layout",
    }
    samples = [[one["utc"], one["value"]] for one in points["demo.reference"]["all"]]
    assert samples == [[second * 1000.0, FIELD_NT] for second in range(1000)]
    kept = [(one["utc"], one["value"]) for one in points["demo.bx"]["all"]]
    assert kept[-MOST_RECENT:] == [(s * 1000.0, float(s) if s < 999 else BIAS_NT[0]) for s in range(880, 1000)]
    assert len(kept) > MOST_WHOLE // 2
    assert all(value == utc / 1000.0 for utc, value in kept[:-1])
    assert points["demo.before"]["part"] == [one for one in points["demo.before"]["all"] if 4e5 <= one["utc"] <= 4.02e5]
    assert len(points["demo.before"]["part"]) == 3
    assert points["demo.bx-3sigma"]["latest"] == [{"utc": 999_000.0, "value": 6.0}]
    assert points["demo.reasons"]["latest"] == [{"utc": 999_000.0, "value": "unprotected: wait"}]
    assert points["demo.finding"]["latest"][0]["value"] == "heat; run: magcal diagnose RECORDING"
    assert points["demo.counter.accepted"]["all"] == [{"utc": 999_000.0, "value": 999}]
    assert points["demo.protection"]["latest"] == [{"utc": 999_000.0, "value": 150.0, "unprotected": 1}]
    assert points["demo.protection"]["lines"] == {"CRITICAL": {"high": {"color": "red", "value": 120}}}
    limits = {key: one["limit"] for key, one in points.items() if one["limit"]}
    assert limits == {"demo.protection": "unprotected", "one_20_more.verdict": "doubtful"}

    assert shown["live"]["demo.bx"] == [{"utc": s * 1000.0, "value": BIAS_NT[0]} for s in range(1000, 1003)]
    assert [one["utc"] for one in shown["live"]["demo.after"]] == [1_000_000.0, 1_001_000.0, 1_002_000.0]
    assert shown["live"]["one_20_more.bx"] == []
    assert set(shown["ticks"]) == {1_002_000.0}
    assert shown["added"] == ["_craft.late"]
    assert shown["stale"]["demo.bx"] == [False, True]  # nothing came for 97 s
