"""The page in a browser: what it shows and asks for, and that everybody can use it."""

from __future__ import annotations

import asyncio
import json
import shutil
from collections.abc import Callable, Coroutine, Iterator
from typing import Any

import numpy as np
import pytest

pytest.importorskip("aiohttp", reason="the extra view is not installed")

from magcal_service.views.colours import DARK, LIGHT
from magcal_service.views.server import Offer
from tests.views.browser import Tab, tab
from tests.views.node_packages import node_package
from tests.views.test_view_page import fly, served
from tests.views.view_messages import status

AXE = node_package("axe-core")
RULES = ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa", "best-practice"]
SIZES = {"desktop": (1280, 900), "phone": (390, 844)}
needs_chromium = pytest.mark.skipif(shutil.which("chromium") is None, reason="chromium is not installed")


class Browser:
    """One browser for all tests here, which start from an empty page."""

    def __init__(self, runner: asyncio.Runner, page: Tab) -> None:
        self._runner, self._page = runner, page

    def run(self, look: Callable[[Tab], Coroutine[Any, Any, None]]) -> None:
        """Look at a page."""
        self._runner.run(self._page.anew())
        self._runner.run(look(self._page))


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    """A browser."""
    with asyncio.Runner() as runner:
        opened = tab(tmp_path_factory.mktemp("profile"))
        page = runner.run(opened.__aenter__())
        yield Browser(runner, page)
        runner.run(opened.__aexit__(None, None, None))


