"""What a live page costs: server memory over two days, browser memory over one, first paint, a long session, 10 Hz.

python -m tests.benchmarks.bench_view
"""

from __future__ import annotations

import asyncio
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from magcal_service.links import Link
from magcal_service.views import server
from magcal_service.views.feed import Feed
from magcal_service.views.state import Views
from tests.views.browser import Tab, tab
from tests.views.test_view_page import fly, served
from tests.views.view_messages import estimate, second_of

DAY_S, HOUR_S = 86_400, 3600
FED_S, WAITED_S = 40, 400  # samples that are sent at once, and after how many the page has to have shown them
SESSION_S = 18_000
WATCHED_S = 15.0


def resident_mb() -> float:
    """Memory of this process [MB]."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096 / 1e6


def two_days() -> tuple[float, float]:
    """Memory [MB] after an hour and after two days of one magnetometer at 1 Hz."""
    views, feed, after_an_hour = Views(), Feed(), 0.0
    for second in range(2 * DAY_S):
        for message in (*second_of(second, ripple_nt=30.0), estimate(second)):
            views.take(message, float(second))
        if second % 60 == 0:
            feed.update(views, float(second))
        if second == 3600:
            after_an_hour = resident_mb()
    return after_an_hour, resident_mb()


async def busy_s(page: Tab) -> float:
    """Time that the page's thread has worked [s]."""
    metrics = (await page.call("Performance.getMetrics"))["metrics"]
    return float(next(one["value"] for one in metrics if one["name"] == "TaskDuration"))


async def ten_a_second(daemon: Link, node: Link, start: int) -> None:
    """Send a sample each tenth of a second, without end."""
    second = start
    while True:
        fly(daemon, node, range(second, second + 1))
        second += 1
        await asyncio.sleep(0.1)


async def in_a_browser() -> tuple[float, float, float]:
    """First paint [s], time until a long session is drawn [s], share of a core at ten samples a second."""
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        async with served("bench") as (address, daemon, node), tab(Path(folder)) as page:
            for start in range(0, SESSION_S, 500):
                fly(daemon, node, range(start, start + 500))
                await asyncio.sleep(0.3)
            begun = time.monotonic()
            await page.call("Page.navigate", url=address)
            await page.until("document.getElementById('sphere-says')?.textContent.includes('%')")
            drawn_s = time.monotonic() - begun
            paint_ms = await page.value("performance.getEntriesByName('first-contentful-paint')[0].startTime")
            await page.call("Performance.enable")
            sending = asyncio.create_task(ten_a_second(daemon, node, SESSION_S))
            before = await busy_s(page)
            await asyncio.sleep(WATCHED_S)
            busy = (await busy_s(page) - before) / WATCHED_S
            sending.cancel()
    return paint_ms * 1e-3, drawn_s, busy


@dataclass(frozen=True, slots=True)
class Held:
    """What a page holds after garbage was collected: the heap of its script [MB], elements, and listeners."""

    heap_mb: float
    elements: int
    listeners: int

    def __str__(self) -> str:
        return f"{self.heap_mb:.1f} MB, {self.elements} elements, {self.listeners} listeners"


async def held(page: Tab) -> Held:
    """What a page holds now."""
    await page.call("HeapProfiler.collectGarbage")
    told = {one["name"]: one["value"] for one in (await page.call("Performance.getMetrics"))["metrics"]}
    return Held(told["JSHeapUsedSize"] / 1e6, int(told["Nodes"]), int(told["JSEventListeners"]))


async def a_day_in_a_browser() -> tuple[Held, Held, int]:
    """What a page holds after an hour and after a day at 1 Hz, fed as fast as it draws, and in how many updates."""
    server.UPDATE_S = 0.01  # an update as soon as the one before is drawn; each brings what has come by then
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        async with served("day") as (address, daemon, node), tab(Path(folder)) as page:
            await page.call("Page.navigate", url=address)
            await page.call("Performance.enable")
            await page.until("typeof source !== 'undefined'")
            await page.value("window.updates = 0, source.addEventListener('message', () => updates++), 0")
            seen = []
            for start in range(0, DAY_S, FED_S):
                fly(daemon, node, range(start, start + FED_S))
                await asyncio.sleep(0.02)
                done = start + FED_S
                if done % WAITED_S == 0:
                    shown = f"document.getElementById('field-says').textContent.includes('to {clock(done - 1)}')"
                    await page.until(shown, 60.0)
                if done in (HOUR_S, DAY_S):
                    seen.append(await held(page))
            assert await page.value("rows.whole.length * newest.every") >= DAY_S - 100, "samples were lost on the way"
            updates = await page.value("updates")
    return seen[0], seen[1], updates


def clock(second: int) -> str:
    """A time as the page writes it."""
    return f"{second // 3600}:{second // 60 % 60:02}:{second % 60:02}"


def main() -> None:
    """Print the figures."""
    hour_mb, days_mb = two_days()
    paint_s, drawn_s, busy = asyncio.run(in_a_browser())
    print(f"the server's memory after an hour {hour_mb:.1f} MB, after two days {days_mb:.1f} MB")
    print(f"first paint {paint_s:.2f} s, {SESSION_S} ticks drawn after {drawn_s:.2f} s")
    print(f"at 10 Hz {100 * busy:.1f} % of a core in the browser", flush=True)
    begun = time.monotonic()
    hour, day, updates = asyncio.run(a_day_in_a_browser())
    print(f"the page after an hour {hour}; after a day {day} ({updates} updates in {time.monotonic() - begun:.0f} s)")


if __name__ == "__main__":
    main()
