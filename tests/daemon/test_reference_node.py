"""``magcal reference``: the field along element sets, or at the positions that a craft sends, arrives at its daemon."""

from __future__ import annotations

import itertools
import math
import threading
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from magcal_service.base.errors import InputRefusedError
from magcal_service.daemon.reference_node import SOURCE, Elements, cost_of, run_along, run_beside
from magcal_service.earth.geomagnetic import igrf_eci_nt
from magcal_service.earth.orbit_elements import checksum
from magcal_service.links import Role, open_link
from magcal_service.wire.messages import Clock, Frame, PositionSample, ReferenceSample
from tests.cli.cli_inputs import run

SETS = """ISS
1 25544U 98067A   08264.51782528 -.00002182  00000-0 -11606-4 0  2927
2 25544  51.6416 247.4627 0006703 130.5360 325.0288 15.72125391563537
"""
EPOCH_NS = round(datetime(2008, 9, 20, 12, 25, 40, tzinfo=UTC).timestamp()) * 10**9
DAY_NS = 86_400 * 10**9


@pytest.fixture
def elements(tmp_path: Path) -> Elements:
    (tmp_path / "iss.tle").write_text(SETS)
    return Elements(tmp_path / "iss.tle", 3.0)


class Stop(threading.Event):
    """Set when it has been asked so often."""

    def __init__(self, times: int) -> None:
        super().__init__()
        self._left = times

    def is_set(self) -> bool:
        self._left -= 1
        return self._left < 0


def test_the_field_along_element_sets_is_the_models(elements: Elements) -> None:
    clock = itertools.count(EPOCH_NS, 10**9)
    with open_link("loop:tle", Role.SERVICE) as service, open_link("loop:tle", Role.NODE) as node:
        sent = run_along(node, "iss", elements, 1000.0, Stop(4), lambda: next(clock))
        messages = service.receive(0.1)
    places = [one for one in messages if isinstance(one, PositionSample)]
    fields = [one for one in messages if isinstance(one, ReferenceSample)]
    assert sent.references == len(places) == len(fields) == 4
    assert [one.time_ns - EPOCH_NS for one in fields] == [0, 10**9, 2 * 10**9, 3 * 10**9]
    assert [(one.source, one.sequence, one.frame) for one in fields] == [(SOURCE, n, Frame.ECI) for n in range(4)]
    radius = [float(np.linalg.norm(one.position_km)) for one in places]
    assert all(6700.0 < one < 6750.0 for one in radius)  # the station flew at 350 km then
    steps = np.linalg.norm(np.diff([one.position_km for one in places], axis=0), axis=1)
    np.testing.assert_allclose(steps, 7.69, atol=0.05)  # [km] in a second
    model = igrf_eci_nt(np.array([one.time_ns for one in places]), np.array([one.position_km for one in places]))
    np.testing.assert_allclose([one.field_nt for one in fields], model, rtol=0.0, atol=1e-6)


def test_nothing_is_sent_by_sets_that_are_too_old(elements: Elements) -> None:
    with open_link("loop:old", Role.SERVICE) as service, open_link("loop:old", Role.NODE) as node:
        sent = run_along(node, "iss", elements, 1000.0, Stop(3), lambda: EPOCH_NS + 4 * DAY_NS)
        assert service.receive(0.05) == []
    assert (sent.references, sent.refused) == (0, {"old_elements": 3})
    with pytest.raises(InputRefusedError, match=r"4\.0 days from now"):
        elements.refuse_old(EPOCH_NS + 4 * DAY_NS)


