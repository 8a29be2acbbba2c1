"""The live page of a flight: what node and daemon say to each other, served beside them (extra ``view``)."""

from __future__ import annotations

import asyncio
import contextlib
import threading
from collections.abc import Iterator
from concurrent.futures import Future

from magcal_service.views.sources import Origin, Source
from magcal_service.views.state import Views
from sim_sensor.demo.report import DemoError

__all__ = ["FlightSource", "live_page"]

_START_S = 30.0  # a slow machine opens a socket well within this
_STOP_S = 5.0  # pages that are open are let go within half a second


class FlightSource(Source):
    """Messages that a flight hands over with ``take``: what is sent to the daemon and what comes back.

    Parameters
    ----------
    address: as the page names the flight.

    A page is fed in this process because a serial line has no end for a viewer.
    """

    def __init__(self, address: str) -> None:
        super().__init__(Views())
        self._address = address
        self.note = ""

    @property
    def origin(self) -> Origin:
        """The flight, and ``note``."""
        return Origin("live", self._address, self.note)

    def _run(self) -> None:
        self._stopped.wait()


@contextlib.contextmanager
def live_page(source: Source, port: int) -> Iterator[str]:
    """Serve the page of a source on 127.0.0.1 while the context lasts; gives its address.

    Parameters
    ----------
    port: 0 for one that is free.

    Raises ``InputRefusedError`` for a port that is taken, ``DemoError`` where the page is not there in time,
    ``ExtraMissingError`` without aiohttp.
    """
    from magcal_service.views.server import Offer, serve

    address: Future[str] = Future()
    handles: Future[tuple[asyncio.AbstractEventLoop, asyncio.Event]] = Future()

    async def until_left() -> None:
        stopped = asyncio.Event()
        handles.set_result((asyncio.get_running_loop(), stopped))
        await serve(source, port, Offer(), served=address.set_result, stopped=stopped)

    def run() -> None:
        try:
            asyncio.run(until_left())
        except BaseException as error:
            if address.done():
                raise
            address.set_exception(error)

    thread = threading.Thread(target=run, name="magcal-page", daemon=True)
    thread.start()
    try:
        try:
            shown = address.result(_START_S)
        except TimeoutError:
            raise DemoError(f"the live page was not served within {_START_S:.0f} s; try again with --no-page") from None
        yield shown
    finally:
        loop, stopped = handles.result(_STOP_S)
        with contextlib.suppress(RuntimeError):  # the loop has ended by itself
            loop.call_soon_threadsafe(stopped.set)
        thread.join(_STOP_S)
