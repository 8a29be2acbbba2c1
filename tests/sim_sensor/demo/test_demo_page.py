"""The live page of a flight: fed by hand, asked over HTTP."""

from __future__ import annotations

import json
import socket
from urllib.request import urlopen

import pytest

from magcal_service.base.errors import InputRefusedError
from magcal_service.wire.messages import Status, Verdict
from sim_sensor.demo.page import FlightSource, live_page


def test_the_page_shows_what_the_flight_hands_over_and_goes_with_it() -> None:
    source = FlightSource("the flight")
    source.take(Status(craft="sat", source="magcal", sequence=0, time_ns=1, uptime_s=0.0, verdict=Verdict.TRUSTED))
    with live_page(source, 0) as address:
        with urlopen(f"{address}events", timeout=10.0) as answer:
            update = json.loads(answer.readline().removeprefix(b"data: "))
        assert (update["label"], update["result"]["verdict"]) == ("sat", "trusted")
        assert update["origin"]["address"] == "the flight"
    with pytest.raises(OSError, match="refused"):
        urlopen(address, timeout=10.0)


def test_a_port_that_is_taken_is_refused() -> None:
    with socket.socket() as holder:
        holder.bind(("127.0.0.1", 0))
        holder.listen()
        port = holder.getsockname()[1]
        with (
            pytest.raises(InputRefusedError, match=f"{port}.*0 for one that is free"),
            live_page(FlightSource(""), port),
        ):
            pass
