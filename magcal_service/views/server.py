"""The page on 127.0.0.1: its files, and updates as server-sent events (extra ``view``)."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

from magcal_service.base.errors import ExtraMissingError, Fault, InputRefusedError, why_not
from magcal_service.views import PAGE
from magcal_service.views.feed import Feed
from magcal_service.views.sources import COMMANDS, Source
from magcal_service.views.state import Views
from magcal_service.views.telemetry import Telemetry

try:
    from aiohttp import web
except ImportError as _missing:
    raise ExtraMissingError("aiohttp", "view", "a live page") from _missing

ADDRESS: Final = "127.0.0.1"
UPDATE_S: Final = 0.5
"""Between two updates of a page [s]."""

MOST_READERS: Final = 16
"""Pages that are served updates at once."""

_TYPES: Final = {
    "html": "text/html",
    "css": "text/css",
    "js": "text/javascript",
    "txt": "text/plain",
    "svg": "image/svg+xml",
}
_NAMES: Final = ("127.0.0.1", "localhost")  # a page of elsewhere whose name was made to lead here has another one
_HEADERS: Final = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; "
    "img-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cache-Control": "no-store",
}
_OPENMCT: Final = "/openmct"
_OPENMCT_POLICY: Final = (
    "default-src 'none'; script-src 'self' 'unsafe-eval'; style-src 'self' 'unsafe-inline'; connect-src 'self'; "
    "img-src 'self' data:; font-src 'self' data:; worker-src 'self'; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'none'"
)
"""Open MCT compiles its own templates and sets styles as it runs; from elsewhere it gets nothing either."""

_END: Final = b"\nretry: 1000\n\n"  # of an update; a reader that is cut off asks again after a second

_Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]
_Update = Callable[[Views, float], dict[str, Any]]


@dataclass(frozen=True, slots=True)
class Offer:
    """What is served beside the page itself, and to whom.

    Parameters
    ----------
    commands: whether the page may give ``COMMANDS``.
    openmct: folder of an Open MCT with the plugin, served below ``/openmct/``; None for none.
    origins: web origins elsewhere, such as ``http://127.0.0.1:8080``, that may read ``/telemetry``.
    """

    commands: bool = False
    openmct: Path | None = None
    origins: tuple[str, ...] = ()


class Page:
    """The handlers of one source's page."""

    def __init__(self, source: Source, offer: Offer) -> None:
        self._source, self._offer = source, offer
        self._commands = COMMANDS if offer.commands else ()
        self._readers = 0

    def application(self) -> web.Application:
        """What aiohttp serves."""
        app = web.Application(middlewares=[web.middleware(_guarded)], client_max_size=4096)
        for file in sorted(PAGE.iterdir()):
            app.router.add_get(
                "/" if file.name == "index.html" else f"/{file.name}", _file(file.read_bytes(), file.name)
            )
        app.router.add_get("/events", self.events)
        app.router.add_get("/telemetry", self.telemetry)
        if self._commands:
            app.router.add_post("/command", self.command)
        if self._offer.openmct is not None:
            index = (self._offer.openmct / "index.html").read_bytes()
            app.router.add_get(f"{_OPENMCT}/", _file(index, "index.html"))
            app.router.add_static(f"{_OPENMCT}/", self._offer.openmct)
        return app

    async def events(self, request: web.Request) -> web.StreamResponse:
        """Updates of the magnetometer that ``of`` names, until the reader goes."""
        return await self._stream(request, Feed(request.query.get("of", "")).update)

    async def telemetry(self, request: web.Request) -> web.StreamResponse:
        """Updates of every magnetometer, until the reader goes; other origins that are allowed may read them."""
        origin = request.headers.get("Origin", "")
        allowed = {"Access-Control-Allow-Origin": origin} if origin in self._offer.origins else {}
        return await self._stream(request, Telemetry().update, {"Vary": "Origin"} | allowed)

    async def _stream(
        self, request: web.Request, update: _Update, headers: Mapping[str, str] = MappingProxyType({})
    ) -> web.StreamResponse:
        if self._readers >= MOST_READERS:
            raise web.HTTPServiceUnavailable(text=f"{MOST_READERS} pages are open already; close one")
        response = web.StreamResponse(headers={"Content-Type": "text/event-stream", **_HEADERS, **headers})
        self._readers += 1
        try:
            await response.prepare(request)
            while True:
                await response.write(b"data: " + json.dumps(self._content(update), allow_nan=False).encode() + _END)
                await asyncio.sleep(UPDATE_S)
        except ConnectionError:
            return response
        finally:
            self._readers -= 1

    def _content(self, update: _Update) -> dict[str, Any]:
        with self._source.lock:
            told = update(self._source.views, time.monotonic())
        return told | {"origin": asdict(self._source.origin), "commands": self._commands}

    async def command(self, request: web.Request) -> web.Response:
        """Give a command: ``{"craft": ..., "name": ...}``, of this page only."""
        if request.headers.get("Origin") != f"http://{request.host}" or request.content_type != "application/json":
            raise web.HTTPForbidden(text="commands are taken from the page itself only")
        try:
            asked = await request.json()
            craft, name = asked["craft"], asked["name"]
        except (ValueError, KeyError, TypeError):
            raise web.HTTPBadRequest(text='{"craft": NAME, "name": COMMAND} is accepted') from None
        with self._source.lock:
            is_known = isinstance(craft, str) and craft in self._source.views.crafts
        if not is_known or name not in self._commands:
            raise web.HTTPBadRequest(text=f"a craft that is shown, and one of {', '.join(self._commands)} are accepted")
        if not self._source.give(craft, name):
            raise web.HTTPServiceUnavailable(text="nobody is there to carry it out")
        return web.Response(status=202)


def _file(content: bytes, name: str) -> _Handler:
    kind = _TYPES[name.rpartition(".")[2]]

    async def handler(request: web.Request) -> web.Response:
        return web.Response(body=content, content_type=kind, charset="utf-8")

    return handler


async def _guarded(request: web.Request, handler: _Handler) -> web.StreamResponse:
    """Refuse who asks by another name than this machine's own, and set the headers of every answer."""
    if request.url.host not in _NAMES:
        return web.Response(
            status=403, text=f"{', '.join(_NAMES)} are accepted as this page's address", headers=_HEADERS
        )
    try:
        response = await handler(request)
    except web.HTTPException as refused:
        refused.headers.update(_HEADERS)
        raise
    if not response.prepared:
        response.headers.update(_HEADERS)
        if request.path.startswith(f"{_OPENMCT}/"):
            response.headers["Content-Security-Policy"] = _OPENMCT_POLICY
    return response


async def serve(source: Source, port: int, offer: Offer, served: Callable[[str], None], stopped: asyncio.Event) -> None:
    """Serve the page until ``stopped`` is set.

    Parameters
    ----------
    source: not started yet; it is stopped at the end.
    port: on 127.0.0.1; 0 for one that is free.
    offer: what is served beside the page itself.
    served: is called with the page's address once it is.

    Raises ``InputRefusedError`` for a port that is taken.
    """
    runner = web.AppRunner(Page(source, offer).application(), access_log=None, shutdown_timeout=0.5)
    await runner.setup()
    try:
        try:
            await web.TCPSite(runner, ADDRESS, port).start()
        except OSError as error:
            accepted = f"{why_not(error)}; give another one, or 0 for one that is free"
            raise InputRefusedError([Fault("--port", port, accepted)]) from None
        source.start()
        served(f"http://{ADDRESS}:{runner.addresses[0][1]}/")
        await stopped.wait()
    finally:
        await asyncio.to_thread(source.stop)
        await runner.cleanup()