def test_a_file_that_changes_is_read_again_and_one_that_is_broken_is_not_used(elements: Elements) -> None:
    before = elements.position("iss", 0, EPOCH_NS)
    elements.path.write_text("ISS\nnothing\n")
    elements.refresh(EPOCH_NS)
    assert elements.position("iss", 0, EPOCH_NS) == before
    first, second = SETS.splitlines()[1:]

    def write(first: str, second: str) -> None:
        lines = [f"{line[:68]}{checksum(line)}" for line in (first, second)]
        elements.path.write_text("\n".join([*lines, ""]))
        elements.refresh(EPOCH_NS)

    write(first.replace("25544", "25545"), second.replace("25544", "25545"))  # of another craft
    assert elements.position("iss", 0, EPOCH_NS) == before
    write(f"{first[:20]}165{first[23:]}", second)  # a hundred days old
    assert elements.position("iss", 0, EPOCH_NS) == before
    write(f"{first[:20]}265{first[23:]}", second)  # of the next day
    assert elements.age_days(EPOCH_NS) == pytest.approx(1.0, abs=1e-3)


def test_the_field_at_positions_that_are_heard() -> None:
    place = PositionSample(
        craft="one", source="gps", sequence=9, time_ns=EPOCH_NS, clock=Clock.UTC,
        position_km=(6900.0, 0.0, 0.0), frame=Frame.ECI,
    )  # fmt: skip
    others = (replace(place, craft="two"), replace(place, source=SOURCE), replace(place, clock=Clock.ELAPSED))
    with (
        open_link("loop:gps", Role.SERVICE) as service,
        open_link("loop:gps", Role.NODE) as craft,
        open_link("loop:gps", Role.NODE) as node,
        open_link("loop:gps", Role.VIEWER) as heard,
    ):
        for one in (place, *others):
            craft.send(one)
        sent = run_beside(node, heard, "one", Stop(2))
        (reference,) = (one for one in service.receive(0.1) if isinstance(one, ReferenceSample))
    assert (reference.craft, reference.time_ns) == ("one", EPOCH_NS)
    assert sent.refused == {"position_without_utc": 1}


@pytest.mark.parametrize(("factor", "warnings"), [(1.0, 0), (1.1, 1)])
def test_positions_that_fall_otherwise_than_their_height_says_are_warned_of_once(
    factor: float, warnings: int, caplog: pytest.LogCaptureFixture
) -> None:
    with (
        open_link("loop:falls", Role.SERVICE) as service,
        open_link("loop:falls", Role.NODE) as node,
        open_link("loop:fallen", Role.SERVICE) as heard,
        open_link("loop:fallen", Role.NODE) as craft,
    ):
        for second in range(0, 600, 10):
            angle = 1.1068e-3 * second  # of a circle at 6878 km
            place = (factor * 6878.0 * math.cos(angle), factor * 6878.0 * math.sin(angle), 0.0)
            craft.send(
                PositionSample(
                    craft="one", source="gps", sequence=second, time_ns=EPOCH_NS + second * 10**9, clock=Clock.UTC,
                    position_km=place, frame=Frame.ECI,
                )
            )  # fmt: skip
        assert run_beside(node, heard, "one", Stop(6)).references == 60
        service.receive(0.0)
    assert sum("positions fall 1.33 times" in record.message for record in caplog.records) == warnings


@pytest.mark.parametrize(("days", "words"), [(0.2, "0.2 days from the epoch, about 6 nT"), (9.0, "more than 900 nT")])
def test_what_age_costs_is_said(days: float, words: str) -> None:
    assert words in cost_of(days)


def test_the_command_refuses_what_cannot_give_a_field(tmp_path: Path) -> None:
    old = run("reference", "--craft", "iss", "--tle", tmp_path / "none.tle")
    assert (old.code, "there is no such file" in old.err) == (2, True)
    (tmp_path / "iss.tle").write_text(SETS)
    old = run("reference", "--craft", "iss", "--tle", tmp_path / "iss.tle")
    assert (old.code, "days from now" in old.err, "--max-age-days" in old.err) == (2, True, True)
    line = run("reference", "--craft", "iss", "--link", "serial:/dev/null")
    assert (line.code, "give --tle, or [craft.reference] in the daemon" in line.err) == (2, True)
