"""Pictures of the live page in docs/view.md, of a simulated flight: ``python -m tests.figures.view``."""

from __future__ import annotations

import asyncio
import tempfile
from pathlib import Path

from magcal_service.offline.replay import craft_of
from magcal_service.recordings.inspect.inspection import inspect
from magcal_service.recordings.reader import read_recording
from magcal_service.views.server import Offer, serve
from magcal_service.views.sources import Flight, ReplaySource
from tests.benchmarks import results
from tests.diagnosis.diagnosis_runs import recorded
from tests.views.browser import tab

SECONDS = 2700.0
SIZES = {"desktop": (1900, 1000), "phone": (390, 844)}
MOST_BYTES = 100_000


async def drawn(folder: Path) -> None:
    """Write each picture; AssertionError for one that is too large for a page."""
    inspection = inspect(read_recording(recorded("paper", SECONDS, folder)))
    source = ReplaySource("flight/RECORDING.toml", [Flight(inspection, craft_of(inspection.to_replay))], 0.0)
    told: asyncio.Future[str] = asyncio.get_running_loop().create_future()
    stopped = asyncio.Event()
    serving = asyncio.create_task(serve(source, 0, Offer(), told.set_result, stopped))
    async with tab(folder / "profile") as page:
        await page.call("Page.navigate", url=await told)
        await page.until("document.getElementById('life')?.textContent === 'replay ended'", 60.0)
        for device, (width, height) in SIZES.items():
            for scheme in ("light", "dark"):
                await page.size(width, height, scheme)
                await page.until("document.getElementById('spectrum-says').textContent.includes('rpm')")
                await asyncio.sleep(1.0)  # plots take their new width a moment later
                path = results.FOLDER / f"view-{device}-{scheme}.webp"
                await page.picture(path)
                size = path.stat().st_size
                assert size < MOST_BYTES, (path, size)
                print(f"{path.name}: {size / 1000:.0f} kB")
    stopped.set()
    await serving


def main() -> None:
    """Write the pictures and name them."""
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        asyncio.run(drawn(Path(folder)))


if __name__ == "__main__":
    main()
