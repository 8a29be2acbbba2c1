"""Open MCT itself, in Chromium, with the plugin on a `magcal view`: does it show what the recording holds?

python -m tests.views.open_mct [FOLDER] [--picture FILE.webp]

FOLDER (default: deploy/openmct) is where `npm install openmct` was run.  A recorded flight by the command as a user
gives it: the tables against a replay, every sample and result of the history against recording and replay, colours of
the limits.  Then a live link: a value that changes, and a daemon that falls silent.  Not in the suite: it needs 60 MB
of npm; `test_view_telemetry.py` has the plugin's providers without Open MCT.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import subprocess
import sys
import tempfile
import time
from dataclasses import replace as changed
from pathlib import Path
from typing import Any

import numpy as np

from magcal_service.offline.replay import replay
from magcal_service.recordings.reader import read_recording
from magcal_service.views.server import Offer
from magcal_service.wire.messages import Estimate, Message, Verdict
from tests.diagnosis.diagnosis_runs import recorded
from tests.figures.pages import ROOT
from tests.views.browser import Tab, tab
from tests.views.test_view_page import fly, served
from tests.views.view_messages import estimate

SECONDS = 1500.0
COLOURS = {Verdict.TRUSTED: "", Verdict.DOUBTFUL: "is-limit--red", Verdict.CONVERGING: "is-limit--yellow"}
ROWS = """Object.fromEntries([...document.querySelectorAll('[aria-label="lad row"]')].map((row) => {
  const cell = (name) => row.querySelector(`[aria-label="lad ${name}"]`);
  return [cell('name').textContent.trim(), [cell('value').textContent.trim(), cell('value').className]];
}))"""


async def rows(page: Tab) -> dict[str, list[str]]:
    """What the tables show: text and classes of each value, by its name."""
    shown: dict[str, list[str]] = await page.value(ROWS)
    return shown


async def history(page: Tab, point: str) -> list[dict[str, Any]]:
    """All that Open MCT gets of a point's past."""
    asked = (
        f"openmct.objects.get('magcal:{point}').then((one) => openmct.telemetry.request(one, {{start: 0, end: 4e12}}))"
    )
    found: list[dict[str, Any]] = json.loads(await page.awaited(f"{asked}.then(JSON.stringify)"))
    return found


def check_console(page: Tab, address: str) -> None:
    """No complaint but of the drawing on a machine without a graphics card, and nothing asked of others."""
    complaints = [one for one in page.complaints if "'source': 'rendering'" not in one]
    assert complaints == [], complaints
    outside = [url for url in page.requests if not url.startswith((address, "about:", "data:", "blob:"))]
    assert outside == [], outside


async def of_a_recording(folder: Path, page: Tab, picture: Path | None) -> str:
    """Compare a recorded flight; what was compared, in words."""
    with tempfile.TemporaryDirectory() as place:
        path = recorded("paper", SECONDS, Path(place))
        recording = read_recording(path)
        told: list[Message] = []
        replay(path, sink=told.append, as_recorded=True)
        estimates = [one for one in told if isinstance(one, Estimate)]
        command = [
            sys.executable,
            "-m",
            "magcal_service.cli",
            "view",
            str(path),
            "--openmct",
            str(folder),
            "--port",
            "0",
        ]
        view = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        try:
            assert view.stdout is not None
            address = view.stdout.readline().split()[0]
            begun = time.monotonic()
            await page.call("Page.navigate", url=f"{address}openmct/")
            await page.until(f"({ROWS})['Ticks used']?.[0] === '{estimates[-1].tick}'", 60.0)
            loaded_s = time.monotonic() - begun
            await page.until("magcal.stream.origin.has_ended")
            shown = await rows(page)
            if picture is not None:
                await asyncio.sleep(2.0)  # plots are drawn a moment later
                await page.picture(picture, whole=False)
            compared = check_tables(shown, estimates[-1]) + await check_history(page, recording, estimates)
            check_console(page, address)
        finally:
            view.terminate()
            view.wait(10.0)
    return f"recording: {compared} values as in the recording and its replay; on the screen after {loaded_s:.1f} s"