@pytest.fixture(autouse=True)
def _hurry(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("magcal_service.views.server.UPDATE_S", 0.1)


async def violations(page: Tab) -> list[list[object]]:
    """What axe-core finds on the page as it stands: rule, and the elements that break it."""
    asked = f"axe.run(document, {{runOnly: {json.dumps(RULES)}}})"
    found = "(done) => JSON.stringify(done.violations.map((one) => [one.id, one.nodes.map((node) => node.html)]))"
    broken: list[list[object]] = json.loads(await page.awaited(f"{asked}.then({found})"))
    return broken


@needs_chromium
@pytest.mark.skipif(AXE is None, reason="axe-core is not installed: npm install --prefix build/node --no-save axe-core")
def test_axe_finds_nothing_light_or_dark_on_a_desk_or_a_phone(browser: Browser) -> None:
    async def look(page: Tab) -> None:
        assert AXE is not None
        async with served("axe") as (address, daemon, node):
            fly(daemon, node, range(100))
            daemon.send(
                status(100, "model doubtful: heat; run: magcal diagnose RECORDING; last event: reset (by hand)")
            )
            await page.call("Page.navigate", url=address)
            await page.until("document.getElementById('spectrum-says')?.textContent.includes('rpm')")
            await page.call("Runtime.evaluate", expression=(AXE / "axe.min.js").read_text(encoding="utf-8"))
            for name, (width, height) in SIZES.items():
                for scheme in ("light", "dark"):
                    await page.size(width, height, scheme)
                    assert await violations(page) == [], (name, scheme)
            await page.until("document.body.classList.contains('stale')", 60.0)
            for scheme in ("light", "dark"):
                await page.size(*SIZES["desktop"], scheme)
                assert await violations(page) == [], f"stale, {scheme}"
            await page.value("document.documentElement.removeAttribute('lang')")
            await page.value("document.getElementById('method').style.color = '#777'")
            assert {one[0] for one in await violations(page)} == {"color-contrast", "html-has-lang"}

    browser.run(look)


@needs_chromium
def test_a_zoom_stays_while_data_come_and_the_page_while_its_server_restarts(browser: Browser) -> None:
    async def look(page: Tab) -> None:
        press = "(k => document.getElementById('field').dispatchEvent(new KeyboardEvent('keydown', {key: k})))"
        scale = "[fieldPlot.plot.scales.x.min, fieldPlot.plot.scales.x.max]"
        async with served("zoom") as (address, daemon, node):
            fly(daemon, node, range(101))
            await page.call("Page.navigate", url=address)
            await page.until("document.getElementById('field-says')?.textContent.includes('0:01:40')")
            await page.value(f"for (let i = 0; i < 50; i++) {press}('ArrowLeft'); {press}('+')")
            assert await page.until(f"fieldPlot.zoom() && {scale}") == [25.0, 75.0]
            assert await page.value("fieldPlot.plot.cursor.idx") == 50
            fly(daemon, node, range(101, 111))
            await page.until("document.getElementById('field-says').textContent.includes('0:01:50')")
            assert await page.value(scale) == [25.0, 75.0]
            await page.value(f"{press}('0')")
            assert await page.until(f"!fieldPlot.zoom() && {scale}") == [0.0, 110.0]
        port = int(address.rstrip("/").rpartition(":")[2])
        async with served("zoom again", port=port) as (_, daemon, node):
            fly(daemon, node, range(8))
            await page.until("document.getElementById('field-says').textContent.includes('0:00:07')")
            assert await page.value("document.getElementById('life').textContent") == "live"
            assert await page.value(scale) == [0.0, 7.0]

    browser.run(look)


@needs_chromium
def test_a_browser_shows_it_follows_it_and_asks_nobody_else(browser: Browser) -> None:
    async def look(page: Tab) -> None:
        async with served("browser", Offer(commands=True)) as (address, daemon, node):
            fly(daemon, node, range(100))
            fly(daemon, node, range(5), "other")
            daemon.send(
                status(100, "model doubtful: heat <b>; run: magcal diagnose RECORDING; last event: <i>reset</i>")
            )
            await page.size(360, 800)
            await page.call("Page.navigate", url=address)
            text = "(document.body?.innerText ?? '')"
            await page.until(f"{text}.includes('magcal diagnose RECORDING')")
            await page.until("document.getElementById('spectrum-says').textContent.includes('rpm')")
            shown = await page.value(text)
            for words in (
                "TRUSTED",
                "3000.0",
                "120 nT before anything notices",
                "heat <b>",
                "<i>reset</i>",
                "rms 40.0 nT after",
                "at 6.00 rpm",
                "LIVE",
            ):
                assert words in shown
            assert await page.value("document.querySelectorAll('#field canvas, #residual canvas').length") == 2
            assert await page.value("document.querySelectorAll('main i').length") == 0  # words of a link are no markup
            assert await page.value("document.documentElement.scrollWidth") == 360
            fly(daemon, node, range(110, 130))
            await page.until("document.getElementById('field-says').textContent.includes('0:02:09')")
            assert (
                await page.value("[99, 100, 101].map(i => fieldPlot.data[2][i] === null).join()") == "false,true,false"
            )
            await page.value(
                "(s => {s.value = 'other'; s.dispatchEvent(new Event('change'))})(document.getElementById('choice'))"
            )
            await page.until("document.getElementById('field-says').textContent.includes('0:00:04')")
            # One call changes what the page holds and reads it: the next answer of the server undoes the change.
            shown_now = "['life', 'stale', 'verdict'].map(i => document.getElementById(i).textContent).join('|')"
            assert await page.value(
                f"Object.assign(newest.list[1], {{age_s: 99, is_stale: true}}); life(); {shown_now} + document.title"
            ) == ("stale|Nothing new of other for 99 s; what is shown is old.|was trustedwas trusted: other")
            assert (await page.value(f"heardMs = Date.now() - 9000; life(); {shown_now}")).startswith(
                "page lost|No answer from magcal view for 9 s"
            )
            unnamed = (
                "[...document.querySelectorAll('canvas[tabindex],select,[role=img]')].filter(e => !e.ariaLabel).length"
            )
            assert await page.value(unnamed) == 0
            assert page.complaints == []
            assert all(url.startswith((address, "about:", "data:")) for url in page.requests)
            assert len(page.requests) > 8

    browser.run(look)


# Linear RGB as eyes without one kind of cone see it: Machado, Oliveira and Fernandes (2009), severity 1.
BLIND = {
    "protan": ((0.152286, 1.052583, -0.204868), (0.114503, 0.786281, 0.099216), (-0.003882, -0.048116, 1.051998)),
    "deutan": ((0.367322, 0.860646, -0.227968), (0.280085, 0.672501, 0.047413), (-0.011820, 0.042940, 0.968881)),
    "tritan": ((1.255528, -0.076749, -0.178779), (-0.078411, 0.930809, 0.147602), (0.004733, 0.691367, 0.303900)),
    "none": ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
}


def lightness_and_hue(colour: str, eye: str) -> np.ndarray:
    """A colour as CIE L*a*b*, D65, seen by such an eye."""
    levels = np.array([int(pair, 16) for pair in (colour[1:3], colour[3:5], colour[5:7])]) / 255.0
    linear = np.where(levels <= 0.04045, levels / 12.92, ((levels + 0.055) / 1.055) ** 2.4)
    seen = np.clip(np.array(BLIND[eye]) @ linear, 0.0, 1.0)
    to_xyz = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
    x, y, z = np.cbrt(np.maximum(to_xyz @ seen / np.array([0.9505, 1.0, 1.089]), 0.008856))
    return np.array([116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)])


@pytest.mark.parametrize("eye", BLIND)
@pytest.mark.parametrize("colours", [LIGHT, DARK], ids=["light", "dark"])
@pytest.mark.parametrize(("one", "other"), [("before", "after"), ("before", "ink"), ("after", "ink")])
def test_what_is_drawn_together_is_told_apart_without_one_kind_of_cone(
    colours: dict[str, str], eye: str, one: str, other: str
) -> None:
    apart = np.linalg.norm(lightness_and_hue(colours[one], eye) - lightness_and_hue(colours[other], eye))
    assert apart > 25.0  # ten times what is just told apart
