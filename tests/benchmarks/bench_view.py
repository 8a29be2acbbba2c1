"""What a live page costs: memory over two days of messages; first paint, a long session drawn, and 10 Hz, in Chromium.

python -m tests.benchmarks.bench_view
"""

from __future__ import annotations

import asyncio
import tempfile
import time
from pathlib import Path

from magcal_service.links import Link
from magcal_service.views.feed import Feed
from magcal_service.views.state import Views
from tests.views.browser import Tab, tab
from tests.views.test_view_page import fly, served
from tests.views.view_messages import estimate, second_of

DAY_S = 86_400
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


def main() -> None:
    """Print the figures."""
    hour_mb, days_mb = two_days()
    paint_s, drawn_s, busy = asyncio.run(in_a_browser())
    print(f"memory after an hour {hour_mb:.1f} MB, after two days {days_mb:.1f} MB")
    print(f"first paint {paint_s:.2f} s, {SESSION_S} ticks drawn after {drawn_s:.2f} s")
    print(f"at 10 Hz {100 * busy:.1f} % of a core in the browser")


if __name__ == "__main__":
    main()
