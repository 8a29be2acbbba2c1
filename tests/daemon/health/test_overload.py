"""An overload is told when it begins and when it is over, with how many messages it has cost."""

from __future__ import annotations

from collections import Counter

from magcal_service.config.settings import Config, CraftConfig
from magcal_service.daemon.health.overload import Overload
from magcal_service.daemon.service import Service
from magcal_service.links import Role, open_link
from magcal_service.wire.messages import Status


def test_it_begins_with_the_first_that_is_shed_and_ends_10_s_after_the_last() -> None:
    shed, now = Counter({"one": 0, "two": 0}), [0.0]
    overload = Overload(shed, lambda: now[0])
    assert overload.changes() == []
    shed["one"], now[0] = 5, 1.0
    assert overload.changes() == [("one", True, "5 messages shed so far, the oldest in the queue")]
    shed["one"], now[0] = 12, 9.0
    assert overload.changes() == []
    assert (overload.trouble("one"), overload.trouble("two")) == ("overloaded: 12 messages shed", "")
    now[0] = 18.9
    assert overload.changes() == []
    now[0] = 19.0
    assert overload.changes() == [("one", False, "12 messages shed, none for 10 s")]
    assert overload.trouble("one") == ""


def test_the_next_one_counts_from_its_own_beginning() -> None:
    shed, now = Counter({"one": 7}), [0.0]
    overload = Overload(shed, lambda: now[0])
    overload.changes()
    now[0] = 10.0
    overload.changes()
    shed["one"] = 9
    assert overload.changes() == [("one", True, "2 messages shed so far, the oldest in the queue")]


def test_event_status_and_metric_say_it() -> None:
    crafts = (CraftConfig("one"), CraftConfig("two"))
    with (
        open_link("loop:overload", Role.SERVICE, crafts=["one", "two"]) as link,
        open_link("loop:overload", Role.NODE) as node,
    ):
        service = Service(Config(link.address, crafts), link)
        link.overflows["two"] += 4
        service.report_overload()
        (status,) = (message for message in node.receive(0.0) if isinstance(message, Status))
        metrics = service.health.metrics(service.pipelines.values(), Counter())
    assert status.craft == "two"
    assert "overloaded: 4 messages shed; last event: overloaded (4 messages shed so far" in status.text
    assert 'magcal_messages_shed_total{craft="two"} 4' in metrics
    assert 'magcal_messages_shed_total{craft="one"} 0' in metrics