def check_tables(shown: dict[str, list[str]], last: Estimate) -> int:
    """Compare the tables with the last estimate; how many values."""
    label = last.craft
    sigma = np.sqrt([last.covariance[place] for place in (0, 9, 17, 24, 30, 35, 39, 42, 44)])
    names = ("bx", "by", "bz", "D11", "D22", "D33", "D12", "D13", "D23")
    expected = {f"Verdict of {label}": str(last.verdict), "Protection level": f"{last.protection_nt:.0f}"}
    for place, (name, value) in enumerate(zip(names, (*last.bias_nt, *last.D), strict=True)):
        digits = 1 if place < 3 else 5
        expected |= {name: f"{value:.{digits}f}", f"{name} 3 sigma": f"{3.0 * sigma[place]:.{digits}f}"}
    assert {name: shown[name][0] for name in expected} == expected
    assert COLOURS[last.verdict] in shown[f"Verdict of {label}"][1]
    assert ("unprotected" in last.reasons) == ("is-limit--red" in shown["Protection level"][1])
    return len(expected)


async def check_history(page: Tab, recording: Any, estimates: list[Estimate]) -> int:
    """Compare what Open MCT gets of the past with the recording's samples and the replay's results; how many values."""
    label = estimates[-1].craft
    measured = dict(
        zip(
            np.round(recording.time_ns * 1e-6).tolist(),
            np.linalg.norm(recording.field_body_nt, axis=1).tolist(),
            strict=True,
        )
    )
    before = await history(page, f"{label}.before")
    assert len(before) >= len(measured) - 2, (len(before), len(measured))
    assert all(abs(one["value"] - measured[round(one["utc"])]) <= 0.051 for one in before)
    by_time = {round(one.time_ns * 1e-6): one for one in estimates}
    results = await history(page, f"{label}.bz")
    assert len(results) > 300, len(results)
    assert all(one["value"] == by_time[round(one["utc"])].bias_nt[2] for one in results)
    verdicts = await history(page, f"{label}.verdict")
    assert all(list(Verdict)[one["value"]] is by_time[round(one["utc"])].verdict for one in verdicts)
    return len(before) + len(results) + len(verdicts)


async def of_a_link(folder: Path, page: Tab) -> str:
    """A live value that changes, silence that is seen, and a server that comes back."""
    offer = Offer(openmct=folder)
    async with served("openmct", offer) as (address, daemon, node):
        await page.anew()  # the end of the other server is a complaint of its page
        fly(daemon, node, range(60))
        await page.call("Page.navigate", url=f"{address}openmct/")
        await page.until(f"({ROWS}).bx?.[0] === '3000.0'", 60.0)
        begun = time.monotonic()
        daemon.send(changed(estimate(61), bias_nt=(1234.5, 0.0, 0.0)))
        await page.until(f"({ROWS}).bx[0] === '1234.5'")
        follows_s = time.monotonic() - begun
        assert "is-stale" not in (await rows(page))["bx"][1]
        await page.until(f"({ROWS}).bx[1].includes('is-stale')", 20.0)
        check_console(page, address)
    port = int(address.rstrip("/").rpartition(":")[2])
    async with served("openmct again", offer, port) as (_, daemon, node):
        begun = time.monotonic()
        fly(daemon, node, range(100, 110))
        daemon.send(changed(estimate(110), bias_nt=(77.0, 0.0, 0.0)))
        await page.until(f"({ROWS}).bx[0] === '77.0' && !({ROWS}).bx[1].includes('is-stale')", 20.0)
        back_s = time.monotonic() - begun
    return (
        f"live: a new value is on the screen after {follows_s:.1f} s, and called stale when no other comes; "
        f"{back_s:.1f} s after a restart of `magcal view` the next one is there"
    )


async def main() -> None:
    """Run both and print what was seen; AssertionError for what differs."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "folder", nargs="?", type=Path, default=ROOT / "deploy/openmct", help="with node_modules/openmct"
    )
    parser.add_argument("--picture", type=Path, help="also write the overview of the recording as WebP or PNG")
    options = parser.parse_args()
    package = options.folder / "node_modules/openmct/package.json"
    if not package.is_file():
        parser.error(f"{package} is missing: run `npm install openmct` in {options.folder}")
    print(f"Open MCT {json.loads(package.read_text(encoding='utf-8'))['version']}")
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        async with tab(Path(profile)) as page:
            await page.size(1440, 900)
            print(await of_a_recording(options.folder, page, options.picture), flush=True)
            print(await of_a_link(options.folder, page), flush=True)


if __name__ == "__main__":
    asyncio.run(main())
