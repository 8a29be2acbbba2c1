"""The top of a report in docs/diagnosis.md, of that page's own example: ``python -m tests.figures.report``."""

from __future__ import annotations

import asyncio
import contextlib
import os
import tempfile
from pathlib import Path

from PIL import Image

from sim_sensor.cli import main as sim_sensor
from tests.benchmarks import results
from tests.diagnosis.diagnosis_runs import diagnose
from tests.views.browser import tab

WIDTH, HEIGHT = 976, 1730  # two columns of figures, as on a desk, to the end of the first three rows
COLOURS = 64  # of the page's few and what smooths their edges
MOST_BYTES = 100_000


async def drawn(page_file: Path, profile: Path) -> Path:
    """Write the picture of a page; AssertionError for one that is too large for the documentation."""
    path = results.FOLDER / "diagnosis-report.png"
    async with tab(profile) as page:
        await page.size(WIDTH, HEIGHT)
        await page.call("Page.navigate", url=page_file.as_uri())
        await page.until("document.readyState === 'complete'")
        await page.picture(path, whole=False)
    Image.open(path).convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE).save(path, optimize=True)
    assert path.stat().st_size < MOST_BYTES, path.stat().st_size
    return path


def main() -> None:
    """Record, diagnose, draw."""
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder, contextlib.chdir(folder):
        assert sim_sensor(["record", "--scenario", "hot-electronics", "--out", "output/hot"]) == 0
        done = diagnose("output/hot/RECORDING.toml", "--out", "output/hot/diagnosis", drawn=True)
        assert done.code == os.EX_OK, done.err
        path = asyncio.run(drawn(Path("output/hot/diagnosis/report.html").resolve(), Path(folder) / "profile"))
    print(f"{path.name}: {path.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
