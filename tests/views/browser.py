"""Chromium without a window, driven over its debugging protocol."""

from __future__ import annotations

import asyncio
import base64
import contextlib
import itertools
import subprocess
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import aiohttp

FLAGS = (
    "--headless",
    "--no-sandbox",
    "--hide-scrollbars",
    "--disable-gpu",
    "--disable-background-networking",
    "--no-first-run",
    "--remote-debugging-port=0",
)


class Tab:
    """One page: what it asked for, what it complained of, and what an expression in it is."""

    def __init__(self, socket: aiohttp.ClientWebSocketResponse) -> None:
        self._socket = socket
        self._numbers = itertools.count(1)
        self._answers: dict[int, asyncio.Future[dict[str, Any]]] = {}
        self.requests: list[str] = []
        self.complaints: list[str] = []

    async def listen(self) -> None:
        """Take what the browser sends, to its end."""
        async for message in self._socket:
            told = message.json()
            if "id" in told:
                self._answers.pop(told["id"]).set_result(told)
                continue
            name, what = told["method"], told["params"]
            if name == "Network.requestWillBeSent":
                self.requests.append(what["request"]["url"])
            elif name == "Runtime.exceptionThrown" or (
                name == "Runtime.consoleAPICalled" and what["type"] in ("error", "warning")
            ):
                self.complaints.append(str(what))
            elif name == "Log.entryAdded" and what["entry"]["level"] in ("error", "warning"):
                self.complaints.append(str(what["entry"]))

    async def call(self, method: str, **parameters: object) -> dict[str, Any]:
        """A method of the protocol; its result."""
        number = next(self._numbers)
        self._answers[number] = asyncio.get_running_loop().create_future()
        await self._socket.send_json({"id": number, "method": method, "params": parameters})
        answer = await asyncio.wait_for(self._answers[number], 20.0)
        assert "result" in answer, answer
        result: dict[str, Any] = answer["result"]
        return result

    async def anew(self) -> None:
        """An empty page, and nothing remembered of the one before."""
        await self.call("Page.navigate", url="about:blank")
        self.requests.clear()
        self.complaints.clear()

    async def value(self, expression: str) -> Any:
        """What an expression is in the page."""
        answer = await self.call("Runtime.evaluate", expression=expression, returnByValue=True)
        assert "exceptionDetails" not in answer, answer
        return answer["result"].get("value")

    async def awaited(self, expression: str) -> Any:
        """What the promise that an expression is in the page comes to."""
        answer = await self.call("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in answer, answer
        return answer["result"].get("value")

    async def until(self, expression: str, timeout_s: float = 10.0) -> Any:
        """What an expression is once it is true."""
        async with asyncio.timeout(timeout_s):
            while not (value := await self.value(expression)):
                await asyncio.sleep(0.05)
        return value

    async def size(self, width: int, height: int, scheme: str = "light") -> None:
        """Show the page in so many pixels, light or dark."""
        await self.call(
            "Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=width < 500
        )
        features = [{"name": "prefers-color-scheme", "value": scheme}]
        await self.call("Emulation.setEmulatedMedia", features=features)

    async def picture(self, path: Path, whole: bool = True) -> None:
        """Write the page, or what of it is in sight, as PNG or WebP, whichever the name says."""
        kind = {"format": "webp", "quality": 70} if path.suffix == ".webp" else {"format": "png"}
        shot = await self.call("Page.captureScreenshot", captureBeyondViewport=whole, **kind)
        path.write_bytes(base64.b64decode(shot["data"]))


@contextlib.asynccontextmanager
async def tab(folder: Path) -> AsyncIterator[Tab]:
    """A browser with one empty page; its profile is in ``folder``."""
    command = ["chromium", *FLAGS, f"--user-data-dir={folder}", "about:blank"]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        place = folder / "DevToolsActivePort"
        async with asyncio.timeout(20.0):
            while not (place.is_file() and place.read_text().count("\n")):
                await asyncio.sleep(0.05)
        port = place.read_text().split()[0]
        async with aiohttp.ClientSession() as session:
            async with session.get(f"http://127.0.0.1:{port}/json/list") as response:
                address = next(one for one in await response.json() if one["type"] == "page")["webSocketDebuggerUrl"]
            async with session.ws_connect(address, max_msg_size=0) as socket:
                page = Tab(socket)
                listening = asyncio.create_task(page.listen())
                for domain in ("Network", "Runtime", "Log", "Page"):
                    await page.call(f"{domain}.enable")
                yield page
                listening.cancel()
    finally:
        process.terminate()
        process.wait(10.0)
